"""Adaptive cruise control beside closed forms: braking, following, swinging; without SUMO."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.config import Adas
from rail_sumo.highway.vehicle import acc
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.records import KMH

STEP_S = 0.1
LOOKBACK = 5
"""Steps over which a leader's acceleration is averaged."""
DEFAULT = Adas()


def drive(leader_mps, *, gap_m, speed_mps, set_mps=math.inf, seconds=60.0, adas=DEFAULT):
    """Follow a leader whose speed is a function of time; returns the host's speeds and the gaps, step by step."""
    speeds, gaps = [speed_mps], [gap_m]
    led = [leader_mps(0.0)]
    for step in range(round(seconds / STEP_S)):
        then = led[max(0, len(led) - 1 - LOOKBACK)]
        since_s = max(1, min(LOOKBACK, len(led) - 1)) * STEP_S
        leader = Leader(gaps[-1], led[-1], (led[-1] - then) / since_s)
        follows = acc.following_mps(speeds[-1], leader, adas)
        speeds.append(min(follows, set_mps, speeds[-1] + adas.acceleration_mps2 * STEP_S))
        led.append(leader_mps((step + 1) * STEP_S))
        gaps.append(gaps[-1] + (led[-1] - speeds[-1]) * STEP_S)
    return np.array(speeds), np.array(gaps)


def braking(speeds):
    return -np.diff(speeds) / STEP_S


def standing(time_s):
    return 0.0


@pytest.mark.parametrize("kmh", [50, 80, 100, 130])
def test_a_standing_queue_seen_in_time_is_braked_for_evenly_and_comfortably(kmh):
    speeds, gaps = drive(standing, gap_m=acc.sight_m(kmh / KMH, DEFAULT), speed_mps=kmh / KMH, set_mps=kmh / KMH)
    assert braking(speeds).max() <= 2.0 + 1e-9
    assert gaps[-1] == pytest.approx(2.0, abs=0.1)
    assert speeds[-1] == pytest.approx(0.0, abs=1e-3)
    # 2 m/s² all the way but for a softened beginning and end: the stop takes v / b and little more.
    assert (braking(speeds) > 1.9).sum() * STEP_S > kmh / KMH / 2.0 - 3.0
    assert (braking(speeds) > 0.1).sum() * STEP_S < kmh / KMH / 2.0 + 5.0


def test_a_queue_too_near_for_comfort_is_braked_for_evenly_as_hard_as_it_takes():
    speeds, gaps = drive(standing, gap_m=122.0, speed_mps=100 / KMH)
    needed = (100 / KMH) ** 2 / (2 * 120.0)  # 3.2 m/s²
    assert needed <= braking(speeds).max() < needed + 0.1
    assert gaps.min() > 1.5


@pytest.mark.parametrize(
    ("speed_mps", "hardest_mps2"), [(3.0, 5.0), (5.0, 5.0), (12.5, 4.25), (20.0, 3.5), (35.0, 3.5)]
)
def test_it_never_brakes_harder_than_iso_15622_allows(speed_mps, hardest_mps2):
    too_near = Leader(gap_m=2.5, speed_mps=0.0)
    slower_mps = acc.following_mps(speed_mps, too_near, DEFAULT)
    assert (speed_mps - slower_mps) / STEP_S == pytest.approx(hardest_mps2)


speeds_mps = st.floats(0.0, 40.0)
time_gaps_s = st.floats(1.0, 5.0)


@given(speeds_mps, speeds_mps, st.floats(-5.0, 400.0), st.floats(-9.0, 3.0), time_gaps_s, st.floats(2.0, 9.0))
def test_whatever_is_ahead_it_stays_within_its_limits(speed, leader, gap_m, acceleration, time_gap_s, emergency):
    adas = Adas(time_gap_s=time_gap_s, emergency_braking_mps2=emergency)
    after = acc.following_mps(speed, Leader(gap_m, leader, acceleration), adas)
    assert after >= 0.0
    assert (speed - after) / STEP_S <= min(acc.hardest_braking_mps2(speed), emergency) + 1e-6


