import dataclasses
import math
import os
import re
import tempfile
import xml.etree.ElementTree as ElementTree

import gymnasium
import libsumo
import numpy as np
import pytest
import stable_baselines3
from driving import (
    ACCELERATE,
    DECELERATE,
    EMPTY,
    KEEP,
    LANE_M,
    LEFT,
    ONE,
    RIGHT,
    UNSEEN,
    Watched,
    always,
    assert_same,
    at_random,
    closing,
    drive,
    led_off,
    on_ramp,
    onlooker_account,
    world,
)
from gymnasium.utils.env_checker import check_env
from sketch import cut_road

from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway import env as env_module
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import feature_names
from rail_sumo.highway.reward import reward, total_reward
from rail_sumo.highway.sumo.held import RESPECT_OTHERS_GAPS
from rail_sumo.highway.sumo.simulation import HOST
from rail_sumo.highway.traffic.moving_window import MovingWindow
from rail_sumo.highway.vehicle.host import SUMO_CHANGES_LANES
from rail_sumo.records import KMH, MetaAction
from rail_sumo.rollout import EVALUATION, traffic_seed


def named(env, observation):
    return dict(zip(feature_names(env.config.lidar, env.config.observation), observation.tolist(), strict=True))


def test_the_last_step_tells_how_the_episode_went(make):
    env = make(world(episode={"duration_s": 3.0}))
    env.reset(seed=UNSEEN)
    told = [env.step(KEEP)[4] for _ in range(3)]
    assert [set(info) for info in told[:2]] == [{"action_mask", "carried_out"}] * 2
    assert (told[2]["end_reason"], told[2]["duration_s"]) == ("duration", 3.0)
    assert told[2]["distance_m"] == env.trajectory().distance_m


def test_every_step_tells_what_was_made_of_its_action(make):
    env = make(world())
    _, info = env.reset(seed=UNSEEN)
    assert "carried_out" not in info
    said = []
    for _ in range(30):
        is_open = info["action_mask"][LEFT]
        info = env.step(LEFT)[4]
        assert info["carried_out"] == (LEFT if is_open else KEEP)
        said.append(info["carried_out"])
    assert set(said) == {LEFT, KEEP}


# Under the tools of others.


def test_gymnasiums_checker_finds_nothing(make):
    check_env(make(), skip_render_check=True)


def test_made_by_its_registered_name_it_is_the_same_environment(make):
    def driven(env):
        first, _ = env.reset(seed=3)
        steps = [env.step(action)[:4] for action in (ACCELERATE, LEFT, KEEP, RIGHT)]
        env.close()
        return first.tolist(), [(observation.tolist(), *rest) for observation, *rest in steps]

    assert driven(gymnasium.make("RailSumo/Highway-v0", config=world())) == driven(make())


def test_stable_baselines_ppo_trains_on_it_unchanged(make):
    model = stable_baselines3.PPO("MlpPolicy", make(), n_steps=128, batch_size=64, n_epochs=2, seed=1, device="cpu")
    before = {name: parameter.clone() for name, parameter in model.policy.named_parameters()}
    model.learn(384)
    assert model.num_timesteps == 384
    for name, parameter in model.policy.named_parameters():
        assert parameter.isfinite().all()
        assert not parameter.equal(before[name]), name


# Randomness.


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"network": {"file": "ring5"}},
        {"network": {"file": "highway3"}},
        {"traffic": {"routes": ["highway5"]}},
        {"episode": {"decision_period_s": 0.1, "duration_s": 30.0}},
    ],
    ids=["highway5", "ring5", "highway3", "demand", "every step"],
)
def test_the_same_seed_is_the_same_episode_bit_for_bit_and_another_one_differs(make, sections):
    config = world(**sections)
    first = drive(make(config), at_random(1), seed=7)
    assert_same(first, drive(make(config), at_random(1), seed=7))
    other = drive(make(config), at_random(1), seed=8)
    assert not np.array_equal(first.observations, other.observations)


def test_an_environment_that_has_driven_before_drives_as_a_new_one(make):
    new = drive(make(), at_random(1), seed=7)
    used = make()
    drive(used, at_random(2), seed=9)
    assert_same(drive(used, at_random(1), seed=7), new)


def test_a_reset_in_mid_episode_starts_all_over(make):
    config = world(observation={"frames": 3, "lateral_state": True})
    new = drive(make(config), at_random(1), seed=7)
    env = make(config)
    env.reset(seed=9)
    env.drive(LEFT)
    env.drive(ACCELERATE)
    assert_same(drive(env, at_random(1), seed=7), new)


def test_without_a_seed_every_episode_has_traffic_of_its_own_and_the_first_seed_decides_all(make):
    def three(seed):
        env = make()
        return [env.reset(seed=seed)[0].tolist(), env.reset()[0].tolist(), env.reset()[0].tolist()]

    once = three(5)
    assert once[0] != once[1] != once[2] != once[0]
    assert three(5) == once


def test_watching_changes_nothing(make, monkeypatch):
    plain = drive(make(), at_random(1))
    monkeypatch.setattr(env_module, "Simulation", Watched)
    assert_same(drive(make(), at_random(1)), plain)


# One simulation a process.


def test_a_second_environment_in_the_process_is_refused_until_the_first_is_closed(make):
    first, second = make(), HighwayEnv(world())
    first.reset(seed=1)
    message = "^a simulation is already running in this process and libsumo holds only one; close it, make"
    with pytest.raises(RuntimeError, match=message):
        second.reset(seed=2)
    first.drive(KEEP)
    first.close()
    first.close()
    second.reset(seed=2)
    first.close()
    second.drive(KEEP)
    second.close()


