import itertools

import numpy as np
from test_rail import JUDGE, SEARCH, evaluate, judge
from toy import EXPERT_ACTIONS, N_DECISIONS, SHAPE, WHITENING, agreement, episode, expert, sights

from rail_sumo.imitation import rail
from rail_sumo.imitation.rewarded import Rewarded
from rail_sumo.policy import Policy
from rail_sumo.records import MetaAction


def braking(trajectory):
    """What an environment earns them that likes nothing but braking, which the expert never does."""
    return float((trajectory.decisions == MetaAction.DECELERATE).sum())


def like_the_expert():
    """A policy that does what the expert does, by a small margin."""
    theta = np.zeros((5, 4))
    theta[EXPERT_ACTIONS, range(3)] = 0.2
    return theta.ravel()


def brakes(theta):
    policy = Policy(theta, SHAPE, WHITENING)
    return np.mean([policy(sight) == MetaAction.DECELERATE for sight in np.eye(3)])


def learned(weight):
    states = rail.train(
        like_the_expert(),
        expert(),
        search=SEARCH,
        judge=Rewarded(judge(), weight, reward=braking, horizon_decisions=N_DECISIONS),
        evaluate=evaluate,
        seed=0,
    )
    return next(itertools.islice(states, 29, None)).theta


def test_a_return_is_the_judges_and_the_weighted_reward_of_a_decision():
    seen = sights(0, 4)
    halting = episode(seen, [MetaAction.DECELERATE, MetaAction.KEEP, MetaAction.DECELERATE, MetaAction.KEEP])
    keeping = episode(seen, [MetaAction.KEEP] * 4)
    plain = judge().returns([halting, keeping])
    np.testing.assert_allclose(
        Rewarded(judge(), 3.0, reward=braking, horizon_decisions=4).returns([halting, keeping]) - plain, [1.5, 0.0]
    )


def test_a_reward_that_weighs_much_leads_away_from_the_expert_and_one_that_weighs_little_does_not():
    assert agreement(like_the_expert()) == 1.0
    assert brakes(learned(weight=30.0)) == 1.0
    assert agreement(learned(weight=0.01)) == 1.0


def test_the_judge_behind_it_learns_as_it_would_without():
    plain, paid = judge(JUDGE), judge(JUDGE)
    seen = sights(1)
    rollouts = [episode(seen, np.zeros(len(seen)))]
    losses = [
        one.fit(expert(), rollouts, np.random.default_rng(0))
        for one in (plain, Rewarded(paid, 3.0, reward=braking, horizon_decisions=4))
    ]
    assert losses[0] == losses[1]
    for name, tensor in plain.state().items():
        np.testing.assert_array_equal(tensor, paid.state()[name])


def test_a_crash_does_not_pay():
    seen = sights(0, 8)
    brake = MetaAction.DECELERATE
    whole = episode(seen, [brake, MetaAction.KEEP] * 4)
    crashed = episode(seen[:2], [brake, brake], end_reason="collision")
    paid = Rewarded(judge(), 3.0, reward=braking, horizon_decisions=8).returns([whole, crashed])
    np.testing.assert_allclose(paid - judge().returns([whole, crashed]), [3.0 * 4 / 8, 3.0 * 2 / 8])


def test_a_crash_does_not_pay_where_driving_on_costs_either():
    seen = sights(0, 8)
    brake = MetaAction.DECELERATE
    whole, crashed = episode(seen, [brake] * 8), episode(seen[:1], [brake], end_reason="collision")
    charged = Rewarded(judge(), 3.0, reward=lambda one: -braking(one), horizon_decisions=8).returns([whole, crashed])
    np.testing.assert_allclose(charged - judge().returns([whole, crashed]), [-3.0, -3.0])
