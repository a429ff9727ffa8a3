"""Lanes that do not lead on along the course: when to leave one, to which side, and where to wait at its end. Pure."""

import math
from collections.abc import Mapping
from typing import Literal

from rail_sumo.records import HostState

Side = Literal[-1, 1]
LEFT: Side = 1
RIGHT: Side = -1

LEAVE_LANE_M = 300.0
"""How far before its end the host leaves a lane that does not lead on along its course, for each lane to cross."""
STANDS_BEFORE_M: Mapping[Side, float] = {RIGHT: 2.5, LEFT: 20.0}
"""How far before the end of such a lane the host stands, by the side to which it must leave it.

SUMO stands closer to it, and brakes for that harder. Where lanes part, each of two side by side may have to go where
the other is: the one that must go left stands back, and the other passes it. SUMO's lane changer keeps such room too
(blocker length).
"""


def other(side: Side) -> Side:
    """Return the other side."""
    return RIGHT if side == LEFT else LEFT


def leading_on(ends_in_m: Mapping[int, float]) -> list[int]:
    """Return the lanes that nobody need leave by now; where all end soon, those that lead on farthest.

    A lane need be left the earlier, the more lanes there are to cross to one of those.
    """
    farthest_m = max(ends_in_m.values())
    best = [lane for lane, metres in ends_in_m.items() if metres == farthest_m]
    to_cross = {lane: min(abs(lane - other) for other in best) for lane in ends_in_m}
    return [lane for lane, metres in ends_in_m.items() if metres >= min(to_cross[lane] * LEAVE_LANE_M, farthest_m)]


def leads_on(host: HostState, lane: int) -> bool:
    """Return whether the host need not leave a lane of its edge by now."""
    return math.isinf(host.ends_in_m(lane)) or lane in leading_on(_ends_in_m(host))


def way_on(host: HostState) -> Side | None:
    """Return the side of the nearest lane that leads on, if the host must leave its own for it by now."""
    if math.isinf(host.ends_in_m(host.lane)):
        return None
    goals = leading_on(_ends_in_m(host))
    return None if host.lane in goals else _towards(goals, host)


def stands_in_m(host: HostState) -> float:
    """Return how far ahead the host would have to stand before the end of its lane; inf if that leads on."""
    ends_in_m = host.ends_in_m(host.lane)
    if math.isinf(ends_in_m):
        return math.inf
    farther = [lane for lane, metres in _ends_in_m(host).items() if metres > ends_in_m]
    return ends_in_m - STANDS_BEFORE_M[_towards(farther, host) if farther else RIGHT]


def _ends_in_m(host: HostState) -> dict[int, float]:
    return {lane: host.ends_in_m(lane) for lane in range(host.rightmost_lane, host.leftmost_lane + 1)}


def _towards(lanes: list[int], host: HostState) -> Side:
    """Return on which side of the host the nearest of these lanes is."""
    return LEFT if min(lanes, key=lambda lane: abs(lane - host.lane)) > host.lane else RIGHT