def test_after_the_end_a_decision_is_refused_until_reset(make):
    env = make(world(episode={"duration_s": 1.0}))
    with pytest.raises(RuntimeError, match="no episode has begun, or the environment was closed; call reset"):
        env.drive(KEEP)
    drive(env, always(KEEP))
    with pytest.raises(RuntimeError, match=r"^the episode is over; call reset\(\)$"):
        env.step(KEEP)
    env.reset(seed=1)
    env.step(KEEP)


# What is seen.


@pytest.mark.parametrize(("network", "lanes"), [("highway5", 5), ("highway3", 3)])
def test_alone_on_the_road_the_scan_is_the_guard_rails(make, network, lanes):
    env = make(world(network={"file": network}, traffic=EMPTY))
    seen = named(env, env.reset(seed=2)[0])
    host, *_ = env.surroundings()
    to_left_m = (lanes - host.lane - 0.5) * LANE_M
    assert seen["distance_0_m"] == 100.0  # straight ahead and behind nothing
    assert seen["distance_6_m"] == pytest.approx(to_left_m)
    assert seen["distance_18_m"] == pytest.approx(lanes * LANE_M - to_left_m)
    assert seen["distance_3_m"] == pytest.approx(to_left_m * math.sqrt(2))  # at 45 degrees
    assert seen["relative_speed_6_mps"] == pytest.approx(-60 / KMH, abs=1e-3)


def test_alone_on_the_ring_the_scan_is_its_two_circles(make):
    env = make(world(network={"file": "ring5"}, traffic=EMPTY))
    env.reset(seed=2)
    for _ in range(30):
        seen = named(env, env.drive(KEEP)[0])
        left, right = seen["distance_6_m"], seen["distance_18_m"]
        lane = env.surroundings()[0].lane
        assert left + right == pytest.approx(5 * LANE_M, abs=0.05)
        assert left == pytest.approx((4.5 - lane) * LANE_M, abs=0.15)
        # Straight ahead the outer circle, radius 508 m, is met after sqrt(508² - r²).
        radius = 500.0 + (2 - lane) * LANE_M
        assert seen["distance_0_m"] == pytest.approx(min(100.0, math.sqrt(508.0**2 - radius**2)), abs=4.0)


def test_without_road_edges_an_empty_road_shows_nothing(make):
    env = make(world(traffic=EMPTY, lidar={"road_edges": False, "n_rays": 8}))
    assert env.reset(seed=2)[0].tolist() == [100.0] * 8 + [0.0] * 8


def test_during_a_lane_change_the_scan_and_the_lateral_state_move_with_the_host(make):
    env = make(world(traffic=EMPTY, observation={"lateral_state": True, "host_speed": True}))
    before = named(env, env.reset(seed=3)[0])
    action, side = (LEFT, 1) if env.action_masks()[LEFT] else (RIGHT, -1)
    after, driven = env.drive(action)
    after = named(env, after)
    assert driven == 10
    assert after["lateral_m"] == pytest.approx(side * 1.7)
    assert before["distance_6_m"] - after["distance_6_m"] == pytest.approx(side * 1.7)
    assert after["host_speed_mps"] == pytest.approx(60 / KMH, abs=1e-3)
    settled = named(env, env.drive(KEEP)[0])
    assert settled["lateral_m"] == 0.0
    assert before["distance_6_m"] - settled["distance_6_m"] == pytest.approx(side * LANE_M)


def test_the_gaps_told_are_those_in_the_scene(make):
    env = make(world(network={"file": "highway5"}, episode={"duration_s": 200.0}))
    env.reset(seed=UNSEEN)
    compared = 0
    decide = at_random(4)
    while not env.is_over:
        scene, (_, *gaps) = env.scene, env.surroundings()
        lane = np.round(scene.y_m / LANE_M)
        for side, gap in zip((0, 1, -1), gaps, strict=True):
            if env.is_changing_lane or not -2 <= lane[0] + side <= 2:
                continue
            # Someone who is just changing lanes is in one lane for SUMO and in the other for the eye: none does here,
            # as SUMO's changes take one step.
            inside = np.flatnonzero(lane == lane[0] + side)
            along = np.array([scene.x_m[i] - scene.x_m[0] for i in inside if i != 0])
            for metres, told in ((along[along > 0], gap.ahead_m), (-along[along < 0], gap.behind_m)):
                seen = metres.min() - 5.0 if len(metres) else math.inf
                if seen < 60.0:  # the scene ends there, SUMO's look-ahead does not
                    assert told == pytest.approx(seen, abs=0.02)
                    compared += 1
                else:
                    assert told > 55.0
        env.drive(decide(env))
    assert compared > 200


# When a decision falls due, and what it earns.


def test_a_decision_falls_due_every_second_and_at_once_when_a_lane_change_ends(make):
    env = make(world(traffic=EMPTY))
    env.reset(seed=3)
    action = LEFT if env.action_masks()[LEFT] else RIGHT
    # 3.2 m at 1.7 m/s are 19 steps.
    assert [env.drive(decision)[1] for decision in (KEEP, action, KEEP, KEEP)] == [10, 10, 9, 10]
    assert env.trajectory().lane_changing.sum() == 19


@pytest.mark.parametrize(("period_s", "steps"), [(0.1, 1), (0.5, 5), (2.0, 20)])
def test_the_decision_period_is_what_is_configured(make, period_s, steps):
    env = make(world(episode={"decision_period_s": period_s}))
    env.reset(seed=3)
    assert [env.drive(KEEP)[1] for _ in range(5)] == [steps] * 5


