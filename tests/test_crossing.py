"""Those who stand across the host's path."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.vehicle import crossing

HOST = (0.0, 0.0, 0.0, 5.0, 4.0, 2.0)
"""Heads east, its front at x = 2."""


def free_m(*others, turned=0.0):
    vehicles = np.array([HOST, *others])
    x, y = vehicles[:, 0].copy(), vehicles[:, 1].copy()
    vehicles[:, 0] = x * math.cos(turned) - y * math.sin(turned) + 30.0
    vehicles[:, 1] = x * math.sin(turned) + y * math.cos(turned) - 70.0
    vehicles[:, 2] += turned
    return crossing.free_m(vehicles.T)


def across(x, y, heading=math.pi / 2, length=5.0, width=1.8):
    return (x, y, heading, 0.0, length, width)


@pytest.mark.parametrize("turned", [0.0, 1.0, 2.5, -3.0])
@pytest.mark.parametrize(
    ("other", "free"),
    [
        (across(10.0, 0.0), 10.0 - 0.9 - 2.0),  # its near side is 7.1 m ahead of the front
        (across(10.0, 3.4), 7.1),  # its tail reaches 0.1 m into the path
        (across(10.0, 3.6), math.inf),  # it ends 0.1 m beside it
        (across(10.0, -3.4), 7.1),
        (across(-10.0, 0.0), math.inf),  # behind
        (across(2.5, 0.0), 0.0),  # touching
        (across(10.0, 0.0, heading=0.3), math.inf),  # the same way: that is car-following
        (across(10.0, 0.0, heading=math.pi), 10.0 - 2.5 - 2.0),  # head on
        (across(10.0, 0.0, heading=math.pi / 2 + 2 * math.pi), 7.1),
    ],
)
def test_how_far_the_path_is_free_by_hand(other, free, turned):
    assert free_m(other, turned=turned) == pytest.approx(free)


def test_the_nearest_of_several_counts_and_nobody_is_in_nobodys_way():
    assert free_m(across(20.0, 0.0), across(10.0, 0.0), across(15.0, 0.0)) == pytest.approx(7.1)
    assert free_m() == math.inf


@given(
    st.floats(-20.0, 30.0),
    st.floats(-8.0, 8.0),
    st.floats(-math.pi, math.pi),
    st.floats(1.0, 18.0),
    st.floats(0.5, 2.6),
)
def test_mirrored_the_path_is_as_free_and_a_longer_vehicle_never_frees_it(x, y, heading, length, width):
    free = free_m(across(x, y, heading, length, width))
    assert free_m(across(x, -y, -heading, length, width)) == pytest.approx(free, abs=1e-6)
    assert free_m(across(x, y, heading, length + 1.0, width)) <= free + 1e-6


@given(st.floats(0.0, 40.0))
def test_it_stops_with_room_to_spare_before_who_is_seen_within_reach(speed_mps):
    free = crossing.CLEAR_M + speed_mps**2 / (2 * crossing.BRAKING_MPS2) + speed_mps
    speed = speed_mps
    while speed > 0.0 and free > 0.0:
        speed = max(min(speed, crossing.allowed_mps(free - speed * 0.1)), speed - 9.0 * 0.1)
        free -= speed * 0.1
        if speed < 1e-3:
            break
    assert free > 0.0
