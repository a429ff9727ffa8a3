import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats

from rail_sumo import statistics
from rail_sumo.statistics import (
    interval,
    iqm,
    mean_difference,
    probability_of_improvement,
    ratio_of_iqms,
    share_interval,
)

scores = arrays.arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 6)), elements=st.integers(-5, 5))


def mean(scores):
    return np.mean(scores, axis=(-2, -1))


def test_the_interquartile_mean_is_that_of_the_middle_half_of_all_scores():
    assert iqm([[0, 1000, 2, 3], [4, 5, 6, -1000]]) == 3.5  # of 2, 3, 4, 5
    many = np.random.default_rng(3).normal(size=(7, 5, 16))
    np.testing.assert_allclose(iqm(many), [stats.trim_mean(one, 0.25, axis=None) for one in many])


def test_of_one_training_the_interval_is_the_plain_bootstrap_over_its_episodes():
    speeds = np.random.default_rng(0).normal(70.0, 3.0, size=16)
    plain = stats.bootstrap((speeds,), np.mean, method="percentile", rng=np.random.default_rng(1)).confidence_interval
    assert interval(mean, speeds[None]) == pytest.approx(tuple(plain), abs=0.1)


def test_of_trainings_whose_episodes_are_all_alike_it_is_the_bootstrap_over_trainings():
    each = np.random.default_rng(0).normal(70.0, 3.0, size=8)
    plain = stats.bootstrap((each,), np.mean, method="percentile", rng=np.random.default_rng(1)).confidence_interval
    assert interval(mean, np.repeat(each[:, None], 16, axis=1)) == pytest.approx(tuple(plain), abs=0.15)


@pytest.mark.parametrize(
    ("n_seeds", "n_episodes", "between", "expected"), [(40, 4, 1.0, 0.94), (5, 16, 0.0, 0.97), (5, 16, 1.0, 0.88)]
)
def test_it_holds_the_truth_about_as_often_as_it_says(n_seeds, n_episodes, between, expected):
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(400):
        of_seeds = between * rng.normal(size=(n_seeds, 1))
        low, high = interval(mean, of_seeds + rng.normal(size=(n_seeds, n_episodes)), n_resamples=400)
        held += low <= 0.0 <= high
    assert held / 400 == pytest.approx(expected, abs=0.035)


def test_of_many_episodes_it_is_what_it_would_be_drawn_at_once(monkeypatch):
    ours = np.random.default_rng(0).normal(70.0, 3.0, size=(3, 50))
    at_once = interval(iqm, ours)
    monkeypatch.setattr(statistics, "DRAWN_AT_ONCE", 1000)
    assert interval(iqm, ours) == pytest.approx(at_once, abs=0.05)


def test_what_never_happened_may_yet_happen():
    low, high = share_interval(np.zeros((10, 16)))
    assert low == 0.0
    assert high == pytest.approx(1.959964**2 / (160 + 1.959964**2))  # Wilson's, at 0 of 160
    low, high = share_interval([[0, 2, 0, 0]])
    assert low < 0.25 < high


def test_scores_on_the_same_traffic_are_drawn_together():
    ours = np.random.default_rng(0).normal(70.0, 3.0, size=(5, 16))
    assert interval(ratio_of_iqms, 1.1 * ours, ours) == pytest.approx((1.1, 1.1))
    apart = interval(ratio_of_iqms, 1.1 * ours, ours[::-1])
    assert apart[0] < 1.09 < 1.11 < apart[1]


def test_the_same_scores_give_the_same_interval():
    ours = np.random.default_rng(0).normal(size=(3, 4))
    assert interval(iqm, ours) == interval(iqm, ours)


@pytest.mark.parametrize(
    "given_scores", [(), (np.zeros(3),), (np.zeros((0, 3)),), (np.zeros((2, 3)), np.zeros((3, 2)))]
)
def test_scores_that_do_not_go_together_are_refused(given_scores):
    with pytest.raises(ValueError, match="one shape"):
        interval(iqm, *given_scores)


@given(scores, scores)
def test_the_probability_of_improvement_is_mann_whitneys_u_by_its_greatest_value(ours, theirs):
    u = stats.mannwhitneyu(ours.ravel(), theirs.ravel(), method="asymptotic").statistic if np.ptp(ours) else None
    improvement = probability_of_improvement(ours, theirs)
    if u is not None:
        assert improvement == pytest.approx(u / (ours.size * theirs.size))
    assert improvement + probability_of_improvement(theirs, ours) == pytest.approx(1.0)


def test_the_mean_difference_is_of_episodes_on_the_same_traffic():
    assert mean_difference([[1, 2], [3, 4]], [[0, 1], [5, 0]]) == 1.0  # of 1, 1, -2, 4
