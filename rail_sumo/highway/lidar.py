"""A synthetic LIDAR: rays against oriented boxes. Pure geometry; knows nothing of SUMO."""

from dataclasses import dataclass

import numpy as np

from rail_sumo.records import Floats

PARALLEL = 1e-12
"""A ray closer to a box's side than this (as a direction cosine) counts as this, to keep the division finite."""


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


class Lidar:
    """`n_rays` evenly spaced rays; ray k points 2*pi*k/n_rays rad counter-clockwise from the host's heading.

    Args:
        n_rays: number of rays over the full circle.
        max_range_m: reported where nothing is hit.
        road_edges: line segments of shape (n, 4) that stand in the way like a guard rail; may be empty.

    Raises:
        ValueError: n_rays < 1 or max_range_m <= 0.

    Source: ray/slab intersection (Kay & Kajiya 1986), in each box's own frame.
    """

    def __init__(self, n_rays: int, max_range_m: float, road_edges: Floats | None = None) -> None:
        if n_rays < 1:
            raise ValueError(f"n_rays must be at least 1; got {n_rays}")
        if max_range_m <= 0:
            raise ValueError(f"max_range_m must be positive; got {max_range_m}")
        self.max_range_m = float(max_range_m)
        angles = 2 * np.pi * np.arange(n_rays) / n_rays
        self._rays = np.array([np.cos(angles), np.sin(angles)])
        self._edges = Boxes.of_segments(np.empty((0, 4)) if road_edges is None else road_edges)
        self._edge_cos, self._edge_sin = np.cos(self._edges.heading_rad), np.sin(self._edges.heading_rad)

    def scan(self, x_m: float, y_m: float, heading_rad: float, speed_mps: float, boxes: Boxes) -> tuple[Floats, Floats]:
        """Return what each ray from the host's centre hits first.

        Args:
            x_m, y_m, heading_rad, speed_mps: the host's centre, heading and speed.
            boxes: the other vehicles; may be empty. One that covers the host's centre reads 0 m.

        Returns:
            distance_m, shape (n_rays,): `max_range_m` where nothing is hit.
            relative_speed_mps, shape (n_rays,): obstacle minus host along the host's heading; 0.0 where nothing is hit.
        """
        edges = self._edges
        cos_host, sin_host = np.cos(heading_rad), np.sin(heading_rad)
        box_cos, box_sin = np.cos(boxes.heading_rad), np.sin(boxes.heading_rad)
        cos = np.concatenate((box_cos, self._edge_cos))
        sin = np.concatenate((box_sin, self._edge_sin))
        east = x_m - np.concatenate((boxes.x_m, edges.x_m))
        north = y_m - np.concatenate((boxes.y_m, edges.y_m))
        half = 0.5 * np.array(
            [np.concatenate((boxes.length_m, edges.length_m)), np.concatenate((boxes.width_m, edges.width_m))]
        )
        # The host and its rays in each box's frame: `origin` (2, n_boxes), `direction` (2, n_boxes, n_rays).
        origin = np.array([cos * east + sin * north, cos * north - sin * east])
        turn = np.array([cos * cos_host + sin * sin_host, cos * sin_host - sin * cos_host])
        rotation = np.array([[turn[0], -turn[1]], [turn[1], turn[0]]]).transpose(0, 2, 1)
        direction = rotation @ self._rays
        direction[np.abs(direction) < PARALLEL] = PARALLEL
        # Distance along the ray to the middle of each slab, and from there to its faces.
        middle = -origin[:, :, None] / direction
        reach = half[:, :, None] / np.abs(direction)
        enter = (middle - reach).max(axis=0)
        leave = (middle + reach).min(axis=0)
        enter[(enter > leave) | (leave < 0.0)] = self.max_range_m
        if not len(enter):
            return np.full(len(self._rays[0]), self.max_range_m), np.zeros(len(self._rays[0]))
        first = enter.argmin(axis=0)
        distance = enter.min(axis=0)
        np.clip(distance, 0.0, self.max_range_m, out=distance)
        along = np.concatenate((boxes.speed_mps, edges.speed_mps)) * turn[0]
        relative = np.where(distance < self.max_range_m, along[first] - speed_mps, 0.0)
        return distance, relative
