"""Who is in the host's own lane and in those beside it, and how far away: in SUMO, over joints, claims heeded."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import libsumo

from rail_sumo.highway.network.road import Road
from rail_sumo.highway.vehicle.whereabouts import ahead_on, to_lane_end_m
from rail_sumo.records import Gaps

OVER_JOINTS = 2
"""Over so many lanes' ends, a junction's inside being a lane, a claim is heeded."""


class Neighbours:
    """Tells the gaps around one vehicle.

    Args:
        name: its id.
        standstill_gap_m: what SUMO takes off the gaps to those ahead of it.
    """

    def __init__(self, name: str, *, standstill_gap_m: float) -> None:
        self._name = name
        self._standstill_gap_m = standstill_gap_m

    def follow(self, road: Road, *, sight_m: float) -> None:
        """Look along a course, so far ahead."""
        self._next_lanes, self._lanes_before = road.next_lanes, road.lanes_before
        self._sight_m = sight_m

    def gaps(self, side: int, claims: Iterable[tuple[str, str]] = ()) -> Gaps:
        """Return the gaps in the own lane (0) or the one to its left (+1) or right (-1).

        Args:
            side: of which lane.
            claims: driven vehicles, each with the lane that it is about to move into; in that lane they count.
        """
        vehicle = libsumo.vehicle
        if side == 0:
            leader, follower = vehicle.getLeader(self._name, self._sight_m), vehicle.getFollower(self._name)
            ahead, behind = ([pair] if pair and pair[0] else [] for pair in (leader, follower))
        else:
            ahead, behind = (vehicle.getNeighbors(self._name, mode) for mode in modes(side))
            beside = self._beside(side)
            ahead, behind = ahead or self._next_ahead(beside), behind or self._next_behind(beside)
            for name, aims_at in claims:
                ahead, behind = self._with_claim(name, self._to_lane_m(beside, aims_at), [*ahead], [*behind])
        ahead_m, ahead_speed = self._nearest(ahead, self._standstill_gap_m)
        behind_m, behind_speed = self._nearest(behind, None)
        return Gaps(ahead_m, ahead_speed, behind_m, behind_speed)

    def ahead(self, side: int) -> tuple[str, float] | None:
        """Return who comes next in the lane to the left (+1) or right (-1), and how far ahead, bumper to bumper."""
        found = libsumo.vehicle.getNeighbors(self._name, modes(side)[0])
        name, gap_m = min(found, key=lambda neighbour: neighbour[1], default=("", 0.0))
        return (name, gap_m + self._standstill_gap_m) if name else None

    def all_ahead(self, side: int) -> Iterator[tuple[str, float]]:
        """Yield who is ahead and in sight in the lane on a side, the nearest first, and how far, bumper to bumper.

        Beyond the edge's end it yields one, if there is none before it.
        """
        nearest = self.ahead(side)
        if nearest is None:
            return
        yield nearest
        vehicle, beside = libsumo.vehicle, self._beside(side)
        if vehicle.getLaneID(nearest[0]) == beside:
            here_m = vehicle.getLanePosition(self._name)
            for name in ahead_on(beside, vehicle.getLanePosition(nearest[0])):
                gap_m = vehicle.getLanePosition(name) - vehicle.getLength(name) - here_m
                if gap_m > self._sight_m:
                    break
                yield name, gap_m

    def _beside(self, side: int) -> str:
        """Return the lane on a side."""
        edge, _, lane = libsumo.vehicle.getLaneID(self._name).rpartition("_")
        return f"{edge}_{int(lane) + side}"

    def _with_claim(
        self, name: str, lane_ahead_m: float | None, ahead: list[tuple[str, float]], behind: list[tuple[str, float]]
    ) -> tuple[list[tuple[str, float]], list[tuple[str, float]]]:
        """Add a vehicle to those ahead or behind, as if it were in the lane already whose beginning is so far ahead."""
        if lane_ahead_m is None:
            return ahead, behind
        vehicle = libsumo.vehicle
        front_m = lane_ahead_m + vehicle.getLanePosition(name) - vehicle.getLanePosition(self._name)
        if front_m >= 0.0:
            ahead.append((name, front_m - vehicle.getLength(name) - self._standstill_gap_m))
        else:
            behind.append((name, -front_m - vehicle.getLength(self._name) - vehicle.getMinGap(name)))
        return ahead, behind

    def _to_lane_m(self, here: str, there: str) -> float | None:
        """Return how far beyond the beginning of one lane another begins, over a few ends; None if it is farther."""
        for following, sign in ((self._next_lanes, 1.0), (self._lanes_before, -1.0)):
            ways = [(here, 0.0)]
            for _ in range(OVER_JOINTS + 1):
                for lane, metres in ways:
                    if lane == there:
                        return metres
                ways = [
                    (one, metres + sign * libsumo.lane.getLength(lane if sign > 0.0 else one))
                    for lane, metres in ways
                    for one in following.get(lane, ())
                ]
        return None

    def _next_ahead(self, lane: str) -> list[tuple[str, float]]:
        """Return who is next beyond the end of a lane beside the host, as `getNeighbors` tells it.

        SUMO itself looks no farther beyond an edge's end than the host takes to stop by emergency braking.
        """
        vehicle = libsumo.vehicle
        return [
            (name, beyond_m + vehicle.getLanePosition(name) - vehicle.getLength(name) - self._standstill_gap_m)
            for name, _, beyond_m in self._next(lane, self._next_lanes, to_lane_end_m(self._name))
        ]

    def _next_behind(self, lane: str) -> list[tuple[str, float]]:
        """Return who is next before the beginning of a lane beside the host, as `getNeighbors` tells it."""
        vehicle = libsumo.vehicle
        before_m = vehicle.getLanePosition(self._name) - vehicle.getLength(self._name)
        return [
            (name, before_m + libsumo.lane.getLength(one) - vehicle.getLanePosition(name) - vehicle.getMinGap(name))
            for name, one, before_m in self._next(lane, self._lanes_before, before_m)
        ]

    def _next(
        self, lane: str, following: Mapping[str, tuple[str, ...]], there_m: float
    ) -> Iterator[tuple[str, str, float]]:
        """Yield the vehicles on the first lanes that have some, from a lane's neighbour on, as far as the host sees.

        Args:
            lane: where it starts, beyond this lane itself.
            following: for each lane those that it goes on to.
            there_m: how far the first of them are.

        Yields:
            The vehicle, its lane, and how far that is.
        """
        ways = [(one, there_m) for one in following.get(lane, ())]
        while ways:
            one, there_m = ways.pop()
            names = libsumo.lane.getLastStepVehicleIDs(one)
            yield from ((name, one, there_m) for name in names)
            if not names and there_m < self._sight_m:
                ways += [(farther, there_m + libsumo.lane.getLength(one)) for farther in following.get(one, ())]

    @staticmethod
    def _nearest(neighbours: Sequence[tuple[str, float]], min_gap_m: float | None) -> tuple[float, float]:
        """SUMO tells gaps without the follower's standstill gap; add it back to get bumper to bumper."""
        if not neighbours:
            return math.inf, 0.0
        name, gap = min(neighbours, key=lambda neighbour: neighbour[1])
        standstill = libsumo.vehicle.getMinGap(name) if min_gap_m is None else min_gap_m
        return gap + standstill, libsumo.vehicle.getSpeed(name)


def modes(side: int) -> tuple[int, int]:
    """Return SUMO's modes of `getNeighbors` on a side, for those ahead and for those behind."""
    return (2, 0) if side > 0 else (3, 1)
