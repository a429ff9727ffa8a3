import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import EXPERT_ACTIONS, N_DECISIONS, SHAPE, WHITENING, agreement, episode, expert, sights, wrong_everywhere

from rail_sumo import config
from rail_sumo.drivers import Sampling
from rail_sumo.errors import InputError
from rail_sumo.imitation import gail
from rail_sumo.imitation.discriminator import Judge, JudgeLoss
from rail_sumo.policy import Policy, Shape, Whitening

SETTINGS = config.Gail(learning_rate=0.01, batch_size=40, epochs=5, critic_hidden=(8,), discount=0.5)
JUDGE = config.Judge(hidden=(16,), minibatches=20, batch_size=128, learning_rate=0.01)


def ppo(theta=None, seed=0, shape=SHAPE, whitening=WHITENING):
    theta = wrong_everywhere() if theta is None else theta
    return gail.Ppo(theta, shape, whitening, SETTINGS, lowest_reward=-5.0, seed=seed)


def sample(theta, iteration):
    driver = Sampling(Policy(theta, SHAPE, WHITENING), seed=iteration)
    return [
        episode(seen, [driver.decide(sight, None) for sight in seen])
        for seen in (sights(1000 * iteration + i) for i in range(4))
    ]


def train(ppo, judge, iterations, first_iteration=1):
    states = gail.train(ppo, expert(), judge=judge, sample=sample, seed=0, first_iteration=first_iteration)
    return list(itertools.islice(states, iterations))


def judge():
    return Judge(3, WHITENING, JUDGE, 0, horizon_decisions=N_DECISIONS)


class Indifferent:
    """A judge to whom all is alike."""

    def fit(self, expert, learner, rng):
        return JudgeLoss(0.25, 0.5, 0.5)

    def rewards(self, observations, actions):
        return np.zeros(len(actions))


def test_it_learns_to_do_what_the_expert_does():
    learned = [agreement(train(ppo(seed=seed), judge(), 30)[-1].theta) for seed in range(3)]
    unguided = [agreement(train(ppo(seed=seed), Indifferent(), 30)[-1].theta) for seed in range(3)]
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
        np.mean([trajectory.actions == EXPERT_ACTIONS[1] for trajectory in sample(theta, 99)])
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
    learner = gail.Ppo(
        wrong_everywhere(),
        SHAPE,
        WHITENING,
        SETTINGS.model_copy(update={"gae_lambda": 1.0}),
        lowest_reward=-5.0,
        seed=0,
    )
    with torch.no_grad():
        learner._ppo.policy.value_net.weight.zero_()
        learner._ppo.policy.value_net.bias.fill_(2.0)
    driven = episode(sights(0, 4), np.zeros(4), end_reason)
    learner.update([driven], lambda observations, actions: np.ones(len(actions)), np.random.default_rng(0))
    np.testing.assert_allclose(learner._ppo.rollout_buffer.advantages.ravel(), advantages)


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
        assert state.judge_loss == uninterrupted.judge_loss


def test_a_rollout_of_one_decision_tells_nothing():
    one, more = episode(sights(0, 1), [0]), episode(sights(1), np.zeros(N_DECISIONS))
    learner, same = ppo(), ppo()
    learner.update([one, more], Indifferent().rewards, np.random.default_rng(0))
    same.update([more], Indifferent().rewards, np.random.default_rng(0))
    np.testing.assert_array_equal(learner.theta(), same.theta())
    with pytest.raises(InputError, match="no rollout came to two decisions"):
        learner.update([one, one], Indifferent().rewards, np.random.default_rng(0))


def test_the_callers_own_chance_is_left_alone(left_alone_by):
    def learn():
        learner = ppo()
        learner.update([episode(sights(1), np.zeros(N_DECISIONS))], Indifferent().rewards, np.random.default_rng(0))

    assert left_alone_by(learn)
