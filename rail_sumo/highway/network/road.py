"""What a network says: the course the host drives, its lanes and its borders. Read with sumolib, without libsumo."""

import itertools
import math
import xml.sax
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import sumolib.net

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway.network import course
from rail_sumo.highway.network.course import CAR, car_lanes, connections
from rail_sumo.highway.network.sumo_xml import UNREADABLE, opened, state_of
from rail_sumo.records import Floats

NARROWEST_LANE_M = 2.4
"""A car of 1.8 m with 0.3 m to either side."""

CHANGE_LEFT, CHANGE_RIGHT = "changeLeft", "changeRight"
"""The attributes of a lane that list who may change from it."""

FORESIGHT_M = 500.0
"""How far ahead a speed limit is known: from 160 km/h to nothing it takes 494 m at 2 m/s²."""

SAME_POINT_M = 0.05
"""Points of a border closer than this are one; netconvert rounds to 0.01 m."""

MAJOR = "M"
"""State of a connection with priority and without a signal. SUMO changes lanes within junctions on such alone."""


@dataclass(frozen=True, slots=True)
class Edge:
    """One edge of the course; lanes are those open to cars, numbered from the right."""

    id: str
    length_m: float
    limit_mps: float
    """The highest speed that is allowed on any of its lanes."""
    limits_ahead: tuple[tuple[float, float], ...]
    """Metres beyond its end, and the limit from there on, through junctions and over edges, as far as `FORESIGHT_M`."""
    lane_widths_m: tuple[float, ...]
    to_left_m: tuple[float, ...]
    """For each lane: from its centre to that of the lane to its left; 0 where there is none or a line forbids it."""
    to_right_m: tuple[float, ...]
    """The same to its right."""
    leads_on_m: tuple[float, ...]
    """For each lane: how far beyond the edge's end it leads on along the course, junctions left out; inf to its end."""
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

    def limited(self, factor: float) -> "Edge":
        """Return the same edge where every speed limit is multiplied by a factor."""
        ahead = tuple((beyond_m, limit_mps * factor) for beyond_m, limit_mps in self.limits_ahead)
        return replace(self, limit_mps=self.limit_mps * factor, limits_ahead=ahead)


@dataclass(frozen=True, eq=False)
class Road:
    """The course of one network: a chain of edges to drive one after the other, or a loop of them.

    A place on the course is its distance s, in metres, from the start of the first edge, junctions included.
    """

    net_file: Path
    name: str
    edges: tuple[Edge, ...]
    joints: Mapping[str, Edge]
    """The junctions' inside where lanes go on side by side and may be changed, as edges, by SUMO's ids of these."""
    next_lanes: Mapping[str, tuple[str, ...]]
    """For each lane of the course, and within its junctions: the lanes it leads to along the course."""
    junctions_m: tuple[float, ...]
    """How long the way through the junction after each edge is; after a chain's last edge 0."""
    is_loop: bool
    gives_way: bool
    """Whether it leads through a junction without priority."""
    sight_m: Mapping[str, float]
    """How far before a junction drivers see who comes, where that is told, by the lane that they enter it on."""
    is_left_hand: bool
    """Whether it is driven on the left. Then all is told in the mirror, as if it were driven on the right: SUMO numbers
    lanes from the kerb on either kind of road, and to it the next lane from there is always the left one."""
    boundaries: Floats
    """(n_segments, 4): x1, y1, x2, y2 of the course's outer borders, in metres, read-only."""

    @property
    def length_m(self) -> float:
        """Length of the course, one lap of a loop, the ways through its junctions included."""
        return self._starts_m[-1]

    @cached_property
    def highest_limit_mps(self) -> float:
        """The highest speed limit of its edges."""
        return max(edge.limit_mps for edge in self.edges)

    @cached_property
    def edge_of(self) -> Mapping[str, Edge]:
        """Its edges by their ids."""
        return {edge.id: edge for edge in self.edges}

    @cached_property
    def lanes_before(self) -> Mapping[str, tuple[str, ...]]:
        """For each lane: the lanes that lead to it along the course; the reverse of `next_lanes`."""
        before: dict[str, tuple[str, ...]] = {}
        for lane, ahead in self.next_lanes.items():
            for one in ahead:
                before[one] = (*before.get(one, ()), lane)
        return before

    @cached_property
    def _starts_m(self) -> tuple[float, ...]:
        # Where each edge starts, and at last where the course ends.
        strides = (edge.length_m + junction for edge, junction in zip(self.edges, self.junctions_m, strict=True))
        return tuple(itertools.accumulate(strides, initial=0.0))

    def place(self, s_m: float) -> tuple[int, float] | None:
        """Return (index into `edges`, metres from that edge's start) of a place on the course.

        A loop wraps. A place inside a junction becomes the start of the edge after it; one beyond either end of a
        chain is None.
        """
        if self.is_loop:
            s_m %= self.length_m
        if not 0.0 <= s_m <= self.length_m:
            return None
        index = min(bisect_right(self._starts_m, s_m), len(self.edges)) - 1
        along = s_m - self._starts_m[index]
        if along > self.edges[index].length_m and (self.is_loop or index + 1 < len(self.edges)):
            return (index + 1) % len(self.edges), 0.0
        return index, along

    def laps(self, first_index: int, distance_m: float) -> tuple[str, ...]:
        """Return the ids of the edges from `edges[first_index]` on that together are at least `distance_m` long.

        Goes round a loop as often as needed; on a chain stops at its end.
        """
        following = self.edges[first_index:]
        ahead: Iterable[Edge] = itertools.chain(following, itertools.cycle(self.edges)) if self.is_loop else following
        ids, covered_m = [], 0.0
        for edge in ahead:
            ids.append(edge.id)
            covered_m += edge.length_m
            if covered_m >= distance_m:
                break
        return tuple(ids)


