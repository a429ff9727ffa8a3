import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.tables.warm_up import BATCH_S, found_s


def filling(level, seconds, *, over_s, swing=0.0):
    """Vehicles on a road that fills evenly, and then swings about what it comes to, once in 90 s."""
    at = np.arange(seconds)
    return np.minimum(at / over_s, 1.0) * level + swing * np.sin(2 * np.pi * at / 90)


@pytest.mark.parametrize("swing", [0.0, 5.0])
@pytest.mark.parametrize("over_s", [90, 200, 500])
def test_a_road_that_fills_and_stays_full_counts_from_then_on(over_s, swing):
    seconds, settles = found_s(filling(100, 1200, over_s=over_s, swing=swing))
    assert settles
    assert over_s * 0.95 <= seconds + BATCH_S
    assert seconds <= over_s + 2 * BATCH_S


def test_where_more_come_than_leave_nothing_settles_and_half_is_left_out():
    assert found_s(filling(100, 1200, over_s=1200)) == (600, False)


def test_few_vehicles_that_come_and_go_by_chance_are_no_growth():
    """Eight on the road on average: in the last quarter ten, in that before eight."""
    counts = [8] * 900 + [10] * 300
    assert found_s(counts)[1]
    assert not found_s([10 * count for count in counts])[1]


@given(st.lists(st.integers(0, 50), max_size=400))
def test_no_more_than_half_is_ever_left_out(counts):
    seconds, _ = found_s(counts)
    assert 0 <= seconds <= max(len(counts) / 2, BATCH_S)


def test_an_empty_road_is_as_it_stays():
    assert found_s([0] * 600) == (BATCH_S, True)
