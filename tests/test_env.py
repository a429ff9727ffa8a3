import dataclasses
import math
import re
import signal
import xml.etree.ElementTree as ElementTree

import gymnasium
import libsumo
import numpy as np
import pytest
import stable_baselines3
from gymnasium.utils.env_checker import check_env

from rail_sumo import assets
from rail_sumo.config import validate
from rail_sumo.errors import InputError
from rail_sumo.highway import env as env_module
from rail_sumo.highway import trial
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import feature_names
from rail_sumo.highway.reward import reward, total_reward
from rail_sumo.highway.simulation import HOST, TRAFFIC_TYPE, Simulation
from rail_sumo.records import KMH, MetaAction

KEEP, ACCELERATE, DECELERATE, LEFT, RIGHT = MetaAction
LANE_M = 3.2
UNSEEN = 1_900_000_000
"""Traffic seeds from here on: beyond those anybody trains or tunes on by hand."""


def world(**sections):
    """The default world for 60 s with some slow vehicles in it, changed by section."""
    tree = {"episode": {"course_m": math.inf, "duration_s": 60.0}, "traffic": {"speed_low_kmh": 40.0}}
    return validate({**tree, **{name: tree.get(name, {}) | changes for name, changes in sections.items()}})


EMPTY = {"vehicles": 0}


@pytest.fixture
def make():
    """Make environments; only the last one has a simulation, and none is left open."""
    made = []

    def make(config=None, **arguments):
        for env in made:
            env.close()
        made.append(HighwayEnv(config or world(), **arguments))
        return made[-1]

    yield make
    for env in made:
        env.close()


class Watched(Simulation):
    """Keeps what an onlooker sees after every step."""

    latest: "Watched"

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        Watched.latest = self
        self.scenes = []

    def _step(self):
        super()._step()
        self.scenes.append(self.scene())


@pytest.fixture
def watched(monkeypatch):
    """Every simulation that an environment opens is watched; `watched()` is the latest."""
    monkeypatch.setattr(env_module, "Simulation", Watched)
    return lambda: Watched.latest


@pytest.fixture
def outputs(monkeypatch, tmp_path):
    """SUMO's own account of every episode; a function that reads the elements of one file after `close`."""
    options = []
    for kind in ("lanechange", "collision"):
        options += [f"--{kind}-output", str(tmp_path / f"{kind}.xml")]
    monkeypatch.setattr(
        env_module, "Simulation", lambda *given, **named: Watched(*given, **named | {"outputs": options})
    )
    return lambda kind: list(ElementTree.parse(tmp_path / f"{kind}.xml").getroot())


def at_random(seed):
    rng = np.random.default_rng(seed)
    return lambda env: int(rng.integers(5))


def always(action):
    return lambda env: action


def in_turn(*actions):
    """These decisions one after the other, then KEEP."""
    left = list(actions)
    return lambda env: left.pop(0) if left else KEEP


def drive(env, decide, seed=7):
    env.reset(seed=seed)
    while not env.is_over:
        env.drive(decide(env))
    return env.trajectory()


def assert_same(one, other):
    for field in dataclasses.fields(one):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        assert np.array_equal(mine, theirs), field.name


def named(env, observation):
    return dict(zip(feature_names(env.config.lidar, env.config.observation), observation.tolist(), strict=True))


def test_the_last_step_tells_how_the_episode_went(make):
    env = make(world(episode={"duration_s": 3.0}))
    env.reset(seed=UNSEEN)
    told = [env.step(KEEP)[4] for _ in range(3)]
    assert told[:2] == [{}, {}]
    assert told[2]["end_reason"] == "duration"
    assert_same(told[2]["trajectory"], env.trajectory())


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
    message = "^a simulation is already running in this process and libsumo holds only one; close it, or drive episodes"
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
    with pytest.raises(RuntimeError, match=r"^the episode is over; call reset\(\)$"):
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


# When an episode ends.


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
    assert (so_far.end_reason, len(so_far.lane_changing), len(so_far.actions)) == (None, 10, 1)


def test_the_duration_ends_the_episode(make):
    driven = drive(make(world(episode={"duration_s": 12.0})), always(KEEP))
    assert (driven.end_reason, len(driven.lane_changing), len(driven.actions)) == ("duration", 120, 12)


