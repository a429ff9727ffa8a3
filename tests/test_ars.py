import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from toy import SHAPE, advice, agreement, episode, sights

from rail_sumo.config import Search
from rail_sumo.imitation import ars
from rail_sumo.policy import Policy

SEARCH = Search(n_directions=8, n_top=4, step_size=0.05, noise_std=0.3)


DRIVEN_BY = []
"""The whitenings that policies were driven with, in order."""


def evaluate(theta, whitening, perturbations, iteration):
    DRIVEN_BY.append(whitening)

    def drive(parameters, seed):
        policy, seen = Policy(parameters, SHAPE, whitening), sights(seed)
        return episode(seen, [policy(sight) for sight in seen], seed=seed)

    plus, minus = (
        [drive(theta + sign * delta, 1000 * iteration + i) for i, delta in enumerate(perturbations)]
        for sign in (1.0, -1.0)
    )
    return plus, minus


def returns(driven):
    """One for every decision that is the expert's."""
    return np.array([(trajectory.decisions == advice(trajectory.observations)).sum() for trajectory in driven], float)


def train(iterations, *, whiten, seed=0, returns=returns, theta=None, moments=None, first_iteration=1):
    states = ars.train(
        np.zeros(SHAPE.size) if theta is None else theta,
        moments or ars.Moments.none(SHAPE.n_features),
        search=SEARCH,
        whiten=whiten,
        evaluate=evaluate,
        returns=returns,
        seed=seed,
        first_iteration=first_iteration,
    )
    return list(itertools.islice(states, iterations))


@pytest.mark.parametrize("whiten", [True, False])
def test_it_finds_what_earns_most_without_being_shown(whiten):
    found = [train(40, whiten=whiten, seed=seed)[-1] for seed in range(5)]
    blind = [train(40, whiten=whiten, seed=seed, returns=lambda driven: np.zeros(len(driven)))[-1] for seed in range(5)]
    assert np.mean([agreement(state.theta, whitening=state.whitening) for state in found]) > 0.9
    assert all(np.array_equal(state.theta, np.zeros(SHAPE.size)) for state in blind)


def test_returns_rise():
    states = train(40, whiten=True)
    assert states[-1].mean_return > 1.5 * states[0].mean_return


def test_v2_whitens_by_all_that_was_met_before_and_v1_by_nothing():
    for state in train(3, whiten=False):
        np.testing.assert_array_equal([state.whitening.mean, state.whitening.std], [np.zeros(3), np.ones(3)])
    DRIVEN_BY.clear()
    states = train(3, whiten=True)
    reported = [ars.Moments.none(3).whitening, *(state.whitening for state in states[:-1])]
    np.testing.assert_array_equal([w.std for w in DRIVEN_BY], [w.std for w in reported])
    np.testing.assert_array_equal([w.mean for w in DRIVEN_BY], [w.mean for w in reported])
    met = np.concatenate([trajectory.observations for state in states for trajectory in state.driven])
    np.testing.assert_allclose(states[-1].whitening.mean, met.mean(axis=0))
    np.testing.assert_allclose(states[-1].whitening.std, met.std(axis=0))


@given(
    st.lists(arrays(np.float64, st.tuples(st.integers(1, 5), st.just(2)), elements=st.floats(-100, 100)), min_size=1)
)
def test_moments_gathered_in_parts_are_those_of_the_whole(parts):
    moments = ars.Moments.none(2)
    for part in parts:
        moments = moments.joined(part)
    whole = np.concatenate(parts)
    np.testing.assert_allclose(moments.whitening.mean, whole.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(moments.squares, len(whole) * whole.var(axis=0), atol=1e-6)


def test_perturbations_are_as_large_as_they_are_to_be():
    tried = []

    def note(theta, whitening, perturbations, iteration):
        tried.append(perturbations)
        return evaluate(theta, whitening, perturbations, iteration)

    states = ars.train(
        np.zeros(SHAPE.size), ars.Moments.none(3), search=SEARCH, whiten=True, evaluate=note, returns=returns, seed=0
    )
    list(itertools.islice(states, 30))
    assert np.std(tried) == pytest.approx(SEARCH.noise_std, rel=0.05)  # 30 x 8 x 20 draws


def test_gone_on_with_it_is_the_same_as_uninterrupted():
    expected = train(5, whiten=True)
    *_, third = train(3, whiten=True)
    resumed = train(2, whiten=True, theta=third.theta, moments=third.moments, first_iteration=4)
    for state, uninterrupted in zip(resumed, expected[3:], strict=True):
        np.testing.assert_array_equal(state.theta, uninterrupted.theta)
        np.testing.assert_array_equal(state.whitening.std, uninterrupted.whitening.std)
