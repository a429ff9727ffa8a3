"""Which signals the host stops at, and how slow it is where others come first."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.vehicle.right_of_way import GiveWay, Signal

STOPPING_M = 60.0 * 60.0 / 12.96 / 18.0  # from 60 km/h at 9 m/s²: 15.4 m


def stops(signal, speed_kmh=60.0):
    return signal.stops(speed_kmh / 3.6, braking_mps2=9.0)


@pytest.mark.parametrize(
    ("state", "ahead_m", "left_s", "expected"),
    [
        ("G", 100.0, 1.0, False),
        ("g", 100.0, 1.0, False),
        ("O", 100.0, 1.0, False),
        ("s", 100.0, 1.0, False),
        ("r", 100.0, 1.0, True),
        ("r", 100.0, 60.0, True),
        ("u", 100.0, 60.0, True),
        ("y", 48.7, 3.0, False),  # 60 km/h is 50 m in 3 s, and to stop 2.5 m before the line takes 3.01 m/s²
        ("y", 48.9, 3.0, True),  # 2.99
        ("Y", 51.0, 3.0, True),
        ("Y", 90.0, 6.0, True),
        ("y", 40.0, 2.0, True),  # it would be too late
        ("r", STOPPING_M - 0.1, 60.0, False),
        ("r", STOPPING_M + 0.1, 60.0, True),
        ("y", STOPPING_M - 0.1, 0.1, False),
    ],
)
def test_the_host_stops_at_red_and_at_a_yellow_that_it_would_miss_or_stops_at_easily(state, ahead_m, left_s, expected):
    assert stops(Signal(ahead_m, state, left_s)) == expected


@given(st.sampled_from("ru"), st.floats(0.0, 500.0), st.floats(0.0, 25.0), st.floats(0.0, 25.0))
def test_whoever_stops_at_red_would_also_stop_from_a_lower_speed(state, ahead_m, one, other):
    signal = Signal(ahead_m, state, 60.0)
    assert signal.stops(min(one, other), braking_mps2=9.0) >= signal.stops(max(one, other), braking_mps2=9.0)


def test_who_gives_way_is_slow_enough_to_see_or_stops_where_somebody_comes():
    """At 2 m/s² it takes 4.2 m to stop from 4.10 m/s, and 100 m from 20 m/s."""
    assert GiveWay(150.0, is_open=True).sight(braking_mps2=2.0) == (145.5, pytest.approx(4.10, abs=0.01))
    assert GiveWay(150.0, is_open=True, sight_m=100.3).sight(braking_mps2=2.0) == pytest.approx((49.7, 20.0))
    assert GiveWay(150.0, is_open=True, sight_m=0.1).sight(braking_mps2=2.0) == pytest.approx((149.9, 0.0))
    assert GiveWay(100.0, is_open=False).stop == (99.7, 0.2)


@pytest.mark.parametrize(
    ("is_open", "ahead_m", "expected"),
    [(True, 100.0, False), (False, 100.0, True), (False, STOPPING_M + 0.1, True), (False, STOPPING_M - 0.1, False)],
)
def test_the_host_waits_for_others_while_it_can(is_open, ahead_m, expected):
    assert stops(GiveWay(ahead_m, is_open)) == expected


def test_the_host_stands_before_a_signals_line():
    assert Signal(100.0, "r", 60.0).stop == (97.5, 0.0)
