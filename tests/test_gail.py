import dataclasses
import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import EXPERT_ACTIONS, N_DECISIONS, SHAPE, WHITENING, agreement, episode, expert, sights, wrong_everywhere

from rail_sumo import config
from rail_sumo.drivers import Learned
from rail_sumo.errors import InputError
from rail_sumo.imitation import gail
from rail_sumo.imitation.discriminator import Discriminator, Fit
from rail_sumo.imitation.perceptron import kept_in_bounds
from rail_sumo.policy import Policy, PolicyParameters, Shape, Whitening

SETTINGS = config.Gail(learning_rate=0.01, batch_size=40, epochs=5, critic_hidden=(8,), discount=0.5)
JUDGE = config.Judge(hidden=(16,), minibatches=20, batch_size=128, learning_rate=0.01)


def ppo(theta=None, seed=0, shape=SHAPE, whitening=WHITENING):
    theta = wrong_everywhere() if theta is None else theta
    return gail.Ppo(theta, shape, whitening, SETTINGS, lowest_reward=-5.0, seed=seed)


def sample(theta, iteration):
    driver = Learned(PolicyParameters(theta, SHAPE, WHITENING, samples=True), seed=iteration)
    return [
        episode(seen, [driver.decide(sight, None) for sight in seen])
        for seen in (sights(1000 * iteration + i) for i in range(4))
    ]


def train(ppo, judge, iterations, first_iteration=1):
    states = gail.train(ppo, expert(), judge=judge, sample=sample, seed=0, first_iteration=first_iteration)
    return list(itertools.islice(states, iterations))


def judge():
    return Discriminator(WHITENING, JUDGE, 0, horizon_decisions=N_DECISIONS)


class Indifferent:
    """A judge to whom all is alike."""

    def fit(self, expert, learner, rng):
        return Fit(0.25, 0.5, 0.5)

    def rewards(self, observations, actions):
        return np.zeros(len(actions))


def test_it_learns_to_do_what_the_expert_does():
    learned = [agreement(train(ppo(seed=seed), judge(), 30)[-1].theta) for seed in range(2)]
    unguided = [agreement(train(ppo(seed=seed), Indifferent(), 30)[-1].theta) for seed in range(2)]
    assert np.mean(learned) > 0.9
    assert np.mean(unguided) < 0.7


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 4]))
def test_the_actor_is_the_policy_it_was_given(seed, hidden):
    shape, rng = Shape(6, hidden), np.random.default_rng(seed)
    theta = rng.normal(size=shape.size)
    whitening = Whitening(rng.normal(size=6), rng.uniform(0.5, 2.0, size=6))
    actor = ppo(theta, shape=shape, whitening=whitening)
    np.testing.assert_allclose(actor.theta(), theta, rtol=1e-6)
    seen = rng.normal(size=(20, 6))
    ours = np.array([Policy(theta, shape, whitening).outputs(sight) for sight in seen])
    whitened = torch.tensor((seen - whitening.mean) / whitening.std, dtype=torch.float32)
    with torch.inference_mode():
        theirs = actor._ppo.policy.get_distribution(whitened).distribution.logits.numpy()
    np.testing.assert_allclose(theirs, ours - np.logaddexp.reduce(ours, axis=1, keepdims=True), atol=1e-5)


def test_rewarded_for_one_action_alone_it_takes_that_more_often():
    def left_alone(observations, actions):
        return (actions == EXPERT_ACTIONS[1]).astype(float)

    improved = ppo()
    for iteration in range(10):
        improved.update(sample(improved.theta(), iteration), left_alone, np.random.default_rng(iteration))
    before, after = (
        np.mean([trajectory.decisions == EXPERT_ACTIONS[1] for trajectory in sample(theta, 99)])
        for theta in (wrong_everywhere(), improved.theta())
    )
    assert after > before + 0.2


@pytest.mark.parametrize(
    ("end_reason", "advantages"),
    [
        # A reward of 1 a decision and half of what follows, less the critic's 2. At the critic's word, what follows the
        # last decision is worth 2; so the last decision is left out.
        ("duration", [0.0, 0.0, 0.0]),
        ("collision", [-0.75, -1.5, -3.0, -6.0]),  # after it -5 for ever: 1 - 5 / 2 / (1 - 1 / 2) = -4
    ],
)
def test_what_follows_a_decision_counts_for_it(end_reason, advantages):
    driven = episode(sights(0, 4), np.zeros(4), end_reason)
    buffer = after_an_update([driven], lambda observations, actions: np.ones(len(actions)))
    np.testing.assert_allclose(buffer.advantages.ravel(), advantages)


def after_an_update(driven, rewards, discount=0.5):
    """PPO's buffer, whose critic says 2 of whatever it sees."""
    settings = SETTINGS.model_copy(update={"gae_lambda": 1.0, "discount": discount})
    learner = gail.Ppo(wrong_everywhere(), SHAPE, WHITENING, settings, lowest_reward=-5.0, seed=0)
    with torch.no_grad():
        learner._ppo.policy.value_net.weight.zero_()
        learner._ppo.policy.value_net.bias.fill_(2.0)
    learner.update(driven, rewards, np.random.default_rng(0))
    return learner._ppo.rollout_buffer


