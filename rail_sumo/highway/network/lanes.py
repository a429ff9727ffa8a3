"""What the lanes of a way lead to: from sumolib's edges and connections to ours."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

from rail_sumo.highway.network.course import Way
from rail_sumo.highway.network.edge import Edge, Limits

CHANGE_LEFT, CHANGE_RIGHT = "changeLeft", "changeRight"
"""The attributes of a lane that list who may change from it."""

FORESIGHT_M = 500.0
"""How far ahead a speed limit is known: from 160 km/h to nothing it takes 494 m at 2 m/s²."""

MAJOR = "M"
"""State of a connection with priority and without a signal. SUMO changes lanes within junctions on such alone."""
ZIPPER = "Z"
"""State of a connection that joins another, and whose drivers take turns."""

Joint = list[Any]
"""The connections from one edge to the next, from right to left."""
Pair = tuple[Any, Any]
"""Two neighbouring connections that run side by side: the right one, then the left one."""


class Lanes(NamedTuple):
    """All that a way's lanes tell; see `road.Road`."""

    edges: tuple[Edge, ...]
    joints: Mapping[str, Edge]
    next_lanes: Mapping[str, tuple[str, ...]]
    zips_with: Mapping[str, tuple[str, ...]]
    junctions_m: tuple[float, ...]


def survey(net: Any, way: Way, has_no_foes: Callable[[Any], bool]) -> Lanes:
    """Return what the lanes of a way lead to.

    Args:
        net: the network, as sumolib has it.
        way: where to drive.
        has_no_foes: tells of a connection whether no other stream crosses or joins it.
    """
    junctions_m = tuple(_through_m(net, joint) for joint in way.joints)
    abreast = [_abreast(net, joint, has_no_foes) for joint in way.joints]
    edges = tuple(
        _edge(edge, lanes, way, *ahead)
        for edge, lanes, *ahead in zip(
            way.edges,
            way.lanes,
            *_leads_on(way),
            _limits_ahead(net, way, junctions_m),
            _goes_on_m(net, way, abreast, CHANGE_LEFT),
            _goes_on_m(net, way, abreast, CHANGE_RIGHT),
            strict=True,
        )
    )
    joints = [
        _inside_edge(net, joint, pairs, ahead, way)
        for joint, pairs, ahead in zip(way.joints, abreast, (*edges[1:], edges[0]), strict=True)
        if pairs and joint[0].getViaLaneID()
    ]
    return Lanes(edges, {joint.id: joint for joint in joints}, _next_lanes(net, way), _zips_with(way), junctions_m)


def has_priority(connection: Any) -> bool:
    """Return whether a connection has priority by its state: a small letter or = has not."""
    return bool(connection.getState().isupper())


def within(net: Any, connection: Any) -> Iterator[Any]:
    """Yield the lanes within the junction that a connection runs over; none in networks built without them."""
    while connection.getViaLaneID():
        lane = net.getLane(connection.getViaLaneID())
        yield lane
        connection = lane.getOutgoing()[0]


def _through_m(net: Any, joint: Joint) -> float:
    ways = [sum(lane.getLength() for lane in within(net, connection)) for connection in joint]
    return fmean(ways) if ways else 0.0


def _leads_on(way: Way) -> tuple[list[tuple[float, ...]], list[tuple[bool, ...]]]:
    # For every edge's lanes how far they lead on, from the last edge back; twice round a loop, whose end is nowhere.
    # And whether they are dead ends.
    leads_on = [dict.fromkeys(lanes, (math.inf, False)) for lanes in way.lanes]
    for k, ahead in _backwards(way):
        leads_on[k] = {lane: (0.0, not lane.getOutgoing()) for lane in leads_on[k]}
        for c in way.joints[k]:
            beyond_m, is_dead_end = leads_on[ahead][c.getToLane()]
            farther = (way.edges[ahead].getLength() + beyond_m, is_dead_end)
            leads_on[k][c.getFromLane()] = max(leads_on[k][c.getFromLane()], farther)
    metres = [tuple(beyond_m for beyond_m, _ in lanes.values()) for lanes in leads_on]
    return metres, [tuple(is_dead_end for _, is_dead_end in lanes.values()) for lanes in leads_on]


def _backwards(way: Way) -> Iterator[tuple[int, int]]:
    # The index of every edge that another one follows, and that one's.
    n = len(way.edges)
    backwards = range(n - 1, -1, -1)
    for k in [*backwards, *backwards] if way.is_loop else backwards[1:]:
        yield k, (k + 1) % n


