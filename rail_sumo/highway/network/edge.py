"""One edge of a course: its lanes, and what they lead to."""

import math
from dataclasses import dataclass, replace

Limits = tuple[tuple[float, float], ...]
"""Metres beyond an edge's end, and the speed limit in m/s from there on."""


@dataclass(frozen=True, slots=True)
class Edge:
    """One edge of the course; lanes are those open to cars, numbered from the right."""

    id: str
    length_m: float
    limit_mps: float
    """The highest speed that is allowed on any of its lanes."""
    limits_ahead: tuple[Limits, ...]
    """For each lane: the limits that follow, through junctions as the lane leads on, as far as `FORESIGHT_M`."""
    lane_widths_m: tuple[float, ...]
    to_left_m: tuple[float, ...]
    """For each lane: from its centre to that of the lane to its left; 0 where there is none or a line forbids it."""
    to_right_m: tuple[float, ...]
    """The same to its right."""
    leads_on_m: tuple[float, ...]
    """For each lane: how far beyond the edge's end it leads on along the course, junctions left out; inf to its end."""
    dead_ends: tuple[bool, ...]
    """For each lane: whether it leads nobody on where it stops leading on along the course, as an acceleration lane."""
    left_goes_on_m: tuple[float, ...]
    """For each lane: how far beyond the edge's end it may be left for the lane to its left without a break: both lead
    on side by side, through junctions without conflicts, and no line forbids it. Junctions count; inf round a loop."""
    right_goes_on_m: tuple[float, ...]
    """The same to its right."""
    first_lane: int = 0
    """SUMO's index of the rightmost lane open to cars: above 0 beside a pavement or a bus lane."""

    @property
    def n_lanes(self) -> int:
        """How many lanes are open to cars."""
        return len(self.lane_widths_m)

    @property
    def lanes(self) -> range:
        """SUMO's indices of the lanes open to cars, from the right."""
        return range(self.first_lane, self.first_lane + self.n_lanes)

    def ends_in_m(self, along_m: float) -> dict[int, float]:
        """Return how far ahead of a place on the edge each of its lanes stops leading on along the course."""
        ahead_m = self.length_m - along_m
        return {lane: ahead_m + leads_on_m for lane, leads_on_m in zip(self.lanes, self.leads_on_m, strict=True)}

    def enters_mps(self, lane: int, along_m: float, braking_mps2: float) -> float:
        """Return the highest speed at a place on a lane from which such braking keeps to the limits that follow."""
        ahead_m = self.length_m - along_m
        speeds = (
            math.sqrt(limit**2 + 2 * braking_mps2 * max(ahead_m + beyond_m, 0.0))
            for beyond_m, limit in self.limits_ahead[lane - self.first_lane]
        )
        return min(speeds, default=math.inf)

    def limited(self, factor: float) -> "Edge":
        """Return the same edge where every speed limit is multiplied by a factor."""
        ahead = tuple(tuple((beyond_m, mps * factor) for beyond_m, mps in lane) for lane in self.limits_ahead)
        return replace(self, limit_mps=self.limit_mps * factor, limits_ahead=ahead)
