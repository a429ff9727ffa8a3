"""How much of a simulation's beginning is left out: until the number of vehicles on the road no longer grows."""

from collections.abc import Sequence

import numpy as np

BATCH_S = 30
"""Counts are averaged over so many seconds: signals and platoons make them swing."""
ENOUGH = 0.95
"""The road is full once it holds this share of the vehicles that it holds on average later."""
GROWS = 1.1
"""The number still grows if it is so many times as large in the last quarter as in the quarter before, ..."""
BY_CHANCE = 2.0
"""... and by more than so many standard deviations of a number that varies by chance alone, as Poisson's does."""


def found_s(counts: Sequence[float]) -> tuple[int, bool]:
    """Return how many seconds to leave out of counts a second apart, and whether they settle.

    "Later" is the second half. If the number still grows there, since more vehicles come than leave, the whole first
    half is left out.

    Source: the rule of FHWA's Traffic Analysis Toolbox, volume III: initialization is over once the number of vehicles
    in the network has stopped growing.
    """
    numbers = np.asarray(counts, dtype=np.float64)
    half = len(numbers) // 2
    settled = numbers[half:]
    if len(settled) < 2 * BATCH_S:
        return half, False
    before, after = settled[: len(settled) // 2].mean(), settled[len(settled) // 2 :].mean()
    if after > GROWS * before and after - before > BY_CHANCE * np.sqrt(before):
        return half, False
    for end in range(BATCH_S, half, BATCH_S):
        if numbers[end - BATCH_S : end].mean() >= ENOUGH * settled.mean():
            return end, True
    return half, True