@pytest.fixture
def short_road(tmp_path):
    """Three lanes of so many metres."""

    def write(length_m):
        path = tmp_path / "short.net.xml"
        path.write_text(assets.network("highway3").read_text().replace("8200.00", f"{length_m:.2f}"))
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


@pytest.fixture
def two_roads(tmp_path):
    """Two roads 35 m apart with slow cars on one, `beside`; on the other, `highway`, nobody drives."""
    text = assets.network("highway3").read_text()
    edges = text[text.index("<edge") : text.index("</edge>") + len("</edge>")]
    beside = edges.replace("highway", "beside").replace("west", "west2").replace("east", "east2")
    for left, right in ((",-3.20", ",-38.20"), (",0.00", ",-35.00"), (",3.20", ",-31.80")):
        beside = beside.replace(left, right)
    junctions = text[text.index("<junction") : text.index("</net>")]
    more = junctions.replace("highway", "beside").replace('"west"', '"west2"').replace('"east"', '"east2"')
    network, demand = tmp_path / "two.net.xml", tmp_path / "slow.rou.xml"
    network.write_text(text.replace(edges, edges + beside).replace(junctions, junctions + more))
    demand.write_text(
        '<routes><route id="r" edges="beside"/><vType id="slow" maxSpeed="8"/>'
        '<flow id="f" type="slow" route="r" begin="0" end="400" period="5" departLane="random"/></routes>'
    )

    def along(road):
        network_, traffic = {"file": str(network), "course": (road,)}, {"routes": (str(demand),), "warm_up_s": 200.0}
        return world(network=network_, traffic=traffic, episode={"course_m": 7222.0})

    return along


def test_who_drives_on_a_road_beside_the_hosts_is_not_overtaken(make, two_roads):
    on = {road: drive(make(two_roads(road)), always(ACCELERATE)) for road in ("beside", "highway")}
    assert on["beside"].overtakes > 5
    assert on["highway"].overtakes == 0


def test_the_check_tells_of_a_demand_that_never_comes_along_the_course(two_roads):
    assert trial.check(two_roads("beside"))[1] == []
    (told,) = trial.check(two_roads("highway"))[1]
    assert told.startswith(
        "when the host enters, no vehicle of the demand is on its course or on the way to it; lead netw"
    )


def test_the_check_tries_the_demand(tmp_path):
    lost = tmp_path / "lost.rou.xml"
    lost.write_text('<routes><vehicle id="v" depart="0"><route edges="nowhere"/></vehicle></routes>')
    with pytest.raises(InputError, match=r"SUMO .*nowhere"):
        trial.check(world(traffic={"routes": (str(lost),)}))


