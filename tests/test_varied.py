import itertools
import math
from collections import Counter
from pathlib import Path

import libsumo
import numpy as np
import pytest

from rail_sumo import config_file, rollout
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway import varied
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import road
from rail_sumo.records import KMH
from rail_sumo.rollout import Task, drive

ANYWHERE = config_file.load(None, ['varied.networks=["highway3", "ring5"]', "episode.duration_s=20"])
MANY = range(2000)


def worlds(*overrides):
    chosen = config_file.load(None, ['varied.networks=["highway3", "ring5"]', *overrides])
    return [varied.draw(chosen, seed) for seed in MANY]


def test_where_no_network_is_named_nothing_varies():
    fixed = Config()
    assert varied.draw(fixed, 7) is fixed


def test_a_seed_draws_the_same_world_again_in_which_nothing_varies():
    drawn = varied.draw(ANYWHERE, 3)
    assert varied.draw(ANYWHERE, 3) == drawn != varied.draw(ANYWHERE, 4)
    assert varied.draw(drawn, 99) is drawn


def test_networks_are_drawn_evenly_and_demand_as_often_as_is_asked_for():
    drawn = worlds("varied.own_demand=0.25")
    kinds = Counter((world.network.file, bool(world.traffic.routes)) for world in drawn)
    for network in ("highway3", "ring5"):  # 4 sigma of 2,000 draws
        assert kinds[network, True] / len(drawn) == pytest.approx(0.125, abs=0.030)
        assert kinds[network, False] / len(drawn) == pytest.approx(0.375, abs=0.044)
    assert all(world.traffic.routes in ((), (world.network.file,)) for world in drawn)


def test_every_figure_of_a_window_is_drawn_from_the_whole_of_its_range():
    window = worlds("varied.own_demand=0", "varied.limit_factor=[0.5, 2.0]", 'varied.networks=["highway3"]')
    limit_kmh = road.load("highway3").highest_limit_mps * KMH
    figures = {
        "limit_factor": ([world.network.limit_factor for world in window], 0.5, 2.0),
        "vehicles": ([world.traffic.vehicles for world in window], 3.0, 21.0),  # 1 to 7 on each of three lanes
        "slowest": ([w.traffic.speed_low_kmh / (limit_kmh * w.network.limit_factor) for w in window], 0.5, 0.8),
        "fastest": ([w.traffic.speed_high_kmh / (limit_kmh * w.network.limit_factor) for w in window], 0.8, 1.0),
        "lorries": ([world.traffic.lorries for world in window], 0.0, 0.3),
    }
    for name, (drawn, lowest, highest) in figures.items():
        assert lowest <= min(drawn) < lowest + 0.05 * (highest - lowest), name
        assert highest >= max(drawn) > highest - 0.05 * (highest - lowest), name
        assert np.mean(drawn) == pytest.approx((lowest + highest) / 2, abs=0.03 * (highest - lowest)), name
    for (one, (these, *_)), (other, (those, *_)) in itertools.combinations(figures.items(), 2):
        assert abs(np.corrcoef(these, those)[0, 1]) < 0.09, (one, other)  # 4 sigma


def test_a_range_of_one_value_is_that_value_and_the_lowest_speed_is_never_above_the_highest():
    drawn = worlds("varied.own_demand=0", "varied.slowest=[0.9, 0.9]", "varied.fastest=[0.6, 1.0]")
    assert all(world.traffic.speed_low_kmh <= world.traffic.speed_high_kmh for world in drawn)
    assert len({world.traffic.speed_low_kmh / world.network.limit_factor for world in drawn}) < 5  # but for rounding


def test_a_configuration_of_sumos_brings_its_own_demand(tmp_path):
    (tmp_path / "my.sumocfg").write_text(
        f"<configuration><net-file value='{road.load('highway3').net_file}'/><route-files value='my.rou.xml'/>"
        "<begin value='100'/><time-to-teleport value='100'/><scale value='3'/></configuration>"
    )
    (tmp_path / "my.rou.xml").write_text(
        "<routes><flow id='f' begin='100' end='400' period='5'><route edges='highway'/></flow></routes>"
    )
    named = f"varied.networks=['{tmp_path / 'my.sumocfg'}']"
    chosen = config_file.load(None, [named, "varied.own_demand=1", "varied.demand_scale=[0.5, 0.5]"])
    traffic = varied.draw(chosen, 0).traffic
    assert (traffic.begin_s, Path(*traffic.routes).name) == (100.0, "my.rou.xml")
    assert sorted(traffic.options) == ["scale=1.5", "time-to-teleport=100"]
    assert [path.name for path in varied.files_of(str(tmp_path / "my.sumocfg"))] == ["highway3.net.xml", "my.rou.xml"]
    assert drive(Task("keep", chosen.changed(episode={"duration_s": 5.0}), 1)).seed == 1


