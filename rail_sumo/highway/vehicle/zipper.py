"""Whom a driven vehicle lets go first where two lanes become one and drivers take turns: SUMO's zipper junctions."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import libsumo

from rail_sumo import config
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.vehicle import acc
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.highway.vehicle.whereabouts import to_lane_end_m

SIGHT_M = 150.0
"""How far before the place where the lanes meet a driver makes room: SUMO's own do from 100 m on, and brake harder."""
CRAWL_MPS = 1.0
"""Whoever is slower counts as so fast: of those who stand, the nearer goes first."""


class Approach(NamedTuple):
    """A vehicle on its way to where the lanes meet."""

    name: str
    metres: float
    """How far its front has to go."""
    speed_mps: float
    braking_mps2: float
    """How hard it may brake."""

    @property
    def seconds(self) -> float:
        """When it is there, if it keeps its speed."""
        return self.metres / max(self.speed_mps, CRAWL_MPS)

    def stays_behind(self, other: "Approach") -> bool:
        """Whether it is behind another, and could stay there by braking for a second."""
        behind_m = self.metres - other.metres
        return behind_m > max(self.speed_mps - self.braking_mps2 - other.speed_mps, 0.0)


class Zipper:
    """Tells how fast one vehicle may be to take its turn.

    Args:
        name: its id.
        adas: limits of its car-following.
    """

    def __init__(self, name: str, adas: config.Adas) -> None:
        self._name = name
        self._adas = adas

    def follow(self, road: Road) -> None:
        """Look along a course."""
        self._zips_with, self._next_lanes = road.zips_with, road.next_lanes

    def allowed_mps(self, speed_mps: float) -> float:
        """Return how fast it may be at the end of the next step, to fall in behind whoever goes first.

        For that it brakes no more than comfortably; inf if nobody goes first.
        """
        if not self._zips_with:
            return math.inf
        falling_in = (acc.falling_in_mps(speed_mps, one, self._adas) for one in self._who_go_first())
        return min(falling_in, default=math.inf)

    def _who_go_first(self) -> Iterator[Leader]:
        """Yield of each lane that is about to join its own the last of those who go first."""
        others, to_meet_m = self._lanes_that_join()
        if not others:
            return
        own = _approach(self._name, to_meet_m)
        for lane in others:
            last = None
            for name in reversed(libsumo.lane.getLastStepVehicleIDs(lane)):  # the foremost first
                its = _approach(name, to_lane_end_m(name))
                if not goes_first(its, own):
                    break
                last = Leader(own.metres - its.metres - libsumo.vehicle.getLength(name), its.speed_mps)
            if last is not None:
                yield last

    def _lanes_that_join(self) -> tuple[tuple[str, ...], float]:
        """Return the lanes that join its own in sight, and how far ahead they do; none if that is farther."""
        lane, ahead_m = libsumo.vehicle.getLaneID(self._name), to_lane_end_m(self._name)
        while lane and lane not in self._zips_with and ahead_m < SIGHT_M:
            lane = next(iter(self._next_lanes.get(lane, ())), "")
            ahead_m += libsumo.lane.getLength(lane) if lane else math.inf
        return (self._zips_with.get(lane, ()), ahead_m) if ahead_m < SIGHT_M else ((), math.inf)


def goes_first(one: Approach, other: Approach) -> bool:
    """Return whether one of two goes first, by the rule of SUMO's drivers: both must be of one mind.

    Whoever is ahead does, if the other could stay behind by braking for a second. Else the earlier one does.
    """
    if one.stays_behind(other) or other.stays_behind(one):
        return other.stays_behind(one)
    return (one.seconds, one.name) < (other.seconds, other.name)


def _approach(name: str, metres: float) -> Approach:
    return Approach(name, metres, libsumo.vehicle.getSpeed(name), libsumo.vehicle.getDecel(name))
