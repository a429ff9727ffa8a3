"""Who passes whom."""

import math

import numpy as np

from rail_sumo.records import Scene

NEAR_M = 60.0
"""Only vehicles this near the host are sorted into ahead and behind. Farther off they may be rounding a bend, and
nobody closes more than this between two looks."""


class PassCounter:
    """Counts vehicles that were fully ahead and are fully behind, and the reverse.

    Jitter alongside does not count, nor does a vehicle that appears or vanishes: each passes only from one clear
    side to the other. Look at least every 2 s.
    """

    def __init__(self) -> None:
        self._ahead: set[str] = set()
        self._behind: set[str] = set()

    def update(self, scene: Scene) -> tuple[int, int]:
        """Return how many vehicles the host overtook, and how many overtook it, since the last look."""
        east, north = scene.x_m - scene.x_m[0], scene.y_m - scene.y_m[0]
        along = east * math.cos(scene.heading_rad[0]) + north * math.sin(scene.heading_rad[0])
        near = np.flatnonzero(east * east + north * north < NEAR_M * NEAR_M)[1:]  # without the host itself
        ahead: set[str] = set()
        behind: set[str] = set()
        alongside: set[str] = set()
        for index, distance in zip(near.tolist(), along[near].tolist(), strict=True):
            clear = 0.5 * (scene.length_m[index] + scene.length_m[0])
            side = ahead if distance > clear else behind if distance < -clear else alongside
            side.add(scene.ids[index])
        overtakes, overtaken = len(self._ahead & behind), len(self._behind & ahead)
        self._ahead = ahead | (self._ahead & alongside)
        self._behind = behind | (self._behind & alongside)
        return overtakes, overtaken
