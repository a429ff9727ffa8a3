"""Means, ratios and differences, and how sure they are.

All of them are over independent units. Of a driver that does not train, and of one training alone, the units are
episodes. Of several trainings the units are the trainings, each by its mean over its episodes, because episodes of one
training are alike: `units` makes them. Intervals are Student's, of 95 %: they hold the truth as often as they say for
two units as for two hundred, as long as the units vary about normally (tests/test_statistics.py measures how often, on
trainings that differ as they do here). What they cannot do with few units is be narrow.

Two drivers on the same traffic are compared unit by unit. The ratio is of means; its interval holds every r for which
the mean of score - r * reference may be 0 (Fieller, "Some problems in interval estimation", JRSS B 16, 1954). So the
ratio's interval holds 1 just where the difference's holds 0, and where the reference's own mean may be 0 there is none.

Means and not interquartile means (Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021): episodes here have light tails, on which the latter are less sure by a tenth to a fifth.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from rail_sumo.records import Floats

CONFIDENCE = 0.95
ROUNDING = 1e-12
"""Units that differ by less, relative to their mean, are the same."""


class Estimate(NamedTuple):
    """A figure with its 95 % interval, which is NaN where the units do not tell one."""

    value: float
    low: float
    high: float


UNKNOWN = Estimate(math.nan, math.nan, math.nan)


def units(scores: ArrayLike, *, trained: bool) -> Floats:
    """Return independent units of scores, shape (n_units,).

    Args:
        scores: shape (n_seeds, n_episodes): a row for each seed, whose episodes are on traffic of its own.
        trained: whether each row is of a training of its own; else one driver drove all of them.
    """
    scores = np.asarray(scores, dtype=np.float64)
    return scores.mean(axis=1) if trained else scores.ravel()


def mean(scores: ArrayLike) -> Estimate:
    """Return the mean of units, shape (n_units,); NaN of none.

    Of one unit there is no interval. That of units which are all the same has no width: they did not vary, which does
    not tell that others cannot.
    """
    scores = np.asarray(scores, dtype=np.float64)
    return _around(float(scores.mean()), scores) if len(scores) else UNKNOWN


def difference(scores: ArrayLike, reference: ArrayLike) -> Estimate:
    """Return the mean of score minus reference, unit by unit, each of shape (n_units,)."""
    return mean(np.asarray(scores, dtype=np.float64) - np.asarray(reference, dtype=np.float64))


def ratio(scores: ArrayLike, reference: ArrayLike) -> Estimate:
    """Return the mean score over the mean reference, unit by unit, each of shape (n_units,), with Fieller's interval.

    NaN where the reference's mean is 0. There is no interval where the reference's mean may be 0, for all that its
    units tell.
    """
    scores, reference = np.asarray(scores, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if not len(scores) or not reference.mean():
        return UNKNOWN
    n, below = len(scores), float(reference.mean())
    quotient = float(scores.mean()) / below
    if n == 1:
        return Estimate(quotient, math.nan, math.nan)
    # r = quotient + u is within where (u below)² <= own - 2 u shared + u² theirs: t² times the variance of the mean of
    # score - r * reference.
    covariance = _quantile(n) ** 2 / n * np.cov(scores - quotient * reference, reference)
    (own, shared), (_, theirs) = covariance.tolist()
    surely = below**2 - theirs
    if surely <= 0.0:
        return Estimate(quotient, math.nan, math.nan)
    if own <= (ROUNDING * float(scores.mean())) ** 2:
        return Estimate(quotient, quotient, quotient)
    reach = math.sqrt(shared**2 + surely * own)
    return Estimate(quotient, quotient - (shared + reach) / surely, quotient - (shared - reach) / surely)


def share(scores: ArrayLike) -> Estimate:
    """Return in what share of scores, of any shape, something happened (is not 0), with Wilson's interval.

    It also tells how often what never happened may yet happen. It takes all scores as independent: where trainings
    differ in how often something happens, it is too narrow. Without scores all is NaN.
    """
    happened = np.asarray(scores) != 0
    if not happened.size:
        return Estimate(math.nan, math.nan, math.nan)
    from scipy import stats  # takes a second to import, and most commands need no share

    found = stats.binomtest(int(happened.sum()), happened.size)
    low, high = found.proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(found.statistic, float(low), float(high))


def probability_of_improvement(scores: ArrayLike, reference: ArrayLike) -> float:
    """Return how likely a score drawn at random beats one of the reference, ties counting half (Mann-Whitney's U).

    NaN if a score is.
    """
    ours, theirs = (np.sort(np.asarray(one, dtype=np.float64), axis=None) for one in (scores, reference))
    if np.isnan([ours[-1], theirs[-1]]).any():  # NaN is sorted last
        return math.nan
    below, up_to = np.searchsorted(theirs, ours, "left"), np.searchsorted(theirs, ours, "right")
    return float((below + up_to).mean() / (2 * len(theirs)))


def _around(value: float, deviating: Floats) -> Estimate:
    """Return the value with Student's interval from what deviates as its units do."""
    n = len(deviating)
    if n == 1:
        return Estimate(value, math.nan, math.nan)
    error = float(deviating.std(ddof=1)) / math.sqrt(n)
    if error <= ROUNDING * abs(value):
        return Estimate(value, value, value)
    reach = _quantile(n) * error
    return Estimate(value, value - reach, value + reach)


def _quantile(n: int) -> float:
    """Return how many standard errors the interval of a mean of so many units reaches: Student's t."""
    return float(special.stdtrit(n - 1, (1 + CONFIDENCE) / 2))