def test_after_a_crash_the_lowest_reward_is_earned_for_ever():
    crashed = episode(sights(0, 2), [0, 0], "collision")
    buffer = after_an_update([crashed], lambda observations, actions: np.ones(2), discount=0.75)
    # 1 - 5 (0.75 + 0.75^2 + ...) = 1 - 15, less the critic's 2; a decision before, 0.75 of that.
    assert buffer.advantages.ravel() == pytest.approx([1.0 - 0.75 * 14.0 - 2.0, 1.0 - 15.0 - 2.0])


def test_no_minibatch_is_of_one_decision():
    """Whose advantage, divided by its spread, would not be finite."""
    learner = ppo()
    driven = episode(sights(0, SETTINGS.batch_size + 1), np.zeros(SETTINGS.batch_size + 1), "collision")
    learner.update([driven], lambda observations, actions: np.ones(len(actions)), np.random.default_rng(0))
    assert np.isfinite(learner.theta()).all()
    assert len(learner._ppo.rollout_buffer.actions) == SETTINGS.batch_size


def test_what_was_not_allowed_is_no_alternative():
    """Of two rollouts that differ in the mask alone, the masked one's policy is updated over what was allowed."""
    seen, allowed = sights(0, 40), np.ones((40, 5), dtype=np.bool_)
    allowed[:, [2, 3, 4]] = False
    driven = episode(seen, np.tile([0, 1], 20))
    masked = dataclasses.replace(driven, allowed=allowed)
    updated = {}
    for name, one in (("open", driven), ("masked", masked)):
        learner = ppo()
        before = learner.theta().reshape(5, 4)
        learner.update([one], lambda observations, actions: (actions == 1).astype(float), np.random.default_rng(0))
        updated[name] = np.abs(learner.theta().reshape(5, 4) - before).max(axis=1)
    assert (updated["masked"][:2] > 0.01).all()
    assert (updated["masked"][2:] < 1e-5).all()
    assert (updated["open"] > 0.01).all()


def test_one_rollout_knows_nothing_of_the_next():
    def rewards(observations, actions):
        return np.where(actions == 1, 7.0, 1.0)

    one, two = episode(sights(0, 4), np.zeros(4)), episode(sights(1, 3), np.ones(3))
    alone = [after_an_update([driven], rewards).advantages.ravel() for driven in (one, two)]
    together = after_an_update([one, two], rewards).advantages.ravel()
    np.testing.assert_allclose(together, np.concatenate(alone), rtol=1e-5)


def test_it_is_paid_for_what_came_of_a_decision_and_taught_about_the_decision():
    refused = episode(sights(0, 4), np.full(4, 3), carried_out=np.zeros(4))
    before = ppo()._ppo.policy
    whitened = torch.tensor((refused.observations - WHITENING.mean) / WHITENING.std, dtype=torch.float32)
    with torch.inference_mode():
        asked = before.get_distribution(whitened).log_prob(torch.full((4,), 3)).numpy()
    buffer = after_an_update([refused], lambda observations, actions: np.asarray(actions, dtype=np.float64))
    assert buffer.rewards.ravel() == pytest.approx([0.0, 0.0, 0.5 * 2.0])  # the critic's word on what comes after
    assert buffer.actions.ravel().tolist() == [3.0] * 3
    np.testing.assert_allclose(buffer.log_probs.ravel(), asked[:3], atol=1e-5)


def test_gone_on_with_it_is_the_same_as_uninterrupted():
    expected = train(ppo(), judge(), 4)
    first_ppo, first_judge = ppo(), judge()
    train(first_ppo, first_judge, 2)
    second_ppo, second_judge = ppo(seed=7), judge()
    second_ppo.load_state(first_ppo.state())
    second_judge.load_state(first_judge.state())
    for state, uninterrupted in zip(train(second_ppo, second_judge, 2, 3), expected[2:], strict=True):
        assert state.iteration == uninterrupted.iteration
        np.testing.assert_array_equal(state.theta, uninterrupted.theta)
        assert state.judge_fit == uninterrupted.judge_fit


def test_a_rollout_of_one_decision_tells_nothing():
    one, more = episode(sights(0, 1), [0]), episode(sights(1), np.zeros(N_DECISIONS))
    learner, same = ppo(), ppo()
    learner.update([one, more], Indifferent().rewards, np.random.default_rng(0))
    same.update([more], Indifferent().rewards, np.random.default_rng(0))
    np.testing.assert_array_equal(learner.theta(), same.theta())
    with pytest.raises(InputError, match="fewer than two decisions to learn from"):
        learner.update([one, one], Indifferent().rewards, np.random.default_rng(0))


def test_the_callers_own_chance_is_left_alone(left_alone_by):
    def learn():
        learner = ppo()
        learner.update([episode(sights(1), np.zeros(N_DECISIONS))], Indifferent().rewards, np.random.default_rng(0))

    assert left_alone_by(learn)


@pytest.mark.parametrize("rate", [1e20, 1e30])
def test_a_training_whose_weights_do_not_stay_finite_is_one_line(rate):
    settings = SETTINGS.model_copy(update={"learning_rate": rate})
    wild = gail.Ppo(wrong_everywhere(), SHAPE, WHITENING, settings, lowest_reward=-5.0, seed=0)
    with pytest.raises(InputError, match=r"^training diverged: weights .* set a smaller gail\.learning_rate$"):
        train(wild, judge(), 2)


def test_another_error_of_an_update_keeps_its_traceback():
    with pytest.raises(ValueError, match="mine"), kept_in_bounds(torch.nn.Linear(2, 2), "gail.learning_rate"):
        raise ValueError("mine")
