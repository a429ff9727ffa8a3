import math

import numpy as np
import pytest
import slow_lidar
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo.highway.vehicle.lidar import Lidar, first_hits
from rail_sumo.records import Scene

RANGE_M = 100.0
CAR_M, CAR_WIDTH_M = 5.0, 1.8

# Drawn by numpy from hypothesis' seed: a corner is hit exactly with probability 0, and there a rounding error decides.
seeds = st.integers(0, 2**32 - 1)


def scene(host, *rows):
    """The host's x, y, heading and speed, and the same of others with, unless they are cars, length and width."""
    full = [row if len(row) == 6 else (*row, CAR_M, CAR_WIDTH_M) for row in (host, *rows)]
    return Scene(0.0, [str(index) for index in range(len(full))], np.array(full, dtype=np.float64).T.copy())


def some_boxes(rng, number):
    return np.column_stack(
        [
            rng.uniform(-120, 120, number),
            rng.uniform(-40, 40, number),
            rng.uniform(-math.pi, math.pi, number),
            rng.uniform(0, 30, number),
            rng.uniform(1, 15, number),
            rng.uniform(0.5, 3, number),
        ]
    )


def any_scene(rng):
    """Anybody around a host anywhere: nobody, some over the host, some along its rays, some without width."""
    rows = some_boxes(rng, rng.integers(9))
    heading = rng.uniform(-math.pi, math.pi)
    over, along, thin = rng.random((3, len(rows))) < 0.3
    rows[over, :2] *= 0.05
    rows[along, 2] = heading + rng.integers(24, size=along.sum()) * math.pi / 12
    rows[thin, 5] = 0.0
    x_m, y_m = rng.uniform(-1000, 1000, 2) if rng.random() < 0.5 else (0.0, 0.0)
    rows[:, :2] += x_m, y_m
    return scene((x_m, y_m, heading, rng.uniform(0, 30)), *rows)


def test_a_car_ahead_is_seen_at_its_bumper():
    distance, relative = Lidar(4, RANGE_M).scan(scene((10.0, 0.0, 0.0, 20.0), (40.0, 0.0, 0.0, 15.0)))
    # From the host's centre at 10 m to the other's rear at 40 - 2.5 m.
    assert distance == pytest.approx([27.5, RANGE_M, RANGE_M, RANGE_M])
    assert relative == pytest.approx([-5.0, 0.0, 0.0, 0.0])


def test_cars_alongside_and_behind_by_hand():
    around = scene((0.0, 0.0, 0.0, 20.0), (0.0, 3.2, 0.0, 25.0), (-20.0, 0.0, 0.0, 22.0), (1.0, -6.4, 0.0, 18.0))
    distance, relative = Lidar(4, RANGE_M).scan(around)
    # Rays: ahead, left, behind, right. Sides are half a width nearer, the front behind half a length.
    assert distance == pytest.approx([RANGE_M, 3.2 - 0.9, 20.0 - 2.5, 6.4 - 0.9])
    assert relative == pytest.approx([0.0, 5.0, 2.0, -2.0])


def test_the_first_ray_off_the_axis_crosses_into_the_next_lane_where_geometry_says():
    lidar = Lidar(24, RANGE_M)
    # 15 degrees reach the near side of the next lane's cars, 3.2 - 0.9 m to the left, after 2.3 / sin(15°) m, 8.58 m
    # ahead: a car whose rear is farther ahead is hit at its rear, if the ray is still within its width, else missed.
    rear_m = 10.0
    distance, _ = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), (rear_m + 2.5, 3.2, 0.0, 20.0)))
    assert distance[1] == pytest.approx(rear_m / math.cos(math.radians(15)))
    far_side_m = (3.2 + 0.9) / math.tan(math.radians(15))
    distance, _ = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), (far_side_m + 0.01 + 2.5, 3.2, 0.0, 20.0)))
    assert (distance == RANGE_M).all()
    distance, _ = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), (8.0, 3.2, 0.0, 20.0)))
    assert distance[1] == pytest.approx(2.3 / math.sin(math.radians(15)))


def test_rays_turn_with_the_host():
    # The host looks north: what lies west of it is on its left.
    distance, relative = Lidar(4, RANGE_M).scan(scene((0.0, 0.0, math.pi / 2, 10.0), (-30.0, 0.0, math.pi / 2, 10.0)))
    assert distance == pytest.approx([RANGE_M, 30.0 - 0.9, RANGE_M, RANGE_M])
    assert relative == pytest.approx(np.zeros(4))


