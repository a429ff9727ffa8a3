"""What `rail_sumo.highway.vehicle.lidar` computes, once more: side by side of every box, in plain Python floats.

Slow, written for reading, and written otherwise than the kernel: it neither turns anything into a box's frame nor
knows of slabs. A box is four corners, a ray ends where it crosses the line between two of them.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from rail_sumo.records import Scene

Point = tuple[float, float]


def scan(scene: Scene, rails: Sequence[Sequence[float]], *, n_rays: int, max_range_m: float) -> list[list[Point]]:
    """Return for each ray what it meets within the range: the distance and the relative speed of each.

    Args:
        scene: the host and the vehicles around it.
        rails: line segments that stand in the way: x1, y1, x2, y2.
        n_rays: rays over the full circle.
        max_range_m: how far they reach.
    """
    host, heading, speed = (scene.x_m[0], scene.y_m[0]), scene.heading_rad[0], scene.speed_mps[0]
    obstacles = list(outlines(scene))
    obstacles += [([(x1, y1), (x2, y2)], 0.0) for x1, y1, x2, y2 in rails]
    rays: list[list[Point]] = []
    for ray in range(n_rays):
        angle = heading + 2 * math.pi * ray / n_rays
        met = ((distance(host, angle, corners), along - speed) for corners, along in obstacles)
        rays.append([(metres, relative) for metres, relative in met if metres < max_range_m])
    return rays


def outlines(scene: Scene) -> Iterator[tuple[list[Point], float]]:
    """Yield the corners of each vehicle but the host, and its speed along the host's heading."""
    for index in range(1, len(scene.ids)):
        heading = scene.heading_rad[index]
        ahead, left = 0.5 * scene.length_m[index], 0.5 * scene.width_m[index]
        corners = [
            (
                scene.x_m[index] + to_front * ahead * math.cos(heading) - to_left * left * math.sin(heading),
                scene.y_m[index] + to_front * ahead * math.sin(heading) + to_left * left * math.cos(heading),
            )
            for to_front, to_left in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        yield corners, scene.speed_mps[index] * math.cos(heading - scene.heading_rad[0])


def distance(origin: Point, angle: float, corners: Sequence[Point]) -> float:
    """Return how far a ray runs to a polygon, or to the line between two points: 0 from inside, inf if it misses."""
    sides = list(pairwise([*corners, corners[0]]))
    if len(corners) > 2 and all(cross(origin, start, end) > 0 for start, end in sides):  # left of every side: inside
        return 0.0
    return min(side_distance(origin, angle, start, end) for start, end in sides)


def side_distance(origin: Point, angle: float, start: Point, end: Point) -> float:
    """Return how far a ray runs to a line segment; inf if it misses, or runs parallel to it.

    origin + t * direction = start + u * (end - start), solved by Cramer's rule.
    """
    to_x, to_y = math.cos(angle), math.sin(angle)
    side_x, side_y = end[0] - start[0], end[1] - start[1]
    x, y = start[0] - origin[0], start[1] - origin[1]
    determinant = to_x * side_y - to_y * side_x
    if determinant == 0.0:
        return math.inf
    t, u = (x * side_y - y * side_x) / determinant, (x * to_y - y * to_x) / determinant
    return t if t >= 0.0 and 0.0 <= u <= 1.0 else math.inf


def cross(point: Point, start: Point, end: Point) -> float:
    """Return a number that is positive where the point lies to the left of the way from start to end."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])
