"""The network as it is drawn: lanes, junctions and stop lines near where somebody has driven."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rail_sumo import assets
from rail_sumo.film import Ground, Lane, StopLine
from rail_sumo.highway.network import road
from rail_sumo.highway.network.course import CAR
from rail_sumo.highway.network.lanes import CHANGE_LEFT, CHANGE_RIGHT, may_cross
from rail_sumo.highway.network.sumo_xml import state_of
from rail_sumo.records import Floats

NEAR_M = 300.0
"""What is farther than about this from where somebody has driven is not drawn."""

Box = tuple[float, float, float, float]
"""The least x and y, and the greatest."""


def near(file: str, x_m: Floats, y_m: Floats) -> Ground:
    """Return the part of a network that is near these places, in its own coordinates.

    Args:
        file: the network, a shipped one's name or a `.net.xml`.
        x_m: places, shape (n,).
        y_m: likewise.

    Raises:
        InputError: no such network, or a damaged one.
    """
    every, cells = whole(file), _cells_near(x_m, y_m)
    lanes = tuple(lane for lane in every.lanes if _touches(_box(lane.points), cells))
    ids = {lane.id for lane in lanes}
    return replace(
        every,
        lanes=lanes,
        junctions=tuple(corners for corners in every.junctions if _touches(_box(corners), cells)),
        stop_lines=tuple(line for line in every.stop_lines if line.lane in ids),
    )


def whole(file: str) -> Ground:
    """Return a whole network as it is drawn; arguments as in `near`."""
    path = assets.network(file)
    return _whole(path, state_of(path))


@lru_cache(maxsize=16)
def _whole(path: Path, state: tuple[int, int]) -> Ground:
    reader = road.read(str(path))
    net = reader.getNet()
    edges = net.getEdges(withInternal=True)
    return Ground(
        lanes=tuple(_lanes(edges)),
        junctions=tuple(_flat(node.getShape()) for node in net.getNodes() if len(node.getShape()) > 2),
        stop_lines=tuple(_stop_lines(edges)),
        name=assets.network_name(path.name),
        is_left_hand=reader.is_left_hand,
    )


def _flat(shape: Any) -> Floats:
    """Return points' x and y, shape (n, 2)."""
    return np.array(shape, dtype=np.float64).reshape(len(shape), -1)[:, :2]


def _cells_near(x_m: Floats, y_m: Floats) -> set[tuple[int, int]]:
    """Return the squares of a side of `NEAR_M` in which places are, and those around each."""
    own = np.unique(np.floor_divide(np.column_stack((x_m, y_m)), NEAR_M).astype(int), axis=0)
    return {(x + east, y + north) for x, y in own.tolist() for east in (-1, 0, 1) for north in (-1, 0, 1)}


def _touches(box: Box, cells: set[tuple[int, int]]) -> bool:
    west, south, east, north = (int(side // NEAR_M) for side in box)
    return any((x, y) in cells for x in range(west, east + 1) for y in range(south, north + 1))


def _box(points: Floats) -> Box:
    return *points.min(axis=0).tolist(), *points.max(axis=0).tolist()


def _lanes(edges: Iterable[Any]) -> Iterator[Lane]:
    for edge in edges:
        for lane, beside in itertools.zip_longest(edge.getLanes(), edge.getLanes()[1:]):  # from the kerb
            yield Lane(
                lane.getID(),
                _flat(lane.getShape()),
                lane.getWidth(),
                is_open=lane.allows(CAR),
                is_inside=edge.isSpecial(),
                left_line="none" if beside is None else _line(lane, beside),
            )


def _line(lane: Any, beside: Any) -> Literal["none", "dashed", "solid"]:
    if lane.getEdge().isSpecial():
        return "none"
    if not (lane.allows(CAR) and beside.allows(CAR)):
        return "solid"
    return "dashed" if may_cross(lane, CHANGE_LEFT, CAR) or may_cross(beside, CHANGE_RIGHT, CAR) else "solid"


def _stop_lines(edges: Iterable[Any]) -> Iterator[StopLine]:
    for edge in edges:
        for lane in () if edge.isSpecial() else edge.getLanes():
            links = sorted({(c.getTLLinkIndex(), c.getTLSID()) for c in lane.getOutgoing() if c.getTLSID()})
            points = _flat(lane.getShape())
            along = points[-1] - points[-2]
            to_left = np.array((-along[1], along[0])) / max(float(np.hypot(*along)), 1e-9)
            ends = points[-1] + np.linspace(-0.5, 0.5, len(links) + 1)[:, None] * lane.getWidth() * to_left
            for (index, light), right, left in zip(links, ends, ends[1:], strict=False):
                yield StopLine(lane.getID(), (*right.tolist(), *left.tolist()), light, index)