def load(file: str, wanted: tuple[str, ...] = (), *, limit_factor: float = 1.0) -> Road:
    """Read a network, a shipped one's name or a `.net.xml`, and lay the course along the edges wanted.

    Without any it is the longest way straight on; see `course`. Every speed limit is multiplied by `limit_factor`.

    Raises:
        InputError: no such file, not a SUMO network, a truncated one, or one without such a course.
    """
    path = assets.network(file)
    found = _load(path, wanted, state_of(path))
    return found if limit_factor == 1.0 else _limited(found, limit_factor)


def require_readable(file: str) -> None:
    """Read a network before anybody drives on it.

    Raises:
        InputError: as in `load`, but for the course.
    """
    path = assets.network(file)
    _read(path, state_of(path))


def warnings(road: Road) -> Iterator[str]:
    """Tell what makes it a poor course."""
    for edge in road.edges:
        if 0.0 in (*edge.to_left_m[:-1], *edge.to_right_m[1:]):
            yield f"lines on edge '{edge.id}' forbid some lane changes; the host will not make them"
        if min(edge.lane_widths_m) < NARROWEST_LANE_M:
            yield (
                f"edge '{edge.id}' has a lane of {min(edge.lane_widths_m):.2f} m; below {NARROWEST_LANE_M} m a car has "
                f"no margin beside it"
            )


@lru_cache(maxsize=32)
def _limited(road: Road, factor: float) -> Road:
    return replace(
        road,
        edges=tuple(edge.limited(factor) for edge in road.edges),
        joints={name: joint.limited(factor) for name, joint in road.joints.items()},
    )


@lru_cache(maxsize=32)
def _load(path: Path, wanted: tuple[str, ...], state: tuple[int, int]) -> Road:
    reader = _read(path, state)
    net, is_left_hand = reader.getNet(), reader.is_left_hand
    edges, is_loop = course.along(net, path.name, wanted) if wanted else course.longest(net, path.name)
    joints = [connections(here, ahead) for here, ahead in itertools.pairwise(edges)]
    joints.append(connections(edges[-1], edges[0]) if is_loop else [])
    junctions_m = tuple(_through_m(net, joint) for joint in joints)
    boundaries = np.concatenate(
        [_border(net, edges, joints, is_loop, side, mirrored=is_left_hand) for side in ("right", "left")]
    )
    boundaries.setflags(write=False)
    abreast = [_abreast(net, joint, reader.without_foes) for joint in joints]
    course_edges = tuple(
        map(
            _edge,
            edges,
            _leads_on_m(edges, joints, is_loop),
            _limits_ahead(net, edges, joints, junctions_m),
            _goes_on_m(net, edges, abreast, is_loop, CHANGE_LEFT),
            _goes_on_m(net, edges, abreast, is_loop, CHANGE_RIGHT),
        )
    )
    following = (*course_edges[1:], course_edges[0])
    inside = [
        _joint(net, joint, pairs, ahead)
        for joint, pairs, ahead in zip(joints, abreast, following, strict=True)
        if pairs and joint[0].getViaLaneID()
    ]
    return Road(
        net_file=path,
        name=assets.network_name(path.name),
        edges=course_edges,
        joints={joint.id: joint for joint in inside},
        next_lanes=_next_lanes(net, joints),
        junctions_m=junctions_m,
        is_loop=is_loop,
        gives_way=not all(c.getState().isupper() for joint in joints for c in joint),  # a small letter or =
        sight_m=reader.sight_m,
        is_left_hand=is_left_hand,
        boundaries=boundaries,
    )


