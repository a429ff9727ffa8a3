import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.vehicle.passing import AHEAD, ALONGSIDE, AWAY, BEHIND, PassCounter, sides_of
from rail_sumo.records import Scene

LENGTH_M = 5.0


def scene(heading_rad=0.0, lengths=None, **along_m):
    """Each vehicle so many metres ahead of the host along its heading, in the lane to its left."""
    ids = ["host", *along_m]
    along = np.array([0.0, *along_m.values()])
    left = np.where(np.arange(len(ids)) > 0, 3.2, 0.0)
    return Scene(
        time_s=0.0,
        ids=ids,
        boxes=np.array(
            (
                700.0 + along * math.cos(heading_rad) - left * math.sin(heading_rad),
                300.0 + along * math.sin(heading_rad) + left * math.cos(heading_rad),
                np.full(len(ids), heading_rad),
                np.full(len(ids), 20.0),
                np.array([(lengths or {}).get(name, LENGTH_M) for name in ids]),
                np.full(len(ids), 1.8),
            )
        ),
    )


def count(*scenes):
    """(overtakes, overtaken) over a sequence of looks."""
    counter = PassCounter()
    return tuple(np.sum([counter.update(look) for look in scenes], axis=0).tolist())


def passes(*along_m, **changes):
    return count(*(scene(car=metres, **changes) for metres in along_m))


def test_from_fully_ahead_to_fully_behind_is_one_overtake():
    assert passes(20.0, 10.0, 0.0, -10.0, -20.0) == (1, 0)


def test_from_fully_behind_to_fully_ahead_is_being_overtaken_once():
    assert passes(-20.0, -10.0, 0.0, 10.0, 20.0) == (0, 1)


def test_between_two_looks_a_whole_pass_counts():
    assert passes(8.0, -8.0) == (1, 0)
    assert passes(-8.0, 8.0) == (0, 1)


def test_the_faster_they_close_the_farther_it_must_look():
    looks = scene(car=70.0), scene(car=-2.0), scene(car=-70.0)
    near, far = PassCounter(), PassCounter(near_m=92.0)
    assert [near.update(look) for look in looks] == [(0, 0)] * 3
    assert [far.update(look) for look in looks] == [(0, 0), (0, 0), (1, 0)]


def test_who_does_not_count_is_neither_passed_nor_passes():
    counter = PassCounter()
    looks = [scene(car=12.0, other=15.0, late=-15.0), scene(car=-12.0, other=-15.0, late=15.0)]
    assert [counter.update(look, lambda name: name == "car") for look in looks] == [(0, 0), (1, 0)]
    assert counter.update(looks[0]) == (1, 2)  # and by then everybody does


@pytest.mark.parametrize("heading_rad", [0.7, math.pi / 2, -2.5])
def test_ahead_is_along_the_hosts_heading(heading_rad):
    assert passes(20.0, 0.0, -20.0, heading_rad=heading_rad) == (1, 0)


@pytest.mark.parametrize("turned_rad", [math.pi, math.pi / 2, -2.0])
def test_who_drives_another_way_is_neither_passed_nor_passes(turned_rad):
    def look(metres):
        seen = scene(car=metres)
        seen.heading_rad[1] += turned_rad
        return seen

    assert count(look(20.0), look(0.0), look(-20.0), look(0.0), look(20.0)) == (0, 0)


def test_who_stays_alongside_has_passed_nobody():
    # Fully behind begins where the bumpers part: half of both lengths, 5 m.
    assert passes(20.0, 0.0, -4.99) == (0, 0)
    assert passes(20.0, 0.0, -5.01) == (1, 0)


def test_fully_behind_depends_on_both_lengths():
    lorry = {"car": 15.0}
    assert passes(20.0, 0.0, -9.99, lengths=lorry) == (0, 0)
    assert passes(20.0, 0.0, -10.01, lengths=lorry) == (1, 0)


def test_jitter_alongside_does_not_count():
    assert passes(20.0, 4.0, -4.0, 4.0, -4.0, 20.0) == (0, 0)


def test_jitter_across_the_line_counts_one_way_once():
    assert passes(20.0, -5.1, -4.9, -5.1, -4.9, -5.1) == (1, 0)


def test_there_and_back_counts_once_each_way():
    assert passes(20.0, 0.0, -20.0, 0.0, 20.0) == (1, 1)


def test_two_pass_in_opposite_directions_at_once():
    looks = [scene(slow=10.0, fast=-10.0), scene(slow=0.0, fast=0.0), scene(slow=-10.0, fast=10.0)]
    assert count(*looks) == (1, 1)


def test_who_appears_behind_or_vanishes_ahead_has_passed_nobody():
    assert count(scene(gone=30.0), scene(new=-30.0), scene(), scene(newer=30.0)) == (0, 0)


def test_who_vanishes_and_comes_back_on_the_other_side_has_passed_nobody():
    assert count(scene(car=30.0), scene(), scene(car=-30.0)) == (0, 0)


def test_who_appears_alongside_has_been_on_neither_side():
    assert count(scene(), scene(car=0.0), scene(car=-20.0)) == (0, 0)
    assert count(scene(), scene(car=0.0), scene(car=20.0)) == (0, 0)


def test_far_away_nobody_is_sorted():
    # Rounding a bend, someone ahead on the road can lie behind the host's back.
    assert passes(70.0, -70.0, 70.0) == (0, 0)


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30))
def test_passes_alternate_so_overtakes_and_overtaken_differ_by_at_most_one(along_m):
    overtakes, overtaken = passes(*along_m)
    assert abs(overtakes - overtaken) <= 1


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30))
def test_seen_from_behind_every_overtake_is_being_overtaken(along_m):
    assert passes(*(-metres for metres in along_m)) == passes(*along_m)[::-1]


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30))
def test_vehicles_are_counted_one_by_one(along_m):
    alone = np.array(passes(*along_m))
    together = count(*(scene(one=metres, other=-metres) for metres in along_m))
    assert together == tuple((alone + alone[::-1]).tolist())


def slow_side(x_m, y_m, heading_rad, length_m, row, near_m):
    """On which side of the host a vehicle is: in the host's frame, by complex numbers."""
    place = (complex(x_m[row], y_m[row]) - complex(x_m[0], y_m[0])) * cmath.exp(-1j * heading_rad[0])
    heading = cmath.exp(1j * heading_rad[row]) * cmath.exp(-1j * heading_rad[0])
    if abs(place) >= near_m or heading.real <= math.cos(math.radians(60)):
        return AWAY
    rear_m, front_m = place.real - length_m[row] / 2, place.real + length_m[row] / 2
    return AHEAD if rear_m > length_m[0] / 2 else BEHIND if front_m < -length_m[0] / 2 else ALONGSIDE


@given(st.integers(0, 2**32 - 1))
def test_on_any_scene_the_machine_code_its_source_and_a_slow_computation_agree(seed):
    rng = np.random.default_rng(seed)
    number = rng.integers(1, 10)
    columns = (
        rng.uniform(-1000, 1000) + rng.uniform(-60, 60, number),
        rng.uniform(-1000, 1000) + rng.uniform(-20, 20, number),
        rng.uniform(-10, 10) + rng.uniform(-2, 2, number),
        rng.uniform(0, 20, number),
    )
    boxes = np.zeros((6, number))
    boxes[[0, 1, 2, 4]] = columns
    slow = [AWAY, *(slow_side(*columns, row, 50.0) for row in range(1, number))]
    assert sides_of(boxes, 50.0).tolist() == sides_of.py_func(boxes, 50.0).tolist() == slow
