"""Which edges of a network the host drives along: those its user wants, or the longest way straight on."""

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import Any

from rail_sumo.errors import InputError, did_you_mean

TURNS_BACK = ("t", "T")
"""Directions of connections that lead back, on roads driven on the right and on the left."""
CAR = "passenger"
"""The vehicle class that must be allowed on the course."""


def car_lanes(edge: Any) -> list[Any]:
    """Return an edge's lanes open to cars: the widest group without a closed lane in between, the rightmost such."""
    groups = itertools.groupby(edge.getLanes(), key=lambda lane: lane.allows(CAR))
    return max((list(lanes) for is_open, lanes in groups if is_open), key=len, default=[])


def connections(here: Any, ahead: Any) -> list[Any]:
    """Return the connections that lead a car from one edge to the next, from right to left."""
    start, end = car_lanes(here), car_lanes(ahead)
    open_to_cars = [c for c in here.getConnections(ahead) if c.allows(CAR)]
    found = [c for c in open_to_cars if c.getFromLane() in start and c.getToLane() in end]
    return sorted(found, key=lambda c: (c.getFromLane().getIndex(), c.getToLane().getIndex()))


def along(net: Any, name: str, wanted: tuple[str, ...]) -> tuple[list[Any], bool]:
    """Return the course that leads over the edges wanted, in their order, and whether it is a loop.

    Between two that do not follow each other it takes the shortest way for cars. It is a loop if the first edge is
    wanted again at the end.

    Args:
        net: the network, as sumolib has it.
        name: what to call it.
        wanted: the edges' ids, one or more.

    Raises:
        InputError: no such edge, no such way, or a way that is closed to cars or leads twice over one edge.
    """
    for edge_id in wanted:
        if not net.hasEdge(edge_id):
            ids = [edge.getID() for edge in net.getEdges(withInternal=False)]
            raise InputError(
                f"network '{name}' has no edge '{edge_id}', which network.course names{did_you_mean(edge_id, ids)}"
            )
    first, *others = map(net.getEdge, wanted)
    edges = [first]
    for ahead in others:
        edges += _between(edges[-1], ahead, net, name)
    is_loop = len(edges) > 1 and edges[-1] is first
    if is_loop:
        edges.pop()
    for edge in edges:
        if not car_lanes(edge):
            raise InputError(
                f"network '{name}': the course runs over edge '{edge.getID()}', which is closed to cars; lead "
                f"network.course around it"
            )
        if edges.count(edge) > 1:
            raise InputError(
                f"network '{name}': the course runs twice over edge '{edge.getID()}'; lead network.course so that it "
                f"does not, or name the first edge again at its end to go round"
            )
    return edges, is_loop


def _between(here: Any, ahead: Any, net: Any, name: str) -> tuple[Any, ...]:
    # The edges after `here`, up to and with `ahead`.
    way = _shortest(here, ahead, net)
    if way is None:
        raise InputError(
            f"network '{name}': no way for cars leads from edge '{here.getID()}' to edge '{ahead.getID()}'; name the "
            f"edges of network.course in driving order"
        )
    for one, other in itertools.pairwise(way):
        if not connections(one, other):
            raise InputError(
                f"network '{name}': none of the lanes that the host may use, the widest group open to cars, leads from "
                f"edge '{one.getID()}' on to edge '{other.getID()}'; lead network.course around them"
            )
    return way[1:]


def _shortest(here: Any, ahead: Any, net: Any) -> tuple[Any, ...] | None:
    # The edges from `here` to `ahead`; where they are the same, once round.
    if ahead in here.getAllowedOutgoing(CAR):
        return here, ahead
    if here is not ahead:
        return net.getOptimalPath(here, ahead, vClass=CAR)[0]
    rounds = (net.getOptimalPath(out, ahead, vClass=CAR) for out in here.getAllowedOutgoing(CAR))
    way, _ = min((found for found in rounds if found[0]), key=lambda found: found[1], default=(None, 0.0))
    return way and (here, *way)


def longest(net: Any, name: str) -> tuple[list[Any], bool]:
    """Return the longest way straight on, round the bend where nothing leads straight on, and whether it is a loop.

    It is the chain of edges with the longest way on two or more lanes for cars, and of these the longest in all, in
    which each edge is followed by the one that its most lanes lead straight on to, or else turn to. A loop counts
    twice its length, since it never ends. Equal chains are told apart by their edges' ids, so the choice depends on the
    network alone.

    Raises:
        InputError: nowhere may cars drive.
    """
    drivable = {edge for edge in net.getEdges(withInternal=False) if car_lanes(edge)}
    if not drivable:
        raise InputError(f"network '{name}' has no edge that is open to cars; rail-sumo drives a passenger car")
    return min(_chains({edge: _next(edge, drivable) for edge in drivable}), key=_rank)


def _next(edge: Any, drivable: set[Any]) -> Any | None:
    choices = []
    for ahead in edge.getOutgoing():
        joint = [c for c in connections(edge, ahead) if c.getDirection() not in TURNS_BACK] if ahead in drivable else []
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
    several_m = _length_m(edge for edge in chain if len(car_lanes(edge)) > 1)
    return -several_m * rounds, -_length_m(chain) * rounds, [edge.getID() for edge in chain]


def _length_m(edges: Iterable[Any]) -> float:
    return math.fsum(edge.getLength() for edge in edges)  # exact: the same loop is as long from every edge
