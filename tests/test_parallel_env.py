"""Several agents in one simulation: PettingZoo's own tests, and what its page promises."""

import importlib.util
import subprocess
import sys
import warnings

import numpy as np
import pytest
from driving import KEEP, LEFT, RIGHT, UNSEEN, led_off, on_ramp

import rail_sumo
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.isolated_parallel import IsolatedParallel
from rail_sumo.highway.parallel_env import HighwayParallelEnv
from rail_sumo.highway.vehicle.host import Host
from rail_sumo.records import EPISODE_COLUMNS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # it imports games by their old names
    from pettingzoo.test import parallel_api_test, parallel_seed_test

SEED = UNSEEN + 300
SHORT = {"network": {"file": "onramp"}, "episode": {"course_m": 400.0}, "traffic": {"entry_within_s": 60.0}}
"""Hosts depart one after the other, and leave after a little."""
FEW = """<routes><route id="r" edges="highway"/><vType id="lorry" vClass="truck"/>
    <vehicle id="early" route="r" depart="2" departSpeed="max"/>
    <vehicle id="lorry" type="lorry" route="r" depart="70" departLane="1" departSpeed="max"/>
    <vehicle id="one" route="r" depart="80" departSpeed="max"/>
    <vehicle id="two" route="r" depart="82.3" departLane="2" departSpeed="max"/>
</routes>"""


@pytest.fixture
def make():
    made = []

    def make_one(*given, **named):
        made.append(rail_sumo.parallel_env(*given, **named))
        return made[-1]

    yield make_one
    for env in made:
        env.close()


@pytest.fixture
def few(tmp_path):
    """A demand of two cars after the warm-up, in which hosts drive for 10 s."""
    path = tmp_path / "few.rou.xml"
    path.write_text(FEW)
    return {
        "network": {"file": "highway3"},
        "traffic": {"routes": [str(path)], "entry_within_s": 0.0},
        "episode": {"duration_s": 10.0},
    }


def drive(env, seed, decide=lambda name, info, rng: rng.choice(np.flatnonzero(info["action_mask"]))):
    """All that is told in an episode, step by step."""
    rng = np.random.default_rng(seed)
    observations, infos = env.reset(seed=seed)
    told = [(observations, infos)]
    while env.agents:
        actions = {name: int(decide(name, infos[name], rng)) for name in env.agents}
        told.append(env.step(actions))
        infos = told[-1][-1]
    return told


