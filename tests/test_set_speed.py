"""The set speed follows the road's limit, in numbers, on the layer and on SUMO."""

import math
import re

import libsumo
import numpy as np
import pytest
from driving import ACCELERATE, DECELERATE, EMPTY, KEEP, MERGE, always, drive

from rail_sumo import config, config_file
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.sumo.simulation import HOST
from rail_sumo.highway.vehicle.adas import Adas
from rail_sumo.records import KMH, Gaps, HostState

FREE = Gaps(ahead_m=math.inf, ahead_speed_mps=0.0, behind_m=math.inf, behind_speed_mps=0.0)


def on_a_road(limit_kmh, speed_kmh):
    return HostState(
        speed_mps=speed_kmh / KMH,
        lane=0,
        rightmost_lane=0,
        leftmost_lane=0,
        to_edge_end_m=5000.0,
        lane_width_m=3.2,
        to_left_m=0.0,
        to_right_m=0.0,
        leads_on_m=(math.inf,),
        limit_mps=limit_kmh / KMH,
    )


def set_kmh(layer, limit_kmh):
    """What a host that crawls would speed up to."""
    return layer.command(on_a_road(limit_kmh, 1.0), lambda side: FREE, steps=1).speed_mps * KMH


@pytest.mark.parametrize("limit_kmh", [30, 80, 120])
def test_it_lies_between_half_the_limit_and_the_limit(limit_kmh):
    layer = Adas(config.Adas(), start_mps=config.Adas().start_mps(limit_kmh / KMH))
    assert set_kmh(layer, limit_kmh) == pytest.approx(0.75 * limit_kmh)
    layer.decide(ACCELERATE, on_a_road(limit_kmh, limit_kmh - 2), lambda side: FREE)
    assert set_kmh(layer, limit_kmh) == pytest.approx(limit_kmh)
    layer.decide(DECELERATE, on_a_road(limit_kmh, limit_kmh / 2 + 2), lambda side: FREE)
    assert set_kmh(layer, limit_kmh) == pytest.approx(limit_kmh / 2)


def test_where_the_limit_changes_it_is_held_to_the_new_one_and_remembered():
    layer = Adas(config.Adas(), start_mps=100.0 / KMH)
    assert [set_kmh(layer, limit) for limit in (120, 50, 240, 120)] == pytest.approx([100, 50, 100, 100])


def test_numbers_take_the_limits_place():
    layer = Adas(config.Adas(min_speed_kmh=20.0, max_speed_kmh=70.0), start_mps=60.0 / KMH)
    layer.decide(ACCELERATE, on_a_road(120, 68), lambda side: FREE)
    assert set_kmh(layer, 120) == pytest.approx(70)
    layer.decide(DECELERATE, on_a_road(120, 22), lambda side: FREE)
    assert set_kmh(layer, 120) == pytest.approx(20)


def test_where_the_lowest_speed_is_above_the_limit_the_limit_holds():
    assert config.Adas(min_speed_kmh=40.0).clipped_mps(20.0 / KMH, 30.0 / KMH) == 30.0 / KMH


def road_of(tmp_path, limit_kmh):
    path = tmp_path / "road.net.xml"
    path.write_text(MERGE.replace('speed="36.11"', f'speed="{limit_kmh / KMH}"'))
    return {"file": str(path)}


def world(network, *, traffic=EMPTY, **adas):
    episode = {"course_m": math.inf, "duration_s": 20.0}
    return config_file.validate({"network": network, "traffic": traffic, "episode": episode, "adas": adas})


def test_on_sumo_the_host_starts_at_three_quarters_of_the_limit_and_speeds_up_to_it(make, tmp_path):
    driven = drive(make(world(road_of(tmp_path, 120))), always(ACCELERATE))
    assert driven.speed_mps[0] * KMH == pytest.approx(90.0, abs=0.01)
    assert driven.speed_mps.max() * KMH == pytest.approx(120.0, abs=0.01)
    assert driven.limit_mps * KMH == pytest.approx(np.full(200, 120.0), abs=0.01)


@pytest.mark.parametrize(
    ("limit_kmh", "adas", "message"),
    [
        (0, {}, "edge 'wide' has a speed limit of 0 km/h; correct the network"),
        (0, {"max_speed_kmh": 80.0}, "edge 'wide' has a speed limit of 0 km/h; correct the network"),
        (
            80,
            {"min_speed_kmh": 80.0},
            "80 km/h (adas.min_speed_kmh = 80.0), is not below the highest, 80 km/h",
        ),
        (
            80,
            {"max_speed_kmh": 30.0},
            "40 km/h (adas.min_speed_kmh = limit/2), is not below the highest, 30 km/h",
        ),
    ],
)
def test_a_limit_or_range_that_makes_no_sense_is_told_in_one_line(tmp_path, limit_kmh, adas, message):
    with pytest.raises(InputError, match=re.escape(message)):
        HighwayEnv(world(road_of(tmp_path, limit_kmh), **adas))