def _limits_ahead(net: Any, way: Way, junctions_m: Sequence[float]) -> list[tuple[Limits, ...]]:
    # For every edge's lanes.
    return [
        tuple(_limits_beyond(net, way, junctions_m, k, lane) for lane in lanes) for k, lanes in enumerate(way.lanes)
    ]


def _limits_beyond(net: Any, way: Way, junctions_m: Sequence[float], k: int, lane: Any) -> Limits:
    # The limits beyond a lane of edge k: within junctions those of the lanes that it leads on to, or of all where it
    # ends; of edges the highest. Behind a chain's last edge, which has no joint, there is nothing.
    limits, beyond_m, lanes = [], 0.0, {lane}
    while way.joints[k] and beyond_m < FORESIGHT_M:
        joint = [c for c in way.joints[k] if c.getFromLane() in lanes] or way.joints[k]
        inside = [lane.getSpeed() for connection in joint for lane in within(net, connection)]
        if inside:
            limits.append((beyond_m, min(inside)))
        beyond_m += junctions_m[k]
        k = (k + 1) % len(way.edges)
        limits.append((beyond_m, _limit_mps(way.lanes[k])))
        beyond_m += way.edges[k].getLength()
        lanes = {c.getToLane() for c in joint}
    return tuple(limits)


def _limit_mps(lanes: list[Any]) -> float:
    return max(lane.getSpeed() for lane in lanes)


def _abreast(net: Any, joint: Joint, has_no_foes: Callable[[Any], bool]) -> list[Pair]:
    """Return the pairs of neighbouring connections that run side by side from edge to edge.

    They have priority, lead straight on, and cross or join no other stream. Their lanes, within the junction too, are
    neighbours of the same widths, and neither lane leads to another of the next edge besides.
    """
    if not joint:
        return []
    here, ahead = joint[0].getFrom(), joint[0].getTo()
    if not all(c.getState() == MAJOR and not c.getTLSID() for c in here.getConnections(ahead)):
        return []
    ways = [(c.getFromLane(), *within(net, c), c.getToLane()) for c in joint]
    inside = [lane.getID() for way in ways for lane in way[1:-1]]
    if inside and inside != _in_a_row(inside[0], len(joint)):
        return []
    starts = Counter(way[0] for way in ways)
    is_free = [
        c.getDirection() == c.LINKDIR_STRAIGHT
        and starts[c.getFromLane()] == 1
        and has_no_foes(c)
        and len({lane.getWidth() for lane in way}) == 1
        for c, way in zip(joint, ways, strict=True)
    ]
    return [
        (joint[k], joint[k + 1])
        for k in range(len(joint) - 1)
        if is_free[k]
        and is_free[k + 1]
        and all(left.getIndex() - right.getIndex() == 1 for right, left in zip(ways[k], ways[k + 1], strict=True))
    ]


def _in_a_row(lane_id: str, number: int) -> list[str]:
    # So many lanes of one edge, from one to the left.
    edge_id, _, index = lane_id.rpartition("_")
    return [f"{edge_id}_{k}" for k in range(int(index), int(index) + number)]


def _goes_on_m(net: Any, way: Way, abreast: list[list[Pair]], side: str) -> list[tuple[float, ...]]:
    # For every edge's lanes how far beyond its end they may be left to a side without a break.
    goes_on = [dict.fromkeys(lanes, math.inf if way.is_loop else 0.0) for lanes in way.lanes]
    for k, ahead in _backwards(way):
        goes_on[k] = dict.fromkeys(goes_on[k], 0.0)
        for pair in abreast[k]:
            connection = pair[side == CHANGE_RIGHT]
            inside = list(within(net, connection))
            if all(may_cross(lane, side, way.vclass) for lane in (*inside, connection.getToLane())):
                inside_m = sum(lane.getLength() for lane in inside)
                farther = way.edges[ahead].getLength() + goes_on[ahead][connection.getToLane()]
                goes_on[k][connection.getFromLane()] = inside_m + farther
    return [tuple(lanes.values()) for lanes in goes_on]


def _next_lanes(net: Any, way: Way) -> dict[str, tuple[str, ...]]:
    following: dict[str, dict[str, None]] = {}  # in order, each once
    for connection in itertools.chain.from_iterable(way.joints):
        lanes = (connection.getFromLane(), *within(net, connection), connection.getToLane())
        for lane, ahead in itertools.pairwise(lanes):
            following.setdefault(lane.getID(), {})[ahead.getID()] = None
    return {lane: tuple(ahead) for lane, ahead in following.items()}


