"""Roads that are no straight highway: they end, turn, narrow, cross, or go round."""

import math
import re
import signal

import libsumo
import numpy as np
import pytest
from driving import ACCELERATE, EMPTY, KEEP, LANE_M, LEFT, MERGE, RIGHT, UNSEEN, always, at_random, drive, world

from rail_sumo import assets, rollout
from rail_sumo.errors import InputError
from rail_sumo.highway import trial
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.sumo.simulation import HOST
from rail_sumo.records import KMH


@pytest.fixture
def short_road(tmp_path):
    """Three lanes of so many metres and a limit of 130 km/h."""

    def write(length_m):
        path = tmp_path / "short.net.xml"
        text = assets.network("highway3").read_text().replace("8200.00", f"{length_m:.2f}")
        path.write_text(re.sub(r'speed="[\d.]+"', 'speed="36.11"', text))
        return {"file": str(path)}

    return write


@pytest.mark.parametrize("decision_period_s", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("max_speed_kmh", [80.0, 130.0])
def test_the_road_ends_the_episode_before_the_host_runs_off_it(make, short_road, decision_period_s, max_speed_kmh):
    config = world(
        network=short_road(1200.0),
        episode={"decision_period_s": decision_period_s},
        traffic=EMPTY,
        adas={"max_speed_kmh": max_speed_kmh},
    )
    driven = drive(make(config), always(ACCELERATE))
    travelled_m = driven.speed_mps[1:].sum() * 0.1
    assert driven.end_reason == "end of road"
    assert 900.0 - decision_period_s * max_speed_kmh / KMH < travelled_m < 1000.0  # it starts at 200 m


def test_a_solid_line_is_not_crossed(make, watched, tmp_path):
    """Between the two right lanes of three."""
    path = tmp_path / "lined.net.xml"
    text = assets.network("highway3").read_text()
    text = text.replace('index="0"', 'index="0" changeLeft="emergency"')
    path.write_text(text.replace('index="1"', 'index="1" changeRight="emergency"'))
    config = world(network={"file": str(path)}, traffic={"vehicles": 6}, episode={"duration_s": 120.0})
    rng = np.random.default_rng(0)
    changes = []
    for seed in range(6):
        driven = drive(make(config), lambda env: rng.choice([LEFT, RIGHT]), UNSEEN + seed)
        lanes = {round(scene.y_m[0] / LANE_M) for scene in watched().scenes}  # -1 the rightmost
        assert lanes in ({-1}, {0, 1}, {0}, {1})
        changes += [(driven.lane_changes > 0, lanes == {0, 1})]
    assert changes.count((True, True)) > 1
    assert changes.count((False, False)) > 0


@pytest.mark.parametrize("driver", ["rule", "expert"])
def test_on_a_road_driven_on_the_left_it_drives_as_in_the_mirror(tmp_path, driver):
    text = assets.network("highway3").read_text()
    right, left = "0.0000,-3.2000 8200.0000,-3.2000", "0.0000,3.2000 8200.0000,3.2000"
    assert text.count(f'shape="{right}"') == text.count(f'shape="{left}"') == 1
    text = text.replace(right, "kerb").replace(left, right).replace("kerb", left)
    path = tmp_path / "left.net.xml"
    path.write_text(text.replace("<net ", '<net lefthand="true" ', 1))
    there, here = (
        rollout.drive(rollout.Task(driver, world(network={"file": file}, episode={"duration_s": 200.0}), UNSEEN))
        for file in (str(path), "highway3")
    )
    assert there.lane_changes > 0
    np.testing.assert_array_equal(there.speed_mps, here.speed_mps)
    np.testing.assert_allclose(there.observations, here.observations, atol=1e-9)
    np.testing.assert_array_equal(there.decisions, here.decisions)


def test_who_drives_on_a_road_beside_the_hosts_is_not_overtaken(make, two_roads):
    on = {road: drive(make(two_roads(road)), always(ACCELERATE)) for road in ("beside", "highway")}
    assert on["beside"].overtakes > 5
    assert on["highway"].overtakes == 0


def test_the_host_drives_along_the_edges_wanted_and_no_farther(make):
    """Half the ring: four of its eight edges of 392.7 m, from whose first the host starts."""
    env = make(world(network={"file": "ring5", "course": ("ring6", "ring1")}, episode={"duration_s": 300.0}))
    env.reset(seed=UNSEEN)
    edges = {libsumo.vehicle.getRoadID(HOST)}
    while not env.is_over:
        env.drive(KEEP)
        edges.add(libsumo.vehicle.getRoadID(HOST))
    assert {edge for edge in edges if not edge.startswith(":")} == {"ring6", "ring7", "ring0", "ring1"}
    assert env.trajectory().end_reason == "end of road"


def test_on_a_ring_the_course_is_driven_in_laps(make):
    config = world(network={"file": "ring5"}, episode={"course_m": 7222.0, "duration_s": math.inf}, traffic=EMPTY)
    driven = drive(make(config), always(ACCELERATE))
    assert driven.end_reason == "course"
    assert 7222.0 <= driven.speed_mps[1:].sum() * 0.1 < 7222.0 + 80 / KMH


@pytest.mark.parametrize("decision_period_s", [1.0, 2.0])
@pytest.mark.parametrize("course_m", [500.0, 530.0, 600.0])
def test_on_a_ring_the_road_does_not_end_with_the_course(make, course_m, decision_period_s):
    config = world(
        network={"file": "ring5"},
        episode={"course_m": course_m, "decision_period_s": decision_period_s},
        traffic=EMPTY,
    )
    driven = drive(make(config), always(KEEP))
    travelled_m = driven.speed_mps[1:].sum() * 0.1
    assert driven.end_reason == "course"
    assert course_m - 1e-6 < travelled_m < course_m + decision_period_s * 60 / KMH


@pytest.fixture
def soon():
    """Fail rather than hang."""

    def late(*_):
        raise TimeoutError("not done within 5 s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, 5.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("soon")
def test_on_a_ring_an_episode_may_be_limited_by_its_duration_alone(make):
    driven = drive(make(world(network={"file": "ring5"}, traffic=EMPTY)), always(KEEP))
    assert (driven.end_reason, len(driven.lane_changing)) == ("duration", 600)


def test_the_window_reaches_over_edges_with_other_lanes(make, soon_narrow):
    for seed in range(6):
        env = make(world(network=soon_narrow))
        env.reset(seed=UNSEEN + seed)
        assert len(libsumo.vehicle.getIDList()) > 8
    env.close()
    assert trial.check(world(network=soon_narrow)).warnings[0].startswith("the road ends 1")


def test_the_host_starts_on_a_lane_that_leads_on(make, soon_narrow):
    lanes = set()
    for seed in range(12):
        make(world(network=soon_narrow, traffic=EMPTY)).reset(seed=seed)
        lanes.add(libsumo.vehicle.getLaneID(HOST))
    assert lanes == {"wide_1", "wide_2"}


def test_who_drives_on_a_bridge_is_not_around_the_host(make, tmp_path):
    path, demand = tmp_path / "bridge.net.xml", tmp_path / "bridge.rou.xml"
    over = (
        '<edge id="over" from="d" to="e" priority="-1"><lane id="over_0" index="0" speed="36.11" length="120.00" '
        'shape="60,-60,6.00 60,60,6.00"/></edge>'
        '<junction id="d" type="dead_end" x="60" y="-60" incLanes="" intLanes="" shape="60,-60"/>'
        '<junction id="e" type="dead_end" x="60" y="60" incLanes="over_0" intLanes="" shape="60,60"/>'
    )
    path.write_text(MERGE.replace("<junction", over + "<junction", 1))
    demand.write_text(
        '<routes><vType id="slow" maxSpeed="0.1"/>'
        '<vehicle id="above" type="slow" depart="0" departPos="55"><route edges="over"/></vehicle>'
        '<vehicle id="beside" type="slow" depart="0" departPos="60" departLane="2"><route edges="wide"/></vehicle>'
        "</routes>"
    )
    env = make(world(network={"file": str(path)}, traffic={"routes": [str(demand)], "warm_up_s": 1.0}))
    env.reset(seed=0)
    assert {"above", "beside"} <= set(libsumo.vehicle.getIDList())
    assert env.scene.ids == [HOST, "beside"]


@pytest.mark.parametrize("traffic", [EMPTY, {"vehicles": 10}])
def test_the_host_gets_on_from_a_lane_that_ends_and_over_a_junction(make, watched, merge, traffic):
    started = []
    for seed in range(12):
        driven = drive(make(world(network=merge, traffic=traffic, episode={"duration_s": 300.0})), always(KEEP), seed)
        first, last = watched().scenes[0], watched().scenes[-1]
        started.append(first.y_m[0])
        assert driven.end_reason == "end of road"
        assert last.x_m[0] > 1900.0
        # Whoever started on the lane that ends, 8 m to the right, moved over by one; the others kept theirs.
        assert driven.lane_changes == (first.y_m[0] == -8.0)
        assert last.y_m[0] == pytest.approx(max(first.y_m[0], -4.8))
    assert set(started) == {-8.0, -4.8, -1.6}


@pytest.mark.parametrize("seed", range(3))
def test_the_windows_vehicles_leave_a_lane_that_ends_and_hold_their_speed_under_another_limit(
    make, watched, tmp_path, seed
):
    path = tmp_path / "limits.net.xml"
    slow_first = MERGE.replace('id="wide_0" index="0" speed="36.11"', 'id="wide_0" index="0" speed="13.89"')
    path.write_text(slow_first.replace('id="wide_1" index="1" speed="36.11"', 'id="wide_1" index="1" speed="13.89"'))
    traffic = {"vehicles": 12, "speed_low_kmh": 50.0, "speed_high_kmh": 60.0}
    env = make(world(network={"file": str(path)}, traffic=traffic, episode={"duration_s": 300.0}))
    drive(env, always(KEEP), UNSEEN + seed)
    others = np.concatenate([scene.speed_mps[1:] for scene in watched().scenes])
    assert others.min() * KMH > 20.0  # nobody waits at the end of the lane
    assert 55.0 < others.max() * KMH <= 60.01


def test_between_lanes_of_unequal_width_the_host_moves_evenly_and_crosses_before_the_border(make, watched, tmp_path):
    path = tmp_path / "widths.net.xml"
    path.write_text(MERGE.replace('shape="0,-1.60 996,-1.60"', 'width="4.50" shape="0,-0.95 996,-0.95"'))
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 40.0}))
    driven = drive(env, at_random(3))
    across = np.diff([scene.y_m[0] for scene in watched().scenes])
    assert driven.lane_changes > 3
    assert np.abs(across).max() < 0.18  # 1.7 m/s


