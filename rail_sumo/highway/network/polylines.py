"""Polylines: arrays of points of shape (n_points, 2), in metres."""

import numpy as np

from rail_sumo.records import Floats

SAME_POINT_M = 0.05
"""Points closer than this are one; netconvert rounds to 0.01 m."""


def offset(line: Floats, leftwards_m: float) -> Floats:
    """Return a polyline of shape (n_points, 2) moved sideways, its corners mitred; left of its direction is positive.

    A line without any extent has no side and comes back as it is. Corners sharper than about 130 degrees are cut.
    """
    line = distinct(line)
    if len(line) < 2:
        return line
    along = np.diff(line, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    left = np.column_stack([-along[:, 1], along[:, 0]])
    before, after = np.vstack([left[:1], left]), np.vstack([left, left[-1:]])
    # At a corner both sides move by the offset: the mitre is (n1 + n2) / (1 + n1.n2).
    cosine = (before * after).sum(axis=1, keepdims=True)
    return line + leftwards_m * (before + after) / np.maximum(1.0 + cosine, 0.35)


def distinct(line: Floats) -> Floats:
    """Return a polyline without points that are the same as the one before."""
    kept = [line[0]]
    kept.extend(point for point in line[1:] if np.hypot(*(point - kept[-1])) > SAME_POINT_M)
    return np.array(kept)


def along_m(line: Floats) -> Floats:
    """Return how far along a polyline each of its points is, shape (n_points,)."""
    return np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])


def at(line: Floats, distance_m: Floats) -> Floats:
    """Return the points so far along a polyline, shape (n, 2)."""
    reached_m = along_m(line)
    return np.column_stack([np.interp(distance_m, reached_m, line[:, 0]), np.interp(distance_m, reached_m, line[:, 1])])


def densified(line: Floats, apart_m: float) -> Floats:
    """Return a polyline with as many more points that none is farther from the next; one without extent has one."""
    if len(line) < 2:
        return line
    corners_m = along_m(line)
    if corners_m[-1] == 0.0:
        return line[:1]
    between_m = np.linspace(0.0, corners_m[-1], int(corners_m[-1] // apart_m) + 2)
    return at(line, np.union1d(corners_m, between_m))