class _Reader(sumolib.net.NetReader):
    """Also reads what sumolib drops: `lefthand`, `changeLeft` and `changeRight`, `visibility`, and who has no foes."""

    def __init__(self) -> None:
        super().__init__(withInternal=True, withFoes=False)
        self.is_left_hand = False
        self.sight_m: dict[str, float] = {}
        self.without_foes: set[tuple[str, int]] = set()
        """Junctions, and the indices of their connections that no other stream crosses or joins."""

    def startElement(self, name: str, attrs: Any) -> None:
        self.is_left_hand = self.is_left_hand or (name == "net" and attrs.get("lefthand") == "true")
        super().startElement(name, attrs)
        for side in (CHANGE_LEFT, CHANGE_RIGHT) if name == "lane" else ():
            if side in attrs:
                self._currentLane.setParam(side, attrs[side])
        if name == "connection" and "visibility" in attrs and "via" in attrs:
            self.sight_m[attrs["via"]] = float(attrs["visibility"])
        if name == "request" and "1" not in attrs["foes"]:
            self.without_foes.add((self._currentNode.getID(), int(attrs["index"])))


@lru_cache(maxsize=16)  # the host may take another course in every episode, on one of several networks
def _read(path: Path, state: tuple[int, int]) -> _Reader:
    # Not sumolib.net.readNet: it picks another parser when lxml is installed and leaves files open after an error.
    reader = _Reader()
    try:
        with opened(path) as stream:
            xml.sax.parse(stream, reader)
    except UNREADABLE as error:
        raise InputError(f"network '{path.name}' is not a complete XML file: {_reason(error)}") from None
    except Exception as error:  # whatever sumolib stumbles over in a file that is XML but not a network
        raise InputError(f"network '{path.name}' is not a SUMO network: {error!r}") from None
    if not reader.getNet().getEdges(withInternal=False):
        raise InputError(
            f"network '{path.name}' has no edges; rail-sumo reads SUMO's .net.xml, and by --network a .sumocfg"
        )
    return reader


def _reason(error: Exception) -> str:
    if isinstance(error, xml.sax.SAXParseException):
        return f"{error.getMessage()} in line {error.getLineNumber()}"
    return str(error)


def _leads_on_m(edges: list[Any], joints: list[list[Any]], is_loop: bool) -> list[tuple[float, ...]]:
    # For every edge's lanes how far they lead on, from the last edge back; twice round a loop, whose end is nowhere.
    leads_on = [dict.fromkeys(car_lanes(edge), math.inf) for edge in edges]
    backwards = range(len(edges) - 1, -1, -1)
    for k in [*backwards, *backwards] if is_loop else backwards[1:]:
        ahead = (k + 1) % len(edges)
        leads_on[k] = dict.fromkeys(leads_on[k], 0.0)
        for c in joints[k]:
            farther = edges[ahead].getLength() + leads_on[ahead][c.getToLane()]
            leads_on[k][c.getFromLane()] = max(leads_on[k][c.getFromLane()], farther)
    return [tuple(lanes.values()) for lanes in leads_on]


def _limits_ahead(
    net: Any, edges: list[Any], joints: list[list[Any]], junctions_m: Sequence[float]
) -> Iterator[tuple[tuple[float, float], ...]]:
    # Behind a chain's last edge, which has no joint, there is nothing.
    for first in range(len(edges)):
        k, limits, beyond_m = first, [], 0.0
        while joints[k] and beyond_m < FORESIGHT_M:
            inside = [lane.getSpeed() for connection in joints[k] for lane in _inside(net, connection)]
            if inside:
                limits.append((beyond_m, min(inside)))
            beyond_m += junctions_m[k]
            k = (k + 1) % len(edges)
            limits.append((beyond_m, _limit_mps(edges[k])))
            beyond_m += edges[k].getLength()
        yield tuple(limits)


