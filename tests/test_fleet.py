"""Many driven vehicles in one simulation, in SUMO."""

import math
import re
import shlex
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import libsumo
import numpy as np
import pandas as pd
import pytest
from driving import ACCELERATE, KEEP, LEFT, ONE, RIGHT, UNSEEN, closing, led_off, on_ramp
from hypothesis import given
from hypothesis import strategies as st
from sketch import cut_road, oval, with_exit

from rail_sumo import config_file, rollout, roster
from rail_sumo.errors import InputError
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic import fleet
from rail_sumo.highway.traffic.fleet import Fleet, is_driven

SEED = UNSEEN + 100


def with_demand(network, routes="", options=(), **sections):
    traffic = {"routes": [str(routes or network)], "options": list(options)}
    return config_file.validate({"network": {"file": str(network)}, "traffic": traffic} | sections)


def watched(monkeypatch, look):
    """Look at the simulation after every step."""
    step = Simulation.step

    def looking(simulation):
        gone = step(simulation)
        look(simulation)
        return gone

    monkeypatch.setattr(Simulation, "step", looking)


def driver(name, world):
    return lambda vehicle: rollout.driver_of(name, world, sum(vehicle.encode())).decide


@pytest.mark.slow
def test_on_a_street_with_signals_driven_cars_touch_nobody_where_they_turn_across_it_either(tmp_path):
    """When they came to ways without priority ready to brake by 3.4 m/s², and saw less there, two of 447 were hit."""
    world, contacts = with_demand("arterial"), ("--collision-output", str(tmp_path / "c.xml"))
    driven = Fleet(world, 1.0, 0, driver("rule", world), contacts)
    driven.drive(500.0)
    assert len(driven.inserted) > 200
    assert not list(ElementTree.parse(tmp_path / "c.xml").iter("collision"))


def test_in_tight_bends_where_rays_end_on_others_in_their_own_lanes_driven_cars_keep_to_theirs(tmp_path):
    """Nobody is faster than the others. `road-rail` took who was round the bend for somebody ahead of it."""
    network, demand, told = tmp_path / "oval.net.xml", tmp_path / "oval.rou.xml", tmp_path / "changes.xml"
    network.write_text(oval(60.0, 20.0))
    cars = "".join(f'<vehicle id="{n}" route="laps" depart="{2 * n}" departLane="{n % 3}"/>' for n in range(10))
    demand.write_text(f'<routes><route id="laps" edges="half0 half1" repeat="20"/>{cars}</routes>')
    changes = {}
    for gain_s in (0.0, "by traffic"):
        world = with_demand(network, demand, adas={"gain_s": gain_s})
        who = roster.find_driver("road-rail", world)
        rollout.fleet_of(who, world, 1.0, UNSEEN, ("--lanechange-output", str(told))).drive(180.0)
        changes[gain_s] = len(list(ElementTree.parse(told).iter("change")))
    assert changes["by traffic"] < 5 < 30 < changes[0.0], changes


def test_on_a_fast_road_driven_cars_sort_themselves_before_an_exit_and_none_slows_down_for_that(tmp_path, monkeypatch):
    """Up to three lanes to cross at 30 m/s. From 300 m a lane on it was too late for some: down to 20 and 23 m/s."""
    network, demand = tmp_path / "exit.net.xml", tmp_path / "exit.rou.xml"
    network.write_text(with_exit(1500.0, lanes=4))
    flow = '<flow id="{0}{1}" type="car" route="{0}" begin="1" end="240" period="exp({2})" departLane="{1}" '
    flow += 'departSpeed="desired"/>'
    demand.write_text(
        '<routes><vType id="car" speedFactor="normc(1,0.1,0.8,1.2)"/><route id="main" edges="part0 main"/>'
        '<route id="exit" edges="part0 exit"/>'
        + flow.format("exit", "random", 1 / 6)
        + "".join(flow.format("main", lane, 1 / 5) for lane in (1, 2, 3))
        + "</routes>"
    )
    slowest_mps = {}

    def look(simulation):
        for name in libsumo.vehicle.getIDList():
            if name.startswith("exit") and libsumo.vehicle.getLaneID(name).startswith("part0"):
                slowest_mps[name] = min(slowest_mps.get(name, math.inf), libsumo.vehicle.getSpeed(name))

    watched(monkeypatch, look)
    world = with_demand(network, demand)
    for seed in (SEED, SEED + 1):
        driven = Fleet(world, 1.0, seed, driver("rule", world))
        driven.drive(300.0)
        assert driven.contacts == 0
        assert len(slowest_mps) > 25
        assert min(slowest_mps.values()) > 23.0
        slowest_mps.clear()


JOINING = (
    """<routes>
    <vType id="car" maxSpeed="27.8" speedFactor="normc(1,0.1,0.8,1.2)"/>
    <route id="main" edges="main3 merge2 main4"/>
    <route id="ramp" edges="on2 merge2 main4"/>
    <flow id="ramp" type="car" route="ramp" begin="1" end="600" period="exp(0.2)" departSpeed="max"/>"""
    + "".join(
        f'<flow id="main{lane}" type="car" route="main" begin="1" end="600" period="exp(0.45)" departLane="{lane}" '
        'departSpeed="desired"/>'
        for lane in range(3)
    )
    + "</routes>"
)
"""1,600 vehicles an hour in each of three lanes, and 700 that join them from a ramp at 60 km/h."""


FASTER = JOINING.replace('maxSpeed="27.8"', 'maxSpeed="36"').replace("exp(0.45)", "exp(0.28)")
"""1,000 vehicles an hour in each lane, at 120 km/h."""