def _zips_with(way: Way) -> dict[str, tuple[str, ...]]:
    zips: dict[str, tuple[str, ...]] = {}
    for connection in itertools.chain.from_iterable(way.joints):
        if connection.getState() == ZIPPER:
            lane, joining = connection.getFromLane(), connection.getToLane().getIncomingConnections()
            others = [one.getFromLane().getID() for one in joining if one.getState() == ZIPPER]
            zips[lane.getID()] = tuple(other for other in others if other != lane.getID())
    return {lane: others for lane, others in zips.items() if others}


def _edge(
    edge: Any,
    lanes: list[Any],
    way: Way,
    leads_on_m: tuple[float, ...],
    dead_ends: tuple[bool, ...],
    limits_ahead: tuple[Limits, ...],
    left_goes_on_m: tuple[float, ...],
    right_goes_on_m: tuple[float, ...],
) -> Edge:
    to_left_m, to_right_m = _apart_m(lanes, way)
    return Edge(
        id=edge.getID(),
        length_m=edge.getLength(),
        limit_mps=_limit_mps(lanes),
        limits_ahead=limits_ahead,
        lane_widths_m=tuple(lane.getWidth() for lane in lanes),
        to_left_m=to_left_m,
        to_right_m=to_right_m,
        leads_on_m=leads_on_m,
        dead_ends=dead_ends,
        left_goes_on_m=left_goes_on_m,
        right_goes_on_m=right_goes_on_m,
        first_lane=lanes[0].getIndex(),
    )


def _inside_edge(net: Any, joint: Joint, abreast: list[Pair], ahead: Edge, way: Way) -> Edge:
    # The inside of a junction as an edge: its lanes may be changed where they may on both sides of it.
    lanes = [net.getLane(connection.getViaLaneID()) for connection in joint]
    there = [connection.getToLane().getIndex() - ahead.first_lane for connection in joint]
    apart_m = _apart_m(lanes, way)
    rights, lefts = {right for right, _ in abreast}, {left for _, left in abreast}
    to_left_m = tuple(
        m * (c in rights and ahead.to_left_m[k] > 0.0) for m, c, k in zip(apart_m[0], joint, there, strict=True)
    )
    to_right_m = tuple(
        m * (c in lefts and ahead.to_right_m[k] > 0.0) for m, c, k in zip(apart_m[1], joint, there, strict=True)
    )
    return Edge(
        id=lanes[0].getEdge().getID(),
        length_m=min(lane.getLength() for lane in lanes),
        limit_mps=_limit_mps(lanes),
        limits_ahead=tuple(
            ((0.0, ahead.limit_mps), *((ahead.length_m + m, limit) for m, limit in ahead.limits_ahead[k]))
            for k in there
        ),
        lane_widths_m=tuple(lane.getWidth() for lane in lanes),
        to_left_m=to_left_m,
        to_right_m=to_right_m,
        leads_on_m=tuple(ahead.length_m + ahead.leads_on_m[k] for k in there),
        dead_ends=tuple(ahead.dead_ends[k] for k in there),
        left_goes_on_m=tuple(
            ahead.length_m + ahead.left_goes_on_m[k] if m else 0.0 for m, k in zip(to_left_m, there, strict=True)
        ),
        right_goes_on_m=tuple(
            ahead.length_m + ahead.right_goes_on_m[k] if m else 0.0 for m, k in zip(to_right_m, there, strict=True)
        ),
        first_lane=lanes[0].getIndex(),
    )


def _apart_m(lanes: list[Any], way: Way) -> tuple[tuple[float, ...], tuple[float, ...]]:
    # For each lane how far the centre of the one to its left is, and of the one to its right; 0 over a line, or where
    # that one is closed.
    def may(here: Any, beside: Any, side: str) -> bool:
        return beside.getID() not in way.closed and may_cross(here, side, way.vclass)

    pairs = [(right, left, 0.5 * (right.getWidth() + left.getWidth())) for right, left in itertools.pairwise(lanes)]
    to_left_m = [metres * may(right, left, CHANGE_LEFT) for right, left, metres in pairs]
    to_right_m = [metres * may(left, right, CHANGE_RIGHT) for right, left, metres in pairs]
    return (*to_left_m, 0.0), (0.0, *to_right_m)


def may_cross(lane: Any, side: str, vclass: str) -> bool:
    """Return whether the lines let a class of vehicles leave a lane to a side."""
    allowed = lane.getParam(side, "all").split()
    return "all" in allowed or vclass in allowed
