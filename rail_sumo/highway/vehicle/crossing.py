"""Others in the host's way through a junction: how far that is free, how fast it may go on, and how it passes them.

SUMO keeps vehicles apart by right of way before they enter a junction. Inside, where one is stuck across the other's
way, it lets them touch. Pure.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rail_sumo.records import Floats

CROSSES_RAD = math.radians(30.0)
"""Whoever's heading differs by more than this from that of the host's way there drives across it, or against it."""
CLEAR_M = 0.5
"""The room that is left to them, ahead."""
BESIDE_M = 0.4
"""The room that the host leaves beside those it passes, if its lane is wide enough."""
LEAST_BESIDE_M = 0.2
"""The least that it leaves. It moves aside for nobody who has as much."""
PASSING_MPS = 8.0
"""How fast they are passed, at most."""
STRIDE_M = 0.1
"""The host moves aside for them by multiples of this."""
ROUNDING = 1e-6
"""What it may take from a number of strides."""
STANDS_MPS, SLOW_MPS = 0.5, 5.0
"""Whoever is slower within a junction stands there, or may be about to."""
BRAKING_MPS2 = 4.5
"""How hard the host brakes for the others as long as that is enough, and they for it."""


def allowed_mps(free_m: float) -> float:
    """Return the speed from which the host stops in time before somebody so far ahead: v^2 = 2 b s."""
    return math.sqrt(2 * BRAKING_MPS2 * max(free_m - CLEAR_M, 0.0))


def passing_mps(free_m: float, braking_mps2: float) -> float:
    """Return the speed from which the host comes down to `PASSING_MPS` until so far ahead, by such braking."""
    return math.sqrt(PASSING_MPS**2 + 2 * braking_mps2 * max(free_m, 0.0))


def free_m(others: Floats, way: Floats, *, width_m: float, aside_m: float = 0.0) -> float:
    """Return how far ahead the host's way is free of those who cross it; inf if it is.

    Args:
        others: x, y, heading in rad, speed, length and width of their boxes, as in a `Scene`, shape (6, n).
        way: the points that the middle of its front comes by, from where it is, shape (k, 2).
        width_m: of the host.
        aside_m: how far to the left of those points it drives.
    """
    return _free_m(others, _straights(way), width_m / 2, aside_m)


def stopped(others: Floats) -> Floats:
    """Return where those of the others who are slow may come to a stop at the earliest, shape (6, n_slow)."""
    x, y, heading, speed, length, width = others[:, others[3] < SLOW_MPS]
    goes_on_m = speed**2 / (2 * BRAKING_MPS2)
    x, y = x + goes_on_m * np.cos(heading), y + goes_on_m * np.sin(heading)
    return np.array([x, y, heading, np.zeros_like(speed), length, width])


def aside_m(host: Floats, others: Floats, way: Floats, *, lane_m: float, now_m: float) -> float:
    """Return how far to the left of its way the host had better drive, within its lane, to pass those who stand there.

    Or who may be about to. It is 0 where nobody is in its way. The host stays where it is beside somebody who drives
    on, and where somebody cannot be passed. In a turn it passes nobody: it may have to wait there, where the middle of
    its lane keeps it out of the way of others.

    Args:
        host: its box, as in a `Scene`, shape (6,).
        others: as for `free_m`.
        way: as for `free_m`.
        lane_m: how wide its lane is.
        now_m: how far to the left it is now.
    """
    heading, length_m, width_m = host[[2, 4, 5]]
    back = length_m * np.array([math.cos(heading), math.sin(heading)])
    body, *parts = _straights(np.vstack([way[0] - back, way]))
    if not parts or abs(math.remainder(parts[-1].heading - parts[0].heading, 2 * math.pi)) > CROSSES_RAD:
        return 0.0

    def is_free(others: Floats, beside_m: float, aside_m: float) -> bool:
        return math.isinf(_free_m(others, [body, *parts], width_m / 2 + beside_m, aside_m))

    standing = stopped(others)
    if is_free(standing, LEAST_BESIDE_M, 0.0):
        return 0.0 if is_free(others, LEAST_BESIDE_M, 0.0) else now_m
    strides = range(1, math.floor((lane_m - width_m) / 2 / STRIDE_M + ROUNDING) + 1)
    for beside_m in (BESIDE_M, LEAST_BESIDE_M):
        for one_m in (side * n * STRIDE_M for n in strides for side in (-1, 1)):
            if is_free(standing, beside_m, one_m):
                return one_m
    return now_m


class _Part(NamedTuple):
    """A straight part of a way."""

    x_m: float
    y_m: float
    heading: float
    length_m: float


def _straights(way: Floats) -> list[_Part]:
    """Return the straight parts of a way."""
    steps = np.diff(way, axis=0)
    parts = zip(*way[:-1].T, np.arctan2(steps[:, 1], steps[:, 0]), np.hypot(*steps.T), strict=True)
    return [_Part(*map(float, part)) for part in parts if part[-1]]


def _free_m(others: Floats, parts: Iterable[_Part], half_width: float, aside_m: float) -> float:
    before_m = 0.0
    for part in parts if others.size else ():
        nearest_m = _free_straight_m(others, part, half_width, aside_m)
        if nearest_m <= part.length_m:
            return before_m + nearest_m
        before_m += part.length_m
    return math.inf


def _free_straight_m(others: Floats, part: _Part, half_width: float, aside_m: float) -> float:
    """Return how far ahead on one straight part the nearest is who crosses it; inf if nobody does."""
    x, y, headings, _, lengths, widths = others
    cosine, sine = math.cos(part.heading), math.sin(part.heading)
    ahead = (x - part.x_m) * cosine + (y - part.y_m) * sine
    left = (y - part.y_m) * cosine - (x - part.x_m) * sine - aside_m
    reach = (lengths + widths) / 2
    is_near = (np.abs(left) <= half_width + reach) & (ahead >= -reach) & (ahead <= part.length_m + reach)
    free = math.inf
    for k in np.flatnonzero(is_near):
        turned = headings[k] - part.heading
        if abs(math.remainder(turned, 2 * math.pi)) <= CROSSES_RAD:
            continue
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (lengths[k] / 2, widths[k] / 2)
        cosine, sine = math.cos(turned), math.sin(turned)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        free = min(free, _nearest_in_strip(corners @ turn + (ahead[k], left[k]), half_width))
    return free


def _nearest_in_strip(corners: Floats, half_width: float) -> float:
    """Return how far ahead a polygon begins within a strip ahead, at least 0; inf if it does not reach into it."""
    reached = []
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if abs(y0) <= half_width:
            reached.append(x0)
        for border in (-half_width, half_width):
            if (y0 - border) * (y1 - border) < 0.0:
                reached.append(x0 + (x1 - x0) * (border - y0) / (y1 - y0))
    if not reached or max(reached) < 0.0:
        return math.inf
    return max(min(reached), 0.0)
