import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import episode

from rail_sumo.config import Judge as Settings
from rail_sumo.errors import InputError
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.discriminator import Discriminator
from rail_sumo.imitation.losses import LOSSES
from rail_sumo.policy import Whitening
from rail_sumo.records import MetaAction

HORIZON = 40
CLIP = 5.0
SMALL = Settings(hidden=(8, 8), minibatches=3, batch_size=16)
THOROUGH = Settings(hidden=(8,), learning_rate=0.01, minibatches=600)


def judge(settings=SMALL, n_features=2, seed=0):
    return Discriminator(Whitening(np.zeros(n_features), np.ones(n_features)), settings, seed, HORIZON)


def constant_judge(logit):
    """A judge to whom everything looks alike."""
    constant = judge()
    state = {name: np.zeros_like(weights) for name, weights in constant.state().items()}
    last_bias = max(name for name in state if name.endswith("bias"))
    constant.load_state(state | {last_bias: np.array([logit], dtype=np.float32)})
    return constant


def rollout(n_decisions, end_reason="duration", rng=None):
    rng = rng or np.random.default_rng(n_decisions)
    return episode(rng.normal(size=(n_decisions, 2)), rng.integers(5, size=n_decisions), end_reason)


def demonstrations(seed=0, n_episodes=3):
    rng = np.random.default_rng(seed)
    return Demonstrations.from_trajectories([rollout(20, rng=rng) for _ in range(n_episodes)])


def blind(counts):
    """An episode of decisions made without anything to see: action k was taken counts[k] times."""
    return episode(np.zeros((sum(counts), 1)), np.repeat(np.arange(5), counts))


def test_it_finds_the_least_squares_optimum():
    expert, learner = np.array([50, 20, 10, 10, 10]), np.array([10, 20, 50, 10, 10])
    fitted = judge(THOROUGH, n_features=1)
    demonstrated = Demonstrations.from_trajectories([blind(expert)])
    loss = fitted.fit(demonstrated, [blind(learner)], np.random.default_rng(0))

    # D* = p / (p + q) with labels 1 and 0 (Mao et al. 2017), so that the reward is log p - log q.
    rewards = fitted.rewards(np.zeros((5, 1)), np.arange(5))
    assert rewards == pytest.approx(np.log(expert / learner), abs=0.3)
    best = expert / (expert + learner)
    assert loss.expert_mean == pytest.approx(expert @ best / 100, abs=0.03)
    assert loss.learner_mean == pytest.approx(learner @ best / 100, abs=0.03)
    later = fitted.fit(demonstrated, [blind(learner)], np.random.default_rng(1))
    assert later.loss == pytest.approx((expert @ (best - 1.0) ** 2 + learner @ best**2) / 200, abs=0.01)


def test_of_two_that_look_the_same_it_makes_nothing():
    """Negative control of the above."""
    fitted = judge(THOROUGH, n_features=1)
    same = blind([50, 20, 10, 10, 10])
    loss = fitted.fit(Demonstrations.from_trajectories([same]), [same], np.random.default_rng(0))
    assert fitted.rewards(np.zeros((5, 1)), np.arange(5)) == pytest.approx(np.zeros(5), abs=0.3)
    assert loss.loss == pytest.approx(0.25, abs=0.005)


def test_a_judge_with_hand_set_weights_gives_its_logit():
    # D = 1 / (1 + e^-0.7): log D - log(1 - D) = 0.7.
    assert constant_judge(0.7).returns([rollout(3), rollout(9)]) == pytest.approx([0.7, 0.7])


def test_in_an_observation_it_sees_the_whitened_values():
    plain, whitened = judge(), Discriminator(Whitening(np.array([1.0, -2.0]), np.array([4.0, 0.5])), SMALL, 0, HORIZON)
    seen = np.array([[5.0, -1.0], [1.0, -2.5]])
    expected = plain.rewards(np.array([[1.0, 2.0], [0.0, -1.0]]), np.array([0, 3]))
    assert whitened.rewards(seen, np.array([0, 3])) == pytest.approx(expected)


