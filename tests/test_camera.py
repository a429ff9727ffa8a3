import itertools
import math
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from driving import BY_THE_LIMIT, UNSEEN, assert_same, world
from sketch import cut_road

from rail_sumo import assets, drivers
from rail_sumo.highway.camera import HOLDINGS, Camera
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import ground
from rail_sumo.highway.sumo.options import floating_car_data
from rail_sumo.highway.vehicle.hard_braking import hard_brakings
from rail_sumo.records import MetaAction
from rail_sumo.rollout import driver_of


@pytest.fixture
def left_hand(tmp_path):
    """The arterial, driven on the left."""
    path = tmp_path / "left.net.xml"
    path.write_text(assets.network("onramp").read_text().replace("<net ", '<net lefthand="true" ', 1))
    return str(path)


def on(network, routes=None, **sections):
    demand = {"traffic": {"routes": (str(assets.routes(routes)),), "warm_up_s": 30.0}} if routes else {}
    return world(network={"file": network}, **demand | sections)


def filmed(config, who, seed=UNSEEN, outputs=()):
    driver = driver_of(who, config, seed)
    env = HighwayEnv(config, hands_off=drivers.hands_off(who), outputs=outputs)
    observation, _ = env.reset(seed=seed)
    camera = Camera(env, partial(drivers.probabilities, driver))
    while not env.is_over:
        observation = camera.drive(driver.decide(observation, env.agent))
    trajectory = env.trajectory()
    env.close()
    below = ground.near(config.network.file, *camera.places)
    return camera.film(str(who), trajectory, below), trajectory, below


def unfilmed(config, who, seed=UNSEEN):
    driver = driver_of(who, config, seed)
    env = HighwayEnv(config, hands_off=drivers.hands_off(who))
    observation, _ = env.reset(seed=seed)
    while not env.is_over:
        observation, _ = env.drive(driver.decide(observation, env.agent))
    trajectory = env.trajectory()
    env.close()
    return trajectory


@pytest.mark.parametrize("who", ["random", "expert", "sumo"])
@pytest.mark.parametrize(("network", "routes"), [("highway5", None), ("onramp", "onramp"), ("arterial", "arterial")])
def test_what_is_filmed_is_driven_as_without_a_camera_and_the_film_is_of_it(network, routes, who):
    config = on(network, routes)
    film, trajectory, _ = filmed(config, who)
    assert_same(trajectory, unfilmed(config, who))

    driven = film.driven
    hosts = film.vehicle == driven.vehicle
    assert np.array_equal(film.frame[hosts], np.arange(film.n_frames))  # it is in every frame, once
    assert np.array_equal(film.speed_mps[hosts], trajectory.speed_mps)
    assert np.array_equal(driven.limit_mps[1:], trajectory.limit_mps)
    marks = Counter(mark.kind for mark in driven.marks)
    changes = trajectory.lane_changes + trajectory.aborted_lane_changes
    assert changes <= marks["lane change"] + marks["lane end"] <= changes + 1  # one may be under way at the end
    assert marks["refused"] == trajectory.refused_decisions
    assert passed(driven, "overtake") == trajectory.overtakes
    assert passed(driven, "overtaken") == trajectory.overtaken
    assert marks["hard braking"] == hard_brakings(trajectory.speed_mps)
    if who == "sumo":
        assert not driven.decisions
        assert {HOLDINGS[k] for k in driven.holding} == {"SUMO"}
        return
    assert [one.asked for one in driven.decisions] == trajectory.decisions.tolist()
    assert [one.carried_out for one in driven.decisions] == trajectory.carried_out.tolist()
    frames = [one.frame for one in driven.decisions]
    assert frames == trajectory.decision_step.tolist()
    places = np.column_stack((film.x_m[hosts], film.y_m[hosts]))[frames]
    assert np.array_equal(places, trajectory.decision_place[:, 1:])
    n_rays = config.lidar.n_rays
    for one, seen in zip(driven.decisions, trajectory.observations, strict=True):
        assert np.array_equal(driven.ray_m[one.frame], seen[:n_rays])


def passed(driven, kind):
    return sum(int(mark.text or 1) for mark in driven.marks if mark.kind == kind)


