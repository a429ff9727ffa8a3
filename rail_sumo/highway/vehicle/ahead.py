"""The vehicle ahead of a driven one, in SUMO, with how it speeds up or brakes."""

import math
from collections import deque

import libsumo

from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.records import SECONDS_PER_STEP

OVER_S = 0.5
"""Over how long its acceleration is measured."""


class Ahead:
    """Looks at the vehicle ahead, step by step.

    Args:
        name: the id of the driven vehicle.
        standstill_gap_m: SUMO's gaps are shorter by this, its `minGap`.
    """

    def __init__(self, name: str, *, standstill_gap_m: float) -> None:
        self._name = name
        self._standstill_gap_m = standstill_gap_m
        self._leader_name = ""
        self._speeds_mps: deque[float] = deque(maxlen=round(OVER_S / SECONDS_PER_STEP) + 1)
        self.leader: Leader | None = None
        """The vehicle ahead when it last looked; None where none was in sight."""

    @property
    def gap_m(self) -> float:
        """Bumper to bumper to the vehicle ahead; NaN where none is in sight."""
        return math.nan if self.leader is None else self.leader.gap_m

    def look(self, sight_m: float) -> Leader | None:
        """Look so far ahead, once a step, and return who is there."""
        self.leader = self._look(sight_m)
        return self.leader

    def _look(self, sight_m: float) -> Leader | None:
        vehicle, speeds_mps = libsumo.vehicle, self._speeds_mps
        ahead = vehicle.getLeader(self._name, sight_m)
        if not ahead or not ahead[0]:
            self._leader_name = ""
            return None
        name, gap_m = ahead
        if name != self._leader_name:
            self._leader_name = name
            speeds_mps.clear()
        speeds_mps.append(vehicle.getSpeed(name))
        seconds = (len(speeds_mps) - 1) * SECONDS_PER_STEP
        acceleration_mps2 = (speeds_mps[-1] - speeds_mps[0]) / seconds if seconds else 0.0
        return Leader(gap_m + self._standstill_gap_m, speeds_mps[-1], acceleration_mps2)