@pytest.mark.parametrize("demand", [JOINING, FASTER], ids=["100 km/h", "120 km/h"])
def test_on_an_acceleration_lane_driven_cars_speed_up_and_have_nobody_slow_down(tmp_path, monkeypatch, demand):
    """Who braked comfortably for the lane's end and wanted the whole time gap came down to 10.5 m/s.

    Beside those at 120 km/h, of whom none makes room for whom it could not stop behind, they stood at the lane's end.
    """
    file = tmp_path / "joining.rou.xml"
    file.write_text(demand)
    slowest_mps = {}

    def look(simulation):
        for name in libsumo.vehicle.getIDList():
            lane = libsumo.vehicle.getLaneID(name)
            if lane.startswith("merge2") and (lane == "merge2_0" or not name.startswith("ramp")):
                slowest_mps[name] = min(slowest_mps.get(name, math.inf), libsumo.vehicle.getSpeed(name))

    watched(monkeypatch, look)
    world = with_demand("onramp", file)
    Fleet(world, 1.0, 0, driver("rule", world)).drive(150.0)
    assert len([name for name in slowest_mps if name.startswith("ramp")]) > 20
    assert len(slowest_mps) > 100
    assert min(slowest_mps.values()) > 12.0


@pytest.mark.parametrize(("gap_s", "goes_first"), [(6.0, False), (10.0, True), (15.0, True)])
def test_whoever_stands_at_a_line_takes_a_gap_that_is_long_enough(tmp_path, monkeypatch, gap_s, goes_first):
    """To turn left into the lane of those who come. SUMO itself lets nobody who stands in, however far they are."""
    demand = tmp_path / "demand.rou.xml"
    car = (
        '<vehicle id="{}" type="car" depart="{}" departLane="{}" departSpeed="max"><route edges="{} west3"/></vehicle>'
    )
    demand.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0"/>'
        + car.format("before", 10, 1, "west2")
        + car.format("turns", 11, 0, "mill_south_in")
        + car.format("next", 13.5, 1, "west2")
        + car.format("after", 13.5 + gap_s, 1, "west2")
        + "</routes>"
    )
    enters, slowest_mps, hardest_mps2 = [], math.inf, 0.0

    def look(simulation):
        nonlocal slowest_mps, hardest_mps2
        vehicle = libsumo.vehicle
        for name in vehicle.getIDList():
            if vehicle.getLaneID(name).startswith(":mill") and name not in enters:
                enters.append(name)
            if name == "turns":
                slowest_mps = min(slowest_mps, vehicle.getSpeed(name))
            if name == "after":
                hardest_mps2 = max(hardest_mps2, -vehicle.getAcceleration(name))

    watched(monkeypatch, look)
    world = with_demand("arterial", demand)
    driven = Fleet(world, 1.0, SEED, driver("rule", world))
    driven.drive(60.0)
    assert slowest_mps < 0.1
    last = ["turns", "after"] if goes_first else ["after", "turns"]
    assert enters == ["before", "next", *last]
    assert driven.contacts == 0
    assert hardest_mps2 < 1.5


def in_the_mirror(network, size_m):
    """The same network of so many metres upwards, driven on the left."""

    def flipped(match):
        points = (point.split(",") for point in match[2].split())
        return match[1] + " ".join(f"{x},{size_m - float(y):.2f}" for x, y in points) + '"'

    text = re.sub(r'(shape=")([^"]*)"', flipped, network.read_text())
    text = re.sub(r'(<junction [^>]* y=")([^"]*)"', lambda at: f'{at[1]}{size_m - float(at[2]):.2f}"', text)
    return text.replace("<net ", '<net lefthand="true" ', 1)


def without_signals(network):
    """The same network, where signals give way to the priority that holds while they are off."""
    text = re.sub(r"<tlLogic.*?</tlLogic>", "", network.read_text(), flags=re.DOTALL)
    text = re.sub(r' tl="c" linkIndex="\d+"', "", text).replace('"traffic_light"', '"priority"')
    return text.replace('state="O"', 'state="M"').replace('state="o"', 'state="m"')


@pytest.mark.parametrize("where", ["on the right", "on the left", "without signals"])
def test_driven_cars_pass_lorries_that_wait_within_a_crossing_and_touch_none(tmp_path, where):
    """SUMO's cars touch their corners, three of four; driven ones touched them, or stood before them for ever."""
    network, demand = Path(__file__).with_name("left_turns.net.xml"), tmp_path / "left.rou.xml"
    if where != "on the right":
        other = tmp_path / "other.net.xml"
        other.write_text(in_the_mirror(network, 500.0) if where == "on the left" else without_signals(network))
        network = other
    flow = '<flow id="{}" from="{}" to="{}" begin="0" end="300" departSpeed="max" '.format
    demand.write_text(
        '<routes><vType id="lorry" vClass="truck"/><vType id="car"/>'
        + flow("left", "sc", "cw")
        + 'type="lorry" period="12" departLane="best"/>'
        + flow("ahead", "nc", "cs")
        + 'type="car" period="6" departLane="0"/></routes>'
    )
    outputs = [str(tmp_path / name) for name in ("contacts.xml", "trips.xml")]
    options = ("--collision-output", outputs[0], "--tripinfo-output", outputs[1])
    for share, are_touched in ((0.0, True), (1.0, False)):
        world = with_demand(network, demand)
        Fleet(world, share, 0, driver("rule", world), options).drive(400.0)
        contacts, trips = (list(ElementTree.parse(file).getroot()) for file in outputs)
        assert bool(contacts) == are_touched
        assert sum(trip.get("id").startswith("ahead") for trip in trips) >= 45  # of 50


def test_driven_cars_do_not_start_into_the_way_of_a_lorry_that_turns(tmp_path):
    """SUMO's cars wait for it; driven ones crept over the line while SUMO called the way open, and it met them."""
    demand, trips = tmp_path / "lorries.rou.xml", tmp_path / "trips.xml"
    # From, straight on to, left to.
    ways = (
        ("bottom", "top", "left"),
        ("top", "bottom", "right"),
        ("left", "right", "top"),
        ("right", "left", "bottom"),
    )
    flow = (
        '<flow id="{0}.{1}" type="{0}" from="{1}0A0" to="A0{2}0" begin="{3}" end="300" period="{4}" departSpeed="max"/>'
    )
    flows = [
        flow.format("car", begin, ahead, number, 15) + flow.format("lorry", begin, left, 2 * number, 20)
        for number, (begin, ahead, left) in enumerate(ways)
    ]
    demand.write_text(f'<routes><vType id="lorry" vClass="truck"/><vType id="car"/>{"".join(flows)}</routes>')
    world = with_demand(Path(__file__).with_name("all_way_stop.net.xml"), demand)
    driven = Fleet(world, 1.0, 0, driver("rule", world), ("--tripinfo-output", str(trips)))
    driven.drive(400.0)
    assert driven.contacts == 0
    arrived = [trip.get("id") for trip in ElementTree.parse(trips).getroot()]
    assert sum(name.startswith("car") for name in arrived) >= 60, len(arrived)