def test_a_host_that_strays_beyond_a_bicycle_lane_drives_on_there(make, tmp_path):
    path = tmp_path / "split.net.xml"
    lane = '<lane id="narrow_{0}" index="{0}" {1} speed="36.11" length="996.00" shape="1004,{2} 2000,{2}"/>'
    lanes = [(0, "", -11.2), (1, 'allow="bicycle"', -8.0), (2, "", -4.8), (3, "", -1.6)]
    split = re.sub(
        r'    <lane id="narrow_0".*?narrow_1"[^>]*>', "".join(lane.format(*one) for one in lanes), MERGE, flags=re.S
    )
    split = re.sub(r'(to="narrow" fromLane="\d" toLane=)"(\d)"', lambda at: f'{at[1]}"{int(at[2]) + 2}"', split)
    path.write_text(split)
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 300.0}))
    env.reset(seed=1)
    libsumo.vehicle.moveTo(HOST, "narrow_0", 50.0)
    decide = at_random(1)
    for _ in range(20):
        env.drive(decide(env))
    assert env.trajectory().lane_changes == 0
    assert libsumo.vehicle.getLaneID(HOST) == "narrow_0"


def test_a_road_too_short_to_drive_on_is_refused_before_anybody_drives(short_road):
    message = (
        "^network 'short': the course is 96 m long, and the host needs 24 m of it behind its start and 72 m to spare "
        "at the end; use a longer course$"
    )
    with pytest.raises(InputError, match=message):
        HighwayEnv(world(network=short_road(96.0)))


def test_on_a_short_road_the_host_starts_after_a_quarter_of_it(make, short_road):
    driven = drive(make(world(network=short_road(400.0), traffic=EMPTY)), always(KEEP))
    assert driven.end_reason == "end of road"
    assert driven.distance_m == pytest.approx(400.0 - 100.0 - 72.2, abs=17.0)  # it looks up every second


@pytest.mark.parametrize("hands_off", [False, True])
def test_beyond_a_junction_other_lane_numbers_are_no_lane_changes(make, outputs, merge, hands_off):
    env = make(world(network=merge, traffic={"vehicles": 10}, episode={"duration_s": 300.0}), hands_off=hands_off)
    driven = drive(env, always(KEEP), seed=UNSEEN)
    env.close()
    of_host = [entry for entry in outputs("lanechange") if entry.get("id") == HOST]
    assert driven.end_reason == "end of road"
    assert driven.lane_changes == len(of_host)
