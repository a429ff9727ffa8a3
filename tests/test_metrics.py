import dataclasses
import math

import numpy as np
import pytest

from rail_sumo.config import Adas
from rail_sumo.highway import metrics
from rail_sumo.highway.reward import reward
from rail_sumo.records import EPISODE_COLUMNS, Trajectory


def trajectory(speed_mps, **changes):
    """An uneventful drive; every field can be changed."""
    speed_mps = np.asarray(speed_mps, dtype=np.float64)
    fields = dict.fromkeys(
        (
            "overtakes",
            "overtaken",
            "lane_changes",
            "aborted_lane_changes",
            "refused_decisions",
            "collisions",
            "struck",
            "hard_brakings_behind",
        ),
        0,
    )
    uneventful = Trajectory(
        observations=np.empty((0, 48)),
        decisions=np.empty(0, dtype=np.int64),
        carried_out=np.empty(0, dtype=np.int64),
        allowed=np.empty((0, 5), dtype=np.bool_),
        decision_step=np.empty(0, dtype=np.int64),
        decision_place=np.empty((0, 3)),
        speed_mps=speed_mps,
        distance_m=float(speed_mps[1:].sum()) / 10,
        limit_mps=np.full(len(speed_mps) - 1, 80 / 3.6),
        lane_changing=np.zeros(len(speed_mps) - 1, dtype=np.bool_),
        min_ttc_s=math.inf,
        end_reason="duration",
        seed=7,
        network="highway5",
        host="host",
        depart_s=0.0,
        **fields,
    )
    return dataclasses.replace(uneventful, **changes)


def row(*arguments, **changes):
    return metrics.row(trajectory(*arguments, **changes), Adas())


def test_two_seconds_at_20_mps_are_40_metres():
    driven = row(np.full(21, 20.0))
    assert driven["duration_s"] == pytest.approx(2.0)
    assert driven["distance_m"] == pytest.approx(40.0)
    assert driven["speed_kmh"] == pytest.approx(72.0)
    # (72 - 40) / (80 - 40) = 0.8 in each of 20 steps.
    assert driven["longitudinal_reward"] == pytest.approx(16.0)
    assert driven["hardest_braking_mps2"] == 0.0


def test_speed_is_the_odometers_distance_over_the_duration():
    driven = row([10.0, 11.0, 13.0, 12.0], distance_m=3.5)  # the mean speeds of the three steps, for 0.1 s each
    assert driven["distance_m"] == 3.5
    assert driven["speed_kmh"] == pytest.approx(3.5 / 0.3 * 3.6)


def test_below_40_kmh_a_step_earns_nothing():
    assert row([0.0, 5.0, 40 / 3.6, 60 / 3.6])["longitudinal_reward"] == pytest.approx(0.5)


def test_a_step_is_worth_its_place_between_half_the_limit_and_the_limit_there():
    # 75 km/h are half way up at a limit of 100, the top at 75, and beyond it at 50.
    limits_mps = np.array([100, 75, 50]) / 3.6
    assert row(np.full(4, 75 / 3.6), limit_mps=limits_mps)["longitudinal_reward"] == pytest.approx(0.5 + 1.0 + 2.0)


def test_where_the_set_speed_has_no_range_a_step_earns_nothing():
    slow = Adas(min_speed_kmh=40.0)
    driven = trajectory(np.full(3, 30 / 3.6), limit_mps=np.full(2, 30 / 3.6))
    assert metrics.row(driven, slow)["longitudinal_reward"] == 0.0


def test_a_full_course_at_70_kmh_earns_what_the_paper_accounts():
    # 7,222 m at 70 km/h are about 3,714 steps of 0.1 s, each worth (70 - 40) / 40 = 0.75.
    steps = round(7222 / (70 / 3.6) / 0.1)
    driven = row(np.full(steps + 1, 70 / 3.6))
    assert driven["longitudinal_reward"] == pytest.approx(3714 * 0.75)
    assert driven["distance_m"] == pytest.approx(7222, abs=2.0)


def test_a_lane_change_of_19_steps_costs_half_a_point_each():
    lane_changing = np.arange(40) < 19
    assert row(np.full(41, 20.0), lane_changing=lane_changing)["lateral_reward"] == -9.5


def test_hardest_braking_is_the_steepest_single_step():
    # 20 -> 19.6 is 4 m/s², 19.6 -> 18.7 is 9, then it speeds up.
    driven = row([20.0, 19.6, 18.7, 19.5])
    assert driven["hardest_braking_mps2"] == pytest.approx(9.0)


def test_hard_brakings_are_those_of_half_a_second():
    # 4 m/s² for a second.
    driven = row([*np.full(10, 20.0), *np.linspace(19.6, 16.0, 10), *np.full(10, 16.0)], hard_brakings_behind=2)
    assert (driven["hard_brakings"], driven["hard_brakings_behind"]) == (1, 2)


def test_counts_are_carried_over_and_the_row_fills_every_column():
    driven = row(np.full(2, 20.0), overtakes=3, overtaken=1, struck=1, min_ttc_s=2.5, end_reason="collision")
    assert {"policy": "rule", "episode": 0, **driven}.keys() == EPISODE_COLUMNS.keys()
    assert (driven["overtakes"], driven["overtaken"], driven["struck"], driven["collisions"]) == (3, 1, 1, 0)
    assert (driven["min_ttc_s"], driven["end_reason"], driven["seed"]) == (2.5, "collision", 7)


@pytest.mark.parametrize(
    ("closing_mps", "told_s"), [(5.0, 100.0), (0.2, 2500.0), (500 / 3600, 3600.0), (0.138, math.inf), (2e-8, math.inf)]
)
def test_who_would_take_more_than_an_hour_to_close_a_gap_of_500_m_never_closes_in(closing_mps, told_s):
    assert row(np.full(2, 20.0), min_ttc_s=500 / closing_mps)["min_ttc_s"] == pytest.approx(told_s)


def test_reward_adds_its_parts_up():
    # Two steps at 60 km/h, 0.5 each; one of them changing lanes; two overtakes more than overtaken; refusals; a crash.
    total = reward(
        np.full(2, 60 / 3.6),
        np.full(2, 80 / 3.6),
        np.array([True, False]),
        Adas(),
        overtakes=3,
        overtaken=1,
        refused_decisions=2,
        collisions=1,
    )
    assert total == pytest.approx(1.0 - 0.5 + 1.0 - 0.2 - 10.0)
