"""Which edges of a network the host drives along: those its user wants, or the longest way straight on."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rail_sumo.errors import CourseError, did_you_mean

TURNS_BACK = ("t", "T")
"""Directions of connections that lead back, on roads driven on the right and on the left."""
CAR = "passenger"
"""The vehicle class that must be allowed on the course, unless the host is of another."""


def open_lanes(edge: Any, vclass: str) -> list[Any]:
    """Return an edge's lanes open to a class: the widest group without a closed lane in between, the rightmost such."""
    groups = itertools.groupby(edge.getLanes(), key=lambda lane: lane.allows(vclass))
    return max((list(lanes) for is_open, lanes in groups if is_open), key=len, default=[])


def connections(here: Any, ahead: Any, vclass: str) -> list[Any]:
    """Return the connections that lead a class of vehicles from one edge to the next, from right to left."""
    start, end = open_lanes(here, vclass), open_lanes(ahead, vclass)
    are_open = [c for c in here.getConnections(ahead) if c.allows(vclass)]
    found = [c for c in are_open if c.getFromLane() in start and c.getToLane() in end]
    return sorted(found, key=lambda c: (c.getFromLane().getIndex(), c.getToLane().getIndex()))


@dataclass(frozen=True, eq=False)
class Way:
    """A chain of edges to drive one after the other, or a loop of them, as sumolib has them."""

    edges: list[Any]
    is_loop: bool
    vclass: str = CAR
    """SUMO's class of the vehicle that drives it."""
    closed: frozenset[str] = frozenset()
    """Ids of lanes that are closed to it for a time: they lead nowhere, and are not entered."""

    @cached_property
    def lanes(self) -> list[list[Any]]:
        """For each edge its lanes that are open to the vehicle; see `open_lanes`."""
        return [open_lanes(edge, self.vclass) for edge in self.edges]

    @cached_property
    def joints(self) -> list[list[Any]]:
        """For each edge the connections that lead on to the next; none behind a chain's last edge."""
        found = [self._joint(here, ahead) for here, ahead in itertools.pairwise(self.edges)]
        return [*found, self._joint(self.edges[-1], self.edges[0]) if self.is_loop else []]

    def _joint(self, here: Any, ahead: Any) -> list[Any]:
        leading = connections(here, ahead, self.vclass)
        return [c for c in leading if self.closed.isdisjoint((c.getFromLane().getID(), c.getToLane().getID()))]


def require_edges(net: Any, name: str, wanted: Sequence[str]) -> None:
    """Raise CourseError for the first of some edges that a network does not have; arguments as in `along`."""
    for edge_id in wanted:
        if not net.hasEdge(edge_id):
            ids = [edge.getID() for edge in net.getEdges(withInternal=False)]
            raise CourseError(
                f"network '{name}' has no edge '{edge_id}', which network.course names{did_you_mean(edge_id, ids)}"
            )


def along(net: Any, name: str, wanted: tuple[str, ...], vclass: str = CAR) -> Way:
    """Return the way over the edges wanted, in their order.

    Between two that do not follow each other it takes the shortest way. It is a loop if the first edge is wanted again
    at the end.

    Args:
        net: the network, as sumolib has it.
        name: what to call it.
        wanted: the edges' ids, one or more.
        vclass: SUMO's class of the vehicle that is to drive there.

    Raises:
        CourseError: no such edge, no such way, or a way that is closed to the class or leads twice over one edge.
    """
    require_edges(net, name, wanted)
    first, *others = map(net.getEdge, wanted)
    edges = [first]
    for ahead in others:
        edges += _between(edges[-1], ahead, net, name, vclass)
    is_loop = len(edges) > 1 and edges[-1] is first
    if is_loop:
        edges.pop()
    for edge in edges:
        if not open_lanes(edge, vclass):
            raise CourseError(
                f"network '{name}': the course runs over edge '{edge.getID()}', which is closed to {_all(vclass)}; "
                f"lead network.course around it"
            )
        if edges.count(edge) > 1:
            raise CourseError(
                f"network '{name}': the course runs twice over edge '{edge.getID()}'; lead network.course so that it "
                f"does not, or name the first edge again at its end to go round"
            )
    return Way(edges, is_loop, vclass)


