"""Those who stand across the host's path."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.vehicle import crossing


def driving(x, y, heading=math.pi / 2):
    """At 3 m/s: at 4.5 m/s² it stands 1 m on."""
    return (x, y, heading, 3.0, 5.0, 1.8)


STRAIGHT = ((2.0, 0.0), (12.0, 0.0), (102.0, 0.0))
"""The host heads east, its front at x = 2."""
WIDE_M = 2.0


def seen(others, way, turned):
    """The vehicles and the way from another place, in another direction."""
    turn = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    vehicles = np.array(others, dtype=np.float64).reshape(-1, 6).T
    vehicles[:2] = turn @ vehicles[:2] + [[30.0], [-70.0]]
    vehicles[2] += turned
    return vehicles, np.array(way) @ turn.T + np.array([30.0, -70.0])


def free_m(*others, way=STRAIGHT, turned=0.0, aside_m=0.0):
    vehicles, way = seen(others, way, turned)
    return crossing.free_m(vehicles, way, width_m=WIDE_M, aside_m=aside_m)


def aside_m(*others, way=STRAIGHT, turned=0.0, heading=0.0, now_m=0.0):
    vehicles, way = seen(others, way, turned)
    host = np.array([0.0, 0.0, heading + turned, 5.0, 4.0, WIDE_M])
    return crossing.aside_m(host, vehicles, way, lane_m=3.6, now_m=now_m)


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


BLOCKED = "more of it is in the way than there is room to pass"
TO_THE_LEFT = ((0.0, 0.0), (10.0, 0.0), (10.0, 20.0))


@pytest.mark.parametrize("turned", [0.0, 2.0])
@pytest.mark.parametrize(
    ("other", "free"),
    [
        (across(20.0, 0.0), math.inf),  # straight ahead, where the host does not come
        (across(10.0, 12.0, heading=0.0), 10.0 + 12.0 - 0.9),  # across the way behind the bend
        (across(10.0, 12.0), math.inf),  # the same way there
        (across(10.0, 12.0, heading=-math.pi / 2), 10.0 + 12.0 - 2.5),  # against it
    ],
)
def test_round_a_bend_whoever_is_on_the_way_counts_and_nobody_beyond_it(other, free, turned):
    assert free_m(other, way=TO_THE_LEFT, turned=turned) == pytest.approx(free)


@pytest.mark.parametrize("turned", [0.0, -2.2])
@pytest.mark.parametrize(
    ("others", "aside", "why"),
    [
        ([], 0.0, "nobody"),
        ([across(10.0, 3.43)], -0.5, "0.07 m in the way from the left, and 0.4 m beside it"),
        ([across(10.0, -3.43)], 0.5, "from the right"),
        ([across(10.0, 3.63)], -0.3, "0.13 m beside the way, which is too near"),
        ([across(10.0, 3.75)], 0.0, "far enough"),
        ([across(10.0, 2.93)], -0.8, "0.57 m in the way: just so much room is there"),
        ([across(10.0, 2.8)], 0.0, BLOCKED),
        ([across(10.0, 3.43), across(14.0, -3.43)], 0.0, BLOCKED),
        ([across(0.5, 3.43)], -0.5, "beside it, behind its front"),
        ([across(-4.0, 3.43)], 0.0, "behind it"),
    ],
)
def test_it_moves_aside_within_its_lane_for_those_who_stand_in_its_way(others, aside, why, turned):
    assert aside_m(*others, turned=turned) == pytest.approx(aside), why
    assert math.isinf(free_m(*others, turned=turned, aside_m=aside)) == (why != BLOCKED)


def test_it_moves_aside_in_time_for_who_is_about_to_stand_in_its_way_and_stays_so_beside_who_drives_on():
    assert aside_m(driving(10.0, 5.43, heading=-math.pi / 2)) == 0.0
    assert aside_m(driving(10.0, 4.43, heading=-math.pi / 2)) == -0.5  # by then at y = 3.43
    drives_away = driving(10.0, 3.43)  # its tail is in the way, and would not be by then
    assert aside_m(drives_away) == 0.0
    assert aside_m(drives_away, now_m=-0.3) == -0.3
    assert aside_m(across(40.0, 30.0), now_m=-0.3) == 0.0
    assert aside_m(across(10.0, 3.4), way=[(2.0, 0.0)], now_m=-0.3) == 0.0  # at its end


def test_it_stays_where_it_is_where_it_cannot_pass_and_moves_aside_in_no_turn():
    assert aside_m(across(10.0, 2.8), now_m=0.3) == 0.3
    slightly, sharply = ([(2.0, 0.0), (12.0, 0.0), (22.0, y)] for y in (4.0, 7.0))
    assert aside_m(across(10.0, 3.43), way=slightly) == -0.5
    assert aside_m(across(10.0, 3.43), way=sharply) == 0.0


def test_it_comes_down_to_the_speed_of_passing_by_the_braking_that_is_asked_for():
    assert crossing.passing_mps(0.0, 2.0) == crossing.passing_mps(-1.0, 2.0) == crossing.PASSING_MPS
    assert crossing.passing_mps(9.0, 2.0) == pytest.approx(10.0)  # 8² + 2 · 2 · 9 = 10²


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
