"""The outer borders of a way, as line segments."""

from typing import Any

import numpy as np

from rail_sumo.errors import CourseError
from rail_sumo.highway.network.course import Way
from rail_sumo.highway.network.lanes import within
from rail_sumo.highway.network.polylines import distinct, offset
from rail_sumo.records import Floats


def borders(net: Any, way: Way, *, mirrored: bool) -> Floats:
    """Return the right and the left border of a way, shape (n_segments, 4): x1, y1, x2, y2, in metres, read-only.

    Args:
        net: the network, as sumolib has it.
        way: where to drive.
        mirrored: whether all is told in the mirror; see `road.Road.is_left_hand`.

    Raises:
        CourseError: a lane without a shape.
    """
    found = np.concatenate([_border(net, way, side, mirrored=mirrored) for side in ("right", "left")])
    found.setflags(write=False)
    return found


def _border(net: Any, way: Way, side: str, *, mirrored: bool) -> Floats:
    outermost = 0 if side == "right" else -1
    sign = -1.0 if side == "right" else 1.0
    points: list[Floats] = []
    for lanes, joint in zip(way.lanes, way.joints, strict=True):
        inside = within(net, joint[outermost]) if joint else ()
        for lane in (lanes[outermost], *inside):
            shape = np.array(lane.getShape(), dtype=np.float64)
            if not len(shape):
                raise CourseError(f"network: lane '{lane.getID()}' has no shape; build the network anew by netconvert")
            if len(distinct(shape)) == 1 and lane.getID().startswith(":"):
                continue  # without extent it has no side: its point is in the middle of the lane, not at its border
            if mirrored:
                shape[:, 1] *= -1.0
            points.extend(offset(shape, sign * lane.getWidth() / 2))
    line = distinct(np.array(points))
    if way.is_loop:
        line = np.vstack([line, line[:1]])
    return np.hstack([line[:-1], line[1:]])