def same(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    return np.array_equal(one, other)


def truncations_at(told, step):
    return {name for name, is_over in told[step][3].items() if is_over}


# PettingZoo's own.


def test_pettingzoos_api_test_passes_with_agents_that_come_late_and_leave(make):
    parallel_api_test(make(4, SHORT), num_cycles=1000)


def test_it_passes_where_some_never_depart(make, few):
    parallel_api_test(make(3, few), num_cycles=1000)


def test_pettingzoos_seed_test_passes_in_processes_of_their_own():
    parallel_seed_test(lambda: rail_sumo.parallel_env(3, SHORT, isolated=True), num_cycles=20)


# Its agents.


def test_they_come_one_after_the_other_live_once_and_end_with_their_figures(make):
    env = make(4, SHORT)
    told = drive(env, SEED)
    assert told[0][0].keys() == {"host_0"}
    assert len(env.vehicles) == 4
    living, ended = {"host_0"}, set()
    for observations, rewards, terminations, truncations, infos in told[1:]:
        assert observations.keys() == rewards.keys() == terminations.keys() == truncations.keys() == infos.keys()
        assert living <= observations.keys()
        assert not ended & observations.keys()
        over = {name for name in observations if terminations[name] or truncations[name]}
        for name, observation in observations.items():
            assert env.observation_space(name).contains(observation)
            assert (infos[name]["action_mask"].dtype, infos[name]["action_mask"].shape) == (np.int8, (5,))
            of_any_step = {"action_mask", "carried_out"} if name in living else {"action_mask"}
            if name in over:
                assert set(infos[name]) == {*of_any_step, "is_success", *EPISODE_COLUMNS} - {"policy", "episode"}
                assert (infos[name]["end_reason"], truncations[name]) == ("course", True)
                assert 400.0 <= infos[name]["distance_m"] < 450.0
            else:
                assert infos[name].keys() == of_any_step
        living, ended = observations.keys() - over, ended | over
    assert ended == set(env.possible_agents)
    with pytest.raises(RuntimeError, match="no episode is under way, or it is over; call reset"):
        env.step({})
    _, infos = env.reset(seed=SEED)
    with pytest.raises(ValueError, match=r"there is no agent host_99, only host_0 to host_\d+"):
        env.step(dict.fromkeys(env.agents, KEEP) | {"host_99": KEEP})


def test_they_are_the_first_cars_after_the_warm_up_and_none_is_forgotten(make, few):
    env = make(3, few)
    told = drive(env, SEED, lambda name, info, rng: KEEP)
    assert env.vehicles == {"host_0": "one", "host_1": "two"}
    entered = [next(k for k, one in enumerate(told) if name in one[0]) for name in env.possible_agents]
    assert entered == [0, 3, 13]  # 2.3 s later, at the next whole second; the third when the road is empty
    *_, truncations, infos = told[14]
    assert truncations == {"host_2": True}
    assert infos["host_2"]["end_reason"] == "not begun"
    assert not infos["host_2"]["is_success"]
    np.testing.assert_array_equal(infos["host_2"]["action_mask"], [1, 0, 0, 0, 0])
    assert truncations_at(told, 10) == {"host_0"}
    assert truncations_at(told, 13) == {"host_1"}  # its ten seconds end 12.3 s after the first entry
    ended = {name: info for one in told for name, info in one[-1].items() if "duration_s" in info}
    assert {name: info["duration_s"] for name, info in ended.items()} == {"host_0": 10.0, "host_1": 10.0}
    assert len(told) == 15


def test_where_nobody_is_left_it_drives_on_until_the_next_departs(make, few, tmp_path):
    path = tmp_path / "far.rou.xml"
    path.write_text(FEW.replace("82.3", "100.3"))
    env = make(2, few | {"traffic": {"routes": [str(path)], "entry_within_s": 0.0}})
    told = drive(env, SEED, lambda name, info, rng: KEEP)
    observations, rewards, _, truncations, _ = told[10]
    assert truncations == {"host_0": True, "host_1": False}
    assert rewards["host_1"] == 0.0
    assert observations["host_1"].any()
    assert len(told) == 21


def test_a_collision_ends_the_episode_of_that_agent_alone(make, monkeypatch):
    env, note = make(2, {"network": {"file": "highway5"}, "episode": {"duration_s": 12.0}}), Host.note

    def struck(host):
        note(host)
        if host.name == env.vehicles.get("host_0") and len(host.speeds_mps) == 45:
            host.struck, host.contact = 1, True

    monkeypatch.setattr(Host, "note", struck)
    ends = {}
    for _, rewards, terminations, truncations, infos in drive(env, SEED, lambda name, info, rng: KEEP)[1:]:
        for name in terminations:
            if terminations[name] or truncations[name]:
                ends[name] = (terminations[name], truncations[name], rewards[name], infos[name])
    crashed, whole = ends["host_0"], ends["host_1"]
    assert crashed[:2] == (True, False)
    assert crashed[2] < -5.0
    assert (crashed[3]["end_reason"], crashed[3]["struck"], crashed[3]["is_success"]) == ("collision", 1, False)
    assert crashed[3]["duration_s"] == pytest.approx(4.4)
    assert whole[:2] == (False, True)
    assert (whole[3]["duration_s"], whole[3]["is_success"]) == (12.0, True)


def test_one_that_parks_is_truncated(make, tmp_path):
    routes = tmp_path / "own.rou.xml"
    routes.write_text(
        '<routes><vType id="car" sigma="0"/><route id="r" edges="highway"/>'
        '<vehicle id="one" type="car" route="r" depart="70" departLane="0" departSpeed="20">'
        '<stop lane="highway_0" endPos="900" duration="30" parking="true"/></vehicle></routes>'
    )
    env = make(1, {"network": {"file": "highway3"}, "traffic": {"routes": [str(routes)]}})
    *_, truncations, infos = drive(env, SEED, lambda name, info, rng: KEEP)[-1]
    assert truncations == {"host_0": True}
    info = infos["host_0"]
    assert info["end_reason"] == "left the road"
    assert info["distance_m"] == pytest.approx(900.0, abs=10.0)
    assert info["speed_kmh"] == pytest.approx(3.6 * info["distance_m"] / info["duration_s"])
    assert info["action_mask"].tolist() == [1, 0, 0, 0, 0]


# One of them drives as the single host does.


@pytest.mark.parametrize("network", ["highway3", "ring5", "arterial"])
def test_one_agent_is_told_what_the_single_environment_tells_bit_for_bit(make, network):
    """Without lane changes, after which a single host decides at once."""
    world = {
        "network": {"file": network},
        "traffic": {"routes": [network], "entry_within_s": 60.0},
        "episode": {"duration_s": 30.4},  # no whole number of decisions
    }
    env = make(1, world)
    together = drive(env, SEED, lambda name, info, rng: rng.integers(3))
    env.close()
    alone, rng, over = HighwayEnv(env.config), np.random.default_rng(SEED), False
    told = [alone.reset(seed=SEED)]
    assert alone.host_name == env.vehicles["host_0"]
    while not over:
        told.append(alone.step(rng.integers(3)))
        over = told[-1][2] or told[-1][3]
    alone.close()
    assert len(told) == 32
    assert same([tuple({"host_0": one} for one in step) for step in told], together)


def test_its_lane_changes_are_the_single_hosts_step_for_step(make):
    """When a change has ended a single host decides at once; to keep is the same then as to wait."""
    world = {
        "network": {"file": "highway3"},
        "traffic": {"routes": ["highway3"], "entry_within_s": 60.0},
        "episode": {"duration_s": 30.0},
    }
    env, asked = make(1, world), iter([LEFT])
    env.reset(seed=SEED)
    agent = env.agent("host_0")
    for _ in range(30):
        mask = agent.mask
        env.step({"host_0": next(asked, KEEP) if mask[LEFT] else KEEP})
    env.close()
    alone, asked = HighwayEnv(env.config), iter([LEFT])
    alone.reset(seed=SEED)
    while not alone.is_over:
        mask = alone.agent.mask
        alone.drive(next(asked, KEEP) if mask[LEFT] else KEEP)
    expected = alone.trajectory()
    alone.close()
    found = agent.trajectory(SEED)
    assert found.lane_changes == expected.lane_changes == 1
    assert len(found.decisions) == 30 < len(expected.decisions)
    np.testing.assert_array_equal(found.speed_mps, expected.speed_mps)
    np.testing.assert_array_equal(found.lane_changing, expected.lane_changing)
    assert found.distance_m == expected.distance_m


def test_an_agent_follows_the_route_that_it_is_given_on_its_way(make, tmp_path):
    one = '<vehicle id="one" type="car" route="through" depart="1" departLane="0" departSpeed="max"/>'
    files = {"routes": on_ramp(tmp_path, one), "additional": led_off(tmp_path)}
    traffic = files | {"entry_within_s": 0.0, "warm_up_s": 0.0}
    env = make(1, {"network": {"file": "onramp"}, "traffic": traffic, "episode": {"course_m": 9999.0}})
    told = [infos["host_0"] for *_, infos in drive(env, SEED, lambda name, info, rng: KEEP) if infos]
    assert told[-1]["end_reason"] == "end of road"
    assert 2200.0 < told[-1]["distance_m"] < 2600.0, "short of the end of the exit"


# The same seed, the same bits.


def test_the_same_seed_tells_the_same_here_and_in_a_child_process(make):
    here, there = make(3, SHORT), make(3, SHORT, isolated=True)
    assert isinstance(here, HighwayParallelEnv)
    assert isinstance(there, IsolatedParallel)
    first = drive(here, SEED)
    assert same(first, drive(here, SEED))
    assert same(first, drive(there, SEED))
    assert not same(first, drive(there, SEED + 1))


def test_seeds_follow_from_the_first(make, few):
    env = make(1, few)
    seeds = []
    for seed in (5, None, 5, None):
        env.reset(seed=seed)
        seeds.append(env._seed)
    assert seeds[0] == 5
    assert seeds[:2] == seeds[2:]
    assert seeds[1] != 5


# They keep clear of one another.


def test_of_two_who_are_told_one_gap_at_the_same_moment_one_is_refused(make, tmp_path, touching):
    routes = tmp_path / "two.rou.xml"
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0"/><route id="r" edges="highway"/>'
        '<vehicle id="right" type="car" route="r" depart="61" departLane="0" departPos="50" departSpeed="20"/>'
        '<vehicle id="left" type="car" route="r" depart="61" departLane="2" departPos="52" departSpeed="20"/></routes>'
    )
    world = {"network": {"file": "highway3"}, "traffic": {"routes": [str(routes)]}, "episode": {"duration_s": 20.0}}
    env = make(2, world | {"adas": {"gain_s": 0.0}})
    _, infos = env.reset(seed=SEED)
    sides = {name: LEFT if env.vehicles[name] == "right" else RIGHT for name in env.agents}
    assert all(infos[name]["action_mask"][side] for name, side in sides.items())
    env.step(sides)
    assert [env.agent(name).is_changing_lane for name in env.agents] == [True, False]
    assert [env.agent(name).refused_decisions for name in env.agents] == [0, 1]
    for _ in range(15):
        env.step(dict.fromkeys(env.agents, KEEP))
        assert not touching(env.agent("host_0").scene)