def test_a_check_that_fails_leaves_no_simulation_open(tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text('<routes><vehicle id="v" depart="500"><route edges="highway"/></vehicle></routes>')
    for _ in range(2):
        with pytest.raises(InputError, match="no vehicle of the demand is on the road at 60 s"):
            trial.check(world(traffic={"routes": (str(late),)}))


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
                TRAFFIC_TYPE,
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
    assert len(driven.lane_changing) * 0.1 - still == pytest.approx(300.0, abs=0.5)


MERGE = """<net version="1.20">
<location netOffset="0,0" convBoundary="0,0,2000,0" origBoundary="0,0,2000,0" projParameter="!"/>
<edge id=":b_0" function="internal">
    <lane id=":b_0_0" index="0" speed="36.11" length="8.00" shape="996,-4.80 1004,-4.80"/>
    <lane id=":b_0_1" index="1" speed="36.11" length="8.00" shape="996,-1.60 1004,-1.60"/>
</edge>
<edge id="wide" from="a" to="b" priority="-1">
    <lane id="wide_0" index="0" speed="36.11" length="996.00" shape="0,-8.00 996,-8.00"/>
    <lane id="wide_1" index="1" speed="36.11" length="996.00" shape="0,-4.80 996,-4.80"/>
    <lane id="wide_2" index="2" speed="36.11" length="996.00" shape="0,-1.60 996,-1.60"/>
</edge>
<edge id="narrow" from="b" to="c" priority="-1">
    <lane id="narrow_0" index="0" speed="36.11" length="996.00" shape="1004,-4.80 2000,-4.80"/>
    <lane id="narrow_1" index="1" speed="36.11" length="996.00" shape="1004,-1.60 2000,-1.60"/>
</edge>
<junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-9.60"/>
<junction id="b" type="priority" x="1000" y="0" incLanes="wide_0 wide_1 wide_2" intLanes=":b_0_0 :b_0_1"
    shape="1004,0 1004,-6.40 996,-9.60 996,0">
    <request index="0" response="00" foes="00" cont="0"/>
    <request index="1" response="00" foes="00" cont="0"/>
</junction>
<junction id="c" type="dead_end" x="2000" y="0" incLanes="narrow_0 narrow_1" intLanes="" shape="2000,-6.40 2000,0"/>
<connection from="wide" to="narrow" fromLane="1" toLane="0" via=":b_0_0" dir="s" state="M"/>
<connection from="wide" to="narrow" fromLane="2" toLane="1" via=":b_0_1" dir="s" state="M"/>
<connection from=":b_0" to="narrow" fromLane="0" toLane="0" dir="s" state="M"/>
<connection from=":b_0" to="narrow" fromLane="1" toLane="1" dir="s" state="M"/>
</net>"""
"""Three lanes, of which the right one ends after a kilometre: what netconvert made of two edges, shortened."""


@pytest.fixture
def merge(tmp_path):
    path = tmp_path / "merge.net.xml"
    path.write_text(MERGE)
    return {"file": str(path)}


@pytest.fixture
def town(tmp_path):
    """The same, but 50 km/h are allowed on the second kilometre, and 30 in the junction before it."""
    path = tmp_path / "town.net.xml"
    narrow = re.sub(r'(<lane id="narrow.*?speed=)"36.11"', r'\1"13.89"', MERGE)
    path.write_text(re.sub(r'(<lane id=":b.*?speed=)"36.11"', r'\1"8.33"', narrow))
    return {"file": str(path)}


@pytest.mark.parametrize("who", ["accelerating", "random", "sumo"])
@pytest.mark.parametrize("traffic", [EMPTY, {"vehicles": 10}])
def test_speed_limits_are_kept_and_braked_for_comfortably(make, watched, town, who, traffic):
    for seed in range(4):
        env = make(world(network=town, traffic=traffic, episode={"duration_s": 300.0}), hands_off=who == "sumo")
        driven = drive(env, at_random(seed) if who == "random" else always(ACCELERATE), UNSEEN + seed)
        fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
        speeds_kmh = driven.speed_mps[1:] * KMH
        assert (speeds_kmh <= np.select([fronts < 996.0, fronts < 1004.0], [80.0, 30.0], 50.0) + 0.1).all()
        if traffic == EMPTY:
            assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s², in every step of 0.1 s
            # Not sooner than it must: from 80 to 30 km/h in (22.2^2 - 8.3^2) / 4 = 106 m, and up to 50 again at once.
            if who != "random":
                assert speeds_kmh[fronts < 885.0].max() == pytest.approx(80.0)
                assert speeds_kmh[fronts < 885.0][-1] > 79.0
                assert speeds_kmh[fronts > 1060.0].min() == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize("traffic", [{"vehicles": 10, "speed_low_kmh": 60.0}])
def test_the_windows_vehicles_keep_to_speed_limits_too(make, watched, town, traffic):
    drive(make(world(network=town, traffic=traffic, episode={"duration_s": 300.0})), always(ACCELERATE), UNSEEN)
    in_town = [
        speed
        for scene in watched().scenes
        for x, length, speed in zip(scene.x_m[1:], scene.length_m[1:], scene.speed_mps[1:], strict=True)
        if x - length > 1004.0
    ]
    assert len(in_town) > 100
    assert max(in_town) <= 13.89 + 0.01


def test_within_a_junction_the_limit_beyond_it_is_kept_in_mind(make, watched, tmp_path):
    path = tmp_path / "fast.net.xml"
    narrow = re.sub(r'(<lane id="narrow.*?speed=)"36.11"', r'\1"13.89"', MERGE)
    path.write_text(re.sub(r'(<lane id=":b.*?)length="8.00"', r'\1length="40.00"', narrow))  # and 130 km/h within
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 60.0}))
    driven = drive(env, always(ACCELERATE), 2)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    assert driven.speed_mps.max() * KMH == pytest.approx(80.0)
    assert (driven.speed_mps[1:] * KMH)[fronts >= 1004.0].max() == pytest.approx(50.0, abs=0.1)


