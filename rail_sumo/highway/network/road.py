"""What a network says: the course the host drives, its lanes and its borders. Read with sumolib, without libsumo."""

import gc
import itertools
import xml.sax
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import sumolib.net
from sumolib.geomhelper import polyLength

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway.network import course
from rail_sumo.highway.network.borders import borders
from rail_sumo.highway.network.course import CAR
from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.network.lanes import CHANGE_LEFT, CHANGE_RIGHT, has_priority, survey, within
from rail_sumo.highway.network.sumo_xml import UNREADABLE, opened, require_flat, state_of
from rail_sumo.records import Floats

NOT_TO_SCALE, NOT_TO_SCALE_M = 0.25, 20.0
"""By what part of its length, and by how much, an edge is drawn longer or shorter where that is told."""
FAR_OFF, FAR_OFF_M = 1 / 3, 8.0
"""Or by what larger part, and by how much: of short edges."""
MOST_TOLD = 12
"""So many more of them are named."""
NARROWEST_LANE_M = 2.4
"""A car of 1.8 m with 0.3 m to either side."""


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
    zips_with: Mapping[str, tuple[str, ...]]
    """The lanes that join another at a zipper junction, each with those that join it there, on the course or not."""
    junctions_m: tuple[float, ...]
    """How long the way through the junction after each edge is; after a chain's last edge 0."""
    is_loop: bool
    meets_others: bool
    """Whether it leads through a junction without priority, or where others cross its way."""
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


def load(
    file: str,
    wanted: tuple[str, ...] = (),
    *,
    vclass: str = CAR,
    limit_factor: float = 1.0,
    closed: frozenset[str] = frozenset(),
) -> Road:
    """Read a network, a shipped one's name or a `.net.xml`, and lay the course along the edges wanted.

    Without any it is the longest way for cars straight on; see `course`. Only lanes that are open to the class `vclass`
    of SUMO's are driven; those `closed` for a time, by their ids, lead nowhere. Every speed limit is multiplied by
    `limit_factor`.

    Raises:
        InputError: no such file, not a SUMO network, a truncated one, or one without such a course.
    """
    path = assets.network(file)
    found = _load(path, wanted, vclass, closed, state_of(path))
    return found if limit_factor == 1.0 else _limited(found, limit_factor)


def require_readable(file: str, wanted: tuple[str, ...] = ()) -> None:
    """Read a network before anybody drives on it, along a course of these edges.

    Raises:
        InputError: as in `load`, but for the course; an edge that is not there.
    """
    course.require_edges(read(file).getNet(), assets.network(file).name, wanted)


def read(file: str) -> "_Reader":
    """Return a network as sumolib reads it, by `getNet()`, and what it drops.

    Raises:
        InputError: as in `load`, but for the course.
    """
    path = assets.network(file)
    return _read(path, state_of(path))


def misdrawn(file: str) -> Iterator[str]:
    """Tell of edges that are drawn much longer or shorter than they are, wherever in the network.

    Raises:
        InputError: as in `load`, but for the course.
    """
    found = []
    for edge in read(file).getNet().getEdges(withInternal=False):
        drawn_m, length_m = polyLength(edge.getLanes()[0].getShape()), edge.getLength()
        off_m = abs(drawn_m - length_m)
        is_far_off = off_m > max(FAR_OFF * length_m, FAR_OFF_M)
        is_off = is_far_off or off_m > max(NOT_TO_SCALE * length_m, NOT_TO_SCALE_M)
        if is_off:
            found.append(f"'{edge.getID()}' is {length_m:.0f} m long and drawn {drawn_m:.0f} m")
    if found:
        names = [one.partition(" ")[0] for one in found[1:]]
        told = f"so are {', '.join(names)}" if len(names) <= MOST_TOLD else f"{len(names)} more"
        more = f" (and {told})" if names else ""
        yield (
            f"edge {found[0]}{more}: vehicles move by the length and are sensed, overtaken and shown "
            "where they are drawn, so that figures of cars driven there are wrong; draw it to scale, or mend its length"
        )