# What can be wrong.


@pytest.mark.parametrize(
    ("hosts", "config", "said"),
    [
        (0, None, "hosts must be at least 1"),
        (2, {"varied": {"networks": ["highway3"]}}, r"leave out varied\.networks"),
        (2, {"traffic": {"host": "added", "routes": ["highway5"]}}, r"leave out traffic\.host, which is 'added'"),
        (2, {"trafic": {}}, "did you mean 'traffic'"),
    ],
)
@pytest.mark.parametrize("isolated", [False, True])
def test_bad_input_is_one_clear_line(hosts, config, said, isolated):
    with pytest.raises(InputError, match=said) as told:
        rail_sumo.parallel_env(hosts, config, isolated=isolated)
    assert "\n" not in str(told.value)


def test_a_network_or_a_demand_without_cars_is_told(tmp_path, network):
    with pytest.raises(InputError, match=r"has none; name its files in traffic\.routes"):
        rail_sumo.parallel_env(2, {"network": {"file": network('<edge id="a" from="a-" to="a+"/>')}})
    empty = tmp_path / "empty.rou.xml"
    empty.write_text('<routes><route id="r" edges="highway"/></routes>')
    world = {"network": {"file": "highway3"}, "traffic": {"routes": [str(empty)]}}
    with pytest.raises(InputError, match="the demand has no <vehicle>"):
        rail_sumo.parallel_env(2, world)
    empty.write_text(FEW.replace('vehicle id="one"', 'vehicle id="one" type="lorry"').replace("82.3", "9"))
    env = rail_sumo.parallel_env(2, world)
    with pytest.raises(InputError, match="no car that the host could replace departed"):
        env.reset(seed=1)
    env.close()


