"""Who passes whom."""

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
        along = east * np.cos(scene.heading_rad[0]) + north * np.sin(scene.heading_rad[0])
        clear = 0.5 * (scene.length_m + scene.length_m[0])
        ids, near = scene.ids, east * east + north * north < NEAR_M * NEAR_M
        ahead = {ids[i] for i in np.flatnonzero(near & (along > clear))}
        behind = {ids[i] for i in np.flatnonzero(near & (along < -clear))}
        alongside = {ids[i] for i in np.flatnonzero(near & (np.abs(along) <= clear))}
        overtakes, overtaken = len(self._ahead & behind), len(self._behind & ahead)
        self._ahead = ahead | (self._ahead & alongside)
        self._behind = behind | (self._behind & alongside)
        return overtakes, overtaken