@pytest.mark.parametrize("is_left_hand", [False, True])
def test_where_everybody_is_sumo_says_too(left_hand, tmp_path, is_left_hand):
    config = on(left_hand if is_left_hand else "onramp", "onramp")
    file = tmp_path / "fcd.csv"
    film, _, _ = filmed(config, "expert", outputs=floating_car_data(file, reach_m=150.0))
    sumo = pd.read_csv(file, sep=";").dropna(subset="vehicle_id")
    sumo = sumo[sumo["timestep_time"].between(film.start_s - 1e-6, film.start_s + film.step_s * (film.n_frames - 0.5))]
    frame = np.round((sumo["timestep_time"] - film.start_s) / film.step_s).astype(int)
    number = sumo["vehicle_id"].map({vehicle.id: k for k, vehicle in enumerate(film.vehicles)})
    rows = pd.Series(np.arange(len(film.frame)), pd.MultiIndex.from_arrays((film.frame, film.vehicle)))
    row = rows[list(zip(frame, number, strict=True))].to_numpy()  # whom SUMO names is on the film
    assert len(row) > 2 * film.n_frames  # the host is not alone
    half_m = np.array([film.vehicles[k].length_m for k in number]) / 2
    heading = film.heading_rad[row]
    assert film.x_m[row] + half_m * np.cos(heading) == pytest.approx(sumo["vehicle_x"].to_numpy(), abs=0.006)
    assert film.y_m[row] + half_m * np.sin(heading) == pytest.approx(sumo["vehicle_y"].to_numpy(), abs=0.006)
    assert film.speed_mps[row] == pytest.approx(sumo["vehicle_speed"].to_numpy(), abs=0.006)
    turned = np.radians(90.0 - sumo["vehicle_angle"].to_numpy()) - heading
    assert np.cos(turned) == pytest.approx(np.ones(len(turned)), abs=1e-6)


def test_on_the_left_too_a_ray_ends_where_the_vehicle_that_it_hits_is(left_hand):
    film, _, _ = filmed(on(left_hand, "onramp", lidar={"road_edges": False}), "rule")
    driven, hits = film.driven, 0
    for frame in range(0, film.n_frames, 10):
        here = np.flatnonzero(film.frame == frame)
        host = here[film.vehicle[here] == driven.vehicle][0]
        others = here[here != host]
        for k, reached_m in enumerate(driven.ray_m[frame]):
            if reached_m >= driven.range_m:
                continue
            angle = film.heading_rad[host] + 2 * math.pi * k / len(driven.ray_m[frame])
            x_m = film.x_m[host] + reached_m * math.cos(angle)
            y_m = film.y_m[host] + reached_m * math.sin(angle)
            sizes_m = [(film.vehicles[j].length_m, film.vehicles[j].width_m) for j in film.vehicle[others]]
            away_m = np.hypot(film.x_m[others] - x_m, film.y_m[others] - y_m)
            assert (away_m <= np.hypot(*np.transpose(sizes_m)) / 2 + 1e-6).any()
            hits += 1
    assert hits > 50


def test_signals_are_filmed_and_each_has_its_part_of_a_stop_line():
    film, _, below = filmed(on("arterial", "arterial"), "rule")
    assert len(film.signals) == len(below.stop_lines) > 5
    by_lane = Counter(line.lane for line in below.stop_lines)
    assert max(by_lane.values()) > 1  # a lane that leads on in several directions
    widths = {lane.id: lane.width_m for lane in below.lanes}
    for lane, parts in by_lane.items():
        lengths = [math.dist(line.ends[:2], line.ends[2:]) for line in below.stop_lines if line.lane == lane]
        assert sum(lengths) == pytest.approx(widths[lane])
        assert len(lengths) == parts
    changes = [changes for changes in film.signals if len(changes) > 1]
    assert changes
    for shown in changes:
        frames, letters = zip(*shown, strict=True)
        assert frames[0] == 0
        assert list(frames) == sorted(set(frames))
        assert all(one != other for one, other in itertools.pairwise(letters))


