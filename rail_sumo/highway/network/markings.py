"""What a network looks like from above: asphalt, its borders and its lane markings, in short pieces."""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rail_sumo.highway.network import ground
from rail_sumo.highway.network.polylines import along_m, at, densified, offset
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.network.sumo_xml import state_of
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
    """(n, 2, 2): the ends of pieces of solid lines, at the edges' sides and where nobody may change lanes."""
    dashes: Floats
    """(n, 2, 2): the ends of dashes, between lanes."""

    def mirrored(self) -> "Markings":
        """Return them with north and south exchanged; see `road.Road.is_left_hand`."""
        mirror = np.array([1.0, -1.0])
        junctions = [corners * mirror for corners in self.junctions]
        return Markings(self.asphalt * mirror, junctions, self.borders * mirror, self.dashes * mirror)


def of(road: Road) -> Markings:
    """Return what the whole network of a road looks like, told in the mirror if the road is.

    Lanes and junctions without an extent have no markings.
    """
    return _of(road.net_file, state_of(road.net_file))


@lru_cache(maxsize=4)
def _of(path: Path, state: tuple[int, int]) -> Markings:
    below = ground.whole(str(path))
    sides = (1.0, -1.0) if below.is_left_hand else (-1.0, 1.0)  # leftwards: the kerb's, and the other
    asphalt: list[Floats] = []
    solid: list[Floats] = []
    dashes: list[Floats] = []
    edge = ""
    for lane in below.lanes:  # edge by edge, from the kerb
        is_first, edge = lane.edge != edge, lane.edge
        line = densified(lane.points, PIECE_M)
        if len(line) < 2:
            continue
        kerb, away = (offset(line, side * lane.width_m / 2) for side in sides)
        asphalt.append(np.stack([kerb[:-1], kerb[1:], away[1:], away[:-1]], axis=1))
        if lane.is_inside:
            continue
        if is_first:
            solid.append(_pieces(kerb))
        if lane.left_line == "dashed":
            dashes.append(_dashes(away))
        else:
            solid.append(_pieces(away))
    found = Markings(
        np.concatenate([np.empty((0, 4, 2)), *asphalt]),
        list(below.junctions),
        np.concatenate([np.empty((0, 2, 2)), *solid]),
        np.concatenate([np.empty((0, 2, 2)), *dashes]),
    )
    return found.mirrored() if below.is_left_hand else found


def _pieces(line: Floats) -> Floats:
    return np.stack([line[:-1], line[1:]], axis=1)


def _dashes(line: Floats) -> Floats:
    begin_m = np.arange(0.0, along_m(line)[-1], DASH_PERIOD_M)
    return np.stack([at(line, begin_m), at(line, begin_m + DASH_M)], axis=1)