def test_rewards_step_by_step_are_the_whole_trajectorys(make):
    env = make(world(episode={"duration_s": 200.0}))
    env.reset(seed=UNSEEN)
    decide, earned, over = at_random(1), 0.0, False
    while not over:
        _, step, terminated, truncated, _ = env.step(decide(env))
        earned += step
        over = terminated or truncated
    driven = env.trajectory()
    assert driven.overtakes > 0
    assert driven.refused_decisions > 0
    assert earned == pytest.approx(
        reward(
            driven.speed_mps[1:],
            driven.limit_mps,
            driven.lane_changing,
            env.config.adas,
            overtakes=driven.overtakes,
            overtaken=driven.overtaken,
            refused_decisions=driven.refused_decisions,
        )
    )
    assert total_reward(driven, env.config.adas) == pytest.approx(earned)
    struck = dataclasses.replace(driven, struck=1, end_reason="collision")  # whoever hits whom, it is charged once
    assert total_reward(struck, env.config.adas) == pytest.approx(earned - 10.0)


def test_a_decision_is_refused_where_the_mask_forbids_it(make):
    env = make(world(episode={"duration_s": 300.0}))
    env.reset(seed=UNSEEN + 1)
    decide, allowed_ones, refused_ones = at_random(3), 0, 0
    while not env.is_over:
        action, before = decide(env), env.trajectory().refused_decisions
        is_allowed, was_changing = env.action_masks()[action], env.is_changing_lane
        env.drive(action)
        refused = env.trajectory().refused_decisions - before
        if is_allowed:
            assert refused == 0
            allowed_ones += 1
        elif not was_changing:
            assert refused == 1
            refused_ones += 1
    assert allowed_ones > 50
    assert refused_ones > 10


def test_the_traffic_is_told_how_much_time_went_by_and_whether_the_host_changes_lanes(make, monkeypatch):
    told = []
    monkeypatch.setattr(
        MovingWindow,
        "update",
        lambda self, *, elapsed_s, changing_lane: told.append((elapsed_s, HOST in changing_lane)),
    )
    env = make(world(traffic=EMPTY))
    env.reset(seed=3)
    for decision in (LEFT if env.action_masks()[LEFT] else RIGHT, KEEP, KEEP):
        env.drive(decision)
    # A change of 1.9 s: a decision in its midst, the next when it ends, and a whole second after that.
    assert told == [(0.0, False), (1.0, True), (pytest.approx(0.9), False), (1.0, False)]


def test_after_the_hosts_lane_change_everybody_changes_lanes_as_before(make):
    env = make(world(traffic={"routes": ("highway5",)}))
    env.reset(seed=4)

    def modes():
        return {name: libsumo.vehicle.getLaneChangeMode(name) for name in env.scene.ids[1:]}

    before = modes()
    while not env.is_changing_lane:
        before |= modes()
        env.drive(next(side for side in (LEFT, RIGHT, KEEP) if env.action_masks()[side]))
    assert RESPECT_OTHERS_GAPS in modes().values()
    while env.is_changing_lane:
        env.drive(KEEP)
    env.drive(KEEP)
    after = modes()
    assert len(before.keys() & after.keys()) > 3
    assert set(after.values()) == set(before.values()) == {SUMO_CHANGES_LANES}


# When an episode ends.


@pytest.mark.parametrize(("duration_s", "steps"), [(12.5, 125), (12.34, 124), (0.1, 1)])
def test_a_duration_ends_in_its_last_step(make, duration_s, steps):
    driven = drive(make(world(episode={"duration_s": duration_s})), always(KEEP))
    assert len(driven.lane_changing) == steps


def test_the_course_ends_the_episode_in_the_first_decision_beyond_it(make):
    env = make(world(episode={"course_m": 500.0, "duration_s": math.inf}, traffic=EMPTY))
    driven = drive(env, always(ACCELERATE))
    # 60 km/h to 80 km/h, a decision a second; SUMO moves by the new speed for the whole step.
    travelled_m = np.cumsum(driven.speed_mps[1:]) * 0.1
    assert driven.end_reason == "course"
    assert travelled_m[-1] >= 500.0 > travelled_m[-11]


def test_an_episode_under_way_has_not_ended(make):
    env = make(world(episode={"duration_s": 12.0}))
    env.reset(seed=0)
    env.step(KEEP)
    so_far = env.trajectory()
    assert (so_far.end_reason, len(so_far.lane_changing), len(so_far.decisions)) == (None, 10, 1)


def test_the_duration_ends_the_episode(make):
    driven = drive(make(world(episode={"duration_s": 12.0})), always(KEEP))
    assert (driven.end_reason, len(driven.lane_changing), len(driven.decisions)) == ("duration", 120, 12)


def test_what_detectors_report_replaces_nothing_and_is_not_kept(make, tmp_path, monkeypatch):
    ours = tmp_path / "of SUMO"
    ours.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(ours))
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "e1.xml").write_text("mine, of last week")
    detector = '<e1Detector id="d" lane="highway_0" pos="500" period="5" file="sub/e1.xml"/>'
    (tmp_path / "d.add.xml").write_text(f'<additional>{detector}<edgeData id="m" file="means.xml"/></additional>')
    monkeypatch.chdir(tmp_path / "sub")  # a relative path is climbed from too
    before = sorted(tmp_path.rglob("*"))
    env = make(world(traffic=EMPTY | {"additional": [str(tmp_path / "d.add.xml")]}, episode={"duration_s": 20.0}))
    drive(env, always(KEEP))
    env.reset(seed=UNSEEN)
    links = {path.name: str(path.readlink()) for path in ours.rglob("*.xml")}
    assert links == {"e1.xml": os.devnull, "means.xml": os.devnull}
    env.close()
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "sub" / "e1.xml").read_text() == "mine, of last week"


