"""A fresh classifier, on drivers that are made up so that it is known how well they can be told from their expert."""

from functools import cache

import numpy as np
import pytest
import torch
from toy import episode

from rail_sumo.records import MetaAction
from rail_sumo.tables.audit import FOLDS, told_apart

pytestmark = pytest.mark.xdist_group("audit")  # what `apart` finds is found once

N_EPISODES, N_DECISIONS = 8, 200


def seen(seed, n_features=6):
    """What is sensed in an episode: noise, other in every episode."""
    return np.random.default_rng(seed).normal(size=(N_DECISIONS, n_features))


def right(observations):
    """What the expert does: it looks at the first feature alone."""
    return np.where(observations[:, 0] > 0, MetaAction.ACCELERATE, MetaAction.LEFT)


def driven(first_seed, decide=right, n=N_EPISODES, n_features=6):
    sights = [seen(first_seed + number, n_features) for number in range(n)]
    return [episode(one, decide(one)) for one in sights]


def otherwise(share):
    """A driver that brakes, which the expert never does, in that share of its decisions, and else does the same."""
    brakes = np.arange(N_DECISIONS) < share * N_DECISIONS
    return lambda observations: np.where(brakes, MetaAction.DECELERATE, right(observations))


EXPERT, ALIKE = driven(0), driven(100)


@cache
def apart(share):
    """How well who does otherwise in that share of its decisions is told from the expert, by episode."""
    return told_apart(driven(100, otherwise(share)), EXPERT)


def test_who_decides_alike_is_not_told_apart():
    assert apart(0.0).mean() == pytest.approx(0.5, abs=0.04)


# A classifier puts the braking below all else and can only guess about the rest: 1/2 for the pairs that it guesses.
@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_who_decides_otherwise_is_told_apart_by_as_much(share):
    assert apart(share).mean() == pytest.approx(share + (1 - share) / 2, abs=0.04)


def test_who_does_the_same_as_often_but_at_the_wrong_moments_is_told_apart():
    swapped = driven(100, lambda observations: right(-observations), n=16)  # which takes more episodes to find out
    assert told_apart(swapped, driven(0, n=16)).mean() > 0.95


def test_who_comes_to_see_something_else_is_told_apart():
    strayed = driven(100)
    for one in strayed:
        one.observations[:, 3] += 4.0
    assert told_apart(strayed, EXPERT).mean() > 0.95


def test_every_episode_has_its_own_figure_in_its_place():
    learner = driven(100, otherwise(1.0))
    learner[::2] = ALIKE[::2]
    told = told_apart(learner, EXPERT)
    assert told.shape == (N_EPISODES,)
    assert (told[1::2] > 0.95).all()
    assert told[::2].mean() == pytest.approx(0.5, abs=0.05)


def test_learner_and_expert_may_change_places():
    learner = driven(100, otherwise(0.5))
    assert apart(0.5).mean() == pytest.approx(told_apart(EXPERT, learner).mean(), abs=0.02)


def test_in_what_unit_a_feature_is_makes_no_difference():
    learner = driven(100, otherwise(0.5))
    rescaled = [[episode(1000.0 * one.observations + 7.0, one.decisions) for one in who] for who in (learner, EXPERT)]
    np.testing.assert_allclose(told_apart(*rescaled), apart(0.5), atol=0.01)


def test_an_episode_is_scored_by_a_classifier_that_has_not_met_it():
    learner, expert = driven(100, n_features=400), driven(0, n_features=400)  # so many that one can learn by heart
    assert told_apart(learner, expert).mean() == pytest.approx(0.5, abs=0.04)
    # Were it met, this is how it would look: every episode is there twice, and its copy most often in another fold.
    assert told_apart([*learner, *learner], [*expert, *expert]).mean() > 0.7


def test_too_few_episodes_to_hold_some_out_tell_nothing():
    for n in (0, 1, FOLDS - 1):
        few = told_apart(ALIKE[:n], EXPERT[:n])
        assert few.shape == (n,)
        assert np.isnan(few).all()
    assert np.isfinite(told_apart(ALIKE[:FOLDS], EXPERT[:FOLDS])).all()


def test_the_same_episodes_give_the_same_figures_and_the_generators_are_left_alone(left_alone_by):
    told = [apart(0.0)]
    torch.rand(1)
    assert left_alone_by(lambda: told.append(told_apart(ALIKE, EXPERT)))
    assert told[0].tolist() == told[1].tolist()


@pytest.mark.parametrize("n", [0, N_EPISODES - 1])
def test_as_many_episodes_of_either_are_wanted(n):
    with pytest.raises(ValueError, match=rf"as many episodes of the expert as of the learner are wanted, {n}; got 8"):
        told_apart(ALIKE[:n], EXPERT)
