import numpy as np
import pytest

from rail_sumo.highway.vehicle.hard_braking import hard_brakings

STEP_S = 0.1


def speeds(*phases, start=30.0):
    """Speeds of a drive of phases (m/s² of braking, seconds)."""
    steps = [np.full(round(seconds / STEP_S), braking * STEP_S) for braking, seconds in phases]
    return start - np.concatenate([[0.0], np.cumsum(np.concatenate(steps))])


@pytest.mark.parametrize(
    ("phases", "count"),
    [
        ([(0.0, 10.0)], 0),
        ([(3.5, 4.0)], 0),  # at the bound, not above it
        ([(3.6, 4.0)], 1),
        ([(8.0, 0.2), (0.0, 5.0)], 0),  # a jerk: 1.6 m/s in half a second are 3.2 m/s²
        ([(9.0, 0.2), (0.0, 5.0)], 1),  # 1.8 m/s are 3.6
        ([(5.0, 1.0), (0.0, 2.0), (5.0, 1.0)], 2),
        ([(5.0, 1.0), (1.0, 2.0), (5.0, 1.0)], 1),  # it eases, and is the same braking still
        ([(5.0, 1.0), (0.01, 60.0), (5.0, 1.0)], 2),  # coasting is no braking
        ([(5.0, 0.4)], 0),  # shorter than what is averaged
        ([(0.0, 0.1)], 0),
    ],
)
def test_brakings_above_three_and_a_half_for_half_a_second_count_once(phases, count):
    assert hard_brakings(speeds(*phases)) == count


def test_a_vehicle_seen_once_has_not_braked():
    assert hard_brakings([20.0]) == 0
    assert hard_brakings([]) == 0