def test_detectors_may_lie_where_nothing_can_be_written_and_a_folder_that_is_missing_is_named(make, tmp_path):
    (tmp_path / "theirs").mkdir()
    additional = tmp_path / "theirs" / "d.add.xml"
    additional.write_text('<additional><edgeData id="m" file="means.xml"/></additional>')
    (tmp_path / "theirs").chmod(0o555)
    drive(make(world(traffic=EMPTY | {"additional": [str(additional)]}, episode={"duration_s": 5.0})), always(KEEP))
    assert list((tmp_path / "theirs").iterdir()) == [additional]  # nor was anything for a superuser, who may write
    (tmp_path / "theirs").chmod(0o755)
    additional.write_text('<additional><edgeData id="m" file="none/means.xml"/></additional>')
    there = str(tmp_path / "theirs" / "none" / "means.xml")
    with pytest.raises(InputError, match=rf"Could not build output file '{there}' \(No such file or directory\)\.$"):
        make(world(traffic=EMPTY | {"additional": [str(additional)]})).reset(seed=UNSEEN)


def test_detectors_by_paths_of_windows_leave_nothing_either(make, tmp_path, monkeypatch):
    additional = tmp_path / "d.add.xml"
    additional.write_text(r'<additional><edgeData id="m" file="sub\means.xml"/></additional>')
    asked = ("--tripinfo-output", str(tmp_path / "trips.xml"))
    env = HighwayEnv(world(traffic=EMPTY | {"additional": [str(additional)]}), outputs=asked)
    env.reset(seed=UNSEEN)
    assert len([path for path in tmp_path.iterdir() if path.name.startswith(r"sub\rail_sumo_")]) == 1  # it does report
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.add.xml", "trips.xml"]


def test_a_report_that_is_asked_for_is_called_as_asked_beside_detectors_too(make, tmp_path):
    detector = '<e1Detector id="d" lane="highway_0" pos="500" period="5" file="e1.xml"/>'
    (tmp_path / "d.add.xml").write_text(f"<additional>{detector}</additional>")
    asked = ("--tripinfo-output", str(tmp_path / "trips.xml"), "--tripinfo-output.write-unfinished", "true")
    env = HighwayEnv(world(traffic=EMPTY | {"additional": [str(tmp_path / "d.add.xml")]}), outputs=asked)
    env.reset(seed=UNSEEN)
    env.step(0)
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.add.xml", "trips.xml"]
    assert HOST in (tmp_path / "trips.xml").read_text()


@pytest.mark.parametrize("host", ["replaces", "added"])
def test_the_row_names_the_vehicle_and_when_it_departed_as_sumos_trip_report_does(make, tmp_path, host):
    asked = ("--tripinfo-output", str(tmp_path / "trips.xml"), "--tripinfo-output.write-unfinished", "true")
    there = world(network={"file": "highway3"}, traffic={"routes": ("highway3",), "host": host})
    env = HighwayEnv(there, outputs=asked)
    env.reset(seed=UNSEEN)
    while not env.is_over:
        _, _, _, _, info = env.step(KEEP)
    env.close()
    trips = ElementTree.parse(tmp_path / "trips.xml").iter("tripinfo")
    departs = {trip.get("id"): trip.get("depart") for trip in trips}
    assert info["depart_s"] == pytest.approx(float(departs[info["host"]]))
    assert (info["host"] == HOST) == (host == "added")


def test_beside_a_users_own_traffic_nobody_is_added(make, tmp_path):
    mine = '<vehicle id="mine" depart="0" departPos="400"><route edges="highway"/></vehicle>'
    (tmp_path / "mine.rou.xml").write_text(f"<routes>{mine}</routes>")
    env = make(world(traffic={"routes": (str(tmp_path / "mine.rou.xml"),), "warm_up_s": 1.0}))
    env.reset(seed=UNSEEN)
    for _ in range(30):
        env.step(0)
        assert set(libsumo.vehicle.getIDList()) == {HOST, "mine"}


def test_without_a_demand_too_the_clock_begins_when_it_is_told_to(make):
    env = make(world(traffic={"begin_s": 25200.0}))
    env.reset(seed=UNSEEN)
    assert env.scene.time_s == pytest.approx(25200.1)


def test_an_action_that_there_is_not_leaves_the_episode_as_it_was(make):
    env = make(world(episode={"duration_s": 3.0}))
    env.reset(seed=UNSEEN)
    for action in (5, -1, 1.5, "keep", np.array([1])):
        with pytest.raises(ValueError, match=r"one whole number \(0 keep, .*, 4 right\); got "):
            env.step(action)
    _, _, _, over, _ = [env.step(action) for action in (0, np.int64(0), np.array(0))][-1]
    assert over
    assert {len(env.trajectory().observations), len(env.trajectory().decisions)} == {3}


def test_additional_files_are_loaded(make, tmp_path):
    """A bus that halts at a stop of theirs for longer than the episode."""
    stops, demand = tmp_path / "stops.add.xml", tmp_path / "bus.rou.xml"
    stops.write_text('<additional><busStop id="s" lane="highway_0" startPos="900" endPos="930"/></additional>')
    demand.write_text(
        '<routes><vehicle id="bus" depart="0" departLane="0" departPos="850"><route edges="highway"/>'
        '<stop busStop="s" duration="500"/></vehicle></routes>'
    )
    traffic = {"routes": (str(demand),), "additional": (str(stops),)}
    make(world(traffic=traffic)).reset(seed=UNSEEN)
    assert libsumo.vehicle.isAtBusStop("bus")
    assert libsumo.vehicle.getLanePosition("bus") == pytest.approx(930.0, abs=0.2)
    with pytest.raises(InputError, match="busStop 's' is not known"):
        make(world(traffic=traffic | {"additional": ()})).reset(seed=UNSEEN)