# Who is driven.


@given(st.text(), st.integers(0, 2**31), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_who_is_driven_at_a_share_is_at_every_larger_one(vehicle, seed, one, other):
    assert not is_driven(vehicle, 0.0, seed)
    assert is_driven(vehicle, 1.0, seed)
    assert is_driven(vehicle, min(one, other), seed) <= is_driven(vehicle, max(one, other), seed)


def test_the_share_is_that_of_the_vehicles_and_another_seed_draws_others():
    names = [f"flow.{number}" for number in range(10_000)]
    for share in (0.1, 0.5):
        drawn = [is_driven(name, share, 1) for name in names]
        assert np.mean(drawn) == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / len(names)))
    one, other = ([is_driven(name, 0.5, seed) for name in names] for seed in (1, 2))
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(0.0, abs=0.05)


def test_only_cars_are_driven_in_the_whole_of_the_share(tmp_path):
    routes = tmp_path / "mixed.rou.xml"
    routes.write_text(
        '<routes><vType id="lorry" vClass="truck"/><vType id="car"/><route id="r" edges="highway"/>'
        '<flow id="lorry" type="lorry" route="r" begin="0" end="60" period="5" departLane="0"/>'
        '<flow id="car" type="car" route="r" begin="1" end="60" period="5" departLane="1"/></routes>'
    )
    world = with_demand("highway3", routes)
    driven = Fleet(world, 1.0, SEED, driver("keep", world))
    driven.drive(70.0)
    assert driven.driven == {f"car.{number}" for number in range(12)}
    assert len(driven.inserted) == 24


# One of them drives as a single host does.


@pytest.mark.parametrize("network", ["highway3", "onramp", "arterial"])
@pytest.mark.parametrize("name", ["rule", "random", "road-rail"])
def test_a_fleet_of_one_drives_as_the_environment_has_it_to_the_byte(monkeypatch, network, name):
    world = config_file.changed(with_demand(network), ["traffic.entry_within_s=60"])
    env = HighwayEnv(world)
    env.reset(seed=SEED)
    chosen, entered_s = env.host_name, libsumo.simulation.getTime()
    env.close()
    world = config_file.changed(world, [f'traffic.host="{chosen}"'])
    who = roster.find_driver(name, world)
    seen = world.seen_with(getattr(who, "senses", None))
    alone = HighwayEnv(seen)
    observation, _ = alone.reset(seed=SEED)
    decide = rollout.driver_of(who, world, sum(chosen.encode())).decide
    for _ in range(40):
        if alone.is_over:
            break
        observation, _ = alone.drive(decide(observation, alone.agent))
    expected, lasted_s = list(alone.agent.host.speeds_mps), libsumo.simulation.getTime() - entered_s
    alone.close()

    monkeypatch.setattr(fleet, "is_driven", lambda vehicle, share, seed: vehicle == chosen)
    kept = []
    monkeypatch.setattr(Agent, "decide", keep_host(Agent.decide, kept))
    Fleet(seen, 1.0, SEED, driver(who, world)).drive(entered_s + lasted_s)
    assert len(expected) > 100
    assert kept[0].speeds_mps[: len(expected)] == expected[: len(kept[0].speeds_mps)]
    assert abs(len(kept[0].speeds_mps) - len(expected)) <= 1


def keep_host(decide, kept):
    def wrapped(agent, action):
        if agent.host not in kept:
            kept.append(agent.host)
        decide(agent, action)

    return wrapped


# They keep clear of one another.


@pytest.mark.parametrize("name", ["random", "rule"])
@pytest.mark.parametrize("network", ["highway3", "onramp", "ring5"])
def test_where_all_cars_are_driven_nobody_is_touched(monkeypatch, touching, network, name):
    world, scenes = with_demand(network), []

    def look(simulation):
        if simulation.hosts:
            scenes.append(simulation.scene(simulation.hosts[len(scenes) % len(simulation.hosts)]))

    watched(monkeypatch, look)
    driven = Fleet(world, 1.0, SEED, driver(name, world))
    driven.drive(60.0)
    assert len(driven.driven) > 15
    assert driven.decisions > 500
    assert driven.contacts == 0
    assert not any(touching(scene) for scene in scenes)


@pytest.mark.parametrize("apart_m", [0.0, 6.0, -6.0])
def test_of_two_that_aim_for_one_gap_from_either_side_one_waits(tmp_path, touching, apart_m):
    network, routes = tmp_path / "three.net.xml", tmp_path / "two.rou.xml"
    network.write_text(cut_road(3000.0, lanes=3))
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0"/><route id="r" edges="part0"/>'
        f'<vehicle id="right" type="car" route="r" depart="0" departLane="0" departPos="50" departSpeed="20"/>'
        f'<vehicle id="left" type="car" route="r" depart="0" departLane="2" departPos="{50 + apart_m}" '
        'departSpeed="20"/></routes>'
    )
    lanes, scenes = [], []

    def to_the_middle(vehicle):
        def decide(observation, agent):
            lanes.append({name: libsumo.vehicle.getLaneIndex(name) for name in libsumo.vehicle.getIDList()})
            scenes.append(agent.scene)
            at_the_side = lanes[-1][vehicle] != 1
            return (LEFT if vehicle == "right" else RIGHT) if at_the_side else KEEP

        return decide

    driven = Fleet(with_demand(network, routes, adas={"gain_s": 0.0}), 1.0, SEED, to_the_middle)
    driven.drive(20.0)
    assert driven.driven == {"left", "right"}
    assert driven.contacts == 0
    assert not any(touching(scene) for scene in scenes)
    in_the_middle = [sum(lane == 1 for lane in one.values()) for one in lanes]
    assert max(in_the_middle) == 1, "the second would have to be clear of the first"


