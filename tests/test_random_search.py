import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rail_sumo.imitation.random_search import RandomSearch

DELTAS = np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 1.0]])
RETURNS = st.lists(st.integers(-100, 100).map(float), min_size=3, max_size=3).map(np.array)


def step(deltas, returns_plus, returns_minus, n_top=2):
    search = RandomSearch(np.zeros(2), n_directions=len(deltas), n_top=n_top, step_size=0.5, noise_std=0.1)
    search.tell(deltas, returns_plus, returns_minus)
    return search.theta


def test_step_matches_hand_computation():
    search = RandomSearch([0.0, 0.0], n_directions=2, n_top=1, step_size=0.5, noise_std=0.1)
    deltas = np.array([[1.0, 0.0], [0.0, 2.0]])
    norm = search.tell(deltas, returns_plus=np.array([1.0, 6.0]), returns_minus=np.array([2.0, 4.0]))
    # The second pair wins (6 > 2). Difference 2, sigma = std(6, 4) = 1: step = 0.5 / (1 * 1) * 2 * (0, 2).
    assert search.theta == pytest.approx([0.0, 2.0])
    assert norm == pytest.approx(2.0)


def test_following_all_directions_is_the_papers_update():
    # Differences (3, -3); sigma = std(4, 1, 2, 5) = sqrt(2.5); step = 0.5 / (2 sqrt(2.5)) * (3 (1, 0) - 3 (0, 2)).
    theta = step(DELTAS[:2], np.array([4.0, 2.0]), np.array([1.0, 5.0]))
    assert theta == pytest.approx(0.25 / np.sqrt(2.5) * np.array([3.0, -6.0]))


def test_steps_add_up_from_where_theta_started():
    start = np.array([10.0, -10.0])
    search = RandomSearch(start, n_directions=2, n_top=1, step_size=0.5, noise_std=0.1)
    for _ in range(2):
        search.tell(DELTAS[:2], np.array([1.0, 6.0]), np.array([2.0, 4.0]))
    assert search.theta == pytest.approx([10.0, -6.0])
    assert start == pytest.approx([10.0, -10.0])  # the caller's array is the caller's


@settings(deadline=None)
@given(RETURNS, RETURNS, st.floats(0.01, 100.0), st.floats(-100.0, 100.0))
def test_scale_and_offset_of_the_returns_do_not_matter(plus, minus, scale, offset):
    rescaled = step(DELTAS, scale * plus + offset, scale * minus + offset)
    assert rescaled == pytest.approx(step(DELTAS, plus, minus), abs=1e-6)


@settings(deadline=None)
@given(RETURNS, RETURNS)
def test_exchanging_plus_and_minus_reverses_the_step(plus, minus):
    assert step(DELTAS, minus, plus) == pytest.approx(-step(DELTAS, plus, minus))


@settings(deadline=None)
@given(RETURNS, RETURNS)
def test_a_direction_not_among_the_best_does_not_matter(plus, minus):
    best = max(plus.max(), minus.max())
    plus[1], minus[1] = best - 201.0, best - 205.0
    elsewhere = DELTAS.copy()
    elsewhere[1] = [-70.0, 40.0]
    assert step(elsewhere, plus, minus) == pytest.approx(step(DELTAS, plus, minus))


@pytest.mark.parametrize("rounding", [0.0, 2e-16])
def test_returns_that_do_not_differ_move_nothing(rounding):
    search = RandomSearch([1.0, 2.0], n_directions=3, n_top=3, step_size=0.5, noise_std=0.1)
    same = np.array([0.1, 0.1 + rounding, 0.1])
    assert search.tell(DELTAS, same, same[::-1] - rounding) == 0.0
    assert list(search.theta) == [1.0, 2.0]


def climb(height, seed):
    rng = np.random.default_rng(seed)
    search = RandomSearch(np.full(5, 2.0), n_directions=8, n_top=4, step_size=0.1, noise_std=0.1)
    for _ in range(100):
        deltas = search.ask(rng)
        plus, minus = (
            np.array([height(search.theta + sign * search.noise_std * delta, rng) for delta in deltas])
            for sign in (1.0, -1.0)
        )
        search.tell(deltas, plus, minus)
    return np.linalg.norm(search.theta)  # the summit is at 0, the start sqrt(20) = 4.5 away


def test_it_climbs_a_hill_and_by_chance_alone_it_does_not():
    assert max(climb(lambda theta, rng: -theta @ theta, seed) for seed in range(5)) < 0.5
    assert min(climb(lambda theta, rng: rng.normal(), seed) for seed in range(5)) > 1.0


def test_directions_are_standard_normal_and_the_generators_own():
    search = RandomSearch(np.zeros(100), n_directions=100, n_top=1, step_size=1.0, noise_std=0.1)
    deltas = search.ask(np.random.default_rng(1))
    # 10,000 draws: the mean has standard error 0.01, the standard deviation 0.007. noise_std is not in them.
    assert deltas.mean() == pytest.approx(0.0, abs=0.04)
    assert deltas.std() == pytest.approx(1.0, abs=0.03)
    assert np.array_equal(deltas, search.ask(np.random.default_rng(1)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((DELTAS[:2], np.ones(3), np.ones(3)), r"deltas must have shape \(3, 2\); got \(2, 2\)"),
        ((DELTAS, np.ones(4), np.ones(3)), r"returns_plus must have shape \(3,\); got \(4,\)"),
        ((DELTAS, np.ones(3), np.ones((3, 1))), r"returns_minus must have shape \(3,\); got \(3, 1\)"),
        ((DELTAS, np.array([1.0, np.nan, 1.0]), np.ones(3)), "returns_plus must be finite; got nan in row 1"),
        ((DELTAS, np.ones(3), np.array([1.0, 1.0, -np.inf])), "returns_minus must be finite; got -inf in row 2"),
    ],
)
def test_what_does_not_fit_is_refused_and_moves_nothing(arguments, message):
    search = RandomSearch(np.zeros(2), n_directions=3, n_top=2, step_size=0.5, noise_std=0.1)
    with pytest.raises(ValueError, match=message):
        search.tell(*arguments)
    assert list(search.theta) == [0.0, 0.0]


@pytest.mark.parametrize("n_top", [0, 4])
def test_more_directions_cannot_be_followed_than_are_tried(n_top):
    with pytest.raises(ValueError, match=rf"n_top must lie in 1\.\.n_directions = 1\.\.3; got {n_top}"):
        RandomSearch(np.zeros(2), n_directions=3, n_top=n_top, step_size=0.5, noise_std=0.1)


@pytest.mark.parametrize("theta", [np.zeros((2, 2)), [0.0, np.nan]])
def test_theta_must_be_a_finite_vector(theta):
    with pytest.raises(ValueError, match="theta must be a vector of finite numbers"):
        RandomSearch(theta, n_directions=3, n_top=2, step_size=0.5, noise_std=0.1)
