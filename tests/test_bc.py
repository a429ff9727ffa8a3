import numpy as np
import pytest
import torch

from rail_sumo.config import Cloning
from rail_sumo.errors import InputError
from rail_sumo.imitation import bc
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Policy, Shape, Whitening, unflatten


def demonstrated(observations, actions):
    return Demonstrations(observations, np.asarray(actions, dtype=np.int64), np.zeros(len(actions), dtype=np.int64))


def agreement(demonstrations, hidden, cloning, seed=0):
    """How many of the demonstrated decisions the clone makes itself."""
    shape = Shape(demonstrations.observations.shape[1], hidden)
    whitening = Whitening.of(demonstrations.observations)
    policy = Policy(bc.clone(demonstrations, shape, whitening, cloning, seed), shape, whitening)
    return np.mean([policy(seen) == done for seen, done in zip(*decisions(demonstrations), strict=True)])


def decisions(demonstrations):
    return demonstrations.observations, demonstrations.actions


def quadrants(rng, n=800):
    """LEFT in two opposite quadrants and RIGHT in the others, off centre and off scale: no line parts them."""
    centred = rng.uniform(-1.0, 1.0, (n, 2))
    return demonstrated(centred * [3.0, 40.0] + [50.0, -7.0], np.where(centred.prod(axis=1) > 0.0, 3, 4))


def test_without_anything_to_see_it_learns_how_often_each_action_was_taken():
    counts = np.array([10, 40, 20, 5, 25])
    blind = demonstrated(np.ones((100, 1)), np.repeat(np.arange(5), counts))
    cloning = Cloning(epochs=400, batch_size=100, learning_rate=0.05, weight_decay=0.0)
    theta = bc.clone(blind, Shape(1, None), Whitening.of(blind.observations), cloning, seed=0)
    bias = unflatten(theta, Shape(1, None))[0][:, -1]
    # Cross-entropy is least where softmax(bias) equals the frequencies.
    assert np.exp(bias) / np.exp(bias).sum() == pytest.approx(counts / 100, abs=1e-3)


def test_masked_it_learns_how_often_each_action_was_taken_where_it_was_allowed():
    # LEFT was taken in half of the decisions in which it was open: a tenth of all.
    open_left = np.arange(100) < 20
    actions = np.where(np.arange(100) < 10, 3, 0)
    allowed = np.column_stack([np.ones((100, 3), np.bool_), open_left, np.zeros(100, np.bool_)])
    blind = Demonstrations(np.ones((100, 1)), actions, np.zeros(100, dtype=np.int64), allowed)
    cloning = Cloning(epochs=800, batch_size=100, learning_rate=0.05, weight_decay=0.0)
    odds = {}
    for masked in (False, True):
        theta = bc.clone(blind, Shape(1, None), Whitening.of(blind.observations), cloning, seed=0, masked=masked)
        bias = unflatten(theta, Shape(1, None))[0][:, -1]
        odds[masked] = np.exp(bias[3] - bias[0])
    assert odds[True] == pytest.approx(1.0, rel=0.02)
    assert odds[False] == pytest.approx(10 / 90, rel=0.02)


def test_two_layers_learn_what_one_cannot():
    demonstrations = quadrants(np.random.default_rng(0))
    cloning = Cloning(epochs=60, learning_rate=0.01)
    assert agreement(demonstrations, 16, cloning) > 0.95
    assert agreement(demonstrations, None, cloning) < 0.7


def test_it_learns_what_was_done_not_what_is_likely():
    """Negative control: shuffled decisions carry nothing to learn."""
    demonstrations = quadrants(np.random.default_rng(0))
    shuffled = demonstrated(demonstrations.observations, np.random.default_rng(1).permutation(demonstrations.actions))
    assert agreement(shuffled, 16, Cloning(epochs=60, learning_rate=0.01)) < 0.7


def test_one_full_batch_step_of_adam_by_hand():
    """Adam's first step moves every weight by the learning rate against its gradient's sign, whatever its size."""
    demonstrations = demonstrated(np.array([[1.0], [2.0], [5.0]]), [1, 1, 1])
    whitening = Whitening.of(demonstrations.observations)
    cloning = {"batch_size": 3, "learning_rate": 0.01, "weight_decay": 0.0}
    before, after = (
        bc.clone(demonstrations, Shape(1, None), whitening, Cloning(epochs=epochs, **cloning), seed=3)
        for epochs in (0, 1)
    )
    bias_step = (after - before).reshape(5, 2)[:, 1]
    assert bias_step == pytest.approx([-0.01, 0.01, -0.01, -0.01, -0.01], rel=1e-4)


def test_a_seed_is_a_clone_and_the_worlds_chance_is_left_alone():
    demonstrations = quadrants(np.random.default_rng(0), n=100)
    shape, whitening = Shape(2, 8), Whitening.of(demonstrations.observations)
    chance = torch.get_rng_state()
    one, same, other = (bc.clone(demonstrations, shape, whitening, Cloning(epochs=2), seed) for seed in (5, 5, 6))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    assert torch.equal(torch.get_rng_state(), chance)


def test_demonstrations_must_fit_the_policy():
    demonstrations = quadrants(np.random.default_rng(0), n=10)
    whitening = Whitening(np.zeros(3), np.ones(3))
    with pytest.raises(ValueError, match=r"demonstrations must have 3 features .*; got 2"):
        bc.clone(demonstrations, Shape(3, None), whitening, Cloning(), seed=0)


def test_a_clone_whose_weights_do_not_stay_finite_is_refused():
    with pytest.raises(InputError, match=r"^training diverged: weights .* set a smaller cloning\.learning_rate$"):
        agreement(quadrants(np.random.default_rng(0)), 8, Cloning(learning_rate=1e30, epochs=3))