def test_an_unknown_network_is_refused_before_anybody_drives():
    from rail_sumo import run

    with pytest.raises(InputError, match="network 'highway33' not found; did you mean 'highway3'"):
        run.require_drivable(config_file.load(None, ['varied.networks=["highway3", "highway33"]']))


def test_the_environment_draws_a_world_at_every_reset():
    env = HighwayEnv(ANYWHERE)
    try:
        for seed in range(4):
            env.reset(seed=seed)
            assert env.world == varied.draw(ANYWHERE, seed)
            assert env.stretch.road.name == env.world.network.file
    finally:
        env.close()


def test_the_drawn_world_driven_by_itself_is_the_same_episode():
    for seed in range(3):
        drawn = varied.draw(ANYWHERE, seed)
        ours, alone = drive(Task("rule", ANYWHERE, seed)), drive(Task("rule", drawn, seed))
        np.testing.assert_array_equal(ours.observations, alone.observations)
        np.testing.assert_array_equal(ours.speed_mps, alone.speed_mps)


def test_a_limit_factor_holds_on_the_course_for_the_host_and_for_everybody_else():
    env = HighwayEnv(config_file.load(None, ["network.limit_factor=1.5", "observation.speed_limit=true"]))
    try:
        observation, _ = env.reset(seed=1)
        limit_mps = 1.5 * road.load("highway5").highest_limit_mps
        assert env.stretch.road.highest_limit_mps == limit_mps
        assert observation[-1] == env.surroundings()[0].limit_mps == pytest.approx(limit_mps)
        assert [libsumo.lane.getMaxSpeed(f"highway_{lane}") for lane in range(5)] == pytest.approx([limit_mps] * 5)
    finally:
        env.close()


def test_limits_ahead_are_multiplied_too():
    plain, faster = (road.load("ring5", limit_factor=factor) for factor in (1.0, 1.25))
    for one, other in zip(plain.edges, faster.edges, strict=True):
        for lane, faster_lane in zip(one.limits_ahead, other.limits_ahead, strict=True):
            assert [(beyond_m, limit * 1.25) for beyond_m, limit in lane] == list(faster_lane)


def test_an_episode_to_learn_from_that_cannot_begin_is_replaced_by_the_next_of_its_seed(monkeypatch):
    tried = []

    def drive_seldom(task):
        tried.append(task.seed)
        if len(tried) < 3:
            raise InputError("no gap")
        return "driven"

    monkeypatch.setattr(rollout, "drive", drive_seldom)
    assert rollout.practise(Task("keep", Config(), 5)) == "driven"
    assert tried[0] == 5
    assert len(set(tried)) == 3
    first, tried[:] = list(tried), []
    assert rollout.practise(Task("keep", Config(), 5)) == "driven"
    assert tried == first


def test_where_no_episode_to_learn_from_can_begin_the_reason_is_told(monkeypatch):
    tried = []

    def never(task):
        tried.append(task)
        raise InputError("no gap")

    monkeypatch.setattr(rollout, "drive", never)
    with pytest.raises(InputError, match="no gap"):
        rollout.practise(Task("keep", Config(), 5))
    assert len(tried) == rollout.ATTEMPTS


def test_lorries_are_as_many_as_the_share_says_long_and_no_faster_than_90_kmh():
    env = HighwayEnv(
        config_file.load(
            None,
            ["traffic.lorries=0.4", "traffic.vehicles=40", "traffic.speed_low_kmh=100", "traffic.speed_high_kmh=120"],
        )
    )
    n_lorries = n = 0
    try:
        for seed in range(8):
            env.reset(seed=seed)
            for name in set(libsumo.vehicle.getIDList()) - {env.host_name}:
                is_lorry = name.startswith("lorry")
                assert libsumo.vehicle.getLength(name) == (12.0 if is_lorry else 5.0)
                assert (libsumo.vehicle.getMaxSpeed(name) * KMH > 90.001) != is_lorry
                n_lorries += is_lorry
                n += 1
    finally:
        env.close()
    assert n > 200
    assert n_lorries / n == pytest.approx(0.4, abs=4 * math.sqrt(0.24 / n))


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_everybody_wants_to_drive_as_fast_as_the_limit_says(factor):
    env = HighwayEnv(config_file.load(None, [f"network.limit_factor={factor}", "traffic.vehicles=40"]))
    desired_kmh = []
    try:
        for seed in range(8):
            env.reset(seed=seed)
            others = set(libsumo.vehicle.getIDList()) - {env.host_name}
            desired_kmh += [libsumo.vehicle.getMaxSpeed(name) * KMH for name in others]
    finally:
        env.close()
    assert 56.0 * factor <= min(desired_kmh) < 57.0 * factor
    assert 69.0 * factor < max(desired_kmh) <= 70.0 * factor
