"""Counts the vehicles that the host overtakes, and those that overtake it."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rail_sumo.highway.compiled import compiled
from rail_sumo.records import Floats, Scene

NEAR_M = 60.0
"""Only vehicles this near the host are sorted into ahead and behind. Farther off they may be rounding a bend."""

SAME_WAY = 0.5
"""Cosine of the angle to the host's heading, 60 degrees, up to which a vehicle drives the host's way."""

AWAY, AHEAD, BEHIND, ALONGSIDE = 0, 1, 2, 3
"""Where a vehicle is, seen from the host: away if it is far off or drives another way."""


class PassCounter:
    """Counts vehicles driving the host's way that were fully ahead and are fully behind, and the reverse.

    Jitter alongside does not count, nor does a vehicle that appears or vanishes: each passes only from one clear side
    to the other.

    Args:
        near_m: only vehicles this near the host are looked at; let it be more than anybody closes between two looks.
    """

    def __init__(self, near_m: float = NEAR_M) -> None:
        self._near_m = near_m
        self._last: dict[str, int] = {}  # the clear side each vehicle near was last on; AWAY if none yet

    def update(self, scene: Scene, counts: Callable[[str], bool] = lambda name: True) -> tuple[int, int]:
        """Return how many vehicles the host overtook, and how many overtook it, since the last look.

        Args:
            scene: what is around the host now.
            counts: whether a vehicle counts; one on a parallel road does not.
        """
        sides = sides_of(scene.boxes, self._near_m)
        overtakes = overtaken = 0
        last: dict[str, int] = {}
        for name, side in zip(scene.ids, sides.tolist(), strict=True):
            if side == AWAY:
                continue
            before = self._last.get(name, AWAY)
            last[name] = before if side == ALONGSIDE else side
            if before != AWAY and before != last[name] and counts(name):
                overtakes += side == BEHIND
                overtaken += side == AHEAD
        self._last = last
        return overtakes, overtaken


@compiled("int8[::1](float64[:, ::1], float64)")
def sides_of(boxes: Floats, near_m: float) -> NDArray[np.int8]:
    """Return on which side of the host each of a `Scene`'s vehicles is, shape (n_vehicles,); the host itself is away.

    Alongside begins and ends where the bumpers part: half of both lengths.
    """
    x_m, y_m, heading_rad, length_m = boxes[0], boxes[1], boxes[2], boxes[4]
    sides = np.full(len(x_m), AWAY, dtype=np.int8)
    host_cos, host_sin = math.cos(heading_rad[0]), math.sin(heading_rad[0])
    for row in range(1, len(x_m)):
        east, north = x_m[row] - x_m[0], y_m[row] - y_m[0]
        is_near = east * east + north * north < near_m * near_m
        if is_near and math.cos(heading_rad[row] - heading_rad[0]) > SAME_WAY:
            along = east * host_cos + north * host_sin
            clear = 0.5 * (length_m[row] + length_m[0])
            sides[row] = AHEAD if along > clear else BEHIND if along < -clear else ALONGSIDE
    return sides