@given(speeds_mps, st.floats(0.0, 390.0), st.floats(0.01, 5.0), time_gaps_s, st.floats(1.0, 5.0))
def test_a_faster_leader_never_allows_less(leader, gap_m, faster, time_gap_s, braking):
    adas = Adas(time_gap_s=time_gap_s, comfort_braking_mps2=braking)
    behind_slow, behind_fast = (acc.allowed_mps(Leader(gap_m, mps), adas) for mps in (leader, leader + faster))
    assert behind_slow <= behind_fast + 1e-9


@given(speeds_mps, st.floats(-5.0, 400.0), speeds_mps, st.floats(-9.0, 3.0), time_gaps_s, st.floats(1.0, 5.0))
def test_compiled_it_is_the_python_function_to_the_bit(speed, gap_m, leader, acceleration, time_gap_s, comfort):
    situation = (speed, gap_m, leader, acceleration, 2.0, time_gap_s, comfort, 9.0, STEP_S)
    assert acc._following_mps(*situation) == acc._following_mps.py_func(*situation)


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0), st.floats(0.0, 390.0), st.floats(0.1, 10.0))
def test_a_farther_leader_never_allows_less(speed_mps, leader_mps, gap_m, farther_m):
    near, far = (acc.allowed_mps(Leader(gap, leader_mps), DEFAULT) for gap in (gap_m, gap_m + farther_m))
    assert near <= far + 1e-9


