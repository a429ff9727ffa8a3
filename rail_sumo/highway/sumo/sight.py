"""Who is around a driven vehicle, as SUMO has it."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import libsumo
import numpy as np

from rail_sumo.highway.sumo import placing
from rail_sumo.records import Floats, Scene

SEEN_FOR_S, FASTEST_MPS = 0.95, 70.0
"""Where several look around, all vehicles are read so often; nobody drives faster."""
STOREY_M = 3.0
"""Vehicles farther above or below drive on another road, as on a bridge."""

Place = tuple[float, float, float]
"""East, north, up, in metres."""


class _View(NamedTuple):
    """What a host can see."""

    reach_m: float
    is_left_hand: bool


class Sight:
    """What the hosts of one simulation see of one another and of all others."""

    def __init__(self) -> None:
        self._views: dict[str, _View] = {}
        self._sizes: dict[str, tuple[float, float]] = {}
        self._seen: tuple[Sequence[str], Floats] = ((), np.empty((3, 0)))  # where all were, in columns, ...
        self._seen_at_s = -math.inf  # ... and when
        self._unseen: list[str] = []  # who has come on the road since

    def give(self, host: str, *, reach_m: float, is_left_hand: bool) -> None:
        """Give a host its sight: how far along either axis, and whether it sees all in the mirror."""
        self._views[host] = _View(reach_m, is_left_hand)

    def forget(self, name: str) -> None:
        """Forget a vehicle that has been taken off the road, or is driven no longer."""
        self._views.pop(name, None)
        self._sizes.pop(name, None)

    def notice(self) -> None:
        """Notice who has come on the road in the last step."""
        self._unseen += (*libsumo.simulation.getDepartedIDList(), *libsumo.simulation.getEndingTeleportIDList())

    def scene(self, ego: str, *, reach_m: float | None = None) -> Scene:
        """Return a host and every vehicle within its reach, or another, east or west, north or south.

        Vehicles on a bridge above or below are left out. On a road that is driven on the left it is told in the mirror;
        see `Road.is_left_hand`.
        """
        # Getters, not a context subscription: a standing one costs half a step more on every step, and one made for a
        # single look costs more than all the getters together.
        angle, speed = libsumo.vehicle.getAngle, libsumo.vehicle.getSpeed
        sizes, view = self._sizes, self._views[ego]
        reach_m = reach_m or view.reach_m
        here = libsumo.vehicle.getPosition3D(ego)
        names, rows = [ego], [*here[:2], angle(ego), speed(ego), *(sizes.get(ego) or self._size(ego))]
        among = libsumo.vehicle.getIDList() if len(self._views) == 1 else self._near_lately(here, reach_m)
        for name, x, y in self._near(ego, here, reach_m, among):
            names.append(name)
            rows += (x, y, angle(name), speed(name), *(sizes.get(name) or self._size(name)))
        vehicles = np.fromiter(rows, np.float64).reshape(len(names), -1)
        if view.is_left_hand:  # told in the mirror
            vehicles[:, 1] *= -1.0
            vehicles[:, 2] = 180.0 - vehicles[:, 2]
        return Scene(libsumo.simulation.getTime(), names, placing.boxes(vehicles))

    @staticmethod
    def _near(ego: str, here: Place, reach_m: float, among: Iterable[str]) -> Iterator[tuple[str, float, float]]:
        """Yield which others among some vehicles are within reach of one, and where they are."""
        position, (here_x, here_y, here_z) = libsumo.vehicle.getPosition3D, here
        for name in among:
            try:
                x, y, z = position(name)
            except (libsumo.TraCIException, ValueError):  # it has left, or is off the road: it has no height then
                continue
            is_near = -reach_m < x - here_x < reach_m and -reach_m < y - here_y < reach_m
            if is_near and name != ego and abs(z - here_z) < STOREY_M:
                yield name, x, y

    def _near_lately(self, here: Place, reach_m: float) -> Iterable[str]:
        """Return who may be within reach of a place, by where all were a moment ago, which several hosts share."""
        now_s = libsumo.simulation.getTime()
        if now_s - self._seen_at_s > SEEN_FOR_S:
            names = libsumo.vehicle.getIDList()
            places = chain.from_iterable(map(libsumo.vehicle.getPosition3D, names))
            self._seen = names, np.fromiter(places, np.float64, 3 * len(names)).reshape(-1, 3).T.copy()
            self._seen_at_s, self._unseen = now_s, []
        names, (x, y, _) = self._seen
        within_m = reach_m + 2 * FASTEST_MPS * (now_s - self._seen_at_s)
        was_near = (np.abs(x - here[0]) < within_m) & (np.abs(y - here[1]) < within_m)
        return dict.fromkeys((*(names[row] for row in was_near.nonzero()[0].tolist()), *self._unseen))

    def _size(self, name: str) -> tuple[float, float]:
        self._sizes[name] = (libsumo.vehicle.getLength(name), libsumo.vehicle.getWidth(name))
        return self._sizes[name]
