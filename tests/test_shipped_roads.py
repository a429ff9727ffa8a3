"""What the shipped networks' names and demand promise."""

import math

import libsumo
import numpy as np
import pytest
from driving import EMPTY, world

from rail_sumo import assets
from rail_sumo.highway import trial
from rail_sumo.highway.network import road
from rail_sumo.rollout import EVALUATION, Task, drive, traffic_seed

KMH = 3.6
INF = math.inf
FREEWAYS = ("highway2", "highway4", "highway6", "lane_drop", "onramp")


def limits_kmh(shipped):
    return [round(edge.limit_mps * KMH) for edge in shipped.edges]


@pytest.mark.parametrize(
    ("name", "lanes", "limits", "length_m"),
    [
        ("highway2", 2, [100, 100, 100, 100], 5100),
        ("highway4", 4, [120, 120, 100, 120, 120], 6100),
        ("highway6", 6, [130, 130, 130, 130], 5000),
    ],
)
def test_a_highway_has_the_lanes_of_its_name_from_end_to_end(name, lanes, limits, length_m):
    highway = road.load(name)
    assert limits_kmh(highway) == limits
    assert {edge.n_lanes for edge in highway.edges} == {lanes}
    assert {edge.leads_on_m for edge in highway.edges} == {(INF,) * lanes}
    assert highway.length_m == pytest.approx(length_m, abs=50)
    assert not highway.meets_others


def bends(border):
    """Radii in metres, one per vertex within an arc, and turns in degrees, leftwards if positive, one per vertex."""
    legs = border[:, 2:] - border[:, :2]
    length_m, heading_rad = np.hypot(*legs.T), np.unwrap(np.arctan2(*legs.T[::-1]))
    turn_rad = np.diff(heading_rad)
    # Chords are equally long within an arc. Where it begins or ends, or within a junction, they are not.
    inside = np.abs(np.log(length_m[1:] / length_m[:-1])) < 0.02
    inside &= np.abs(turn_rad) > math.radians(0.5)
    return length_m[1:][inside] / np.abs(turn_rad[inside]), np.degrees(turn_rad)


