"""Whoever stands or drives across the host's path within a junction, and how fast the host may go on then.

SUMO keeps vehicles apart by right of way before they enter a junction. Inside, where one is stuck across the other's
path, it lets them touch.
"""

import math

import numpy as np

from rail_sumo.records import Floats

CROSSES_RAD = math.radians(30.0)
"""Whoever's heading differs by more than this from the host's drives across its path, or against it."""
CLEAR_M = 0.5
"""The room that is left to them."""
BRAKING_MPS2 = 4.5
"""How hard the host brakes for them as long as that is enough."""


def allowed_mps(free_m: float) -> float:
    """Return the speed from which the host stops in time before somebody so far ahead: v^2 = 2 b s."""
    return math.sqrt(2 * BRAKING_MPS2 * max(free_m - CLEAR_M, 0.0))


def free_m(boxes: Floats) -> float:
    """Return how far straight ahead of the host's front its path is free of those who cross it; inf if it is.

    Args:
        boxes: as in a `Scene`, shape (6, n): x, y, heading in rad, speed, length and width of the host's box, and then
            of the others'.
    """
    (x, y, heading), (length, width) = boxes[:3, 0], boxes[4:, 0]
    cosine, sine = math.cos(heading), math.sin(heading)
    free = math.inf
    for other_x, other_y, other_heading, _, other_length, other_width in boxes[:, 1:].T:
        turned = other_heading - heading
        if abs(math.remainder(turned, 2 * math.pi)) <= CROSSES_RAD:
            continue
        # In the host's frame, from the middle of its front: ahead, and to the left.
        ahead = (other_x - x) * cosine + (other_y - y) * sine - length / 2
        left = (other_y - y) * cosine - (other_x - x) * sine
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (other_length / 2, other_width / 2)
        turn = np.array([[math.cos(turned), math.sin(turned)], [-math.sin(turned), math.cos(turned)]])
        free = min(free, _nearest_in_strip(corners @ turn + (ahead, left), width / 2))
    return free


def _nearest_in_strip(corners: Floats, half_width: float) -> float:
    """Return how far ahead a polygon begins within a strip ahead, at least 0; inf if it does not reach into it."""
    reached = []
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if abs(y0) <= half_width:
            reached.append(x0)
        for border in (-half_width, half_width):
            if (y0 - border) * (y1 - border) < 0.0:
                reached.append(x0 + (x1 - x0) * (border - y0) / (y1 - y0))
    if not reached or max(reached) < 0.0:
        return math.inf
    return max(min(reached), 0.0)