def test_the_host_enters_no_faster_than_it_may(make, tmp_path):
    path = tmp_path / "zone30.net.xml"
    path.write_text(MERGE.replace("36.11", "8.33"))
    driven = drive(make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 5.0})), always(KEEP))
    assert driven.speed_mps == pytest.approx(np.full(51, 8.33))


@pytest.fixture
def signalled(tmp_path):
    """The same, and the signal before the junction turns green after 80 s."""
    path = tmp_path / "signal.net.xml"
    logic = (
        '<tlLogic id="b" type="static" programID="0" offset="0">'
        '<phase duration="80" state="rr"/><phase duration="900" state="GG"/></tlLogic>'
    )
    text = MERGE.replace('id="b" type="priority"', 'id="b" type="traffic_light"')
    text = text.replace("<junction", logic + "<junction", 1)
    for lane in (0, 1):
        text = text.replace(f'via=":b_0_{lane}"', f'via=":b_0_{lane}" tl="b" linkIndex="{lane}"')
    path.write_text(text)
    return path


@pytest.mark.parametrize("hands_off", [False, True])
def test_for_a_red_light_the_host_brakes_comfortably_and_no_sooner_than_it_must(make, watched, signalled, hands_off):
    world_of_its_own = world(network={"file": str(signalled)}, traffic=EMPTY, episode={"duration_s": 100.0})
    driven = drive(make(world_of_its_own, hands_off=hands_off), always(ACCELERATE), UNSEEN)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    times = np.array([scene.time_s for scene in watched().scenes])
    speeds = driven.speed_mps[1:]
    assert 990.0 < fronts[times <= 80.0].max() < 996.0
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s²
    assert speeds[fronts < 996.0 - 130.0][-1] * KMH == pytest.approx(80.0)  # 2.5 m + (80 / 3.6)^2 / 4 = 126 m
    assert speeds[times <= 80.0][-1] == pytest.approx(0.0, abs=0.01)
    assert fronts[-1] > 1050.0


@pytest.mark.parametrize(("away_m", "stops"), [(40.0, False), (80.0, True)])
@pytest.mark.parametrize("hands_off", [False, True])
def test_at_yellow_the_host_stops_if_it_can_comfortably_and_else_drives_on(
    make, watched, signalled, away_m, stops, hands_off
):
    # At 60 km/h it needs (60 / 3.6)^2 / 4 = 69 m, and gets 50 m far in 3 s.
    turns_s = round((796.0 - away_m) / (60 / KMH), 1)  # it starts at 200 m
    red = '<phase duration="80" state="rr"/>'
    yellow = f'<phase duration="{turns_s}" state="GG"/><phase duration="3" state="yy"/>{red}'
    signalled.write_text(signalled.read_text().replace(red, yellow))
    episode = {"duration_s": turns_s + 20.0}
    adas = {"start_speed_kmh": 60.0, "max_speed_kmh": 60.1}
    world_of_its_own = world(network={"file": str(signalled)}, traffic=EMPTY, episode=episode, adas=adas)
    driven = drive(make(world_of_its_own, hands_off=hands_off), always(KEEP), UNSEEN)
    front = watched().scenes[-1].x_m[0] + 0.5 * watched().scenes[-1].length_m[0]
    assert driven.speed_mps[-1] * KMH == pytest.approx(0.0 if stops else 60.0, abs=0.2)
    assert (front < 996.0) == stops
    assert np.diff(driven.speed_mps).min() >= (-0.2 if stops else -0.01) - 1e-6