PLATOON = """<routes>
    <vType id="fast" maxSpeed="33" tau="0.3" sigma="0" speedFactor="1" lcCooperative="0" lcStrategic="-1"
           lcSpeedGain="0" lcKeepRight="0"/>
    <route id="main" edges="main3 merge2 main4"/>
    <flow id="right" type="fast" route="main" begin="0" end="22" period="0.6" departLane="0" departSpeed="max"/>
    <flow id="left" type="fast" route="main" begin="0" end="22" period="0.6" departLane="1" departSpeed="max"/>
    <vehicle id="joins" depart="21.5" departSpeed="max"><route edges="on2 merge2 main4"/></vehicle>
</routes>"""
"""Nobody of a platoon at 119 km/h lets in who joins from a ramp at 60 km/h."""


def test_at_the_end_of_an_acceleration_lane_the_speed_follows_the_lanes_end_until_the_layer_leaves_it(tmp_path):
    demand = tmp_path / "platoon.rou.xml"
    demand.write_text(PLATOON)
    traffic = {"routes": (str(demand),), "warm_up_s": 0.0, "host": "joins"}
    film, trajectory, _ = filmed(on("onramp", traffic=traffic), "rule", UNSEEN)
    ends = np.array([HOLDINGS[k] == "lane end" for k in film.driven.holding])
    assert ends.any()
    assert (np.diff(trajectory.speed_mps)[ends[1:] & ends[:-1]] < 0.0).all()  # from the frame on in which it begins
    [left] = [mark for mark in film.driven.marks if mark.kind == "lane end"]
    assert left.text == "to the left"
    assert not ends[left.frame + 20 :].any()  # 2 s later it has left it


def test_behind_slower_vehicles_the_speed_follows_them():
    film, trajectory, _ = filmed(world(traffic={"speed_low_kmh": 40.0, "speed_high_kmh": 45.0, "vehicles": 30}), "keep")
    following = np.array([HOLDINGS[k] == "vehicle ahead" for k in film.driven.holding])
    assert following.sum() > 100
    below_set = film.driven.set_mps[following] - trajectory.speed_mps[following]
    assert (below_set > -0.05).mean() > 0.95  # whoever follows drives no faster than it would


def test_at_its_vehicles_own_top_speed_the_speed_follows_that(tmp_path):
    routes = tmp_path / "slow.rou.xml"
    car = '<vehicle id="v" type="own" depart="5"><route edges="highway"/></vehicle>'
    routes.write_text(f'<routes><vType id="own" maxSpeed="14"/>{car}</routes>')
    demand = {"routes": (str(routes),), "warm_up_s": 0.0, "host": "v"}
    film, trajectory, _ = filmed(on("highway3", traffic=demand, episode={"duration_s": 60.0}), "rule")
    at_top = np.array([HOLDINGS[k] == "top speed" for k in film.driven.holding])
    assert at_top.sum() > 300
    assert trajectory.speed_mps[at_top] == pytest.approx(14.0, abs=0.06)
    assert (film.driven.set_mps[at_top] > 14.0).all()


def test_before_a_red_signal_the_speed_follows_the_signal():
    network = {"file": str(Path(__file__).with_name("two_signals.net.xml"))}
    config = world(network=network, traffic={"vehicles": 0}, episode={"duration_s": 100.0})
    film, trajectory, _ = filmed(config, "keep")
    held = np.array([HOLDINGS[k] for k in film.driven.holding])
    brakes = np.diff(trajectory.speed_mps, prepend=trajectory.speed_mps[0]) < -0.05
    assert brakes.sum() > 50
    assert set(held[brakes]) == {"signal"}
    assert (held == "signal").sum() < film.n_frames / 2  # it has turned green since


def test_past_a_lorry_that_waits_within_a_crossing_the_speed_follows_the_lorry(tmp_path):
    network, demand = Path(__file__).with_name("left_turns.net.xml"), tmp_path / "left.rou.xml"
    demand.write_text(
        '<routes><vType id="lorry" vClass="truck"/>'
        '<flow id="ahead" from="nc" to="cs" begin="0" end="60" period="3" departSpeed="max" departLane="0"/>'
        '<flow id="left" type="lorry" from="sc" to="cw" begin="0" end="60" period="12" departSpeed="max" '
        'departLane="best"/></routes>'
    )
    traffic = {"routes": (str(demand),), "warm_up_s": 0.0, "host": "ahead.4"}
    film, trajectory, _ = filmed(on(str(network), traffic=traffic, episode={"duration_s": 60.0}), "rule")
    held = np.array([HOLDINGS[k] for k in film.driven.holding])
    assert (held == "vehicle across").sum() > 5
    assert trajectory.speed_mps[held == "vehicle across"].min() > 7.0  # past it at 8 m/s
    aside_m = film.x_m[film.vehicle == 0][held == "vehicle across"] - 245.2  # from the middle of its lane
    assert -0.75 < aside_m.min() < -0.35
    assert aside_m.max() < 0.01
    assert not trajectory.collisions + trajectory.struck


