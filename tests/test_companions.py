"""Vehicles of the made traffic that are driven too, looked at in SUMO."""

import itertools
import math

import libsumo
import numpy as np
import pytest
from driving import KEEP, UNSEEN, assert_same, at_random, world
from sketch import cut_road

from rail_sumo import config_file, rollout
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import ground
from rail_sumo.highway.parallel_env import HighwayParallelEnv
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.traffic.fleet import Fleet
from rail_sumo.highway.vehicle.abilities import HOST_TYPE
from rail_sumo.highway.vehicle.host import SUMO_CHANGES_LANES
from rail_sumo.records import KMH, MetaAction
from rail_sumo.rollout import Task, deciders, drive, workers

SEED = UNSEEN + 200


def among(driven, *, network="highway5", seconds=60.0, **traffic):
    """The default world for some seconds, in which so many of the window's vehicles are driven."""
    return config_file.validate(
        {"network": {"file": network}, "episode": {"duration_s": seconds}, "traffic": {"driven": driven, **traffic}}
    )


def always(action):
    return lambda vehicle: lambda observation, agent: action


def cars_of_ours():
    """Those but the host that are of its type, which SUMO tells."""
    kinds = {name: libsumo.vehicle.getTypeID(name).partition("@")[0] for name in libsumo.vehicle.getIDList()}
    return {name for name, kind in kinds.items() if kind == HOST_TYPE} - {HOST}


# Nobody.


@pytest.mark.parametrize("name", ["rule", "random"])
@pytest.mark.parametrize("network", ["highway3", "ring5"])
def test_where_there_is_nobody_to_drive_the_episode_is_that_without_to_the_byte(network, name):
    """Lorries are not driven; so the loop for many drives the host alone."""
    without, with_all = (drive(Task(name, among(n, network=network, lorries=1.0), SEED)) for n in (0, 18))
    assert_same(without, with_all)


def test_of_no_driven_vehicles_there_are_no_companions(make):
    env = make(among(0), companions=always(KEEP))
    env.reset(seed=SEED)
    assert env.companions is None
    assert cars_of_ours() == set()


# All of them.


@pytest.mark.parametrize("name", ["rule", "random"])
@pytest.mark.parametrize("network", ["highway3", "highway5", "ring5"])
def test_where_all_are_driven_each_decides_once_a_second_and_nobody_is_touched(make, touching, network, name):
    config = among(18, network=network)
    by_name = deciders(name, config, SEED)
    decided_s = {}

    def noting(vehicle):
        decide, decided_s[vehicle] = by_name(vehicle), []

        def decides(observation, agent):
            decided_s[vehicle].append(libsumo.simulation.getTime())
            return decide(observation, agent)

        return decides

    touched, on_road_s = [], {}

    def look(simulation):
        for vehicle in libsumo.vehicle.getIDList():
            on_road_s.setdefault(vehicle, []).append(simulation.now_s)
        touched.extend(touching(simulation.scene(host, sees_m=50.0)) for host in simulation.hosts)

    for seed in (SEED, SEED + 1):
        decided_s.clear()
        on_road_s.clear()
        env, driver = make(config, companions=noting), rollout.driver_of(name, config, seed)
        observation, _ = env.reset(seed=seed)
        env.watch(look)
        while not env.is_over:
            observation, _ = env.drive(driver.decide(observation, env.agent))
        assert env.companions.contacts == 0
        assert env.agent.end == "duration"
        del on_road_s[HOST]
        assert decided_s.keys() == on_road_s.keys()
        for vehicle, times_s in decided_s.items():
            seen_s = on_road_s[vehicle]
            assert times_s[0] == pytest.approx(seen_s[0])
            gaps_s = np.diff([*times_s, seen_s[-1]])
            assert gaps_s.max(initial=0.0) < 1.0 + 1e-6
        assert sum(map(len, decided_s.values())) > 400
    assert not any(touched)


def test_two_workers_drive_bit_for_bit_what_one_drives():
    tasks = [Task(name, among(6, seconds=40.0), seed) for name in ("random", "rule") for seed in (SEED, SEED + 1)]
    alone = list(map(drive, tasks))
    with workers(2) as two:
        together = list(two.map(drive, tasks[::-1]))[::-1]
    for one, other in zip(alone, together, strict=True):
        assert_same(one, other)