def test_on_a_road_without_a_limit_the_host_drives_as_fast_as_a_car_can_or_as_is_named(tmp_path, make):
    env = make(world(road_of(tmp_path, 999)))
    driven = drive(env, always(KEEP))
    assert driven.speed_mps[0] * KMH == pytest.approx(150.0, abs=0.01)
    assert env.stretch.fastest_mps * KMH == pytest.approx(200.0)
    named = {"max_speed_kmh": 100.0, "min_speed_kmh": 50.0, "start_speed_kmh": 75.0}
    driven = drive(make(world(road_of(tmp_path, 999), **named)), always(ACCELERATE))
    assert driven.speed_mps.max() * KMH == pytest.approx(100.0, abs=0.01)


@pytest.fixture
def demand(tmp_path):
    """Vehicles at 54 km/h in the left lane and at 36 in the others."""
    path = tmp_path / "demand.rou.xml"
    flows = "".join(
        f'<flow id="{lane}" type="{kind}" route="r" begin="0" end="500" period="6" departLane="{lane}" '
        'departPos="base" departSpeed="max"/>'
        for lane, kind in enumerate(("slow", "slow", "fast"))
    )
    path.write_text(
        '<routes><vType id="slow" maxSpeed="10" sigma="0" laneChangeModel="LC2013" lcSpeedGain="0" lcKeepRight="0"/>'
        '<vType id="fast" maxSpeed="15" sigma="0" laneChangeModel="LC2013" lcSpeedGain="0" lcKeepRight="0"/>'
        f'<route id="r" edges="highway"/>{flows}</routes>'
    )
    return {"routes": [str(path)], "host": "added"}


def test_into_a_demand_the_host_enters_as_fast_as_its_lane_drives_unless_a_number_is_given(make, demand):
    entered = {}
    for seed in range(16):
        env = make(world({"file": "highway3"}, traffic=demand))
        env.reset(seed=seed)
        entered[libsumo.vehicle.getLaneIndex(HOST)] = libsumo.vehicle.getSpeed(HOST)
    assert entered == pytest.approx({0: 10.0, 1: 10.0, 2: 15.0}, abs=0.2)
    env = make(world({"file": "highway3"}, traffic=demand, start_speed_kmh=45.0))
    env.reset(seed=0)
    assert libsumo.vehicle.getSpeed(HOST) == pytest.approx(45.0 / KMH, abs=0.01)


def test_into_fast_traffic_the_host_enters_no_faster_than_its_own_highest_speed(make, demand):
    env = make(world({"file": "highway3"}, traffic=demand, max_speed_kmh=30.0, min_speed_kmh=20.0))
    env.reset(seed=0)
    assert libsumo.vehicle.getSpeed(HOST) <= 30.0 / KMH + 1e-3


def test_after_an_episode_that_could_not_begin_another_one_can(make, tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text('<routes><trip id="a" depart="5000" from="highway" to="highway"/></routes>')
    with pytest.raises(InputError, match="no vehicle of the demand is on the road"):
        HighwayEnv(world({"file": "highway3"}, traffic={"routes": [str(late)], "host": "added"})).reset(seed=0)
    make(world({"file": "highway3"})).reset(seed=0)


def test_a_number_above_the_limit_needs_no_closer_look_than_the_limit():
    layer = Adas(config.Adas(max_speed_kmh=130.0), start_mps=100.0 / KMH)
    command = layer.command(on_a_road(80, 80), lambda side: FREE, steps=10)
    assert (command.speed_mps * KMH, command.steps) == (pytest.approx(80.0), 10)


def test_a_demand_is_driven_as_sumo_drives_it_alone(make, demand, tmp_path):
    # A type with an actionStepLength of its own changes everybody's driving, even if nobody is of that type.
    env = make(world({"file": "highway3"}, traffic=demand))
    env.reset(seed=1)
    assert not any(name.startswith("rail_sumo_traffic") for name in libsumo.vehicletype.getIDList())
    env = make(world({"file": "highway3"}))
    env.reset(seed=1)
    assert {"rail_sumo_traffic_Krauss", "rail_sumo_traffic_IDM"} <= set(libsumo.vehicletype.getIDList())


def test_keeping_on_a_slower_road_ahead_comes_back_to_its_speed_after_it(make, tmp_path):
    path = tmp_path / "zone.net.xml"
    text = MERGE.replace("36.11", "22.2222")
    path.write_text(re.sub(r'(<lane id=":b.*?speed=)"22.2222"', r'\1"8.33"', text))
    long = config_file.validate(
        {"network": {"file": str(path)}, "traffic": EMPTY, "episode": {"course_m": math.inf, "duration_s": 120.0}}
    )
    driven = drive(make(long), always(KEEP))
    slowest = int(driven.speed_mps.argmin())
    assert driven.speed_mps[slowest] == pytest.approx(8.33, abs=0.01)
    assert driven.speed_mps[:50] * KMH == pytest.approx(np.full(50, 60.0), abs=0.01)
    assert driven.speed_mps[slowest:].max() * KMH == pytest.approx(60.0, abs=0.01)