def _limit_mps(edge: Any) -> float:
    return max(lane.getSpeed() for lane in car_lanes(edge))


def _abreast(net: Any, joint: list[Any], without_foes: set[tuple[str, int]]) -> list[tuple[Any, Any]]:
    """Return the pairs of neighbouring connections, right and left, that run side by side from edge to edge.

    They have priority, lead straight on, and cross or join no other stream. Their lanes, within the junction too, are
    neighbours of the same widths, and neither lane leads to another of the next edge besides.
    """
    if not joint:
        return []
    here, ahead = joint[0].getFrom(), joint[0].getTo()
    if not all(c.getState() == MAJOR and not c.getTLSID() for c in here.getConnections(ahead)):
        return []
    ways = [(c.getFromLane(), *_inside(net, c), c.getToLane()) for c in joint]
    inside = [lane.getID() for way in ways for lane in way[1:-1]]
    if inside and inside != _in_a_row(inside[0], len(joint)):
        return []
    node, starts = here.getToNode(), Counter(way[0] for way in ways)
    is_free = [
        c.getDirection() == c.LINKDIR_STRAIGHT
        and starts[c.getFromLane()] == 1
        and (node.getID(), node.getLinkIndex(c)) in without_foes
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


def _goes_on_m(
    net: Any, edges: list[Any], abreast: list[list[tuple[Any, Any]]], is_loop: bool, side: str
) -> list[tuple[float, ...]]:
    # As in `_leads_on_m`: from the last edge back, twice round a loop.
    goes_on = [dict.fromkeys(car_lanes(edge), math.inf if is_loop else 0.0) for edge in edges]
    backwards = range(len(edges) - 1, -1, -1)
    for k in [*backwards, *backwards] if is_loop else backwards[1:]:
        ahead = (k + 1) % len(edges)
        goes_on[k] = dict.fromkeys(goes_on[k], 0.0)
        for pair in abreast[k]:
            connection = pair[side == CHANGE_RIGHT]
            inside = list(_inside(net, connection))
            if all(_may_cross(lane, side) for lane in (*inside, connection.getToLane())):
                inside_m = sum(lane.getLength() for lane in inside)
                farther = edges[ahead].getLength() + goes_on[ahead][connection.getToLane()]
                goes_on[k][connection.getFromLane()] = inside_m + farther
    return [tuple(lanes.values()) for lanes in goes_on]


def _next_lanes(net: Any, joints: list[list[Any]]) -> dict[str, tuple[str, ...]]:
    following: dict[str, dict[str, None]] = {}  # in order, each once
    for connection in itertools.chain.from_iterable(joints):
        way = (connection.getFromLane(), *_inside(net, connection), connection.getToLane())
        for lane, ahead in itertools.pairwise(way):
            following.setdefault(lane.getID(), {})[ahead.getID()] = None
    return {lane: tuple(ahead) for lane, ahead in following.items()}


def _edge(
    edge: Any,
    leads_on_m: tuple[float, ...],
    limits_ahead: tuple[tuple[float, float], ...],
    left_goes_on_m: tuple[float, ...],
    right_goes_on_m: tuple[float, ...],
) -> Edge:
    lanes = car_lanes(edge)
    to_left_m, to_right_m = _apart_m(lanes)
    return Edge(
        id=edge.getID(),
        length_m=edge.getLength(),
        limit_mps=_limit_mps(edge),
        limits_ahead=limits_ahead,
        lane_widths_m=tuple(lane.getWidth() for lane in lanes),
        to_left_m=to_left_m,
        to_right_m=to_right_m,
        leads_on_m=leads_on_m,
        left_goes_on_m=left_goes_on_m,
        right_goes_on_m=right_goes_on_m,
        first_lane=lanes[0].getIndex(),
    )


def _joint(net: Any, joint: list[Any], abreast: list[tuple[Any, Any]], ahead: Edge) -> Edge:
    # The inside of a junction as an edge: its lanes may be changed where they may on both sides of it.
    lanes = [net.getLane(connection.getViaLaneID()) for connection in joint]
    there = [connection.getToLane().getIndex() - ahead.first_lane for connection in joint]
    apart_m = _apart_m(lanes)
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
        limit_mps=max(lane.getSpeed() for lane in lanes),
        limits_ahead=((0.0, ahead.limit_mps), *((ahead.length_m + m, limit) for m, limit in ahead.limits_ahead)),
        lane_widths_m=tuple(lane.getWidth() for lane in lanes),
        to_left_m=to_left_m,
        to_right_m=to_right_m,
        leads_on_m=tuple(ahead.length_m + ahead.leads_on_m[k] for k in there),
        left_goes_on_m=tuple(
            ahead.length_m + ahead.left_goes_on_m[k] if m else 0.0 for m, k in zip(to_left_m, there, strict=True)
        ),
        right_goes_on_m=tuple(
            ahead.length_m + ahead.right_goes_on_m[k] if m else 0.0 for m, k in zip(to_right_m, there, strict=True)
        ),
        first_lane=lanes[0].getIndex(),
    )