@pytest.mark.parametrize(("heading_deg", "along_mps"), [(0, 12.0), (60, 6.0), (90, 0.0), (180, -12.0)])
def test_relative_speed_counts_only_what_lies_along_the_hosts_heading(heading_deg, along_mps):
    _, relative = Lidar(1, RANGE_M).scan(scene((0.0, 0.0, 0.0, 20.0), (30.0, 0.0, math.radians(heading_deg), 12.0)))
    assert relative == pytest.approx([along_mps - 20.0])


def test_the_nearer_car_hides_the_farther_one_and_lends_the_ray_its_speed():
    far, near = (60.0, 0.0, 0.0, 30.0), (30.0, 0.0, 0.0, 10.0)
    for order in ((far, near), (near, far)):
        distance, relative = Lidar(1, RANGE_M).scan(scene((0.0, 0.0, 0.0, 20.0), *order))
        assert (distance[0], relative[0]) == pytest.approx((27.5, -10.0))


def test_the_range_ends_a_ray_between_its_last_hit_and_its_first_miss():
    lidar = Lidar(1, RANGE_M)
    distance, relative = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), (99.9 + 2.5, 0.0, 0.0, 10.0)))
    assert (distance[0], relative[0]) == pytest.approx((99.9, -10.0))
    distance, relative = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), (100.1 + 2.5, 0.0, 0.0, 10.0)))
    assert (distance[0], relative[0]) == (RANGE_M, 0.0)


def test_with_nobody_around_every_ray_reads_the_range_and_no_speed():
    distance, relative = Lidar(24, 80.0).scan(scene((3.0, 4.0, 0.5, 20.0)))
    assert distance.tolist() == [80.0] * 24
    assert relative.tolist() == [0.0] * 24


def test_a_box_over_the_hosts_centre_reads_nothing_between():
    distance, relative = Lidar(8, RANGE_M).scan(scene((0.0, 0.0, 0.3, 20.0), (0.5, 0.2, 0.0, 10.0)))
    assert distance.tolist() == [0.0] * 8
    assert relative == pytest.approx(np.full(8, 10.0 * math.cos(0.3) - 20.0))


GUARD_RAILS = np.array([[0.0, -8.0, 8200.0, -8.0], [0.0, 8.0, 8200.0, 8.0]])


def test_guard_rails_stand_where_geometry_says_and_tell_the_hosts_own_speed():
    distance, relative = Lidar(24, RANGE_M, GUARD_RAILS).scan(scene((500.0, 3.2, 0.0, 20.0)))
    # Ray k leaves at 15k degrees; the left rail is 4.8 m away, the right one 11.2 m.
    sine = np.sin(np.radians(15.0 * np.arange(24)))
    expected = [RANGE_M if abs(s) < 1e-9 else (4.8 / s if s > 0 else 11.2 / -s) for s in sine]
    assert distance == pytest.approx(np.minimum(expected, RANGE_M))
    assert relative == pytest.approx(np.where(np.array(expected) < RANGE_M, -20.0, 0.0))


def test_a_car_before_the_guard_rail_is_what_is_seen():
    distance, relative = Lidar(4, RANGE_M, GUARD_RAILS).scan(scene((500.0, 0.0, 0.0, 20.0), (500.0, 3.2, 0.0, 17.0)))
    assert distance == pytest.approx([RANGE_M, 2.3, RANGE_M, 8.0])
    assert relative == pytest.approx([0.0, -3.0, 0.0, -20.0])


def test_a_guard_rail_ends_where_it_ends():
    two_rails = np.array([[-50.0, 5.0, -1.0, 5.0], [1.0, 5.0, 50.0, 5.0]])
    distance, _ = Lidar(8, RANGE_M, two_rails).scan(scene((0.0, 0.0, 0.0, 0.0)))
    assert distance[[1, 2, 3]] == pytest.approx([5 * math.sqrt(2), RANGE_M, 5 * math.sqrt(2)])


@given(seeds)
def test_on_any_scene_it_agrees_with_a_slow_computation_by_sides(seed):
    rng = np.random.default_rng(seed)
    around, rails = any_scene(rng), rng.uniform(-150, 150, (rng.integers(4), 4))
    distance, relative = Lidar(24, RANGE_M, rails).scan(around)
    slow = slow_lidar.scan(around, rails, n_rays=24, max_range_m=RANGE_M)
    for metres, mps, met in zip(distance, relative, slow, strict=True):
        nearest = min(met, default=(RANGE_M, 0.0))[0]
        assert metres == pytest.approx(nearest, abs=1e-7)
        # Of several that cover the host's centre, any may lend its speed.
        candidates = [mps for metres, mps in met if metres == nearest] or [0.0]
        assert min(abs(mps - candidate) for candidate in candidates) < 1e-9