def intrude(gap_m):
    """A decision maker before whose second decision a parked car appears right ahead, by a lane change in one step."""

    def decide(env):
        decide.calls += 1
        if decide.calls == 2:
            front_m, lane = libsumo.vehicle.getLanePosition(HOST), libsumo.vehicle.getLaneIndex(HOST)
            beside = lane + 1 if lane < 4 else lane - 1
            libsumo.route.add("parking", ["highway"])
            libsumo.vehicle.add(
                "parked",
                "parking",
                "DEFAULT_VEHTYPE",
                departLane=str(beside),
                departPos=str(front_m + gap_m + 5.0),
                departSpeed="0",
            )
            libsumo.vehicle.setSpeedMode("parked", 0)
            libsumo.vehicle.setLaneChangeMode("parked", 0)
            libsumo.vehicle.setSpeed("parked", 0.0)
        if decide.calls == 3:
            libsumo.vehicle.changeLane("parked", libsumo.vehicle.getLaneIndex(HOST), 0.0)
        return KEEP

    decide.calls = 0
    return decide


def test_a_collision_terminates_costs_ten_and_is_what_sumo_writes_down(make, outputs):
    env = make(world(traffic=EMPTY, episode={"decision_period_s": 0.5}))
    env.reset(seed=1)
    decide, over = intrude(20.0), False
    while not over:
        _, earned, terminated, truncated, _ = env.step(decide(env))
        over = terminated or truncated
    driven = env.trajectory()
    env.close()
    assert (terminated, truncated) == (True, False)
    assert earned < -9.0
    assert (driven.end_reason, driven.collisions, driven.struck) == ("collision", 1, 0)
    (entry,) = outputs("collision")
    assert (entry.get("collider"), entry.get("victim")) == (HOST, "parked")


def test_a_parked_car_that_appears_farther_ahead_is_none(make, outputs):
    # 16.7 m/s are braked away at 9 m/s² in 15.4 m.
    env = make(world(traffic=EMPTY, episode={"decision_period_s": 0.5, "duration_s": 20.0}))
    driven = drive(env, intrude(40.0))
    env.close()
    assert (driven.end_reason, driven.collisions, driven.struck) == ("duration", 0, 0)
    assert driven.speed_mps[-1] == pytest.approx(0.0, abs=1e-3)
    assert outputs("collision") == []


def test_a_host_that_has_stood_still_for_five_minutes_ends_the_episode(make):
    driven = drive(make(world(traffic=EMPTY, episode={"decision_period_s": 0.5, "duration_s": 600.0})), intrude(40.0))
    assert driven.end_reason == "standstill"
    still = np.flatnonzero(driven.speed_mps > 0.1)[-1] * 0.1
    assert 297.0 < len(driven.lane_changing) * 0.1 - still < 300.5  # less the time of its last metres


def test_so_does_one_that_creeps_on_by_a_car_length_now_and_then(make):
    """As SUMO's teleports of those ahead would have it for hours."""
    parks = intrude(40.0)

    def decide(env):
        if parks.calls and parks.calls % 200 == 0:
            lane, front_m = libsumo.vehicle.getLaneID("parked"), libsumo.vehicle.getLanePosition("parked")
            libsumo.vehicle.moveTo("parked", lane, front_m + 6.0)
        return parks(env)

    driven = drive(make(world(traffic=EMPTY, episode={"decision_period_s": 0.5, "duration_s": 600.0})), decide)
    assert driven.end_reason == "standstill"
    crept_m = driven.speed_mps[-3000:].sum() * 0.1
    assert 10.0 < crept_m < 30.0
    assert driven.speed_mps[-3000:].max() > 0.5


@pytest.mark.parametrize(
    "by",
    [
        '<vaporizer id="ring2" begin="0" end="9999"/>',
        '<rerouter id="r" edges="ring1"><interval begin="0" end="999">'
        '<destProbReroute id="ring2"/></interval></rerouter>',
    ],
)
def test_a_host_that_is_taken_off_the_road_is_told_in_one_line(make, tmp_path, by):
    path = tmp_path / "off.add.xml"
    path.write_text(f"<additional>{by}</additional>")
    ring = {"network": {"file": "ring5"}, "episode": {"duration_s": 400.0}}
    with pytest.raises(InputError, match=r"^the host was taken off the road; keep rerouters, .* \(SUMO: .*\)$"):
        drive(make(world(**ring | {"traffic": EMPTY | {"additional": [str(path)]}})), always(KEEP))


def test_a_host_of_the_demand_follows_the_route_that_it_is_given_on_its_way(make, tmp_path):
    """A rerouter on `merge1` has it leave by the exit, where as it entered it drove on along the motorway."""
    traffic = {"routes": on_ramp(tmp_path, ONE), "additional": led_off(tmp_path), "host": "one"}
    endless = {"course_m": 9999.0, "duration_s": 999.0}
    env = make(world(network={"file": "onramp", "course": ["main1"]}, traffic=traffic, episode=endless))
    driven = drive(env, always(KEEP))
    assert env.agent.stretch.road.edges[-1].id == "off"
    assert driven.end_reason == "end of road"
    # To where it looks for the last time on `off`, as far before its end as its highest speed there asks for.
    whole_m = sum(env.stretch.road.edge_of[name].length_m for name in ("main1", "merge1", "main2", "diverge"))
    assert whole_m + 200.0 < driven.distance_m < whole_m + 370.0
    assert driven.speed_mps[-1] <= 22.3
    assert driven.lane_changes == 2
    assert driven.collisions == 0