def test_filmed_it_is_the_same_and_the_film_shows_them():
    task = Task("random", among(18), SEED)
    camera, filmed = rollout.film(task)
    assert_same(filmed, drive(task))
    film = camera.film("random", filmed, ground.near("highway5", *camera.places))
    assert {vehicle.id for vehicle in film.vehicles} >= {HOST, *(f"car{number}" for number in range(15))}


def test_each_draws_for_itself():
    by_name = deciders("random", among(2), SEED)

    def drawn(decide):
        return [decide(None, None) for _ in range(50)]

    assert drawn(by_name("car0")) == drawn(by_name("car0"))
    mine = rollout.driver_of("random", among(2), SEED).decide
    of_another_seed = deciders("random", among(2), SEED + 1)("car0")
    for one, other in itertools.combinations((by_name("car0"), by_name("car1"), mine, of_another_seed), 2):
        assert drawn(one) != drawn(other)


# Some of them.


def test_so_many_stay_driven_for_those_that_leave_others_are(make):
    env = make(among(6, seconds=200.0), companions=deciders("random", among(6), SEED))
    decide = at_random(SEED)
    env.reset(seed=SEED)
    assert cars_of_ours() == {f"car{number}" for number in range(6)}, "the first"
    known, numbers = set(), []
    while not env.is_over:
        env.drive(decide(env))
        assert cars_of_ours() == set(env.companions.names)
        numbers.append(len(env.companions.names))
        known |= cars_of_ours()
    assert len(known) > 9
    assert max(numbers) == 6
    assert np.mean(numbers) > 5.5  # those that enter are driven from their first step on


def test_lorries_are_not_driven(make):
    env = make(among(18, lorries=0.5), companions=deciders("random", among(18), SEED))
    decide = at_random(SEED)
    env.reset(seed=SEED)
    while not env.is_over:
        env.drive(decide(env))
        others = set(libsumo.vehicle.getIDList()) - {HOST}
        assert cars_of_ours() == {name for name in others if name.startswith("car")}
        assert any(name.startswith("lorry") for name in others)


def test_they_enter_at_the_speed_that_was_drawn_and_drive_as_fast_as_they_decide(make):
    fastest_kmh = {}
    for action in (MetaAction.KEEP, MetaAction.ACCELERATE, MetaAction.DECELERATE):
        env = make(among(1, vehicles=1, speed_low_kmh=68.0, speed_high_kmh=68.0), companions=always(action))
        env.reset(seed=SEED)
        assert libsumo.vehicle.getSpeed("car0") * KMH == pytest.approx(68.0, abs=0.1)
        for _ in range(15):
            env.drive(KEEP)
        fastest_kmh[action] = libsumo.vehicle.getSpeed("car0") * KMH
    assert fastest_kmh == pytest.approx({KEEP: 68.0, MetaAction.ACCELERATE: 80.0, MetaAction.DECELERATE: 40.0}, abs=0.1)


def test_only_the_hosts_course_ends_the_episode(make):
    far = among(1, vehicles=1, ahead_m=2000.0).changed(episode={"course_m": 400.0, "duration_s": math.inf})
    env = make(far, companions=always(MetaAction.ACCELERATE))
    env.reset(seed=SEED)
    while not env.is_over:
        env.drive(MetaAction.DECELERATE)
    assert env.agent.end == "course"
    assert libsumo.vehicle.getDistance("car0") > 600.0
    assert env.companions.names == ["car0"]


def test_a_driven_vehicle_is_never_ordered_to_change_lanes(make, monkeypatch):
    ordered, order = [], Simulation.order_lane_change

    def noted(simulation, name, lane):
        ordered.append(name in cars_of_ours())
        order(simulation, name, lane)

    monkeypatch.setattr(Simulation, "order_lane_change", noted)
    env = make(among(9, lane_change_every_s=2.0), companions=always(KEEP))
    env.reset(seed=SEED)
    while not env.is_over:
        env.drive(KEEP)
    assert len(ordered) > 50
    assert not any(ordered)