@pytest.mark.parametrize(
    ("name", "tightest_m", "widest_m", "turn_deg"),
    [("highway2", 400, 800, 405), ("highway4", 1000, 1800, 170), ("highway6", 4000, 5000, 16)],
)
def test_the_guard_rails_follow_bends_of_the_radii_promised(name, tightest_m, widest_m, turn_deg):
    boundaries = road.load(name).boundaries
    for border in np.split(boundaries, [len(boundaries) // 2]):  # the right one, then the left one
        radius_m, turns_deg = bends(border)
        # The course runs in the middle of the road, at most 10.5 m from its border; points are rounded to 0.01 m.
        assert radius_m.min() == pytest.approx(tightest_m, rel=0.05)
        assert radius_m.max() == pytest.approx(widest_m, rel=0.05)
        assert np.abs(turns_deg).sum() == pytest.approx(turn_deg, rel=0.05)
        assert 0 < turns_deg.max() < 3  # also within junctions, which leave no dents
        assert -3 < turns_deg.min() < 0


def test_a_lane_ends_on_the_right_and_then_one_on_the_left():
    four, three, two = road.load("lane_drop").edges
    assert four.leads_on_m == (0.0, INF, INF, three.length_m)
    assert three.leads_on_m == (INF, INF, 0.0)
    assert two.leads_on_m == (INF, INF)
    assert limits_kmh(road.load("lane_drop")) == [100, 100, 100]


def test_the_motorway_has_three_lanes_and_a_fourth_where_ramps_join_or_leave():
    motorway = road.load("onramp")
    fourth_ends = (0.0, INF, INF, INF)
    assert {edge.id: edge.leads_on_m for edge in motorway.edges if edge.n_lanes == 4} == {
        "merge1": fourth_ends,
        "diverge": fourth_ends,
        "merge2": fourth_ends,
    }
    assert {edge.leads_on_m for edge in motorway.edges if edge.n_lanes != 4} == {(INF, INF, INF)}
    assert all(200 < edge.length_m < 300 for edge in motorway.edges if edge.n_lanes == 4)
    assert set(limits_kmh(motorway)) == {120}


@pytest.mark.parametrize(("ramp", "merge", "limit_kmh"), [("on1", "merge1", 80), ("on2", "merge2", 60)])
def test_from_a_ramp_one_comes_to_the_lane_that_ends(ramp, merge, limit_kmh):
    joining = road.load("onramp", (ramp, "main4"))
    assert limits_kmh(joining)[:2] == [limit_kmh, 120]
    assert joining.edges[0].leads_on_m == (joining.edge_of[merge].length_m,)
    assert joining.edge_of[merge].leads_on_m == (0.0, INF, INF, INF)


def test_only_the_rightmost_of_four_lanes_leaves_the_motorway():
    leaving = road.load("onramp", ("main1", "off"))
    assert leaving.edge_of["diverge"].leads_on_m == (INF, 0.0, 0.0, 0.0)
    assert leaving.edge_of["off"].n_lanes == 1


@pytest.mark.parametrize(
    ("ends", "signals"),
    [
        (("east1", "east5"), 3),
        (("west1", "west5"), 3),
        (("east1", "park_north_out"), 3),  # turns left across what comes towards it
        (("mill_south_in", "east5"), 1),
        (("school_south_in", "school_north_out"), 1),
    ],
)
def test_the_arterial_has_three_signals_and_one_junction_without(ends, signals):
    assert road.load("arterial", ends).meets_others
    world_there = world(network={"file": "arterial", "course": ends}, traffic=EMPTY, episode={"duration_s": 300.0})
    assert trial.check(world_there).n_signals == signals


def test_on_the_arterial_a_pocket_leads_left_and_the_two_other_lanes_on():
    for ends in (("east1", "east5"), ("west1", "west5")):
        along = road.load("arterial", ends)
        pockets = [edge for edge in along.edges if edge.id.endswith("_pocket")]
        assert len(pockets) in (2, 3)
        assert {edge.leads_on_m for edge in pockets} == {(INF, INF, 0.0)}
        assert {edge.n_lanes for edge in along.edges if edge not in pockets} == {2}
        assert limits_kmh(along)[0] == limits_kmh(along)[-1] == 50
        assert max(limits_kmh(along)) == 60
    turning = road.load("arterial", ("east1", "market_north_out"))
    assert turning.edge_of["east2_pocket"].leads_on_m == (0.0, 0.0, INF)


@pytest.mark.parametrize("name", [*FREEWAYS, "arterial"])
def test_shipped_demand_flows(name):
    """SUMO alone, for ten minutes; speeds are of the limit, and vehicles are counted from the second minute on."""
    slowest = 0.45 if name == "arterial" else 0.75
    files = ("-n", str(assets.network(name)), "-r", str(assets.routes(name)))
    contacts = ("--collision.action", "warn", "--collision.check-junctions", "true")
    times = ("--step-length", "0.1", "--time-to-teleport", "300", "--seed", "1")
    libsumo.start(["sumo", *files, *times, *contacts, "--no-step-log", "true"])
    try:
        on_the_road, of_limit, mishaps = [], [], 0
        for step in range(6000):
            libsumo.simulationStep()
            mishaps += len(libsumo.simulation.getCollisions()) + libsumo.simulation.getStartingTeleportNumber()
            if step >= 600 and step % 50 == 0:
                vehicles = libsumo.vehicle.getIDList()
                on_the_road.append(len(vehicles))
                limits_mps = [libsumo.lane.getMaxSpeed(libsumo.vehicle.getLaneID(v)) for v in vehicles]
                of_limit += [libsumo.vehicle.getSpeed(v) / mps for v, mps in zip(vehicles, limits_mps, strict=True)]
    finally:
        libsumo.close()
    assert mishaps == 0
    assert 40 < np.mean(on_the_road) < 120
    assert np.mean(of_limit) > slowest


@pytest.mark.parametrize("seed", [traffic_seed(0, EVALUATION, 0), traffic_seed(0, EVALUATION, 1)])
def test_turning_left_the_host_comes_comfortably_to_where_it_waits_within_the_junction(seed):
    turning = world(
        network={"file": "arterial", "course": ("east1", "market_north_out")},
        traffic={"routes": ("arterial",), "host": "added"},
        episode={"course_m": math.inf, "duration_s": 240.0},
    )
    driven = drive(Task("rule", turning, seed))
    assert -np.diff(driven.speed_mps).min() / 0.1 < 3.1  # 9 m/s² while that place was overlooked
    assert driven.end_reason == "end of road"  # it has turned
