"""Figures over training seeds and episodes, and how sure they are.

Scores have shape (..., n_seeds, n_episodes): a row for each training, whose episodes are on traffic of its own. One
training is the case of one row.

Source: interquartile mean, bootstrap intervals and probability of improvement as in Agarwal et al., "Deep reinforcement
learning at the edge of the statistical precipice" (NeurIPS 2021), whose scores are means over a training's episodes.
Ours are the episodes themselves: the middle half is of all that was driven. Resampling goes in two stages because
episodes of one training are alike (Davison & Hinkley, "Bootstrap methods and their application", 1997, section 3.8).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, trim_mean

from rail_sumo.records import Floats

CONFIDENCE = 0.95
N_RESAMPLES = 10_000
DRAWN_AT_ONCE = 2**21
"""At most this many scores are drawn at a time, to bound memory."""


def iqm(scores: ArrayLike) -> Floats:
    """Return the mean of the middle half of all scores, shape (...); blind to what befalls less than a quarter."""
    scores = np.asarray(scores, dtype=np.float64)
    return trim_mean(scores.reshape(*scores.shape[:-2], -1), 0.25, axis=-1)


def ratio_of_iqms(scores: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the interquartile mean of the scores over that of a reference driven on the same traffic, shape (...).

    Where the reference's is 0 there is no ratio: inf, or NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return iqm(scores) / iqm(reference)


def interval(
    statistic: Callable[..., Floats], *scores: ArrayLike, n_resamples: int = N_RESAMPLES
) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of a statistic.

    Trainings are drawn with replacement, and within each its episodes. Several scores are drawn together, episode by
    episode: they are of drivers on the same traffic. The same scores always give the same interval.

    How often it holds the truth depends on how much trainings differ. Where they hardly do, it counts chance twice and
    is too wide: of five trainings of 16 episodes it holds the truth in some 97 of 100 cases. Where they differ as much
    as their episodes, in some 88; with forty trainings in 94. Of one training it tells nothing about others.

    Where the statistic of a draw is not finite there is no interval: NaN.

    Args:
        statistic: of scores with any leading axes, such as `iqm`.
        scores: each of shape (n_seeds, n_episodes), all alike.
        n_resamples: how many to draw.

    Raises:
        ValueError: no scores, or of different shapes.
    """
    arrays = [np.asarray(one, dtype=np.float64) for one in scores]
    shapes = {array.shape for array in arrays}
    if len(shapes) != 1 or len(arrays[0].shape) != 2 or not arrays[0].size:
        raise ValueError(f"scores must all have one shape (n_seeds, n_episodes), neither 0; got {sorted(shapes)}")
    n_seeds, n_episodes = arrays[0].shape
    rng = np.random.default_rng(0)
    drawn = np.empty(n_resamples)
    at_once = max(1, DRAWN_AT_ONCE // arrays[0].size)
    for some in np.array_split(drawn, math.ceil(n_resamples / at_once)):
        seeds = rng.integers(n_seeds, size=(len(some), n_seeds, 1))
        episodes = rng.integers(n_episodes, size=(len(some), n_seeds, n_episodes))
        some[:] = statistic(*(array[seeds, episodes] for array in arrays))
    if not np.isfinite(drawn).all():  # too often nothing to divide by
        return np.nan, np.nan
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def share_interval(scores: ArrayLike) -> tuple[float, float]:
    """Return Wilson's 95 % interval of how often a score is not 0, all scores being alike.

    A bootstrap of what never happened would be sure that it never will.
    """
    happened = np.asarray(scores) != 0
    share = binomtest(int(happened.sum()), happened.size).proportion_ci(CONFIDENCE, method="wilson")
    return float(share.low), float(share.high)


def probability_of_improvement(scores: ArrayLike, reference: ArrayLike) -> float:
    """Return how likely a score drawn at random beats one of the reference, ties counting half."""
    ours, theirs = (np.sort(np.asarray(one, dtype=np.float64), axis=None) for one in (scores, reference))
    below, up_to = np.searchsorted(theirs, ours, "left"), np.searchsorted(theirs, ours, "right")
    return float((below + up_to).mean() / (2 * len(theirs)))


def mean_difference(scores: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the mean of score minus reference, episode by episode on the same traffic, shape (...)."""
    return (np.asarray(scores, dtype=np.float64) - np.asarray(reference)).mean(axis=(-2, -1))
