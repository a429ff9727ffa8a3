"""Lanes that do not lead on along the course: when to leave one, to which side, and where to wait at its end. Pure."""

import math
from collections.abc import Mapping
from typing import Literal

from rail_sumo.config import FASTEST_CAR_MPS
from rail_sumo.records import HostState

Side = Literal[-1, 1]
LEFT: Side = 1
RIGHT: Side = -1

LEAVE_LANE_S, LEAVE_LANE_M = 20.0, 300.0
"""How long and how far before its end the host leaves a lane that does not lead on along its course, for each lane to
cross: whichever is farther, if it drives at the limit.

At 130 km/h two lanes could not be crossed within 600 m: cars that had to change places braked for one another.
"""
STANDS_BEFORE_M: Mapping[Side, float] = {RIGHT: 2.5, LEFT: 20.0}
"""How far before the end of such a lane the host stands, by the side to which it must leave it.

SUMO stands closer to it, and brakes for that harder. Where lanes part, each of two side by side may have to go where
the other is: the one that must go left stands back, and the other passes it. SUMO's lane changer keeps such room too
(blocker length).
"""
FOR_DEAD_END_MPS2 = 3.0
"""How hard the host brakes for the end of a lane that leads nobody on, as it does for nothing else in sight.

Whoever brakes comfortably on an acceleration lane comes into the flow beside too slow. SUMO's drivers brake by `decel`.
"""
FOR_QUEUE_MPS2 = 2.0
"""How hard the host brakes to the end of a queue that it joins: it must be in that lane before."""
OVERTAKING_S = 10.0
"""For how long the host must be able to stay in a lane that it enters, unless the lane is nearer to one that leads on.

A car that overtakes just before its exit stands beside the queue there. SUMO's own drivers want 20 s.
"""
NO_QUEUES: Mapping[int, float] = {}


def other(side: Side) -> Side:
    """Return the other side."""
    return RIGHT if side == LEFT else LEFT


def leading_on(
    ends_in_m: Mapping[int, float],
    limit_mps: float,
    queued_m: Mapping[int, float] = NO_QUEUES,
    spare_m: float = 0.0,
) -> list[int]:
    """Return the lanes that nobody need leave by now; where all end soon, those that lead on farthest.

    A lane need be left the earlier, the more lanes there are to cross to the nearest of those, and the longer the queue
    in either is: so that a vehicle joins a queue at its end, and does not stand beside it.

    Args:
        ends_in_m: for each lane how far ahead it ends.
        limit_mps: the speed limit here.
        queued_m: for each lane how long the queue ahead in it is, with the room that it takes to brake for it.
        spare_m: without those that need be left within so far.
    """
    farthest_m = max(ends_in_m.values())
    best = [lane for lane, metres in ends_in_m.items() if metres == farthest_m]
    a_lane_m = max(LEAVE_LANE_M, LEAVE_LANE_S * min(limit_mps, FASTEST_CAR_MPS))

    def to_leave_m(lane: int) -> float:
        goal = min(best, key=lambda one: abs(one - lane))
        queue_m = max(queued_m.get(goal, 0.0), queued_m.get(lane, 0.0))
        return abs(goal - lane) * a_lane_m + queue_m + spare_m if goal != lane else 0.0

    return [lane for lane, metres in ends_in_m.items() if metres >= min(to_leave_m(lane), farthest_m)]


def may_enter(host: HostState, side: Side) -> bool:
    """Return whether the host may move into the lane on a side: on its way on, or where it may stay for a while."""
    if math.isinf(host.ends_in_m(host.lane + side)) or side == way_on(host):
        return True
    spare_m = 0.0 if side == must_leave(host) else OVERTAKING_S * host.speed_mps
    return host.lane + side in _leading_on(host, spare_m)


def way_on(host: HostState) -> Side | None:
    """Return the side of the nearest lane that leads on, if the host must leave its own for it by now."""
    if math.isinf(host.ends_in_m(host.lane)):
        return None
    goals = _leading_on(host)
    return None if host.lane in goals else _towards(goals, host)


def must_leave(host: HostState) -> Side | Literal[0]:
    """Return on which side the nearest lane is that leads on farther than the host's own; 0 if none does.

    However far ahead its own ends.
    """
    ends_in_m = host.ends_in_m(host.lane)
    if math.isinf(ends_in_m):
        return 0
    farther = [lane for lane, metres in _ends_in_m(host).items() if metres > ends_in_m]
    return _towards(farther, host) if farther else 0


def stands_in_m(host: HostState) -> float:
    """Return how far ahead the host would have to stand before the end of its lane; inf if that leads on."""
    ends_in_m = host.ends_in_m(host.lane)
    if math.isinf(ends_in_m):
        return math.inf
    return ends_in_m - stands_before_m(must_leave(host) or RIGHT, is_dead_end=host.is_dead_end(host.lane))


def braking_mps2(host: HostState, comfort_mps2: float) -> float:
    """Return how hard the host brakes at least to stand there."""
    return max(comfort_mps2, FOR_DEAD_END_MPS2) if host.is_dead_end(host.lane) else comfort_mps2


def stands_before_m(side: Side, *, is_dead_end: bool) -> float:
    """Return how far before the end of a lane that must be left to this side a host stands.

    Into a dead end nobody beside has to come.
    """
    return STANDS_BEFORE_M[RIGHT if is_dead_end else side]


def joins_in_m(host: HostState) -> float:
    """Return how far ahead it must have left its lane: where it would have to stand, or by the queue that it joins."""
    side = must_leave(host)
    return max(stands_in_m(host) - (_queued_m(host).get(host.lane + side, 0.0) if side else 0.0), 0.0)


def _leading_on(host: HostState, spare_m: float = 0.0) -> list[int]:
    to_stop_m = host.speed_mps**2 / (2 * FOR_QUEUE_MPS2)
    queued_m = {lane: metres + to_stop_m for lane, metres in _queued_m(host).items() if metres}
    return leading_on(_ends_in_m(host), host.limit_mps, queued_m, spare_m)


def _queued_m(host: HostState) -> dict[int, float]:
    return dict(enumerate(host.queued_m, host.rightmost_lane))


def _ends_in_m(host: HostState) -> dict[int, float]:
    return {lane: host.ends_in_m(lane) for lane in range(host.rightmost_lane, host.leftmost_lane + 1)}


def _towards(lanes: list[int], host: HostState) -> Side:
    """Return on which side of the host the nearest of these lanes is."""
    return LEFT if min(lanes, key=lambda lane: abs(lane - host.lane)) > host.lane else RIGHT