@given(seeds)
def test_the_machine_code_computes_the_same_bits_as_its_python_source(seed):
    rng = np.random.default_rng(seed)
    seen = any_scene(rng)
    edges = np.column_stack((rng.uniform(-150, 150, (5, 2)), rng.uniform(-4, 4, 5), rng.uniform(0, 200, 5)))
    rays = rng.uniform(-1, 1, (2, 24))
    machine, python = (run(seen.boxes, edges, rays, RANGE_M) for run in (first_hits, first_hits.py_func))
    assert machine.tolist() == python.tolist()


def scan_of(rng, rows, rails, *, turned=0.0, mirrored=False):
    """Scan with the whole world turned about the origin, or mirrored left to right in the host's heading 0."""
    cos, sin = math.cos(turned), math.sin(turned)
    rows, rails = rows.copy(), rails.copy()
    if mirrored:
        rows[:, 1:3] *= -1
        rails[:, [1, 3]] *= -1
    for points in (rows[:, 0:2], rails[:, 0:2], rails[:, 2:4]):
        points[:] = points @ np.array([[cos, sin], [-sin, cos]])
    rows[:, 2] += turned
    return Lidar(24, RANGE_M, rails).scan(scene((0.0, 0.0, turned, 20.0), *rows))


@given(seeds)
def test_mirror_the_road_and_the_scan_mirrors(seed):
    rng = np.random.default_rng(seed)
    rows, rails = some_boxes(rng, 8), rng.uniform(-60, 60, (2, 4))
    for plain, mirrored in zip(scan_of(rng, rows, rails), scan_of(rng, rows, rails, mirrored=True), strict=True):
        assert mirrored == pytest.approx(plain[-np.arange(24)], abs=1e-6)


@given(seeds, st.floats(-10, 10))
def test_turn_the_world_and_nothing_changes(seed, turned):
    rng = np.random.default_rng(seed)
    rows, rails = some_boxes(rng, 8), rng.uniform(-60, 60, (2, 4))
    for plain, after in zip(scan_of(rng, rows, rails), scan_of(rng, rows, rails, turned=turned), strict=True):
        assert after == pytest.approx(plain, abs=1e-6)


@given(seeds)
def test_wherever_a_lidar_goes_it_meets_the_rails_that_are_in_reach_there(seed):
    rng = np.random.default_rng(seed)
    rails = rng.uniform(-400, 400, (8, 4))
    lidar = Lidar(6, RANGE_M, rails)
    for x_m, y_m in rng.uniform(-300, 300, (8, 2)):
        here = scene((x_m, y_m, 0.3, 20.0))
        slow = slow_lidar.scan(here, rails, n_rays=6, max_range_m=RANGE_M)
        assert lidar.scan(here)[0] == pytest.approx([min(met, default=(RANGE_M,))[0] for met in slow], abs=1e-6)


@given(seeds)
def test_one_more_car_never_lengthens_a_ray_and_changes_no_speed_on_rays_it_leaves_alone(seed):
    rows = some_boxes(np.random.default_rng(seed), 9)
    lidar = Lidar(24, RANGE_M)
    before, speed_before = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), *rows[:-1]))
    after, speed_after = lidar.scan(scene((0.0, 0.0, 0.0, 20.0), *rows))
    assert (after <= before).all()
    untouched = after == before
    assert speed_after[untouched].tolist() == speed_before[untouched].tolist()


@given(seeds)
def test_speed_is_told_exactly_where_something_is_hit(seed):
    rows = some_boxes(np.random.default_rng(seed), 8)
    rows[:, 3] = 40.0  # nobody along the heading as slow as a host that reverses at 50 m/s
    distance, relative = Lidar(24, RANGE_M).scan(scene((0.0, 0.0, 0.0, -50.0), *rows))
    assert ((distance < RANGE_M) == (relative != 0.0)).all()


@pytest.mark.parametrize(
    ("n_rays", "max_range_m", "message"),
    [
        (0, 100.0, "n_rays must be at least 1; got 0"),
        (24, 0.0, "max_range_m must be positive; got 0.0"),
        (24, -5.0, "max_range_m must be positive; got -5.0"),
    ],
)
def test_a_lidar_without_rays_or_range_is_refused(n_rays, max_range_m, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        Lidar(n_rays, max_range_m)


@pytest.mark.parametrize(("host_m", "ray"), [(49.0, 0), (-49.0, 2)])
def test_a_short_rail_is_seen_as_far_as_the_range_reaches(host_m, ray):
    rails = np.array([[145.0, -1.0, 145.0, 1.0], [-145.0, -1.0, -145.0, 1.0]])
    distance, _ = Lidar(4, RANGE_M, rails).scan(scene((host_m, 0.0, 0.0, 0.0)))
    assert distance[ray] == pytest.approx(96.0)
