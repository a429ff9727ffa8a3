"""How much of a simulation's beginning is left out: until the number of vehicles on the road has settled."""

from collections.abc import Sequence

import numpy as np

BATCH_S = 5
"""Counts are averaged over so many seconds first (MSER-5)."""


def found_s(counts: Sequence[float]) -> tuple[int, bool]:
    """Return how many seconds to leave out of counts a second apart, and whether they settle.

    The marginal standard error rule (MSER-5): what is left has the smallest standard error of its mean. They do not
    settle if that leaves out more than half of them, as where more vehicles come than leave.

    Source: White (1997), "An effective truncation heuristic for bias reduction in simulation output".
    """
    whole = len(counts) // BATCH_S * BATCH_S
    batches = np.asarray(counts[:whole], dtype=np.float64).reshape(-1, BATCH_S).mean(axis=1)
    if len(batches) < 4:
        return 0, False
    last = len(batches) - 2
    errors = [batches[first:].var() / (len(batches) - first) for first in range(last)]
    first = int(np.argmin(errors))
    settles = first <= len(batches) // 2
    return min(first, len(batches) // 2) * BATCH_S, settles