@pytest.mark.parametrize(
    ("is_made", "settle_s", "back_s"), [(False, "by traffic", 10.0), (False, 2.0, 2.0), (True, "by traffic", 0.0)]
)
def test_in_a_demand_a_host_settles_in_its_lane_before_it_goes_back(make, tmp_path, is_made, settle_s, back_s):
    traffic = EMPTY if is_made else {"routes": on_ramp(tmp_path, ONE), "host": "one"}
    adas = {"settle_s": settle_s, "gain_s": 0.0}
    env = make(world(network={"file": "onramp", "course": ["main1"]}, traffic=traffic, adas=adas))
    env.reset(seed=UNSEEN)
    env.step(LEFT)
    crossed, there = env.agent.n_steps, libsumo.vehicle.getLaneIndex(env.agent.host.name)
    while libsumo.vehicle.getLaneIndex(env.agent.host.name) == there:
        env.step(RIGHT)
        assert env.agent.n_steps < 200, "it never goes back"
    # Decided at full seconds and where the change there ended; it takes up to a second until it has crossed over again.
    assert back_s <= (env.agent.n_steps - crossed) / 10 <= back_s + 2.0


@pytest.mark.parametrize(
    ("is_made", "gain_s", "changes"),
    [(False, "by traffic", False), (False, 0.0, True), (True, "by traffic", True), (True, 5.0, False)],
)
def test_in_a_demand_a_host_changes_no_lanes_for_nothing(make, tmp_path, is_made, gain_s, changes):
    traffic = EMPTY if is_made else {"routes": on_ramp(tmp_path, ONE), "host": "one"}
    env = make(world(network={"file": "onramp", "course": ["main1"]}, traffic=traffic, adas={"gain_s": gain_s}))
    env.reset(seed=UNSEEN)
    assert env.action_masks()[LEFT] == changes
    env.step(LEFT)
    assert (env.agent.adas.why, env.agent.adas.lane_changes > 0 or env.agent.is_changing_lane) == (
        "" if changes else "no gain",
        changes,
    )


@pytest.mark.parametrize(("before_m", "brakes_mps2"), [(60.0, 4.5), (300.0, 0.0)])
def test_a_single_host_leaves_a_lane_that_is_closed_or_drives_on_where_it_cannot_stop(
    make, tmp_path, before_m, brakes_mps2
):
    """It notices at once, whenever that is; by then SUMO has braked for a step. Then it leaves the lane."""
    network, routes = tmp_path / "three.net.xml", tmp_path / "one.rou.xml"
    network.write_text(cut_road(800.0, 400.0, 900.0, lanes=3))
    place_m = 800.0 - 25.0 * 10.0 - before_m
    routes.write_text(
        '<routes><vType id="car" sigma="0"/><route id="r" edges="part0 part1 part2"/>'
        f'<vehicle id="one" type="car" route="r" depart="0" departLane="0" departPos="{place_m}" departSpeed="25"/>'
        "</routes>"
    )
    works = closing(tmp_path, ["part1_0"], 10.0)
    for period_s in (1.0, 0.7):
        env = make(
            world(
                network={"file": str(network)},
                traffic={"routes": [str(routes)], "additional": works, "host": "one"},
                adas={"max_speed_kmh": 90.0, "start_speed_kmh": 90.0},
                episode={"course_m": 1200.0, "decision_period_s": period_s},
            )
        )
        driven = drive(env, always(KEEP))
        env.close()
        assert driven.end_reason == "course"
        assert driven.lane_changes == 1
        assert driven.collisions == 0
        assert -np.diff(driven.speed_mps).min() / 0.1 <= brakes_mps2 + 1e-6
        assert driven.speed_mps.min() > 24.0


def test_where_a_lane_is_closed_made_traffic_enters_on_the_others(make, tmp_path):
    """SUMO stops at a vehicle that is to enter on a closed lane."""
    traffic = {"additional": closing(tmp_path, ["main2_1", "main2_2"], edge="main1"), "vehicles": 60}
    env = make(world(network={"file": "onramp"}, traffic=traffic, episode={"duration_s": 150.0}))
    for seed in range(2):
        driven = drive(env, always(ACCELERATE), UNSEEN + seed)
        assert driven.distance_m > 500.0
        assert driven.collisions == 0


