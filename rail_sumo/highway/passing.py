"""Who passes whom."""

import math
from collections.abc import Callable

import numpy as np

from rail_sumo.records import Scene

NEAR_M = 60.0
"""Only vehicles this near the host are sorted into ahead and behind. Farther off they may be rounding a bend."""

SAME_WAY = 0.5
"""Cosine of the angle to the host's heading, 60 degrees, up to which a vehicle drives the host's way."""


class PassCounter:
    """Counts vehicles driving the host's way that were fully ahead and are fully behind, and the reverse.

    Jitter alongside does not count, nor does a vehicle that appears or vanishes: each passes only from one clear side
    to the other.

    Args:
        near_m: only vehicles this near the host are looked at; let it be more than anybody closes between two looks.
    """

    def __init__(self, near_m: float = NEAR_M) -> None:
        self._near_m = near_m
        self._ahead: set[str] = set()
        self._behind: set[str] = set()

    def update(self, scene: Scene, counts: Callable[[str], bool] = lambda name: True) -> tuple[int, int]:
        """Return how many vehicles the host overtook, and how many overtook it, since the last look.

        Args:
            scene: what is around the host now.
            counts: whether a vehicle counts; one on a parallel road does not.
        """
        heading = scene.heading_rad[0]
        east, north = scene.x_m - scene.x_m[0], scene.y_m - scene.y_m[0]
        along = east * math.cos(heading) + north * math.sin(heading)
        clear = 0.5 * (scene.length_m + scene.length_m[0])
        away = np.where(np.cos(scene.heading_rad - heading) > SAME_WAY, np.hypot(east, north), np.inf)
        ahead: set[str] = set()
        behind: set[str] = set()
        alongside: set[str] = set()
        rows = zip(scene.ids, along.tolist(), clear.tolist(), away.tolist(), strict=True)
        next(rows)  # the host itself
        for name, distance, touching, apart in rows:
            if apart < self._near_m:
                side = ahead if distance > touching else behind if distance < -touching else alongside
                side.add(name)
        overtakes, overtaken = (sum(map(counts, passed)) for passed in (self._ahead & behind, self._behind & ahead))
        self._ahead = ahead | (self._ahead & alongside)
        self._behind = behind | (self._behind & alongside)
        return overtakes, overtaken
