import itertools

import numpy as np
from toy import EXPERT_ACTIONS, SHAPE, WHITENING, advice, agreement, episode

from rail_sumo.config import Cloning
from rail_sumo.imitation import bc, dagger
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Policy

CLONING = Cloning(epochs=60, learning_rate=0.05, batch_size=16)


def fit(labelled):
    return bc.clone(labelled, SHAPE, WHITENING, CLONING, seed=0)


def blinkered():
    """Demonstrations of the first sight alone."""
    seen = np.tile(np.eye(3)[0], (20, 1))
    return Demonstrations.from_trajectories([episode(seen, advice(seen))])


def advise(theta, iteration):
    """A drive past the sights in turn; the first mistake leads to the same sight again and again."""
    policy, seen, sight = Policy(theta, SHAPE, WHITENING), [], 0
    for _ in range(12):
        seen.append(np.eye(3)[sight])
        sight = (sight + (policy(seen[-1]) == EXPERT_ACTIONS[sight])) % 3
    seen = np.array(seen)
    return [(episode(seen, [policy(sight) for sight in seen], seed=iteration), advice(seen))]


def test_it_learns_what_the_demonstrations_never_showed():
    states = dagger.train(fit(blinkered()), blinkered(), fit=fit, advise=advise)
    *_, last = itertools.islice(states, 4)
    assert agreement(fit(blinkered())) == 1 / 3
    assert agreement(last.theta) == 1.0


def test_every_rollout_is_added_with_the_experts_decisions_and_fitted_to():
    theta = fit(blinkered())
    first, second = itertools.islice(dagger.train(theta, blinkered(), fit=fit, advise=advise), 2)
    ((driven, advised),) = advise(theta, 1)
    np.testing.assert_array_equal(first.labelled.observations[20:], driven.observations)
    np.testing.assert_array_equal(first.labelled.actions[20:], advised)
    assert not np.array_equal(driven.decisions, advised)
    np.testing.assert_array_equal(first.theta, fit(first.labelled))
    assert first.step_norm == np.linalg.norm(first.theta - theta)
    assert [len(state.labelled.actions) for state in (first, second)] == [32, 44]
    np.testing.assert_array_equal(second.labelled.episode, np.repeat([0, 1, 2], [20, 12, 12]))


def test_gone_on_with_it_is_the_same_as_uninterrupted():
    *_, expected = itertools.islice(dagger.train(fit(blinkered()), blinkered(), fit=fit, advise=advise), 3)
    *_, second = itertools.islice(dagger.train(fit(blinkered()), blinkered(), fit=fit, advise=advise), 2)
    third = next(dagger.train(second.theta, second.labelled, fit=fit, advise=advise, first_iteration=3))
    assert third.iteration == expected.iteration == 3
    np.testing.assert_array_equal(third.theta, expected.theta)