def test_a_demand_that_begins_later_needs_to_be_told_when(make, tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text(
        '<routes><flow id="f" begin="25200" end="25500" period="4" departLane="random"><route edges="highway"/></flow>'
        "</routes>"
    )
    with pytest.raises(
        InputError,
        match=r"^no vehicle of the demand is on the road at 60 s; its vehicles depart from 25200 to 25500 s: ",
    ):
        drive(make(world(traffic={"routes": (str(late),)})), always(KEEP))
    env = make(world(traffic={"routes": (str(late),), "begin_s": 25200.0}))
    env.reset(seed=1)
    assert len(libsumo.vehicle.getIDList()) > 10


def test_ids_of_a_users_demand_do_not_meet_ours(make, tmp_path):
    plain = tmp_path / "plain.rou.xml"
    plain.write_text(
        '<routes><vType id="DEFAULT_VEHTYPE" vClass="truck" carFollowModel="IDM" length="12" width="2.5"/>'
        '<route id="route0" edges="highway"/><vehicle id="host" route="route0" depart="0"/></routes>'
    )
    env = make(world(traffic={"routes": (str(plain),)}))
    env.reset(seed=1)
    assert sorted(libsumo.vehicle.getIDList()) == ["host", HOST]
    assert (env.scene.length_m[0], env.scene.width_m[0]) == (5.0, 1.8)


@pytest.mark.parametrize("seed", [0, 2**31, 2**40])
def test_any_seed_that_is_not_negative_begins_an_episode(make, seed):
    env = make(world(traffic=EMPTY))
    env.reset(seed=seed)
    assert env.trajectory().seed == seed


# Agreement with an onlooker, and with SUMO's own account.


@pytest.mark.parametrize("decision_period_s", [0.3, 1.0])
@pytest.mark.parametrize("seed", range(UNSEEN, UNSEEN + 3))
def test_lane_changes_are_those_of_an_onlooker_and_of_sumos_own_output(make, outputs, seed, decision_period_s):
    env = make(world(episode={"duration_s": 300.0, "decision_period_s": decision_period_s}))
    driven = drive(env, at_random(seed), seed=seed)
    env.close()
    left_m = [scene.y_m[0] for scene in Watched.latest.scenes]
    changes, aborted, entries = onlooker_account(left_m)
    assert (driven.lane_changes, driven.aborted_lane_changes) == (changes, aborted)
    assert changes > 5
    assert aborted > 0
    of_host = [entry for entry in outputs("lanechange") if entry.get("id") == HOST]
    assert len(of_host) == entries
    assert sum(int(entry.get("dir")) for entry in of_host) == round((left_m[-1] - left_m[0]) / LANE_M)


@pytest.mark.parametrize("seed", range(UNSEEN, UNSEEN + 3))
def test_with_hands_off_sumo_changes_lanes_and_its_own_output_agrees(make, outputs, seed):
    env = make(world(episode={"duration_s": 300.0}), hands_off=True)
    driven = drive(env, at_random(seed), seed=seed)
    env.close()
    of_host = [entry for entry in outputs("lanechange") if entry.get("id") == HOST]
    assert driven.lane_changes == len(of_host) >= 3
    assert (driven.refused_decisions, driven.aborted_lane_changes) == (0, 0)
    assert outputs("collision") == []


def test_with_hands_off_a_lane_change_in_the_very_last_step_counts_too(make, outputs):
    changes = {"episode": {"duration_s": 40.0}, "traffic": {"vehicles": 30}}
    env = make(Config().changed(**changes), hands_off=True)
    driven = drive(env, always(KEEP), seed=traffic_seed(9, EVALUATION, 55))
    env.close()
    of_host = [entry for entry in outputs("lanechange") if entry.get("id") == HOST]
    assert float(of_host[-1].get("time")) >= 39.9
    assert driven.lane_changes == len(of_host)


@pytest.mark.parametrize("host", ["replaces", "added"])
def test_with_hands_off_too_the_highest_set_speed_holds_and_who_enters_faster_slows_down_evenly(make, host):
    """A highest set speed of 50 km/h, where the demand's cars enter at the limit of 80."""
    slow = {"min_speed_kmh": 30.0, "start_speed_kmh": "limit*3/4", "max_speed_kmh": 50.0}
    there = world(network={"file": "highway3"}, traffic={"routes": ("highway3",), "host": host}, adas=slow)
    driven = drive(make(there, hands_off=True), always(KEEP))
    if host == "replaces":
        assert driven.speed_mps[0] > 55 / KMH
    assert driven.speed_mps[150:].max() == pytest.approx(50 / KMH, abs=0.03)
    assert np.diff(driven.speed_mps).min() >= -0.21  # 2 m/s²


def test_with_hands_off_decisions_do_nothing(make):
    kept = drive(make(hands_off=True), always(KEEP))
    decided = drive(make(hands_off=True), at_random(1))
    assert np.array_equal(kept.speed_mps, decided.speed_mps)
    assert kept.lane_changes == decided.lane_changes


TYPES = """<routes>
    <vType id="slow" length="9.0" width="2.2" minGap="4.0" tau="2.0" maxSpeed="15.0" speedFactor="0.5"/>
    <vType id="hasty" speedFactor="1.5"/>
    <route id="along" edges="highway"/>
    <vehicle id="one" type="slow" route="along" depart="0" departLane="0" departPos="1500"/>
</routes>"""


@pytest.mark.parametrize(("kind", "length_m", "kmh"), [("slow", 9.0, 40.0), ("hasty", 5.0, 120.0)])
def test_sumos_driver_may_be_one_of_the_demands_types(make, tmp_path, kind, length_m, kmh):
    (tmp_path / "demand.rou.xml").write_text(TYPES)
    traffic = {"routes": [str(tmp_path / "demand.rou.xml")], "warm_up_s": 1.0}
    env = make(world(traffic=traffic, episode={"duration_s": 60.0}), hands_off=kind)
    driven = drive(env, always(KEEP))
    assert env.scene.length_m[0] == length_m
    # Its speed factor times the limit of 80 km/h, and not the 40 to 80 of the ADAS layer.
    assert driven.speed_mps[-1] * 3.6 == pytest.approx(kmh, abs=0.1)


def test_who_enters_faster_than_its_type_drives_comes_down_evenly(make, tmp_path):
    """At 120 km/h, as the car did in whose place it drives, and its own type drives at 40."""
    fast = '<vehicle id="two" type="hasty" route="along" depart="5" departSpeed="desired"/>'
    steady = TYPES.replace("<vType ", '<vType sigma="0" ').replace("</routes>", f"{fast}</routes>")
    (tmp_path / "demand.rou.xml").write_text(steady)
    traffic = {"routes": [str(tmp_path / "demand.rou.xml")], "warm_up_s": 1.0, "host": "replaces"}
    there = world(traffic=traffic, episode={"duration_s": 60.0})
    driven = drive(make(there, hands_off="slow"), always(KEEP))
    assert driven.speed_mps[0] * 3.6 > 119.0
    assert np.diff(driven.speed_mps).min() >= -0.21  # 2 m/s²
    assert driven.speed_mps[-1] * 3.6 == pytest.approx(40.0, abs=0.1)


def test_a_type_that_the_demand_has_not_is_refused_in_one_line(make, tmp_path):
    (tmp_path / "demand.rou.xml").write_text(TYPES)
    available = "(available: DEFAULT_VEHTYPE, hasty, slow)"
    message = f"vehicle type 'slwo' of driver 'sumo:slwo' not found; did you mean 'slow'? {available}"
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        make(world(traffic={"routes": [str(tmp_path / "demand.rou.xml")]}), hands_off="slwo")
    with pytest.raises(InputError, match=r"^driver 'sumo:slow' is a vehicle of your demand's, which names no types; "):
        make(world(), hands_off="slow")


def onlooker_passes(scenes):
    """Overtakes and being overtaken on a straight road, from every step; all cars are 5 m long."""
    side, overtakes, overtaken = {}, 0, 0
    for scene in scenes:
        side = {name: clear for name, clear in side.items() if name in scene.ids}
        for name, ahead in zip(scene.ids, (scene.x_m - scene.x_m[0]).tolist(), strict=True):
            if abs(ahead) > 5.0:
                before, side[name] = side.get(name), ahead > 0
                overtakes += before is True and ahead < 0
                overtaken += before is False and ahead > 0
    return overtakes, overtaken


@pytest.mark.parametrize("decision_period_s", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("action", [ACCELERATE, DECELERATE])
def test_overtakes_are_those_of_an_onlooker(make, watched, decision_period_s, action):
    env = make(world(episode={"duration_s": 300.0, "decision_period_s": decision_period_s}))
    driven = drive(env, always(action), seed=UNSEEN)
    assert (driven.overtakes, driven.overtaken) == onlooker_passes(watched().scenes)
    assert driven.overtakes + driven.overtaken > 10


def sideways_or_faster(env):
    """Change lanes whenever that is allowed, else speed up."""
    mask = env.action_masks()
    return next((action for action in (LEFT, RIGHT) if mask[action]), ACCELERATE)


def test_with_a_demand_of_ones_own_only_its_vehicles_are_on_the_road(make):
    env = make(world(traffic={"routes": ["highway5"]}, episode={"duration_s": 120.0}))
    env.reset(seed=UNSEEN)
    seen, widths = set(), set()
    while not env.is_over:
        env.drive(sideways_or_faster(env))
        seen |= set(env.scene.ids[1:])
        widths |= set(env.scene.width_m[1:].tolist())
    assert len(seen) > 20
    assert {name.partition(".")[0] for name in seen} <= {"fill", "follow"}
    assert {1.8, 2.5} <= widths  # its lorries keep their size
    assert env.trajectory().overtakes > 0


# Safety, whatever the supervisor decides.


def test_who_does_not_ask_is_told_nothing(make):
    driven = drive(make(world(episode={"duration_s": 20.0})), at_random(1))
    assert driven.allowed.shape == (len(driven.decisions), 5)
    assert driven.allowed.all()


def jumpy(seed):
    """Nothing but sideways."""
    rng = np.random.default_rng(seed)
    return lambda env: int(rng.choice([LEFT, RIGHT]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "sections", "seeds"),
    [
        (at_random, {}, 12),
        (lambda seed: sideways_or_faster, {}, 12),
        (jumpy, {}, 12),
        (at_random, {"episode": {"decision_period_s": 0.1}}, 12),
        (jumpy, {"episode": {"decision_period_s": 0.3}}, 12),
        (at_random, {"network": {"file": "ring5"}}, 12),
        (at_random, {"traffic": {"routes": ["highway5"]}}, 4),  # among so many one takes as long as five
        (at_random, {"traffic": {"vehicles": 60, "lane_change_every_s": 5.0}}, 12),
    ],
    ids=["random", "sideways", "jumpy", "random every step", "jumpy every 0.3 s", "ring", "demand", "dense"],
)
def test_whatever_is_decided_the_host_touches_nobody_and_never_brakes_beyond_9_mps2(
    make, watched, touching, driver, sections, seeds
):
    config = world(**{**sections, "episode": {"duration_s": 300.0} | sections.get("episode", {})})
    changes = 0
    for seed in range(UNSEEN, UNSEEN + seeds):
        driven = drive(make(config), driver(seed), seed=seed)
        assert (driven.collisions, driven.struck) == (0, 0), seed
        for scene in watched().scenes:
            assert touching(scene) == [], (seed, scene.time_s)
        assert -np.diff(driven.speed_mps).min() / 0.1 <= 9.0 + 1e-6, seed
        changes += driven.lane_changes
    assert changes > 2.5 * seeds


def test_what_came_of_each_decision_is_noted(make):
    env = make(world(episode={"duration_s": 100.0}))
    env.reset(seed=UNSEEN)
    decide, came, told = at_random(1), [], []
    while not env.is_over:
        action, mask = decide(env), env.action_masks()
        sideways = action in (MetaAction.LEFT, MetaAction.RIGHT)
        came.append(MetaAction.KEEP if sideways and not mask[action] else action)
        env.drive(action)
        told.append(mask)
    driven = env.trajectory()
    np.testing.assert_array_equal(driven.carried_out, came)
    np.testing.assert_array_equal(driven.allowed, told)
    assert 0 < driven.refused_decisions < (driven.carried_out != driven.decisions).sum()  # others were under way