def test_where_two_lanes_become_one_the_speed_follows_who_goes_first(tmp_path):
    network, demand = Path(__file__).with_name("zipper.net.xml"), tmp_path / "pairs.rou.xml"
    pair = '<vehicle id="{0}" depart="{1}" departSpeed="max"><route edges="{0} both one out"/></vehicle>'
    demand.write_text(f"<routes>{pair.format('right', 0.0)}{pair.format('left', 7.0)}</routes>")
    traffic = {"routes": (str(demand),), "warm_up_s": 0.0, "host": "left"}
    film, trajectory, _ = filmed(on(str(network), traffic=traffic, adas=BY_THE_LIMIT), "keep")
    held = np.array([HOLDINGS[k] for k in film.driven.holding])
    assert (held == "vehicle joining").sum() > 20
    brakes = np.diff(trajectory.speed_mps, prepend=trajectory.speed_mps[0]) < -0.05
    assert brakes.any()
    assert set(held[brakes]) == {"limit", "vehicle joining"}  # since it enters faster than is allowed
    assert np.diff(trajectory.speed_mps).min() >= -0.2 - 1e-6


def test_before_a_lower_limit_the_speed_follows_that_limit_and_not_the_one_where_it_is(tmp_path):
    network = tmp_path / "slower.net.xml"
    fast, slow = cut_road(600.0, 600.0).split('<edge id="part1"')
    network.write_text(f'{fast}<edge id="part1"{slow.replace("36.11", "13.89")}')
    config = world(network={"file": str(network)}, traffic={"vehicles": 0}, episode={"duration_s": 60.0})
    film, trajectory, _ = filmed(config, "rule")
    held = np.array([HOLDINGS[k] for k in film.driven.holding])
    brakes = np.diff(trajectory.speed_mps, prepend=trajectory.speed_mps[0]) < -0.05
    assert (film.driven.limit_mps[brakes] > 36.0).sum() > 30  # for 3 s and more, while the limit there is 130 km/h
    assert set(held[brakes]) == {"limit ahead"}
    assert set(held[film.driven.limit_mps < 14.0]) <= {"limit", "set speed"}


class InTurn:
    """Decides these, one after the other, then KEEP."""

    senses = None

    def __init__(self, *actions):
        self._left = list(actions)

    def decide(self, observation, agent):
        return self._left.pop(0) if self._left else MetaAction.KEEP


def test_a_reversed_lane_change_and_contacts_leave_a_mark_in_the_frame_in_which_they_happen():
    config = world(traffic={"vehicles": 0})
    env = HighwayEnv(config)
    env.reset(seed=UNSEEN)
    camera = Camera(env, partial(drivers.probabilities, InTurn()))
    side = MetaAction.LEFT if env.agent.mask[MetaAction.LEFT] else MetaAction.RIGHT
    back = MetaAction.RIGHT if side == MetaAction.LEFT else MetaAction.LEFT
    camera.drive(side)
    camera.drive(back)
    camera.drive(MetaAction.KEEP)
    env.agent.host.collisions += 1  # as if it had struck, and been struck, by now
    env.agent.host.struck += 1
    frame = len(env.agent.host.speeds_mps)
    camera.drive(MetaAction.KEEP)
    film = camera.film("in turn", env.trajectory(), ground.near("highway5", *camera.places))
    env.close()
    towards = "to the left" if side == MetaAction.LEFT else "to the right"
    assert [(mark.frame, mark.kind, mark.text) for mark in film.driven.marks] == [
        (1, "lane change", towards),
        (11, "reversed", ""),
        (frame, "collision", ""),
        (frame, "struck", ""),
    ]


