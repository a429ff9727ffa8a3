import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.sumo import placing


@pytest.mark.parametrize(
    ("angle_deg", "x_m", "y_m", "heading_rad"),
    [
        (0.0, 100.0, 198.0, math.pi / 2),  # northwards: the centre lies half a length to the south of the bumper
        (90.0, 98.0, 200.0, 0.0),
        (180.0, 100.0, 202.0, -math.pi / 2),
        (270.0, 102.0, 200.0, -math.pi),
        (45.0, 100.0 - math.sqrt(2), 200.0 - math.sqrt(2), math.pi / 4),
    ],
)
def test_the_centre_lies_half_a_length_behind_the_bumper(angle_deg, x_m, y_m, heading_rad):
    box = placing.boxes(np.array([[100.0, 200.0, angle_deg, 20.0, 4.0, 1.8]]))
    assert box[:, 0] == pytest.approx([x_m, y_m, heading_rad, 20.0, 4.0, 1.8])


@given(st.integers(0, 2**32 - 1))
def test_on_any_road_the_machine_code_its_source_and_the_way_back_agree(seed):
    rng = np.random.default_rng(seed)
    low, high = [-1e4, -1e4, 0, 0, 0, 0], [1e4, 1e4, 360, 40, 20, 3]
    vehicles = rng.uniform(low, high, (rng.integers(1, 9), 6))
    boxes = placing.boxes(vehicles)
    assert boxes.tolist() == placing.boxes.py_func(vehicles).tolist()
    for (front_x, front_y, angle, *others), (x, y, heading, speed, length, width) in zip(
        vehicles, boxes.T, strict=True
    ):
        assert complex(x, y) + cmath.rect(length / 2, heading) == pytest.approx(complex(front_x, front_y))
        assert cmath.rect(1.0, heading) == pytest.approx(1j * cmath.rect(1.0, -math.radians(angle)))  # from north
        assert (speed, length, width) == tuple(others)