def test_the_traffic_is_told_of_those_that_change_lanes(make, monkeypatch):
    """Nobody near them is ordered to change lanes then."""
    near_m, order = [], Simulation.order_lane_change

    def noted(simulation, name, lane):
        x_m = libsumo.vehicle.getPosition(name)[0]
        changing = [one for one in cars_of_ours() if libsumo.vehicle.getLateralLanePosition(one)]
        near_m.extend(abs(libsumo.vehicle.getPosition(one)[0] - x_m) for one in changing)
        order(simulation, name, lane)

    monkeypatch.setattr(Simulation, "order_lane_change", noted)
    config = among(9, lane_change_every_s=2.0, seconds=150.0)
    env = make(config, companions=deciders("random", config, SEED))
    env.reset(seed=SEED)
    while not env.is_over:
        env.drive(KEEP)
    assert len(near_m) > 50
    assert min(near_m) > 39.9


def test_the_driver_sumo_drives_them_too(make):
    env = make(among(6), hands_off=True, companions=always(KEEP))
    env.reset(seed=SEED)
    assert len(env.companions.names) == 6
    modes = {libsumo.vehicle.getLaneChangeMode(name) for name in cars_of_ours()}
    assert modes == {SUMO_CHANGES_LANES}
    while not env.is_over:
        env.drive(KEEP)
    assert env.companions.contacts == 0


def test_at_the_end_of_the_road_sumo_drives_them_on(make, tmp_path):
    network = tmp_path / "short.net.xml"
    network.write_text(cut_road(1500.0, lanes=3))
    config = world(
        network={"file": str(network)}, traffic={"driven": 18}, episode={"course_m": math.inf, "duration_s": 300.0}
    )
    env = make(config, companions=deciders("rule", config, SEED))
    env.reset(seed=SEED)
    ours, gone_on, arrived = set(), set(), set()

    def look(simulation):
        arrived.update(libsumo.simulation.getArrivedIDList())
        ours.update(cars_of_ours())
        gone_on.update((ours - cars_of_ours()) & set(libsumo.vehicle.getIDList()))

    env.watch(look)
    while not env.is_over:
        env.drive(KEEP)
    assert env.agent.end == "end of road"
    assert env.companions.contacts == 0
    assert len(arrived & ours) > 3
    assert arrived & ours <= gone_on


def test_what_holds_for_the_host_alone_does_not_hold_for_them(make):
    """They are of one vehicle type."""
    env = make(among(6), companions=always(MetaAction.ACCELERATE))
    env.reset(seed=SEED)
    env.agent.host.abilities.hold_below(10.0)
    assert libsumo.vehicle.getMaxSpeed(HOST) == 10.0
    assert libsumo.vehicletype.getMaxSpeed(HOST_TYPE) == pytest.approx(80 / KMH, abs=0.01)


# What cannot be.


def test_nobody_decides_for_them():
    with pytest.raises(InputError, match=r"^traffic.driven is 5, and nobody decides .* set traffic.driven to 0$"):
        HighwayEnv(among(5))


def test_a_driver_in_place_of_its_decisions(make):
    driver = rollout.driver_of("keep", among(5), SEED)
    env = make(among(5), companions=lambda vehicle: driver)
    with pytest.raises(InputError, match=r"; got a Keep: of a driver give its `decide`$"):
        env.reset(seed=SEED)
    make(among(5), companions=lambda vehicle: driver.decide).reset(seed=SEED)


def test_more_than_there_are():
    with pytest.raises(InputError, match=r"driven 19 is above vehicles 18, of which they are; lower it$"):
        among(19)


@pytest.mark.parametrize(
    "with_them",
    [
        lambda config: HighwayEnv(config, companions=always(KEEP)),
        lambda config: HighwayParallelEnv(config),
        lambda config: Fleet(config, 0.5, SEED, "nothing").drive(10.0),
    ],
)
def test_a_demand_has_none(with_them):
    with pytest.raises(InputError, match=r"^traffic.driven is 5, and such vehicles are of the made .*sweep share$"):
        with_them(among(5, routes=("highway5",)))


def test_from_the_command_line(rail_sumo):
    code, _, said = rail_sumo("eval", "rule", "--set", "traffic.driven=5", "--routes", "highway5", "--episodes", "1")
    assert (code, said.count("\n")) == (2, 1)
    assert "sweep share" in said
    assert rail_sumo("network", "check", "highway5")[0] == 0