def warnings(road: Road) -> Iterator[str]:
    """Tell what makes it a poor course."""
    yield from misdrawn(str(road.net_file))
    if all(len(edge.lanes) == 1 for edge in road.edges):
        yield "every edge has one lane: nobody can change lanes or overtake, and drivers differ by their speed alone"
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
def _load(path: Path, wanted: tuple[str, ...], vclass: str, closed: frozenset[str], state: tuple[int, int]) -> Road:
    reader = _read(path, state)
    net = reader.getNet()
    way = course.along(net, path.name, wanted, vclass) if wanted else course.longest(net, path.name)
    return Road(
        net_file=path,
        name=assets.network_name(path.name),
        **survey(net, replace(way, closed=closed), reader.has_no_foes)._asdict(),
        is_loop=way.is_loop,
        meets_others=any(not has_priority(c) or reader.is_crossed(c) for joint in way.joints for c in joint),
        sight_m=reader.sight_m,
        is_left_hand=reader.is_left_hand,
        boundaries=borders(net, way, mirrored=reader.is_left_hand),
    )


class _Reader(sumolib.net.NetReader):
    """Also reads what sumolib drops: `lefthand`, `changeLeft` and `changeRight`, `visibility`, and who has no foes."""

    def __init__(self, path: Path) -> None:
        super().__init__(withInternal=True, withFoes=False)
        self._path = path
        self._depth = 0
        self.is_left_hand = False
        self.sight_m: dict[str, float] = {}
        self._foes: dict[tuple[str, int], str] = {}  # by junction and index of a connection: 1 for each, the last first
        self._streams: dict[str, dict[int, Any]] = {}  # by junction: its connections by their index

    def startElement(self, name: str, attrs: Any) -> None:
        self._depth += 1
        require_flat(self._path, self._depth)
        self.is_left_hand = self.is_left_hand or (name == "net" and attrs.get("lefthand") == "true")
        super().startElement(name, attrs)
        for side in (CHANGE_LEFT, CHANGE_RIGHT) if name == "lane" else ():
            if side in attrs:
                self._currentLane.setParam(side, attrs[side])
        if name == "connection" and "visibility" in attrs and "via" in attrs:
            self.sight_m[attrs["via"]] = float(attrs["visibility"])
        if name == "request":
            self._foes[self._currentNode.getID(), int(attrs["index"])] = attrs["foes"]

    def endElement(self, name: str) -> None:
        self._depth -= 1
        super().endElement(name)

    def has_no_foes(self, connection: Any) -> bool:
        """Return whether no other stream crosses or joins a connection."""
        return "1" not in self._foes.get(_place(connection), "1")

    def is_crossed(self, connection: Any) -> bool:
        """Return whether another stream crosses a connection, or may wait within the junction before it joins it."""
        node, ahead = connection.getFrom().getToNode(), connection.getTo()
        foes = self._foes.get(_place(connection), "")
        if node.getID() not in self._streams:
            self._streams[node.getID()] = {node.getLinkIndex(one): one for one in node.getConnections()}
        streams = self._streams[node.getID()]
        others = (streams[index] for index in range(len(foes)) if foes[-1 - index] == "1" and index in streams)
        return any(one.getTo() != ahead or len(list(within(self.getNet(), one))) > 1 for one in others)


def _place(connection: Any) -> tuple[str, int]:
    # A connection's junction, and its index there.
    node = connection.getFrom().getToNode()
    return node.getID(), node.getLinkIndex(connection)


@lru_cache(maxsize=16)  # the host may take another course in every episode, on one of several networks
def _read(path: Path, state: tuple[int, int]) -> _Reader:
    # Not sumolib.net.readNet: it picks another parser when lxml is installed and leaves files open after an error.
    reader = _Reader(path)
    try:
        with opened(path) as stream, _no_garbage_collection():
            xml.sax.parse(stream, reader)
    except UNREADABLE as error:
        raise InputError(f"network '{path.name}' is not a complete XML file: {_reason(error)}") from None
    except InputError:
        raise
    except Exception as error:  # whatever sumolib stumbles over in a file that is XML but not a network
        raise InputError(f"network '{path.name}' is not a SUMO network: {error!r}") from None
    if not reader.getNet().getEdges(withInternal=False):
        raise InputError(
            f"network '{path.name}' has no edges; rail-sumo reads SUMO's .net.xml, and by --network a .sumocfg"
        )
    return reader


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Leave garbage until afterwards: looking for it among ever more objects takes two fifths of the parser's time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _reason(error: Exception) -> str:
    if isinstance(error, xml.sax.SAXParseException):
        return f"{error.getMessage()} in line {error.getLineNumber()}"
    return str(error)