def test_the_reward_is_clipped():
    assert constant_judge(123.0).returns([rollout(3)]) == pytest.approx([CLIP])
    assert constant_judge(-123.0).returns([rollout(3)]) == pytest.approx([-CLIP])


def test_the_returns_of_many_are_those_of_each():
    judged = judge()
    many = [rollout(5), rollout(1), rollout(30, "collision"), rollout(8)]
    assert judged.returns(many) == pytest.approx([judged.returns([one])[0] for one in many])
    assert judged.returns(many)[0] == pytest.approx(judged.rewards(many[0].observations, many[0].decisions).mean())


@pytest.mark.parametrize("end_reason", ["duration", "course", "end of road", "standstill"])
def test_no_other_end_than_a_crash_is_padded(end_reason):
    driven = rollout(5, end_reason)
    one = judge()
    assert one.returns([driven]) == pytest.approx([one.rewards(driven.observations, driven.carried_out).mean()])


def test_a_crash_is_padded_with_the_lowest_reward_to_the_horizon():
    # 10 decisions at 0 and 30 at -5: -150 / 40.
    assert constant_judge(0.0).returns([rollout(10, "collision")]) == pytest.approx([-3.75])
    # Beyond the horizon one absorbing decision is left: (49 * 1 - 5) / 50.
    assert constant_judge(1.0).returns([rollout(49, "collision")]) == pytest.approx([0.88])


@settings(deadline=None)
@given(st.floats(-10.0, 10.0), st.integers(1, 60), st.integers(1, 60))
def test_a_crash_never_pays_and_the_sooner_the_less(logit, sooner, later):
    sooner, later = sorted((sooner, later))
    constant = constant_judge(logit)
    crash_soon, crash_late, safe = constant.returns(
        [rollout(sooner, "collision"), rollout(later, "collision"), rollout(later)]
    )
    assert crash_late <= safe + 1e-9
    assert crash_soon <= crash_late + 1e-9


def test_a_rollout_without_a_decision_is_refused():
    with pytest.raises(ValueError, match="at least one decision"):
        judge().returns([rollout(3), rollout(0)])


def test_labels_say_who_is_who():
    """What only the expert does must end up near the expert's label."""
    fitted = judge(SMALL.model_copy(update={"minibatches": 200, "learning_rate": 0.01}))
    still = Demonstrations.from_trajectories([episode(np.zeros((50, 2)), np.full(50, 1))])
    loss = fitted.fit(still, [episode(np.zeros((50, 2)), np.full(50, 2))], np.random.default_rng(0))
    assert loss.expert_mean > 0.5 > loss.learner_mean


@settings(max_examples=15, deadline=None)
@given(stop=st.integers(0, 4))
def test_resumed_is_uninterrupted_bit_for_bit(stop):
    def fit(judged, iterations):
        return [
            judged.fit(demonstrations(), [rollout(4 + i), rollout(7)], np.random.default_rng(i)) for i in iterations
        ]

    uninterrupted = judge()
    losses = fit(uninterrupted, range(5))

    stopped = judge()
    before = fit(stopped, range(stop))
    resumed = judge(seed=99)
    fit(resumed, range(7, 9))  # whatever it went through must be gone
    kept = stopped.state()
    fit(stopped, range(7, 9))  # what was kept must not follow
    resumed.load_state(kept)
    assert before + fit(resumed, range(stop, 5)) == losses
    state = uninterrupted.state()
    assert resumed.state().keys() == state.keys()
    assert all(np.array_equal(resumed.state()[name], state[name]) for name in state)