@pytest.mark.parametrize("time_gap_s", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("leader_mps", [0.5, 5.0, 15.0, 30.0])
def test_it_settles_at_its_time_gap(leader_mps, time_gap_s):
    adas = Adas(time_gap_s=time_gap_s)
    speeds, gaps = drive(lambda time_s: leader_mps, gap_m=250.0, speed_mps=33.0, seconds=300.0, adas=adas)
    assert speeds[-1] == pytest.approx(leader_mps, abs=0.01)
    assert gaps[-1] == pytest.approx(2.0 + time_gap_s * leader_mps, abs=0.1)
    assert gaps.min() > 2.0


@pytest.mark.parametrize("time_gap_s", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("mean_kmh", [25, 60, 110])
@pytest.mark.parametrize("period_s", [10, 20, 30, 60])
def test_behind_a_leader_that_swings_the_host_swings_no_more(period_s, mean_kmh, time_gap_s):
    mean_mps, swing_mps = mean_kmh / KMH, 10 / KMH
    adas = Adas(time_gap_s=time_gap_s)
    speeds, _ = drive(
        lambda time_s: mean_mps + swing_mps * math.sin(2 * math.pi * time_s / period_s),
        gap_m=2.0 + time_gap_s * mean_mps,
        speed_mps=mean_mps,
        seconds=400.0,
        adas=adas,
    )
    settled = speeds[-round(2 * period_s / STEP_S) :]
    assert 0.3 * swing_mps < (settled.max() - settled.min()) / 2 <= swing_mps


def test_a_platoon_calms_a_leaders_swing_down():
    swing = lambda time_s: 20.0 + 10 / KMH * math.sin(2 * math.pi * time_s / 20.0)  # noqa: E731
    amplitudes = []
    for _ in range(4):
        speeds, _ = drive(swing, gap_m=22.0, speed_mps=20.0, seconds=300.0)
        settled = speeds[-400:]
        amplitudes.append(settled.max() - settled.min())
        swing = lambda time_s, speeds=speeds: float(speeds[round(time_s / STEP_S)])  # noqa: E731
    assert amplitudes == sorted(amplitudes, reverse=True)


@pytest.mark.parametrize(("braking_mps2", "hardest_mps2"), [(2.0, 2.1), (3.0, 3.1), (3.5, 3.6)])
def test_behind_a_leader_that_brakes_it_brakes_hardly_harder(braking_mps2, hardest_mps2):
    speeds, gaps = drive(
        lambda time_s: max(0.0, 25.0 - braking_mps2 * max(0.0, time_s - 1.0)), gap_m=27.0, speed_mps=25
    )
    assert braking(speeds).max() <= hardest_mps2
    assert gaps[-1] == pytest.approx(2.0, abs=0.5)


def test_for_a_vehicle_that_cuts_in_without_danger_it_brakes_comfortably():
    # 27 m ahead and 6 m/s slower: braking at 2 m/s² is enough.
    speeds, gaps = drive(lambda time_s: 16.0, gap_m=27.0, speed_mps=22.0)
    assert braking(speeds).max() <= 2.0 + 1e-9
    assert gaps.min() > 10.0


def test_for_one_that_cuts_in_near_but_faster_it_does_not_brake():
    speeds, _ = drive(lambda time_s: 25.4, gap_m=13.0, speed_mps=22.2, set_mps=22.2)
    assert speeds.min() == 22.2


def test_it_starts_off_smoothly_behind_a_queue_that_moves_on():
    speeds, gaps = drive(lambda time_s: min(15.0, 2.0 * max(0.0, time_s - 1.0)), gap_m=2.0, speed_mps=0.0, set_mps=16.0)
    acceleration = np.diff(speeds) / STEP_S
    assert acceleration.min() > -1e-9
    assert acceleration.max() <= 2.0 + 1e-9
    assert np.abs(np.diff(acceleration)).max() / STEP_S < 4.0  # no jerk
    assert gaps.min() > 1.9


def test_it_sees_250_m_ahead_and_farther_where_comfortable_braking_needs_more():
    assert acc.sight_m(80 / KMH, DEFAULT) == 250.0
    assert acc.sight_m(40.0, DEFAULT) == pytest.approx(40**2 / 4 + 2 + 40)


@given(
    st.floats(0.0, 40.0), st.floats(-10.0, 100.0), st.floats(0.0, 40.0), st.floats(0.0, 300.0), st.floats(0.0, 300.0)
)
def test_who_falls_in_or_lets_in_brakes_comfortably_at_most(speed, gap_m, other, stands_in_m, farther_m):
    comfortably = speed - DEFAULT.comfort_braking_mps2 * acc.SECONDS_PER_STEP - 1e-9
    ahead = Leader(gap_m, other)
    assert acc.falling_in_mps(speed, ahead, DEFAULT) >= comfortably
    letting_in = acc.letting_in_mps(speed, ahead, stands_in_m, DEFAULT)
    assert letting_in >= comfortably
    assert acc.letting_in_mps(speed, ahead, stands_in_m + farther_m, DEFAULT) <= letting_in  # room enough stays so


def test_nobody_is_let_in_for_whom_there_would_be_no_room():
    """At 14 m/s it takes 49 m to stop comfortably. One that stands 51.4 m ahead, at its lane's end, is passed."""
    assert acc.letting_in_mps(14.0, Leader(51.4, 0.0), 0.0, DEFAULT) == math.inf
    assert acc.letting_in_mps(14.0, Leader(51.6, 0.0), 0.0, DEFAULT) < 14.0
    assert acc.letting_in_mps(14.0, Leader(21.6, 10.0), 30.0, DEFAULT) < 14.0
    assert acc.letting_in_mps(14.0, Leader(6.4, 10.0), 30.0, DEFAULT) == math.inf  # it slows down by 4 m/s within 4 m
    assert acc.letting_in_mps(14.0, Leader(6.6, 10.0), 30.0, DEFAULT) < 14.0
    assert acc.letting_in_mps(0.0, Leader(1.8, 0.0), 0.0, DEFAULT) == math.inf  # or both would stand for ever


def test_who_falls_in_comes_to_a_gap_that_is_long_enough():
    speed, gap_m = 20.0, -4.0
    for _ in range(300):
        slower = acc.falling_in_mps(speed, Leader(gap_m, 20.0), DEFAULT)
        speed = min(slower, speed + DEFAULT.acceleration_mps2 * acc.SECONDS_PER_STEP)
        gap_m += (20.0 - speed) * acc.SECONDS_PER_STEP
    assert gap_m > DEFAULT.standstill_gap_m + DEFAULT.time_gap_s * 20.0
    assert speed == pytest.approx(20.0, abs=0.2)