def _all(vclass: str) -> str:
    return "cars" if vclass == CAR else f"vehicles of the class {vclass}"


def _between(here: Any, ahead: Any, net: Any, name: str, vclass: str) -> tuple[Any, ...]:
    # The edges after `here`, up to and with `ahead`.
    way = _shortest(here, ahead, net, vclass)
    if way is None:
        raise CourseError(
            f"network '{name}': no way for {_all(vclass)} leads from edge '{here.getID()}' to edge "
            f"'{ahead.getID()}'; name the edges of network.course in driving order"
        )
    for one, other in itertools.pairwise(way):
        if not connections(one, other, vclass):
            raise CourseError(
                f"network '{name}': none of the lanes that the host may use, the widest group open to {_all(vclass)}, "
                f"leads from edge '{one.getID()}' on to edge '{other.getID()}'; lead network.course around them"
            )
    return way[1:]


def _shortest(here: Any, ahead: Any, net: Any, vclass: str) -> tuple[Any, ...] | None:
    # The edges from `here` to `ahead`; where they are the same, once round.
    if ahead in here.getAllowedOutgoing(vclass):
        return here, ahead
    if here is not ahead:
        return net.getOptimalPath(here, ahead, vClass=vclass)[0]
    rounds = (net.getOptimalPath(out, ahead, vClass=vclass) for out in here.getAllowedOutgoing(vclass))
    way, _ = min((found for found in rounds if found[0]), key=lambda found: found[1], default=(None, 0.0))
    return way and (here, *way)


def longest(net: Any, name: str) -> Way:
    """Return the longest way for cars straight on, and round the bend where nothing leads straight on.

    It is the chain of edges with the longest way on two or more lanes for cars, and of these the longest in all, in
    which each edge is followed by the one that its most lanes lead straight on to, or else turn to. A loop counts
    twice its length, since it never ends. Equal chains are told apart by their edges' ids, so the choice depends on the
    network alone.

    Raises:
        CourseError: nowhere may cars drive.
    """
    drivable = {edge for edge in net.getEdges(withInternal=False) if open_lanes(edge, CAR)}
    if not drivable:
        raise CourseError(f"network '{name}' has no edge that is open to cars; rail-sumo drives a passenger car")
    return Way(*min(_chains({edge: _next(edge, drivable) for edge in drivable}), key=_rank))


def _next(edge: Any, drivable: set[Any]) -> Any | None:
    choices = []
    for ahead in edge.getOutgoing():
        all_on = connections(edge, ahead, CAR) if ahead in drivable else []
        joint = [c for c in all_on if c.getDirection() not in TURNS_BACK]
        if joint:
            is_straight = any(c.getDirection() == c.LINKDIR_STRAIGHT for c in joint)
            choices.append((not is_straight, -len({c.getFromLane() for c in joint}), ahead.getID(), ahead))
    return min(choices)[-1] if choices else None


def _chains(following: dict[Any, Any | None]) -> Iterator[tuple[list[Any], bool]]:
    # Those that are part of no other: they begin where none leads to, or go round a loop, from its first id on.
    seen: set[Any] = set()
    for first in (*following.keys() - following.values(), *following):
        if first in seen:
            continue
        places: dict[Any, int] = {}
        edge: Any | None = first
        while edge is not None and edge not in places:
            places[edge] = len(places)
            edge = following[edge]
        chain = list(places)
        seen.update(chain)
        if edge is not first:
            yield chain, False
        if edge is not None:
            loop = chain[places[edge] :]
            start = loop.index(min(loop, key=lambda one: one.getID()))
            yield loop[start:] + loop[:start], True


def _rank(candidate: tuple[list[Any], bool]) -> tuple[float, float, list[str]]:
    chain, is_loop = candidate
    rounds = 2 if is_loop else 1
    several_m = _length_m(edge for edge in chain if len(open_lanes(edge, CAR)) > 1)
    return -several_m * rounds, -_length_m(chain) * rounds, [edge.getID() for edge in chain]


def _length_m(edges: Iterable[Any]) -> float:
    return math.fsum(edge.getLength() for edge in edges)  # exact: the same loop is as long from every edge