def test_an_agent_without_an_action_is_named(make, few):
    env = make(2, few)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="no action for host_0"):
        env.step({})
    with pytest.raises(ValueError, match=r"one whole number \(0 keep, .*\); got 9"):
        env.step({"host_0": 9})


def test_without_pettingzoo_the_extra_is_named(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr("rail_sumo.highway.make.find_spec", lambda name: None if name == "pettingzoo" else found(name))
    with pytest.raises(InputError, match=r"pip install 'rail-sumo\[multi\]'"):
        rail_sumo.parallel_env()


def test_asking_for_it_imports_no_sumo_and_an_unknown_name_is_told():
    program = (
        "import sys, rail_sumo; assert 'parallel_env' in rail_sumo.__all__; "
        "assert not {'libsumo', 'torch', 'pettingzoo'} & set(sys.modules); "
        "assert callable(rail_sumo.parallel_env); assert not {'torch', 'pettingzoo'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    with pytest.raises(AttributeError, match="no attribute 'serial_env'"):
        _ = rail_sumo.serial_env


def test_a_shipped_network_takes_its_shipped_demand(make):
    env = make(config={"network": {"file": "ring5"}})
    assert env.config.traffic.routes == ("ring5",)
    assert env.possible_agents == [f"host_{number}" for number in range(8)]
    for name in env.possible_agents:
        assert env.observation_space(name) is env.observation_space(name)
        assert env.action_space(name) is env.action_space(name)


def test_one_that_ends_before_its_first_decision_is_told_so_at_the_next(make, few, monkeypatch):
    env, note = make(2, few), Host.note

    def struck(host):
        note(host)
        if host.name == "two" and len(host.speeds_mps) == 4:
            host.struck, host.contact = 1, True

    monkeypatch.setattr(Host, "note", struck)
    told = drive(env, SEED, lambda name, info, rng: KEEP)
    assert told[3][2] == {"host_0": False, "host_1": False}
    assert told[3][-1]["host_1"].keys() == {"action_mask"}
    assert told[4][2] == {"host_0": False, "host_1": True}
    assert told[4][-1]["host_1"]["end_reason"] == "collision"
    assert "host_1" not in told[5][0]