def test_a_seed_is_a_judge_and_the_worlds_chance_is_left_alone():
    chance = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    trained = []
    for seed, draw in ((1, 2), (1, 2), (1, 3), (4, 2)):
        judged = judge(seed=seed)
        judged.fit(demonstrations(), [rollout(9)], np.random.default_rng(draw))
        trained.append(judged.state()["network.0.weight"])
    assert np.array_equal(trained[0], trained[1])
    assert not np.array_equal(trained[0], trained[2])
    assert not np.array_equal(trained[0], trained[3])
    assert torch.equal(torch.get_rng_state(), chance[0])
    assert np.array_equal(np.random.get_state()[1], chance[1])  # noqa: NPY002


def test_another_judges_state_is_refused():
    larger = judge(SMALL.model_copy(update={"hidden": (9, 8)}))
    with pytest.raises(ValueError, match=r"network\.0\.weight must have shape \(8, 7\); got \(9, 7\)"):
        judge().load_state(larger.state())
    with pytest.raises(KeyError, match=r"network\.0\.weight"):
        judge().load_state({})


def test_a_decision_is_judged_as_what_came_of_it():
    seen = np.random.default_rng(0).normal(size=(40, 2))
    asked = np.full(40, MetaAction.LEFT)
    came = np.where(np.arange(40) % 2, MetaAction.KEEP, MetaAction.LEFT)
    rollouts = [episode(seen, asked, carried_out=came), episode(seen, came), episode(seen, asked)]
    given, same, other = judge().returns(rollouts)
    assert given == same
    assert given != other


def test_torch_computes_in_one_thread_and_has_as_many_as_before_after(monkeypatch):
    one, used = judge(), []
    pairs = one._pairs
    monkeypatch.setattr(one, "_pairs", lambda *given: used.append(torch.get_num_threads()) or pairs(*given))
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        one.fit(demonstrations(), [rollout(5)], np.random.default_rng(0))
        one.returns([rollout(5)])
        assert set(used) == {1}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


def failing(**changes):
    """The judge's loss, with a part that goes wrong."""
    return dataclasses.replace(LOSSES["least-squares"], **changes)


SEVERAL = failing(minimised=lambda outputs, expert, learner, rng: outputs(expert))
PLAIN = failing(minimised=lambda outputs, expert, learner, rng: 0.5)
IDLE = failing(minimised=lambda outputs, expert, learner, rng: torch.tensor(0.5))
NO_NUMBER = failing(minimised=lambda outputs, expert, learner, rng: outputs(expert).mean() * float("nan"))
REWARDS_NOBODY = failing(reward=lambda outputs: outputs.mean())
REWARDS_NAN = failing(reward=lambda outputs: outputs * float("nan"))


def test_a_loss_that_is_no_number_is_told_by_its_name():
    name = f"{__name__}:NO_NUMBER"
    fitted = judge(SMALL.model_copy(update={"loss": name}))
    with pytest.raises(InputError, match=rf"^judge.loss '{name}' came to nan; it must be a finite number$"):
        fitted.fit(demonstrations(), [rollout(20)], np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("SEVERAL", r"a tensor of shape \(\d+,\)"),
        ("PLAIN", r"0\.5"),
        ("IDLE", r"a tensor of shape \(\) that does not depend on them"),
    ],
)
def test_a_loss_that_cannot_be_minimised_is_told_by_its_name(name, said):
    fitted = judge(SMALL.model_copy(update={"loss": f"{__name__}:{name}"}))
    with pytest.raises(
        InputError, match=rf"^judge.loss '{__name__}:{name}' minimises {said}; it must return one number"
    ):
        fitted.fit(demonstrations(), [rollout(20)], np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("REWARDS_NOBODY", "must be one number for each of 20 decisions; it has shape ()"),
        ("REWARDS_NAN", "must be finite; it is not always"),
    ],
)
def test_rewards_that_are_not_one_number_a_decision_are_told_by_their_loss(name, said):
    paying = judge(SMALL.model_copy(update={"loss": f"{__name__}:{name}"}))
    with pytest.raises(InputError) as refused:
        paying.returns([rollout(20)])
    assert str(refused.value) == f"the reward of judge.loss '{__name__}:{name}' {said}"