def parting(length_m):
    """A road of two lanes, the right one of which leads to `exit` alone, the left one to `main` alone."""
    text = cut_road(length_m, 300.0, lanes=2)
    whole = text[
        text.index('<edge id="part1"') : text.index("</edge>", text.index('<edge id="part1"')) + len("</edge>")
    ]
    lanes = re.findall(r"<lane .*?/>", whole)
    for number, (name, lane) in enumerate(zip(("exit", "main"), lanes, strict=True)):
        own = re.sub(r'id="part1_\d" index="\d"', f'id="{name}_0" index="0"', lane)
        text = text.replace(whole, f'<edge id="{name}" from="cut0" to="east">{own}</edge>{whole}')
        way = f'to="part1" fromLane="{number}" toLane="{number}"'
        text = text.replace(way, f'to="{name}" fromLane="{number}" toLane="0"')
    return text.replace(whole, "").replace("part1_0 part1_1", "exit_0 main_0")


@pytest.mark.parametrize("rows", [1, 4])
@pytest.mark.parametrize("apart_m", [0.0, 3.0, -3.0])
def test_who_must_go_where_the_other_is_get_past_one_another(tmp_path, touching, rows, apart_m):
    """All cars in the right lane have to go to the left, and all in the left one to the right."""
    network, routes = tmp_path / "parting.net.xml", tmp_path / "crossing.rou.xml"
    network.write_text(parting(400.0))
    cars = "".join(
        f'<vehicle id="{way}{k}" type="car" depart="0" departLane="{lane}" departPos="{start_m - 10 * k}">'
        f'<route edges="part0 {way}"/></vehicle>'
        for way, lane, start_m in (("main", 0, 100.0), ("exit", 1, 100.0 + apart_m))
        for k in range(rows)
    )
    routes.write_text(f'<routes><vType id="car" speedFactor="1" sigma="0"/>{cars}</routes>')
    world, scenes = with_demand(network, routes), []

    def watching(vehicle):
        def decide(observation, agent):
            scenes.append(agent.scene)
            return KEEP

        return decide

    driven, arrived = trips(world, 1.0, watching, tmp_path)
    assert len(driven.driven) == 2 * rows
    assert driven.contacts == 0
    assert not any(touching(scene) for scene in scenes)
    assert {name for name, trip in arrived.items() if float(trip.get("arrival")) > 0.0} == driven.driven


# What becomes of them, and of the traffic.


def trips(world, share, who, folder, until_s=150.0):
    file = folder / f"trips-{share}-{who if isinstance(who, str) else 'driven'}.xml"
    options = ("--tripinfo-output", str(file), "--tripinfo-output.write-unfinished", "true")
    driven = Fleet(world, share, SEED, who, options)
    driven.drive(until_s)
    return driven, {trip.get("id"): trip for trip in ElementTree.parse(file).getroot()}


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_from_any_lane_driven_cars_find_their_exit_in_dense_traffic(tmp_path, share):
    """From five lanes, at 16 vehicles a minute and lane. Before they let one another in, half as many got through."""
    network, routes = tmp_path / "exit.net.xml", tmp_path / "own.rou.xml"
    network.write_text(with_exit(2000.0, lanes=5))
    flow = '<flow id="{way}{lane}" type="car" begin="{at}" end="240" period="{every}" departLane="{lane}" '
    flow += 'departSpeed="max"><route edges="part0 {way}"/></flow>'
    routes.write_text(
        '<routes><vType id="car" speedFactor="normc(1,0.1,0.8,1.2)" sigma="0.5"/>'
        + "".join(flow.format(way="main", lane=lane, at=0.3 * lane, every=4.3) for lane in range(1, 5))
        + "".join(flow.format(way="exit", lane=lane, at=2.0 + lane, every=22) for lane in range(1, 5))
        + "</routes>"
    )
    world = with_demand(network, routes)
    who = rollout.fleet_of(roster.find_driver("road-rail", world), world, share, SEED)
    file = tmp_path / "trips.xml"
    who.outputs = ("--tripinfo-output", str(file))
    who.drive(300.0)
    arrived = ElementTree.parse(file).getroot().findall("tripinfo")
    losses_s = [float(trip.get("timeLoss")) for trip in arrived if trip.get("id").startswith("exit")]
    assert who.contacts == 0
    assert len(losses_s) >= 38
    assert np.mean(losses_s) < 15.0


@pytest.mark.parametrize("network", ["highway3", "onramp"])
def test_departures_types_and_vehicles_are_the_same_at_every_share(tmp_path, network):
    world = with_demand(network)

    def of(driven, listed):
        wanted = {name: float(trip.get("depart")) - float(trip.get("departDelay")) for name, trip in listed.items()}
        kinds = {name: (car.kind, car.edges, round(car.speed_factor, 4)) for name, car in driven.inserted.items()}
        return {name: round(at, 2) for name, at in wanted.items()}, kinds

    as_they_are = of(*trips(world, 0.0, "nothing", tmp_path))
    assert len(as_they_are[0]) > 50
    for share, who in ((0.5, driver("rule", world)), (1.0, "acc")):
        assert of(*trips(world, share, who, tmp_path)) == as_they_are


