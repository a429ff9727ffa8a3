"""How long the queues ahead are in the lanes of a driven vehicle's edge, in SUMO."""

import math
from collections.abc import Iterator, Mapping, Sequence

import libsumo

from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.vehicle.whereabouts import ahead_on

SLOW_MPS = 2.0
"""Whoever is slower is in a queue."""
MATTERS_M = 2000.0
"""Lanes that end farther ahead need not be left for a queue by now."""


class Queues:
    """Measures them for one vehicle.

    Args:
        name: its id.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._seen: tuple[str, tuple[float, ...]] | None = None  # since it looked: its edge, and the queues

    def follow(self, next_lanes: Mapping[str, Sequence[str]]) -> None:
        """Look along a course: the lanes that each of its lanes leads to."""
        self._next_lanes = next_lanes
        self._seen = None

    def look_again(self) -> None:
        """Measure afresh from now on."""
        self._seen = None

    def queued_m(self, edge: Edge) -> tuple[float, ...]:
        """Return for each lane of its edge how long the queue ahead is, up to where the first lane ends.

        Empty where none ends soon.
        """
        if self._seen is None or self._seen[0] != edge.id:
            self._seen = edge.id, self._measured(edge)
        return self._seen[1]

    def _measured(self, edge: Edge) -> tuple[float, ...]:
        here_m = libsumo.vehicle.getLanePosition(self._name)
        ends_in_m = edge.ends_in_m(here_m)
        nearest_m = min(ends_in_m.values())
        if nearest_m == max(ends_in_m.values()) or nearest_m > MATTERS_M:
            return ()
        return tuple(sum(self._slow_ones_m(f"{edge.id}_{lane}", here_m, here_m + nearest_m)) for lane in edge.lanes)

    def _slow_ones_m(self, lane: str, begin_m: float, end_m: float) -> Iterator[float]:
        """Yield the room that each vehicle of a queue takes up between two places on a lane and those it leads to."""
        vehicle = libsumo.vehicle
        while lane and end_m > 0.0:
            for name in ahead_on(lane, begin_m):
                if vehicle.getSpeed(name) < SLOW_MPS and vehicle.getLanePosition(name) < end_m:
                    yield vehicle.getLength(name) + vehicle.getMinGap(name)
            end_m -= libsumo.lane.getLength(lane)
            lane, begin_m = next(iter(self._next_lanes.get(lane, ())), ""), -math.inf
