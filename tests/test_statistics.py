import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats

from rail_sumo.tables.statistics import difference, mean, probability_of_improvement, ratio, share, units

scores = arrays.arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 6)), elements=st.integers(-5, 5))

several = st.integers(2, 8).flatmap(lambda n: arrays.arrays(np.float64, (2, n), elements=st.integers(0, 20)))
pairs = several.filter(lambda pair: pair[1].any())


def test_of_trainings_the_units_are_their_means_of_one_driver_its_episodes():
    driven = [[1.0, 3.0], [5.0, 9.0]]
    assert units(driven, trained=True).tolist() == [2.0, 7.0]
    assert units(driven, trained=False).tolist() == [1.0, 3.0, 5.0, 9.0]


def test_the_interval_is_students():
    speeds = np.random.default_rng(0).normal(70.0, 3.0, size=16)
    expected = stats.ttest_1samp(speeds, 0.0).confidence_interval(0.95)
    assert mean(speeds) == pytest.approx((speeds.mean(), expected.low, expected.high))


def test_two_units_by_hand():
    # Mean 2, standard error 1, and 12.706 is the 97.5 % point of Student's t with one degree of freedom.
    assert mean([1.0, 3.0]) == pytest.approx((2.0, 2.0 - 12.706, 2.0 + 12.706), abs=1e-3)


def test_one_unit_does_not_tell_how_others_may_differ():
    value, low, high = mean([61.5])
    assert value == 61.5
    assert np.isnan([low, high]).all()


@pytest.mark.parametrize("same", [[61.5] * 2, [0.0] * 16, [70.1] * 160])
def test_units_that_are_all_the_same_have_an_interval_without_width(same):
    value, low, high = mean(same)
    assert low == value == high == pytest.approx(same[0])


def test_of_nothing_there_is_no_mean():
    assert np.isnan([*mean([]), *ratio([], []), *difference([], [])]).all()


def test_there_is_no_ratio_to_nothing():
    assert np.isnan(ratio([1.0, 2.0], [0.0, 0.0])).all()


def test_what_is_compared_on_the_same_traffic_is_compared_unit_by_unit():
    ours = np.random.default_rng(0).normal(70.0, 3.0, size=16)
    theirs = ours + np.random.default_rng(1).normal(2.0, 0.1, size=16)
    value, low, high = difference(ours, theirs)
    assert value == pytest.approx(-2.0, abs=0.1)
    assert high - low < 0.2
    always = ratio(1.1 * ours, ours)
    assert always.value == pytest.approx(1.1)
    assert always.low == always.high == always.value  # without exception
    narrow, wide = ratio(ours, theirs), ratio(ours, theirs[::-1])
    assert wide.high - wide.low > 5 * (narrow.high - narrow.low)


@given(pairs)
def test_the_ratio_may_be_1_just_where_the_difference_may_be_0(pair):
    ours, theirs = pair
    told, differs = ratio(ours, theirs), difference(ours, theirs)
    if np.isfinite(told.low) and min(map(abs, differs[1:])) > 1e-6:
        assert (told.low <= 1.0 <= told.high) == (differs.low <= 0.0 <= differs.high)


@given(pairs)
def test_the_ends_of_a_ratio_are_where_students_test_turns(pair):
    ours, theirs = pair
    told = ratio(ours, theirs)
    for end in told[1:]:
        if np.isfinite(end) and told.high - told.low > 1e-3:
            assert stats.ttest_1samp(ours - end * theirs, 0.0).pvalue == pytest.approx(0.05, rel=1e-4)


@pytest.mark.parametrize("ours", [[0, 0, 0, 0, 2], [0, 0, 0, 0, 0], [1, 0, 0, 0, 0]])
def test_a_ratio_to_what_happened_once_has_no_interval(ours):
    value, low, high = ratio(ours, [0, 0, 0, 0, 1])
    assert value == sum(ours)
    assert np.isnan([low, high]).all()


def test_the_ratio_is_of_means():
    assert ratio([1.0, 5.0], [2.0, 2.0]).value == 1.5


def test_a_ratio_to_a_reference_that_does_not_vary_has_the_interval_of_the_mean():
    ours = np.random.default_rng(0).normal(70.0, 3.0, size=10)
    assert ratio(ours, np.full(10, 50.0)) == pytest.approx(np.array(mean(ours)) / 50.0)


def test_what_never_happened_may_yet_happen():
    value, low, high = share(np.zeros((10, 16)))
    assert (value, low) == (0.0, 0.0)
    assert high == pytest.approx(1.959964**2 / (160 + 1.959964**2))  # Wilson's, at 0 of 160
    value, low, high = share([[0, 2, 0, 0]])
    assert low < value == 0.25 < high


# Standard deviations between trainings, and between the episodes of one, in km/h, overtakes and lane changes: those of
# RAIL on two layers in docs/data.
BETWEEN, WITHIN, MEAN = np.array([0.6, 1.5, 0.5]), np.array([3.0, 9.7, 4.9]), np.array([70.3, 44.4, 13.9])


@pytest.mark.parametrize("n_seeds", [3, 5, 10])
@pytest.mark.parametrize("between", [0.0, 1.0, 4.0], ids=["alike", "as here", "four times that"])
def test_intervals_hold_the_truth_in_95_of_100_cases(n_seeds, between):
    rng = np.random.default_rng(5)
    held = []
    for _ in range(1500):
        trained = MEAN + between * BETWEEN * rng.normal(size=(n_seeds, 1, 3))
        ours = np.maximum(trained + WITHIN * rng.normal(size=(n_seeds, 32, 3)), 0.0)
        theirs = np.maximum(MEAN + WITHIN * rng.normal(size=(n_seeds, 32, 3)), 0.0)
        for i in range(3):
            one, other = (units(driven[:, :, i], trained=True) for driven in (ours, theirs))
            for truth, (_, low, high) in (
                (MEAN[i], mean(one)),
                (1.0, ratio(one, other)),
                (0.0, difference(one, other)),
            ):
                held.append(low <= truth <= high)
    by_figure = np.reshape(held, (-1, 3, 3)).mean(axis=0)
    assert (by_figure >= 0.93).all(), by_figure
    assert (by_figure <= 0.97).all(), by_figure


def test_intervals_of_one_training_hold_its_own_truth():
    rng = np.random.default_rng(5)
    held = [low <= 41.0 <= high for _, low, high in (mean(rng.poisson(41.0, size=16)) for _ in range(3000))]
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)


@given(scores, scores)
def test_the_probability_of_improvement_is_mann_whitneys_u_by_its_greatest_value(ours, theirs):
    u = stats.mannwhitneyu(ours.ravel(), theirs.ravel(), method="asymptotic").statistic if np.ptp(ours) else None
    improvement = probability_of_improvement(ours, theirs)
    if u is not None:
        assert improvement == pytest.approx(u / (ours.size * theirs.size))
    assert improvement + probability_of_improvement(theirs, ours) == pytest.approx(1.0)