def test_behind_driven_cars_as_many_enter_as_behind_others(tmp_path):
    """SUMO would want some 50 m more behind a car that may brake at 9 m/s²."""
    network, routes = tmp_path / "road.net.xml", tmp_path / "dense.rou.xml"
    network.write_text(cut_road(3000.0, lanes=2))
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0" decel="4.5"/><route id="r" edges="part0"/>'
        '<flow id="f" type="car" route="r" begin="0" end="90" period="0.8" departLane="free" departSpeed="30"/>'
        "</routes>"
    )
    world = with_demand(network, routes)
    as_they_are, driven = (Fleet(world, share, SEED, driver("keep", world)) for share in (0.0, 1.0))
    as_they_are.drive(60.0)
    driven.drive(60.0)
    assert len(as_they_are.inserted) > 60
    assert len(driven.inserted) > 0.9 * len(as_they_are.inserted)
    assert driven.contacts == 0


def test_left_as_they_are_a_share_drives_as_without_one_to_the_byte(tmp_path):
    world, written = with_demand("onramp"), []
    for share in (0.0, 0.5):
        file = tmp_path / f"{share}.csv"
        driven = Fleet(world, share, SEED, "nothing", ("--fcd-output", str(file)))
        driven.drive(60.0)
        assert bool(driven.driven) == (share > 0.0)
        written.append(file.read_bytes())
    assert written[0] == written[1]
    assert len(written[0]) > 10_000


@pytest.mark.parametrize("network", ["highway3", "onramp"])
def test_as_they_are_they_drive_as_by_the_command_that_is_told_to_the_byte(tmp_path, network):
    options = ("default.speeddev=0.2", "scale=0.9")
    _, ours = trips(
        with_demand(network, options=(*options, "device.emissions.probability=1")), 0.0, "nothing", tmp_path
    )
    file = tmp_path / "theirs.xml"
    further = ["--tripinfo-output", str(file), "--tripinfo-output.write-unfinished", "true"]
    libsumo.start([*shlex.split(fleet.sumo_command(with_demand(network, options=options), SEED)), *further])
    libsumo.simulation.step(150.0)
    libsumo.close()
    theirs = {trip.get("id"): trip for trip in ElementTree.parse(file).getroot()}
    assert len(theirs) > 40

    def driven(of_all):
        return {name: {key: value for key, value in trip.items() if key != "devices"} for name, trip in of_all.items()}

    assert driven(theirs) == driven(ours)  # though a sweep accounts for emissions


@pytest.mark.parametrize("last_m", [1000.0, 30.0])
def test_they_are_driven_until_they_arrive(tmp_path, last_m):
    """However short the last edge is: handed back before lanes part, a vehicle might stand in the wrong one."""
    network, routes = tmp_path / "two.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(600.0, last_m))
    routes.write_text(
        '<routes><vType id="slow" vClass="passenger" maxSpeed="20" length="7"/><route id="r" edges="part0 part1"/>'
        '<vehicle id="one" type="slow" route="r" depart="0" departPos="200" departSpeed="15"/></routes>'
    )
    world, times_s = with_demand(network, routes), []

    def watching(vehicle):
        def decide(observation, agent):
            times_s.append(agent.scene.time_s)
            return KEEP

        return decide

    driven, listed = trips(world, 1.0, watching, tmp_path, until_s=120.0)
    assert driven.driven == {"one"}
    assert 0.0 < float(listed["one"].get("arrival")) - times_s[-1] < 1.2
    assert driven.inserted["one"].kind == "slow"
    assert driven.inserted["one"].length_m == 7.0


def test_who_goes_round_and_round_is_driven_in_every_round(tmp_path):
    """Eight edges of 392 m, at 80 km/h a round takes 141 s."""
    routes = tmp_path / "round.rou.xml"
    edges = " ".join(f"ring{k}" for k in range(8))
    routes.write_text(
        f'<routes><vType id="car" speedFactor="1"/><route id="r" edges="{edges}" repeat="9"/>'
        '<vehicle id="v" type="car" route="r" depart="0" departSpeed="20" departPos="100"/></routes>'
    )
    kinds = []

    def watching(vehicle):
        def decide(observation, agent):
            kinds.append((agent.scene.time_s, libsumo.vehicle.getDistance(vehicle)))
            return ACCELERATE

        return decide

    driven = Fleet(with_demand("ring5", routes), 1.0, SEED, watching)
    driven.drive(450.0)
    times_s, metres = map(np.array, zip(*kinds, strict=True))
    assert (driven.driven, driven.contacts) == ({"v"}, 0)
    assert np.diff(times_s).max() == pytest.approx(1.0)
    assert times_s[-1] > 449.0
    assert metres[-1] > 3 * 8 * 392.0
    assert driven.decisions == len(kinds)


def test_who_drives_elsewhere_than_the_course_is_left_to_sumo_and_told(tmp_path):
    network, routes = tmp_path / "two.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(500.0, 3000.0))
    routes.write_text('<routes><vehicle id="one" depart="0"><route edges="part0"/></vehicle></routes>')
    world = with_demand(network, routes).changed(network={"course": ("part0", "part1")})
    driven = Fleet(world, 1.0, SEED, driver("keep", world))
    driven.drive(20.0)
    assert driven.driven == set()
    assert "does not drive over the edges of network.course" in driven.undriven["one"]


def test_without_a_demand_there_is_nobody_to_drive():
    with pytest.raises(InputError, match="a share is of the cars of a demand, and there is none; name its files"):
        Fleet(config_file.validate({}), 0.5, SEED, "nothing").drive(10.0)


@pytest.mark.parametrize("network", ["onramp", "arterial"])
def test_who_is_near_is_the_same_whether_one_looks_or_many(monkeypatch, network):
    world, compared = with_demand(network), []

    def look(simulation):
        sight = simulation._sight
        for host in simulation.hosts[len(compared) % 3 :: 3]:
            here, reach_m = libsumo.vehicle.getPosition3D(host.name), 105.0
            one = sorted(sight._near(host.name, here, reach_m, libsumo.vehicle.getIDList()))
            lately = sight._near_lately(here, reach_m)
            assert one == sorted(sight._near(host.name, here, reach_m, lately))
            compared.append(len(one))

    watched(monkeypatch, look)
    Fleet(world, 0.5, SEED, driver("keep", world)).drive(120.0)
    assert len(compared) > 1000
    assert np.mean(compared) > 2


# Demands of every kind.


