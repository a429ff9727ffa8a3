import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.policy import Policy, Shape, Whitening, unflatten
from rail_sumo.records import MetaAction

seeds = st.integers(0, 2**32 - 1)


def plain(n_features):
    """Whitening that changes nothing."""
    return Whitening(np.zeros(n_features), np.ones(n_features))


def test_a_linear_policy_by_hand():
    # Rows of (weight of x, weight of y, bias), one for each action.
    theta = [1, 0, 0, 0, 1, 0, -1, 0, 0.5, 0, -1, 0, 1, 1, -2]
    policy = Policy(np.array(theta), Shape(2, None), plain(2))
    assert policy.outputs(np.array([3.0, 4.0])) == pytest.approx([3.0, 4.0, -2.5, -4.0, 5.0])
    assert policy(np.array([3.0, 4.0])) == MetaAction.RIGHT
    assert policy(np.array([3.0, 0.5])) == MetaAction.KEEP
    assert policy(np.array([0.0, -1.0])) == MetaAction.LEFT


def test_a_tanh_policy_by_hand():
    hidden = [2.0, 0.5, -1.0, 1.0]  # two units of one feature: tanh(2 x + 0.5), tanh(-x + 1)
    output = [1, 0, 0, 0, 1, 0, 1, 1, 0, -1, -1, 0, 0, 0, 0.9]
    policy = Policy(np.array(hidden + output), Shape(1, 2), plain(1))
    one, two = math.tanh(2.0 * 0.25 + 0.5), math.tanh(-0.25 + 1.0)  # 0.7616, 0.6351
    assert policy.outputs(np.array([0.25])) == pytest.approx([one, two, one + two, -one - two, 0.9])
    assert policy(np.array([0.25])) == MetaAction.DECELERATE  # 1.397 beats 0.9
    assert policy(np.array([-3.0])) == MetaAction.ACCELERATE  # tanh(-5.5), tanh(4)
    assert policy(np.array([4.0])) == MetaAction.KEEP  # tanh(8.5), tanh(-3)
    assert policy(np.array([1.2])) == MetaAction.KEEP  # 0.994 alone: tanh(-0.2) takes away from the sum
    assert policy(np.array([-0.3])) == MetaAction.RIGHT  # -0.1, 0.86, 0.76


def test_whitening_by_hand():
    # (10 - 4) / 3 = 2 for the first feature, (1 - 2) / 0.5 = -2 for the second.
    whitening = Whitening(np.array([4.0, 2.0]), np.array([3.0, 0.5]))
    theta = np.zeros(15)
    theta[:3], theta[3:6] = (1, 0, 0.25), (0, 1, 0)
    policy = Policy(theta, Shape(2, None), whitening)
    assert policy.outputs(np.array([10.0, 1.0])) == pytest.approx([2.25, -2.0, 0.0, 0.0, 0.0])


@given(seeds, st.integers(1, 60), st.one_of(st.none(), st.integers(1, 80)))
def test_whitening_folded_into_the_weights_is_whitening_the_observation(seed, n_features, hidden):
    rng = np.random.default_rng(seed)
    shape = Shape(n_features, hidden)
    theta = rng.normal(size=shape.size)
    whitening = Whitening(rng.normal(size=n_features) * 50, rng.uniform(0.1, 30, n_features))
    observation = whitening.mean + whitening.std * rng.normal(size=n_features)
    folded = Policy(theta, shape, whitening).outputs(observation)
    explicit = Policy(theta, shape, plain(n_features)).outputs((observation - whitening.mean) / whitening.std)
    assert folded == pytest.approx(explicit, rel=1e-9, abs=1e-8)


@given(seeds, st.permutations(range(5)))
def test_swapping_output_rows_swaps_the_actions(seed, order):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(5, 9))
    observation = rng.normal(size=8)
    action = Policy(matrix.ravel(), Shape(8, None), plain(8))(observation)
    swapped = Policy(matrix[order].ravel(), Shape(8, None), plain(8))(observation)
    assert order[swapped] == action


def test_equal_outputs_mean_keep():
    assert Policy(np.zeros(15), Shape(2, None), plain(2))(np.array([1.0, 2.0])) == MetaAction.KEEP


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (Shape(48, None), 5 * 49),
        (Shape(48, 64), 64 * 49 + 5 * 65),
        (Shape(1, 1), 2 + 10),
    ],
)
def test_theta_is_as_long_as_its_weights_and_biases(shape, size):
    assert shape.size == size
    with pytest.raises(ValueError, match=rf"^theta must have shape \({size},\) for Shape\(.*\); got \({size + 1},\)$"):
        Policy(np.zeros(size + 1), shape, plain(shape.n_features))


def test_theta_lies_row_by_row_the_input_layer_first():
    first, second = unflatten(np.arange(2 * 4 + 5 * 3), Shape(3, 2))
    assert first.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert second.tolist() == [[8, 9, 10], [11, 12, 13], [14, 15, 16], [17, 18, 19], [20, 21, 22]]


def test_the_layers_are_views_so_that_a_change_of_theta_shows():
    theta = np.zeros(15)
    unflatten(theta, Shape(2, None))[0][4, 2] = 7.0
    assert theta[14] == 7.0


def test_whitening_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"^whitening must have shape \(2,\); got \(3,\)$"):
        Policy(np.zeros(15), Shape(2, None), plain(3))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(wrong):
    theta, whitening = np.zeros(15), plain(2)
    theta[[3, 7]] = wrong
    with pytest.raises(ValueError, match=r"^theta must be finite; 2 of 15 values are not$"):
        Policy(theta, Shape(2, None), whitening)
    whitening.mean[1] = wrong
    with pytest.raises(ValueError, match=r"^whitening must be finite; 1 of 4 values are not$"):
        Policy(np.zeros(15), Shape(2, None), whitening)


def test_whitening_is_measured_by_column_and_a_constant_feature_keeps_its_scale():
    whitening = Whitening.of(np.array([[1.0, 7.0, -3.0], [3.0, 7.0, -5.0]]))
    assert whitening.mean.tolist() == [2.0, 7.0, -4.0]
    assert whitening.std.tolist() == [1.0, 1.0, 1.0]
    assert Whitening.of(np.array([[0.0], [8.0]])).std.tolist() == [4.0]


@given(seeds)
def test_whitened_by_their_own_statistics_observations_have_mean_0_and_deviation_1(seed):
    observations = np.random.default_rng(seed).normal(5.0, 3.0, size=(50, 4))
    whitening = Whitening.of(observations)
    whitened = (observations - whitening.mean) / whitening.std
    assert whitened.mean(axis=0) == pytest.approx(np.zeros(4), abs=1e-9)
    assert whitened.std(axis=0) == pytest.approx(np.ones(4))


def test_a_policy_does_not_change_what_it_is_given():
    theta, observation = np.arange(15.0), np.array([1.0, 2.0])
    Policy(theta, Shape(2, None), Whitening(np.ones(2), np.full(2, 2.0)))(observation)
    assert theta.tolist() == list(range(15))
    assert observation.tolist() == [1.0, 2.0]