def _apart_m(lanes: list[Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    # For each lane how far the centre of the one to its left is, and of the one to its right; 0 over a line.
    pairs = [(right, left, 0.5 * (right.getWidth() + left.getWidth())) for right, left in itertools.pairwise(lanes)]
    to_left_m = (*(metres * _may_cross(right, CHANGE_LEFT) for right, _, metres in pairs), 0.0)
    return to_left_m, (0.0, *(metres * _may_cross(left, CHANGE_RIGHT) for _, left, metres in pairs))


def _may_cross(lane: Any, side: str) -> bool:
    allowed = lane.getParam(side, "all").split()
    return "all" in allowed or CAR in allowed


def _inside(net: Any, connection: Any) -> Iterator[Any]:
    # The lanes within the junction that a connection runs over; none in networks built without them.
    while connection.getViaLaneID():
        lane = net.getLane(connection.getViaLaneID())
        yield lane
        connection = lane.getOutgoing()[0]


def _through_m(net: Any, joint: list[Any]) -> float:
    ways = [sum(lane.getLength() for lane in _inside(net, connection)) for connection in joint]
    return fmean(ways) if ways else 0.0


def _border(net: Any, edges: list[Any], joints: list[list[Any]], is_loop: bool, side: str, *, mirrored: bool) -> Floats:
    outermost = 0 if side == "right" else -1
    sign = -1.0 if side == "right" else 1.0
    points: list[Floats] = []
    for edge, joint in zip(edges, joints, strict=True):
        inside = _inside(net, joint[outermost]) if joint else ()
        for lane in (car_lanes(edge)[outermost], *inside):
            shape = np.array(lane.getShape(), dtype=np.float64)
            if not len(shape):
                raise InputError(f"network: lane '{lane.getID()}' has no shape; build the network anew by netconvert")
            if len(_distinct(shape)) == 1 and lane.getID().startswith(":"):
                continue  # without extent it has no side: its point is in the middle of the lane, not at its border
            if mirrored:
                shape[:, 1] *= -1.0
            points.extend(offset(shape, sign * lane.getWidth() / 2))
    line = _distinct(np.array(points))
    if is_loop:
        line = np.vstack([line, line[:1]])
    return np.hstack([line[:-1], line[1:]])


def offset(line: Floats, leftwards_m: float) -> Floats:
    """Return a polyline of shape (n_points, 2) moved sideways, its corners mitred; left of its direction is positive.

    A line without any extent has no side and comes back as it is. Corners sharper than about 130 degrees are cut.
    """
    line = _distinct(line)
    if len(line) < 2:
        return line
    along = np.diff(line, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    left = np.column_stack([-along[:, 1], along[:, 0]])
    before, after = np.vstack([left[:1], left]), np.vstack([left, left[-1:]])
    # At a corner both sides move by the offset: the mitre is (n1 + n2) / (1 + n1.n2).
    cosine = (before * after).sum(axis=1, keepdims=True)
    return line + leftwards_m * (before + after) / np.maximum(1.0 + cosine, 0.35)


def _distinct(line: Floats) -> Floats:
    kept = [line[0]]
    kept.extend(point for point in line[1:] if np.hypot(*(point - kept[-1])) > SAME_POINT_M)
    return np.array(kept)