def one_road(tmp_path, *elements, types='<vType id="car"/>'):
    routes = tmp_path / "own.rou.xml"
    routes.write_text(f'<routes>{types}<route id="r" edges="highway"/>{"".join(elements)}</routes>')
    return with_demand("highway3", routes)


def test_a_driven_car_pollutes_as_the_one_that_it_is(tmp_path):
    world = one_road(
        tmp_path,
        '<vehicle id="one" type="clean" route="r" depart="0" departSpeed="20"/>',
        types='<vType id="clean" emissionClass="Zero"/>',
    )
    told = []

    def decide(observation, agent):
        told.append(libsumo.vehicle.getEmissionClass("one"))
        return KEEP

    Fleet(world, 1.0, SEED, lambda vehicle: decide).drive(5.0)
    assert {one.partition("/")[0] for one in told} == {"Zero"}
    options = ("--tripinfo-output", str(tmp_path / "t.xml"), "--tripinfo-output.write-unfinished", "true")
    Fleet(world, 1.0, SEED, "acc", (*options, "--device.emissions.probability", "1")).drive(20.0)
    (emissions,) = ElementTree.parse(tmp_path / "t.xml").getroot().iter("emissions")
    assert float(emissions.get("CO2_abs")) == 0.0


def test_a_car_that_parks_on_its_way_goes_on_by_itself(tmp_path):
    world = one_road(
        tmp_path,
        '<vehicle id="one" type="car" route="r" depart="0" departSpeed="10">'
        '<stop lane="highway_0" endPos="400" duration="10" parking="true"/></vehicle>',
    )
    driven, listed = trips(world, 1.0, driver("keep", world), tmp_path, until_s=60.0)
    assert driven.driven == {"one"}
    assert driven.decisions > 10
    assert float(listed["one"].get("stopTime")) > 9.0


def test_a_car_that_departs_later_on_its_route_is_driven_from_there(tmp_path):
    network, routes = tmp_path / "two.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(500.0, 3000.0))
    routes.write_text(
        '<routes><route id="r" edges="part0 part1"/><vehicle id="one" route="r" depart="0" departEdge="1"/></routes>'
    )
    driven = Fleet(with_demand(network, routes), 1.0, SEED, driver("keep", {}))
    driven.drive(10.0)
    assert driven.driven == {"one"}
    assert driven.inserted["one"].edges == ("part1",)


def test_handed_back_a_car_does_not_brake_for_what_it_would_have_driven(tmp_path):
    slow = '<vType id="slow" speedFactor="0.5"/>'
    world = one_road(
        tmp_path, '<vehicle id="one" type="slow" route="r" depart="0" departPos="7000" departSpeed="max"/>', types=slow
    )
    file = tmp_path / "f.csv"
    Fleet(world, 1.0, SEED, driver("keep", world), ("--fcd-output", str(file))).drive(80.0)
    speeds = pd.read_csv(file, sep=";")["vehicle_speed"].dropna().to_numpy()
    assert speeds.max() > 15.0
    assert np.diff(speeds).min() > -0.31


def test_where_it_takes_that_a_driven_car_brakes_harder_than_others_expect(tmp_path):
    """At 25 m/s, 60 m behind a car that stands: v^2 / (2 s) is 5.4 m/s^2, and others expect 4.5."""
    network, routes, file = tmp_path / "one.net.xml", tmp_path / "own.rou.xml", tmp_path / "f.csv"
    network.write_text(cut_road(500.0, 500.0, lanes=1))
    routes.write_text(
        '<routes><vType id="car" decel="9" tau="0.3" sigma="0" speedFactor="1"/>'
        '<vType id="lorry" vClass="truck" length="5"/><route id="r" edges="part0 part1"/>'
        '<vehicle id="lorry" type="lorry" route="r" depart="0" departPos="200">'
        '<stop lane="part0_0" endPos="200" duration="99"/></vehicle>'
        '<vehicle id="one" type="car" route="r" depart="3" departPos="135" departSpeed="25"/></routes>'
    )
    world = with_demand(network, routes)
    driven = Fleet(world, 1.0, SEED, driver("keep", world), ("--fcd-output", str(file)))
    driven.drive(20.0)
    fcd = pd.read_csv(file, sep=";")
    speeds = fcd.loc[fcd["vehicle_id"] == "one", "vehicle_speed"].to_numpy()
    assert driven.driven == {"one"}
    assert driven.contacts == 0
    assert speeds[0] == pytest.approx(25.0)
    assert -0.9 - 1e-6 < np.diff(speeds).min() < -0.5
    assert speeds[-1] == 0.0


def test_a_lane_change_model_that_cannot_be_asked_with_is_left_alone(tmp_path):
    routes = tmp_path / "own.rou.xml"
    routes.write_text(
        '<routes><vType id="car" laneChangeModel="DK2008" sigma="0"/><route id="main" edges="main1 merge1 main2"/>'
        '<route id="ramp" edges="on1 merge1 main2"/>'
        '<flow id="main" type="car" route="main" begin="0" end="90" period="1.8" departLane="0" departSpeed="max"/>'
        '<flow id="ramp" type="car" route="ramp" begin="0" end="90" period="20" departSpeed="max"/></routes>'
    )
    world = with_demand("onramp", routes)
    driven = Fleet(world, 0.5, SEED, driver("keep", world))
    driven.drive(90.0)
    assert driven.contacts == 0
    assert any(name.startswith("ramp") for name in driven.driven)


def on_the_ramp(tmp_path, elements, **traffic):
    return config_file.validate(
        {"network": {"file": "onramp"}, "traffic": {"routes": on_ramp(tmp_path, elements)} | traffic}
    )


