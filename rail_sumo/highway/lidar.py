"""A synthetic LIDAR: rays against oriented boxes. Pure geometry; knows nothing of SUMO."""

import cmath
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rail_sumo.records import Floats

PARALLEL = 1e-300
"""Added to a ray's direction cosines, so that one parallel to a box's side divides to something huge, not to nan."""

CELL_M = 50.0
"""Road edges are looked up by squares of this size."""


@dataclass(frozen=True, slots=True)
class Boxes:
    """Oriented rectangles that move along their heading; arrays of shape (n_boxes,), SI, counter-clockwise radians."""

    x_m: Floats
    y_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    length_m: Floats
    width_m: Floats

    @classmethod
    def of_segments(cls, segments: Floats) -> "Boxes":
        """Return standing boxes without width for line segments of shape (n, 4): x1, y1, x2, y2 in metres."""
        x1, y1, x2, y2 = np.asarray(segments, dtype=np.float64).reshape(-1, 4).T
        still = np.zeros(len(x1))
        length = np.hypot(x2 - x1, y2 - y1)
        return cls((x1 + x2) / 2, (y1 + y2) / 2, np.arctan2(y2 - y1, x2 - x1), still, length, still)

    def table(self) -> Floats:
        """Return the columns side by side, shape (n_boxes, 6)."""
        return np.array((self.x_m, self.y_m, self.heading_rad, self.speed_mps, self.length_m, self.width_m)).T


class Lidar:
    """`n_rays` evenly spaced rays; ray k points 2*pi*k/n_rays rad counter-clockwise from the host's heading.

    Args:
        n_rays: number of rays over the full circle.
        max_range_m: reported where nothing is hit.
        road_edges: line segments of shape (n, 4) that stand in the way like a guard rail; may be empty.

    Raises:
        ValueError: n_rays < 1 or max_range_m <= 0.

    Source: ray/slab intersection (Kay & Kajiya 1986), in each box's own frame, with points as complex numbers so that
    a rotation is a product. numpy, not numba: on 24 rays and some ten boxes it is fast enough, and numba would more
    than double a rollout worker's memory.
    """

    def __init__(self, n_rays: int, max_range_m: float, road_edges: Floats | None = None) -> None:
        if n_rays < 1:
            raise ValueError(f"n_rays must be at least 1; got {n_rays}")
        if max_range_m <= 0:
            raise ValueError(f"max_range_m must be positive; got {max_range_m}")
        self.max_range_m = float(max_range_m)
        self._rays = np.exp(2j * np.pi * np.arange(n_rays) / n_rays)
        self._columns = np.arange(n_rays)
        self._edges = Boxes.of_segments(np.empty((0, 4)) if road_edges is None else road_edges).table()
        self._cells: dict[tuple[int, int], Floats] = {}

    def scan(self, x_m: float, y_m: float, heading_rad: float, speed_mps: float, boxes: Boxes) -> tuple[Floats, Floats]:
        """Return what each ray from the host's centre hits first.

        Args:
            x_m, y_m, heading_rad, speed_mps: the host's centre, heading and speed.
            boxes: the other vehicles; may be empty. One that covers the host's centre reads 0 m.

        Returns:
            distance_m, shape (n_rays,): `max_range_m` where nothing is hit.
            relative_speed_mps, shape (n_rays,): obstacle minus host along the host's heading; 0.0 where nothing is hit.
        """
        table = np.concatenate((boxes.table(), self._edges_near(x_m, y_m)))
        if not len(table):
            return np.full(len(self._rays), self.max_range_m), np.zeros(len(self._rays))
        # From the host's frame into each box's own, where the host is at `origin` and the rays go along `direction`.
        turn = np.exp((heading_rad - table[:, 2]) * 1j)
        centre = (table[:, 0] - x_m + 1j * (table[:, 1] - y_m)) * cmath.exp(-1j * heading_rad)
        origin = -centre * turn
        direction = turn[:, None] * self._rays
        # Distance along each ray to where it enters and leaves the box's length, and its width; (n_boxes, n_rays).
        enter_x, leave_x = _slab(origin.real, direction.real, table[:, 4])
        enter_y, leave_y = _slab(origin.imag, direction.imag, table[:, 5])
        enter, leave = np.maximum(enter_x, enter_y), np.minimum(leave_x, leave_y)
        enter[(enter > leave) | (leave < 0.0)] = self.max_range_m
        first = enter.argmin(axis=0)
        distance = np.minimum(np.maximum(enter[first, self._columns], 0.0), self.max_range_m)
        relative = (table[:, 3] * turn.real)[first] - speed_mps
        relative[distance >= self.max_range_m] = 0.0
        return distance, relative

    def _edges_near(self, x_m: float, y_m: float) -> Floats:
        """Return the road edges that a ray from anywhere in the host's square can reach."""
        cell = (int(x_m // CELL_M), int(y_m // CELL_M))
        if cell not in self._cells:
            self._cells[cell] = self._edges[self._within_reach(complex(*cell) * CELL_M + (0.5 + 0.5j) * CELL_M)]
        return self._cells[cell]

    def _within_reach(self, middle: complex) -> NDArray[np.bool_]:
        from_middle = (self._edges[:, 0] - middle.real) + 1j * (self._edges[:, 1] - middle.imag)
        reach = self.max_range_m + CELL_M + 0.5 * self._edges[:, 4]
        return np.abs(from_middle) < reach


def _slab(origin: Floats, direction: Floats, size_m: Floats) -> tuple[Floats, Floats]:
    """Return how far along each ray it enters and leaves a slab of this size about 0; shape (n_boxes, n_rays)."""
    per_metre = 1.0 / (direction + PARALLEL)
    middle = -origin[:, None] * per_metre
    to_face = np.abs((0.5 * size_m)[:, None] * per_metre)
    return middle - to_face, middle + to_face