def test_why_a_lane_change_was_refused_is_on_the_film():
    film, _, _ = filmed(world(traffic={"vehicles": 0}), InTurn(*[MetaAction.LEFT] * 12))
    whys = [one.why for one in film.driven.decisions[:12]]
    assert "under way" in whys
    assert whys[-1] == "no lane"  # on the leftmost of five
    refused = [mark for mark in film.driven.marks if mark.kind == "refused"]
    assert {mark.text for mark in refused} == {"no lane"}
    assert [mark.frame for mark in refused] == [one.frame for one in film.driven.decisions if one.why == "no lane"]


def test_a_decision_that_leaves_the_set_speed_at_an_end_of_its_range_is_told_from_one_that_moves_it():
    down, up = [MetaAction.DECELERATE] * 12, [MetaAction.ACCELERATE] * 16
    film, _, _ = filmed(world(traffic={"vehicles": 0}), InTurn(*down, MetaAction.KEEP, *up))
    told = [one.stays for one in film.driven.decisions]
    set_mps, limit_mps = film.driven.set_mps, film.driven.limit_mps
    for one, stays in zip(film.driven.decisions, told, strict=True):
        before, after = set_mps[one.frame], set_mps[one.frame + 1]
        is_speed = one.asked in (MetaAction.ACCELERATE, MetaAction.DECELERATE)
        assert (stays != "") == (is_speed and before == after)
        if stays:
            share_of_limit = {"lowest": 0.5, "highest": 1.0}[stays]
            assert after == pytest.approx(share_of_limit * limit_mps[one.frame], abs=1e-3)
    n_up = len(down) + 1
    assert (told[0], told[len(down) - 1]) == ("", "lowest")
    assert (told[n_up + 1], told[n_up + len(up) - 1]) == ("", "highest")
    assert all(told[len(down)] == stays == "" for stays in told[n_up + len(up) :])  # to keep is meant to change nothing


def test_speeding_up_once_more_at_a_red_light_leaves_the_set_speed_the_same():
    """It is 5 km/h above the speed that is driven, which is neither end of its range."""
    at_a_light = on("arterial", adas={"min_speed_kmh": 1.0}, episode={"duration_s": 120.0})
    film, trajectory, _ = filmed(at_a_light, InTurn(*[MetaAction.ACCELERATE] * 120))
    standing = [one.frame for one in film.driven.decisions if one.stays == "same"]
    assert standing
    assert film.driven.set_mps[standing] == pytest.approx(5.0 / 3.6, abs=1e-3)
    assert trajectory.speed_mps[standing] == pytest.approx(0.0, abs=1e-3)


def test_a_learned_driver_tells_how_probable_each_decision_was():
    film, _, _ = filmed(on("highway5"), "expert")
    for one in film.driven.decisions:
        assert sum(one.probabilities) == pytest.approx(1.0)
        assert one.asked == MetaAction(int(np.argmax(one.probabilities)))
        assert all(p == 0.0 for p, is_open in zip(one.probabilities, one.open, strict=True) if not is_open)
    assert not filmed(on("highway5"), "rule")[0].driven.decisions[0].probabilities


@pytest.mark.parametrize(
    ("ground_lane", "lines", "painted"),
    [
        ("", "", "dashed"),
        ('changeLeft="emergency"', "", "dashed"),  # from the left lane one may still come over
        ('changeLeft="emergency"', 'changeRight="emergency"', "solid"),
    ],
)
def test_a_line_is_solid_where_nobody_may_cross_it(network, ground_lane, lines, painted):
    lane = '<lane id="a_{0}" index="{0}" speed="30" length="100" width="3.2" shape="0,{1} 100,{1}" {2}/>'
    lanes = lane.format(0, 0, ground_lane) + lane.format(1, 3.2, lines)
    below = ground.near(network(f'<edge id="a" from="a-" to="a+">{lanes}</edge>'), np.array([50.0]), np.array([0.0]))
    assert [one.left_line for one in below.lanes] == [painted, "none"]


def test_what_is_far_from_where_anybody_drove_is_not_drawn():
    here = ground.near("highway5", np.array([100.0]), np.array([0.0]))
    assert len(here.lanes) == 5
    assert ground.near("highway5", np.array([100.0]), np.array([5000.0])).lanes == ()