def test_a_car_that_is_led_elsewhere_is_driven_there(tmp_path):
    world = on_the_ramp(tmp_path, ONE, additional=led_off(tmp_path))
    on_edges = {}

    def watching(vehicle):
        decides = rollout.driver_of("keep", world, SEED).decide

        def decide(observation, agent):
            edge = libsumo.vehicle.getRoadID(vehicle)
            on_edges.setdefault(edge, []).append((libsumo.vehicle.getDistance(vehicle), agent.host.fastest_mps))
            return decides(observation, agent)

        return decide

    driven, listed = trips(world, 1.0, watching, tmp_path, until_s=200.0)
    assert driven.driven == {"one"}
    assert listed["one"].get("arrivalLane") == "off_0"
    assert float(listed["one"].get("arrivalSpeed")) < 22.3, "it is told of the limit of the edge that it leaves by"
    assert list(on_edges) == ["main1", "merge1", "main2", "diverge", "off"]
    assert on_edges["off"][-1][0] > float(listed["one"].get("routeLength")) - 25.0
    assert driven.decisions == sum(map(len, on_edges.values()))


def test_many_that_are_led_elsewhere_do_not_come_to_stand(tmp_path):
    """Every second one must leave by the exit, and is told so 1.4 km before it, on whatever lane it is.

    When driven cars kept to their first routes, 3 of 67 arrived.
    """
    flow = (
        '<flow id="f" type="car" route="through" begin="0" end="120" period="1.8" departLane="random" '
        'departSpeed="max"/>'
    )
    world = on_the_ramp(tmp_path, flow, additional=led_off(tmp_path, 0.5))
    driven, listed = trips(world, 1.0, driver("rule", world), tmp_path, until_s=240.0)
    lanes = [one.get("arrivalLane") for one in listed.values() if float(one.get("arrival")) > 0.0]
    assert len(lanes) == len(driven.driven) == 67
    assert 20 < lanes.count("off_0") < 47
    assert driven.contacts == 0
    assert max(float(one.get("waitingTime")) for one in listed.values()) < 15.0


def test_a_lane_change_goes_on_though_the_route_changes_meanwhile(tmp_path):
    world, seen = on_the_ramp(tmp_path, ONE).changed(adas={"gain_s": 0.0}), []

    def watching(vehicle):
        def decide(observation, agent):
            begins = len(seen) == 3
            if len(seen) == 4:
                libsumo.vehicle.setRoute(vehicle, ["main1", "merge1", "main2", "diverge", "off"])
            course = agent.stretch.road.edges[-1].id
            seen.append((agent.is_changing_lane, agent.adas.lateral_m, agent.adas.lane_changes, course))
            return LEFT if begins else KEEP

        return decide

    driven = Fleet(world, 1.0, SEED, watching)
    driven.drive(12.0)
    assert seen[4][0]
    assert seen[4][3] == "main3"
    assert seen[5][0], "still under way"
    assert seen[5][1] > seen[4][1] > 0.0
    assert seen[5][3] == "off"
    assert seen[-1][:3] == (False, 0.0, 1)


@pytest.mark.parametrize("first", ["main1", "on1"])
def test_a_car_within_a_junction_follows_another_route_once_it_is_on_an_edge(tmp_path, first):
    way = f'<route edges="{first} merge1 main2 diverge off"/>'
    world = on_the_ramp(tmp_path, f'<vehicle id="one" type="car" depart="0" departSpeed="max">{way}</vehicle>')
    courses = []

    def watching(vehicle):
        def decide(observation, agent):
            where = libsumo.vehicle.getLaneID(vehicle)
            courses.append((where.rpartition("_")[0], agent.stretch.road.edges[-1].id))
            if where.startswith(":join1") and courses[-2][0] == first:
                libsumo.vehicle.setRoute(vehicle, ["merge1", "main2", "diverge", "main3"])
            return KEEP

        return decide

    driven = Fleet(world.changed(episode={"decision_period_s": 0.1}), 1.0, SEED, watching)
    driven.drive(90.0)
    assert driven.contacts == 0
    assert {course for where, course in courses if where.startswith((first, ":join1"))} == {"off"}
    assert {course for where, course in courses if where in ("merge1", "main2", "main3")} == {"main3"}


# Lanes that are closed for a time.


def with_works(tmp_path, additional):
    """Three lanes, of which some are closed on the way, and cars that enter on all of them."""
    network, routes = tmp_path / "three.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(800.0, 400.0, 600.0))
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0.2"/><route id="r" edges="part0 part1 part2"/>'
        '<flow id="f" type="car" route="r" begin="0" end="160" period="2" departLane="random" '
        'departSpeed="max"/></routes>'
    )
    return with_demand(network, routes).changed(traffic={"additional": tuple(additional)})


@pytest.mark.parametrize(
    "closed", [["part1_0"], ["part1_1"], ["part1_2"], ["part1_0", "part1_1"], ["part1_2", "part2_2"]]
)
def test_driven_cars_drive_past_lanes_that_are_closed(tmp_path, monkeypatch, closed):
    """Before they saw it they stood before them, some for five minutes."""
    world, entered = with_works(tmp_path, closing(tmp_path, closed)), set()
    watched(monkeypatch, lambda _: entered.update(map(libsumo.vehicle.getLaneID, libsumo.vehicle.getIDList())))
    driven, listed = trips(world, 1.0, driver("rule", world), tmp_path, until_s=300.0)
    assert len(driven.driven) == len(listed) == 80
    assert driven.contacts == 0
    assert min(float(one.get("arrival")) for one in listed.values()) > 0.0, "all have arrived"
    assert max(float(one.get("waitingTime")) for one in listed.values()) < 15.0
    assert entered.isdisjoint(closed)
    assert {f"part1_{k}" for k in range(3)} - set(closed) <= entered


def test_a_lane_that_is_closed_to_others_is_driven(tmp_path, monkeypatch):
    world, entered = with_works(tmp_path, closing(tmp_path, ["part1_0"], disallow="truck")), set()
    watched(monkeypatch, lambda _: entered.update(map(libsumo.vehicle.getLaneID, libsumo.vehicle.getIDList())))
    Fleet(world, 1.0, SEED, driver("keep", world)).drive(100.0)
    assert "part1_0" in entered


