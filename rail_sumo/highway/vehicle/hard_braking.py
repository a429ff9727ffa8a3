"""Hard brakings, counted. Pure: knows nothing of SUMO."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rail_sumo.records import SECONDS_PER_STEP

HARD_MPS2 = 3.5
"""Braking harder than this is hard: ISO 15622 allows adaptive cruise control no more at 20 m/s and above."""
AVERAGED_STEPS = 5
"""Deceleration is averaged over half a second: a single step's is the jerk of a car-following model, not a braking."""
EASED_MPS2 = 0.5
"""Below this a braking is over."""
ROUNDING_MPS2 = 1e-6


def hard_brakings(speed_mps: ArrayLike) -> int:
    """Return how often the deceleration, averaged over half a second, rises above `HARD_MPS2`.

    A braking counts once, however it varies until it is below `EASED_MPS2`.

    Args:
        speed_mps: a vehicle's speed, a step apart, shape (n_steps + 1,); shorter than half a second has none.
    """
    return int(starts(speed_mps).sum())


def starts(speed_mps: ArrayLike) -> NDArray[np.bool_]:
    """Return in which steps a hard braking begins, for all but the last half second; see `hard_brakings`."""
    speed = np.asarray(speed_mps, dtype=np.float64)
    braking = (speed[:-AVERAGED_STEPS] - speed[AVERAGED_STEPS:]) / (AVERAGED_STEPS * SECONDS_PER_STEP)
    return beginnings(braking > HARD_MPS2 + ROUNDING_MPS2, braking < EASED_MPS2)


def beginnings(hard: NDArray[np.bool_], eased: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a hard braking begins; it counts once until it is over.

    Args:
        hard: where somebody brakes hard, shape (n,).
        eased: where a braking is over, likewise.
    """
    begins, is_counted = np.zeros(len(hard), dtype=np.bool_), False
    for row in np.flatnonzero(hard | eased).tolist():
        begins[row] = hard[row] and not is_counted
        is_counted = (is_counted or hard[row]) and not eased[row]
    return begins