@pytest.mark.parametrize("vehicles", [0, 16])
def test_close_to_a_red_light_the_host_starts_slower_and_is_none_the_slower_later(make, signalled, vehicles):
    signalled.write_text(re.sub(r'(<lane id="wide.*?)length="996.00"', r'\1length="204.00"', signalled.read_text()))
    network, traffic, episode = {"file": str(signalled)}, {"vehicles": vehicles}, {"duration_s": 120.0}
    for seed in range(3):  # it starts at 200 m
        env = make(world(network=network, traffic=traffic, episode=episode))
        driven = drive(env, always(ACCELERATE), UNSEEN + seed)
        assert 0.0 < driven.speed_mps[0] < 10.0  # of the 16.7 m/s that it was to
        if not vehicles:
            assert driven.speed_mps[10:700].max() < 1.0  # it waits
            assert driven.speed_mps.max() * KMH == pytest.approx(80.0)


@pytest.fixture
def soon_narrow(tmp_path):
    """Three lanes, the right one of which ends 100 m ahead of the host's start."""
    path = tmp_path / "soon.net.xml"
    path.write_text(re.sub(r'(<lane id="wide.*?)length="996.00"', r'\1length="300.00"', MERGE))
    return {"file": str(path)}


def test_the_window_reaches_over_edges_with_other_lanes(make, soon_narrow):
    for seed in range(6):
        env = make(world(network=soon_narrow))
        env.reset(seed=UNSEEN + seed)
        assert len(libsumo.vehicle.getIDList()) > 10
    env.close()
    assert trial.check(world(network=soon_narrow))[1][0].startswith("the road ends 1")


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


@pytest.mark.parametrize("start_lane", [0, 1, 2])
def test_a_lanes_own_limit_holds_on_that_lane_alone(make, tmp_path, start_lane):
    path = tmp_path / "slow.net.xml"
    path.write_text(MERGE.replace('id="wide_0" index="0" speed="36.11"', 'id="wide_0" index="0" speed="13.89"'))
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 30.0}))
    env.reset(seed=1)
    libsumo.vehicle.moveTo(HOST, f"wide_{start_lane}", 10.0)
    for _ in range(25):
        env.drive(ACCELERATE)
    assert env.trajectory().speed_mps[-1] * KMH == pytest.approx(80.0 if start_lane else 50.0, abs=0.1)


def test_a_variable_speed_sign_holds_from_its_moment_on_and_is_braked_for_comfortably(make, tmp_path):
    path, sign = tmp_path / "open.net.xml", tmp_path / "sign.add.xml"
    path.write_text(MERGE)
    steps = '<step time="0" speed="36.11"/><step time="20" speed="13.89"/>'
    sign.write_text(
        f'<additional><variableSpeedSign id="vss" lanes="wide_0 wide_1 wide_2">{steps}</variableSpeedSign></additional>'
    )
    traffic = EMPTY | {"additional": [str(sign)]}
    driven = drive(
        make(world(network={"file": str(path)}, traffic=traffic, episode={"duration_s": 40.0})), always(ACCELERATE), 1
    )
    speeds_kmh = driven.speed_mps * KMH
    assert speeds_kmh.max() == pytest.approx(80.0)
    assert speeds_kmh[-1] == pytest.approx(50.0, abs=0.1)
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6


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


@pytest.mark.parametrize("length_m", [150.0, 250.0, 272.0])
def test_a_road_too_short_to_drive_on_is_refused_before_anybody_drives(short_road, length_m):
    message = (
        f"^network 'short': the course is {length_m:.0f} m long, and the host needs 200 m of it behind its start and "
        "72 m to spare at the end; use a longer course or a smaller traffic.behind_m$"
    )
    with pytest.raises(InputError, match=message):
        HighwayEnv(world(network=short_road(length_m)))


