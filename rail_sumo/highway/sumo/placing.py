"""From where SUMO places vehicles to the boxes that they fill."""

import math

import numpy as np

from rail_sumo.highway.compiled import compiled
from rail_sumo.records import Floats

VEHICLE_M = 20.0
"""No vehicle reaches farther than this from its front bumper, by which SUMO places it."""


@compiled("float64[:, ::1](float64[:, ::1])")
def boxes(vehicles: Floats) -> Floats:
    """Return x, y, heading, speed, length and width of the vehicles' boxes as a `Scene` has them, shape (6, n).

    Args:
        vehicles: as SUMO has them, shape (n, 6): x and y of the front bumper's middle, the angle in degrees clockwise
            from north, speed, length and width.
    """
    columns = np.empty((6, len(vehicles)))
    for row in range(len(vehicles)):
        heading_rad, length_m = math.radians(90.0 - vehicles[row, 2]), vehicles[row, 4]
        columns[0, row] = vehicles[row, 0] - 0.5 * length_m * math.cos(heading_rad)
        columns[1, row] = vehicles[row, 1] - 0.5 * length_m * math.sin(heading_rad)
        columns[2, row] = heading_rad
        columns[3, row] = vehicles[row, 3]
        columns[4, row] = length_m
        columns[5, row] = vehicles[row, 5]
    return columns
