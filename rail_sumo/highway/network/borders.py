"""The outer borders of a way, as line segments."""

from typing import Any

import numpy as np

from rail_sumo.errors import CourseError
from rail_sumo.highway.network.course import Way
from rail_sumo.highway.network.lanes import within
from rail_sumo.records import Floats

SAME_POINT_M = 0.05
"""Points of a border closer than this are one; netconvert rounds to 0.01 m."""


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
            if len(_distinct(shape)) == 1 and lane.getID().startswith(":"):
                continue  # without extent it has no side: its point is in the middle of the lane, not at its border
            if mirrored:
                shape[:, 1] *= -1.0
            points.extend(offset(shape, sign * lane.getWidth() / 2))
    line = _distinct(np.array(points))
    if way.is_loop:
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
