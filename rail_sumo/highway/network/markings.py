"""What a network looks like from above: asphalt, its borders and its lane markings, in short pieces."""

from typing import Any, NamedTuple

import numpy as np

from rail_sumo.highway.network.borders import offset
from rail_sumo.records import Floats

PIECE_M = 20.0
"""No piece is longer, so that those near a place are found by their middles."""
DASH_M, DASH_PERIOD_M = 3.0, 9.0


class Markings(NamedTuple):
    """Pieces of the road's surface and of the lines on it, in metres east and north."""

    asphalt: Floats
    """(n, 4, 2): the corners of pieces of lanes."""
    junctions: list[Floats]
    """(n_corners, 2) of each junction."""
    borders: Floats
    """(n, 2, 2): the ends of pieces of solid lines, at the edges' sides."""
    dashes: Floats
    """(n, 2, 2): the ends of dashes, between lanes."""

    def mirrored(self) -> "Markings":
        """Return them with north and south exchanged; see `road.Road.is_left_hand`."""
        mirror = np.array([1.0, -1.0])
        junctions = [corners * mirror for corners in self.junctions]
        return Markings(self.asphalt * mirror, junctions, self.borders * mirror, self.dashes * mirror)


def of(net: Any) -> Markings:
    """Return the markings of a network, as sumolib has it. Lanes and junctions without an extent have none."""
    asphalt: list[Floats] = []
    borders: list[Floats] = []
    dashes: list[Floats] = []
    for edge in net.getEdges(withInternal=True):
        lanes = [_line(lane) for lane in edge.getLanes()]
        for number, (lane, line) in enumerate(zip(edge.getLanes(), lanes, strict=True)):
            if len(line) < 2:
                continue
            left, right = (offset(line, side * lane.getWidth() / 2) for side in (1.0, -1.0))
            asphalt.append(np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1))
            if edge.getFunction() == "internal":
                continue
            if number == 0:
                borders.append(_pieces(right))
            if number == len(lanes) - 1:
                borders.append(_pieces(left))
            else:
                dashes.append(_dashes(left))
    junctions = [np.array(node.getShape()) for node in net.getNodes()]
    return Markings(
        np.concatenate([np.empty((0, 4, 2)), *asphalt]),
        [corners[:, :2] for corners in junctions if len(corners) > 2],
        np.concatenate([np.empty((0, 2, 2)), *borders]),
        np.concatenate([np.empty((0, 2, 2)), *dashes]),
    )


def _line(lane: Any) -> Floats:
    """Return the middle of a lane, shape (n_points, 2), with points no farther apart than `PIECE_M`."""
    shape = np.array(lane.getShape(), dtype=np.float64).reshape(-1, 2)
    if len(shape) < 2:
        return shape
    along_m = _along_m(shape)
    if along_m[-1] == 0.0:
        return shape[:1]
    between = np.linspace(0.0, along_m[-1], int(along_m[-1] // PIECE_M) + 2)
    return _at(shape, np.union1d(along_m, between))


def _along_m(line: Floats) -> Floats:
    """Return how far along a line each of its points is."""
    return np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])


def _at(line: Floats, along_m: Floats) -> Floats:
    """Return the points so far along a line."""
    reached = _along_m(line)
    return np.column_stack([np.interp(along_m, reached, line[:, 0]), np.interp(along_m, reached, line[:, 1])])


def _pieces(line: Floats) -> Floats:
    return np.stack([line[:-1], line[1:]], axis=1)


def _dashes(line: Floats) -> Floats:
    begin_m = np.arange(0.0, _along_m(line)[-1], DASH_PERIOD_M)
    return np.stack([_at(line, begin_m), _at(line, begin_m + DASH_M)], axis=1)