def test_a_demand_that_begins_later_needs_to_be_told_when(make, tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text(
        '<routes><flow id="f" begin="25200" end="25500" period="4" departLane="random"><route edges="highway"/></flow>'
        "</routes>"
    )
    with pytest.raises(InputError, match=r"^no vehicle of the demand is on the road at 60 s; set traffic\.begin_s"):
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


@pytest.mark.parametrize("hands_off", [False, True])
def test_beyond_a_junction_other_lane_numbers_are_no_lane_changes(make, outputs, merge, hands_off):
    env = make(world(network=merge, traffic={"vehicles": 10}, episode={"duration_s": 300.0}), hands_off=hands_off)
    driven = drive(env, always(KEEP), seed=UNSEEN)
    env.close()
    of_host = [entry for entry in outputs("lanechange") if entry.get("id") == HOST]
    assert driven.end_reason == "end of road"
    assert driven.lane_changes == len(of_host)


# Agreement with an onlooker, and with SUMO's own account.


LATE_M = 0.25
"""How far before the border the host becomes a vehicle of the next lane, there and back."""


def onlooker_account(left_m):
    """(lane changes, aborted ones, entries that SUMO must have made) of a host that was here sideways after each step.

    A completed change is one entry for SUMO. An aborted one is two if it had crossed over, there and back, and none
    otherwise; one that the episode's end cuts short is as many as it had made by then.
    """
    lane, offset, farthest = round(left_m[0] / LANE_M), 0.0, 0.0
    changes = aborted = entries = 0
    for now in left_m:
        offset = abs(now - lane * LANE_M)
        farthest = max(farthest, offset)
        settled = round(now / LANE_M)
        if abs(now - settled * LANE_M) < 1e-6 and farthest > 1e-6:
            if settled == lane:
                aborted += 1
                entries += 2 * (farthest >= LANE_M / 2 - LATE_M - 1e-9)
            else:
                changes += 1
                entries += 1
            lane, offset, farthest = settled, 0.0, 0.0
    if farthest >= LANE_M / 2 - LATE_M - 1e-9:
        is_back = offset < farthest and offset <= LANE_M / 2 + LATE_M + 1e-9
        entries += 2 if is_back else 1
    return changes, aborted, entries


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


def test_with_hands_off_decisions_do_nothing(make):
    kept = drive(make(hands_off=True), always(KEEP))
    decided = drive(make(hands_off=True), at_random(1))
    assert np.array_equal(kept.speed_mps, decided.speed_mps)
    assert kept.lane_changes == decided.lane_changes


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


def jumpy(seed):
    """Nothing but sideways."""
    rng = np.random.default_rng(seed)
    return lambda env: int(rng.choice([LEFT, RIGHT]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "sections"),
    [
        (at_random, {}),
        (lambda seed: sideways_or_faster, {}),
        (jumpy, {}),
        (at_random, {"episode": {"decision_period_s": 0.1}}),
        (jumpy, {"episode": {"decision_period_s": 0.3}}),
        (at_random, {"network": {"file": "ring5"}}),
        (at_random, {"traffic": {"routes": ["highway5"]}}),
        (at_random, {"traffic": {"vehicles": 60, "lane_change_every_s": 5.0}}),
    ],
    ids=["random", "sideways", "jumpy", "random every step", "jumpy every 0.3 s", "ring", "demand", "dense"],
)
def test_whatever_is_decided_the_host_touches_nobody_and_never_brakes_beyond_9_mps2(
    make, watched, touching, driver, sections
):
    config = world(**{**sections, "episode": {"duration_s": 300.0} | sections.get("episode", {})})
    changes = 0
    for seed in range(UNSEEN, UNSEEN + 20):
        driven = drive(make(config), driver(seed), seed=seed)
        assert (driven.collisions, driven.struck) == (0, 0), seed
        for scene in watched().scenes:
            assert touching(scene) == [], (seed, scene.time_s)
        assert -np.diff(driven.speed_mps).min() / 0.1 <= 9.0 + 1e-6, seed
        changes += driven.lane_changes
    assert changes > 50


def test_what_came_of_each_decision_is_noted(make):
    env = make(world(episode={"duration_s": 100.0}))
    env.reset(seed=UNSEEN)
    decide, came = at_random(1), []
    while not env.is_over:
        action, mask = decide(env), env.action_masks()
        sideways = action in (MetaAction.LEFT, MetaAction.RIGHT)
        came.append(MetaAction.KEEP if sideways and not mask[action] else action)
        env.drive(action)
    driven = env.trajectory()
    np.testing.assert_array_equal(driven.carried_out, came)
    assert 0 < driven.refused_decisions < (driven.carried_out != driven.actions).sum()  # others were under way