def test_lanes_are_left_when_they_are_closed_and_driven_again_when_they_are_opened(tmp_path, monkeypatch):
    """Whoever is on the first of two closed lanes must leave it before the second."""
    closed, entered = ["part1_0", "part2_0"], []
    world = with_works(tmp_path, closing(tmp_path, closed, 60.0, 120.0))

    def note(simulation):
        now_s = simulation.now_s
        entered.extend((now_s, name, libsumo.vehicle.getLaneID(name)) for name in libsumo.vehicle.getIDList())

    watched(monkeypatch, note)
    driven, listed = trips(world, 1.0, driver("keep", world), tmp_path, until_s=300.0)

    def who(lane, from_s, until_s):
        return {name for now_s, name, where in entered if where == lane and from_s <= now_s < until_s}

    assert driven.contacts == 0
    assert min(float(one.get("arrival")) for one in listed.values()) > 0.0
    assert who("part1_0", 0.0, 60.0)
    on_it = who("part1_0", 60.0, 63.0)
    assert on_it
    assert who("part1_0", 63.0, 120.0) <= on_it, "only those that could not stop when it was closed"
    assert who("part2_0", 63.0, 120.0) <= who("part2_0", 60.0, 63.0)
    assert who("part1_0", 121.0, 300.0)
    assert max(float(one.get("waitingTime")) for one in listed.values()) < 30.0


@pytest.mark.parametrize("closed", [["main2_2"], ["main2_0"], ["main2_0", "main2_1"], ["merge1_1", "main2_0"]])
def test_who_is_caught_by_a_lane_that_is_closed_does_not_stand_when_it_is_opened(tmp_path, closed):
    """SUMO lets nobody who was on it drive on, unless it is told to look at its lanes anew.

    Where two are closed, a van came off the ramp and moved 3 m ahead of a car that asked for room, 10 m/s faster.
    """
    works = closing(tmp_path, closed, 100.0, 160.0, edge="main1")
    world = with_demand("onramp").changed(traffic={"additional": tuple(works)})
    driven, listed = trips(world, 0.5, driver("rule", world), tmp_path, until_s=300.0)
    assert driven.contacts == 0
    assert len(driven.driven) > 30
    assert max(float(one.get("waitingTime")) for one in listed.values()) < 60.0


@pytest.mark.parametrize(("before_m", "brakes_mps2"), [(20.0, 4.5), (60.0, 4.5), (120.0, 4.5), (300.0, 3.5)])
def test_who_cannot_stop_before_a_lane_that_is_closed_drives_on_into_it(tmp_path, before_m, brakes_mps2):
    """At 108 km/h it takes 100 m to stop by 4.5 m/s²; SUMO would stop it at the lane's end by 250 m/s²."""
    network, routes = tmp_path / "three.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(800.0, 400.0, 600.0, lanes=3))
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0"/><route id="r" edges="part0 part1 part2"/>'
        f'<vehicle id="one" type="car" route="r" depart="0" departLane="0" departPos="{800.0 - 300.0 - before_m}" '
        'departSpeed="30"/></routes>'
    )
    world = with_demand(network, routes).changed(
        traffic={"additional": tuple(closing(tmp_path, ["part1_0"], 10.0))},
        adas={"max_speed_kmh": 108.0, "start_speed_kmh": 108.0},
    )
    speeds, lanes, classes = [], [], []

    def watching(vehicle):
        def decide(observation, agent):
            classes.append(libsumo.vehicle.getVehicleClass(vehicle))
            lanes.append(libsumo.vehicle.getLaneID(vehicle))
            speeds.append(agent.host.speeds_mps)
            return KEEP

        return decide

    driven = Fleet(world, 1.0, SEED, watching)
    driven.drive(40.0)
    decided_mps = np.array(max(speeds, key=len))
    assert driven.contacts == 0
    assert -np.diff(decided_mps).min() / 0.1 <= brakes_mps2 + 1e-6
    assert decided_mps.min() > 5.0
    assert ("part1_0" in lanes) == ("ignoring" in classes) == (before_m < 100.0)
    assert classes[-1] == "passenger"


def test_who_is_teleported_beside_several_driven_cars_is_seen_no_more(tmp_path):
    """Lorries halt on every lane of a short edge, until SUMO takes those behind off the road, and has no room ahead."""

    def vehicle(kind, lane, place, edges, stop="", depart_s=0.0):
        about = f'depart="{depart_s}" departLane="{lane}" departPos="{place}"><route edges="{edges}"/>{stop}'
        return f'<vehicle id="{kind}{lane}{place}" type="{kind}" {about}</vehicle>'

    lanes, way = range(3), "part0 part1 part2"
    halts = [f'<stop lane="part1_{k}" endPos="18" duration="9999"/>' for k in lanes]
    elements = [
        *(vehicle("lorry", k, 17, "part1 part2", halts[k]) for k in lanes),
        *(vehicle("lorry", k, place, way) for k in lanes for place in (560, 520)),
        # So that there is one that looks at every step.
        *(vehicle("car", k, 400 - 20 * row, way, depart_s=0.1 * (3 * row + k)) for row in range(3) for k in lanes),
    ]
    network, routes = tmp_path / "three.net.xml", tmp_path / "own.rou.xml"
    network.write_text(cut_road(600.0, 20.0, 600.0))
    types = '<vType id="lorry" vClass="truck" length="12"/><vType id="car"/>'
    routes.write_text(f"<routes>{types}{''.join(elements)}</routes>")
    world = with_demand(network, routes).changed(traffic={"options": ("time-to-teleport=2",)})
    fleet = Fleet(world, 1.0, SEED, driver("rule", world))
    fleet.drive(60.0)
    assert len(fleet.driven) == 9
    assert len({name for _, name in fleet.teleported}) == 6
    assert fleet.contacts == 0


def test_worlds_that_vary_have_no_share():
    world = config_file.validate({"varied": {"networks": ["highway3"]}, "traffic": {"routes": ["highway3"]}})
    with pytest.raises(InputError, match=r"leave out varied\.networks"):
        Fleet(world, 0.5, SEED, "nothing").drive(10.0)
