"""A synthetic LIDAR: rays against oriented boxes. Pure geometry; knows nothing of SUMO."""

import math

import numpy as np
from numpy.typing import NDArray

from rail_sumo.highway.compiled import compiled
from rail_sumo.records import Floats, Scene

PARALLEL = 1e-300
"""Added to a ray's direction cosines, so that one parallel to a box's side divides to something huge, not to nan."""

CELL_M = 50.0
"""Road edges are looked up by squares of this size."""


class Lidar:
    """`n_rays` evenly spaced rays; ray k points 2*pi*k/n_rays rad counter-clockwise from the host's heading.

    Args:
        n_rays: number of rays over the full circle.
        max_range_m: reported where nothing is hit.
        road_edges: line segments of shape (n, 4) that stand in the way like a guard rail: x1, y1, x2, y2 in metres;
            may be empty.

    Raises:
        ValueError: n_rays < 1 or max_range_m <= 0.

    Compiled by numba: a scan of 24 rays takes 3 to 4 us on the default world, a tenth of what it takes as numpy's array
    operations, each of which costs about 1 us however small its arrays. In return a process that scans is 120 MB larger
    and starts half a second later.
    """

    def __init__(self, n_rays: int, max_range_m: float, road_edges: Floats | None = None) -> None:
        if n_rays < 1:
            raise ValueError(f"n_rays must be at least 1; got {n_rays}")
        if max_range_m <= 0:
            raise ValueError(f"max_range_m must be positive; got {max_range_m}")
        self.max_range_m = float(max_range_m)
        angle = 2 * np.pi * np.arange(n_rays) / n_rays
        self._rays = np.array((np.cos(angle), np.sin(angle)))
        self._edges = _posed(np.empty((0, 4)) if road_edges is None else road_edges)
        self._cells: dict[tuple[float, float], Floats] = {}

    def scan(self, scene: Scene) -> Floats:
        """Return what each ray from the host's centre hits first, shape (2, n_rays).

        Args:
            scene: the host and the other vehicles. One that covers the host's centre reads 0 m.

        Returns:
            Row 0 holds distances in m: `max_range_m` where nothing is hit. Row 1 holds relative speeds in m/s: obstacle
            minus host along the host's heading; 0.0 where nothing is hit.
        """
        boxes = scene.boxes
        return first_hits(boxes, self._edges_near(boxes[0, 0], boxes[1, 0]), self._rays, self.max_range_m)

    def _edges_near(self, x_m: float, y_m: float) -> Floats:
        """Return the road edges that a ray from anywhere in the host's square can reach."""
        cell = (x_m // CELL_M, y_m // CELL_M)
        near = self._cells.get(cell)
        if near is None:
            near = self._cells[cell] = self._edges[self._within_reach(complex(*cell) * CELL_M + (0.5 + 0.5j) * CELL_M)]
        return near

    def _within_reach(self, middle: complex) -> NDArray[np.bool_]:
        from_middle = (self._edges[:, 0] - middle.real) + 1j * (self._edges[:, 1] - middle.imag)
        reach = self.max_range_m + CELL_M + 0.5 * self._edges[:, 3]
        return np.abs(from_middle) < reach


def _posed(segments: Floats) -> Floats:
    """Return the x, y, heading and length of line segments of shape (n, 4), as boxes without width; shape (n, 4)."""
    x1, y1, x2, y2 = np.asarray(segments, dtype=np.float64).reshape(-1, 4).T
    return np.column_stack(((x1 + x2) / 2, (y1 + y2) / 2, np.arctan2(y2 - y1, x2 - x1), np.hypot(x2 - x1, y2 - y1)))


@compiled("float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, ::1], float64)")
def first_hits(boxes: Floats, edges: Floats, rays: Floats, max_range_m: float) -> Floats:
    """Return each ray's distance and relative speed, as `Lidar.scan` does.

    Args:
        boxes: those of a `Scene`, shape (6, n_vehicles).
        edges: x, y, heading and length of the road edges, shape (n_edges, 4).
        rays: cosine and sine of each ray's angle to the host's heading, shape (2, n_rays).
        max_range_m: how far they reach.

    Source: ray/slab intersection (Kay & Kajiya 1986), in each box's own frame.
    """
    x_m, y_m, heading_rad, speed_mps, length_m, width_m = boxes[0], boxes[1], boxes[2], boxes[3], boxes[4], boxes[5]
    n_vehicles, n_rays = len(x_m), rays.shape[1]
    scan = np.zeros((2, n_rays))
    distance_m, relative_mps = scan[0], scan[1]
    distance_m[:] = max_range_m
    host_cos, host_sin = math.cos(heading_rad[0]), math.sin(heading_rad[0])
    for box in range(1, n_vehicles + len(edges)):
        if box < n_vehicles:
            east, north, turn = x_m[box] - x_m[0], y_m[box] - y_m[0], heading_rad[0] - heading_rad[box]
            half_length, half_width, speed = 0.5 * length_m[box], 0.5 * width_m[box], speed_mps[box]
        else:
            edge = box - n_vehicles
            east, north, turn = edges[edge, 0] - x_m[0], edges[edge, 1] - y_m[0], heading_rad[0] - edges[edge, 2]
            half_length, half_width, speed = 0.5 * edges[edge, 3], 0.0, 0.0
        reach = max_range_m + half_length + half_width
        if east * east + north * north > reach * reach:
            continue
        # Into the host's frame, then by `turn` into the box's own. There its centre is at (along, across).
        ahead, left = east * host_cos + north * host_sin, north * host_cos - east * host_sin
        cos, sin = math.cos(turn), math.sin(turn)
        along, across = ahead * cos - left * sin, ahead * sin + left * cos
        relative = speed * cos - speed_mps[0]
        for ray in range(n_rays):
            per_along = 1.0 / (cos * rays[0, ray] - sin * rays[1, ray] + PARALLEL)
            per_across = 1.0 / (sin * rays[0, ray] + cos * rays[1, ray] + PARALLEL)
            to_end, to_side = abs(half_length * per_along), abs(half_width * per_across)
            enter = max(along * per_along - to_end, across * per_across - to_side)
            leave = min(along * per_along + to_end, across * per_across + to_side)
            hits = (enter <= leave) & (leave >= 0.0) & (enter < distance_m[ray])
            distance_m[ray] = enter if hits else distance_m[ray]
            relative_mps[ray] = relative if hits else relative_mps[ray]
    for ray in range(n_rays):
        distance_m[ray] = max(distance_m[ray], 0.0)
    return scan
