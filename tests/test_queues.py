"""Queues before an exit: how long they are, who is let in from them, and how driven cars join them, in SUMO."""

from xml.etree import ElementTree

import libsumo
import numpy as np
import pytest
from driving import UNSEEN
from sketch import with_exit

from rail_sumo import config_file, rollout
from rail_sumo.config import Adas
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic.fleet import Fleet
from rail_sumo.highway.vehicle.abilities import HOST_TYPE
from rail_sumo.records import Command

SEED = UNSEEN + 300
FRONT_M = 600.0
ROOM_M = 7.0
"""What one of the host's type takes up in a queue: its length and the gap that it leaves."""
LETS_IN_MPS = 10.0


@pytest.fixture
def on_lane(tmp_path):
    """Three lanes, of which the right one alone leads on along the host's course, to an exit at 1000 m."""
    network = tmp_path / "exit.net.xml"
    network.write_text(with_exit(1000.0, lanes=3))
    opened = []

    def begin(lane, speed_mps=0.0, front_m=FRONT_M):
        course = road.load(str(network), ("part0", "exit"))
        simulation = Simulation(course.net_file, seed=1)
        opened.append(simulation)
        simulation.lay_course(course, Adas(), sees_m=300.0)
        simulation.add_host(["part0", "exit"], lane=lane, front_m=front_m, speed_mps=speed_mps)
        for way in ("exit", "main"):
            libsumo.route.add(way, ["part0", way])
        simulation.wait_for_host()
        return simulation

    yield begin
    for one in opened:
        one.close()


def put(name, lane, front_m, speed_mps=0.0, *, route="exit", changes_lanes=False):
    """Have a vehicle stand or drive at a place."""
    libsumo.vehicle.add(
        name, route, HOST_TYPE, departLane=str(lane), departPos=f"{front_m:.2f}", departSpeed=f"{speed_mps}"
    )
    libsumo.vehicle.setSpeedMode(name, 0)
    libsumo.vehicle.setSpeed(name, speed_mps)
    if not changes_lanes:
        libsumo.vehicle.setLaneChangeMode(name, 0)


def queued_m(simulation):
    simulation.host.heed()
    return simulation.host.state().queued_m


@pytest.mark.parametrize("lane", [0, 1])
def test_a_queue_is_who_stands_ahead_as_far_as_the_lane_ends(on_lane, lane):
    simulation = on_lane(lane)
    assert queued_m(simulation) == (0.0, 0.0, 0.0)
    for k, ahead_m in enumerate((50.0, 150.0, 380.0)):
        put(f"queued{k}", 0, FRONT_M + ahead_m)
    put("behind", 0, FRONT_M - 30.0)
    put("drives", 0, FRONT_M + 300.0, 5.0)
    put("beside", 2, FRONT_M + 10.0)
    libsumo.route.add("beyond", ["exit"])
    put("beyond", 0, 50.0, route="beyond")
    simulation.run(Command(0.0))
    assert len(libsumo.vehicle.getIDList()) == 8
    assert queued_m(simulation) == (3 * ROOM_M, 0.0, ROOM_M)


def test_a_queue_is_measured_once_until_the_host_looks_again(on_lane):
    simulation = on_lane(1)
    assert queued_m(simulation) == (0.0, 0.0, 0.0)
    put("queued", 0, FRONT_M + 50.0)
    simulation.run(Command(0.0))
    assert simulation.host.state().queued_m == (0.0, 0.0, 0.0)
    assert queued_m(simulation) == (ROOM_M, 0.0, 0.0)


def lets_in(simulation):
    """Whether the host, which is set to keep its speed, slows down for somebody in a lane beside."""
    simulation.host.heed()
    simulation.run(Command(LETS_IN_MPS, steps=1))
    assert simulation.host.told_mps[0] == LETS_IN_MPS
    return simulation.host.told_mps[1] < LETS_IN_MPS


@pytest.mark.parametrize("passes_m", [6.0, 12.0])
def test_who_must_come_is_let_in_whoever_drives_between(on_lane, passes_m):
    """One that passes it hid it."""
    simulation = on_lane(0, LETS_IN_MPS)
    put("waits", 1, FRONT_M + 36.0)
    put("passes", 1, FRONT_M + passes_m, LETS_IN_MPS)
    simulation.run(Command(LETS_IN_MPS))
    assert not lets_in(simulation)
    libsumo.vehicle.setParameter("waits", "rail_sumo.indicator", "-1")
    assert lets_in(simulation)


@pytest.mark.parametrize(("gap_m", "is_let_in"), [(-0.3, False), (1.8, False), (4.0, True)])
def test_nobody_waits_beside_one_that_stands_where_it_has_no_room_to_come(on_lane, gap_m, is_let_in):
    """On beihong-flyover, a road of others, one stood 45 s so, on an open road, and all behind it."""
    simulation = on_lane(0)
    put("waits", 1, FRONT_M + 5.0 + gap_m)
    simulation.run(Command(0.0))
    libsumo.vehicle.setParameter("waits", "rail_sumo.indicator", "-1")
    assert lets_in(simulation) == is_let_in


@pytest.mark.parametrize(("says", "is_let_in"), [("", True), ("-1", True), ("0", False), ("1", False)])
def test_what_sumo_wants_of_a_driven_one_counts_only_where_its_own_layer_says_so_too(on_lane, says, is_let_in):
    simulation = on_lane(0, LETS_IN_MPS, front_m=930.0)
    put("other", 1, 942.0, LETS_IN_MPS, changes_lanes=True)
    simulation.run(Command(LETS_IN_MPS, steps=2))
    libsumo.vehicle.setParameter("other", "rail_sumo.must_leave", says)
    assert libsumo.vehicle.getLaneID("other") == "part0_1"
    assert lets_in(simulation) == is_let_in


def test_the_host_says_where_it_must_go_until_it_is_let_go(on_lane):
    simulation = on_lane(1)
    said = []
    for must_leave in (-1, 0, None):
        simulation.run(Command(0.0, must_leave=must_leave))
        said.append(libsumo.vehicle.getParameter(simulation.host.name, "rail_sumo.must_leave"))
    assert said == ["-1", "0", ""]
    simulation.run(Command(0.0, must_leave=-1))
    simulation.host.let_go(HOST_TYPE, speed_factor=1.0)
    assert libsumo.vehicle.getParameter(simulation.host.name, "rail_sumo.must_leave") == ""


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_driven_cars_join_the_queue_before_an_exit_at_its_end_and_those_who_pass_need_not_wait(tmp_path, share):
    """Some overtook it, stood beside it, and had who passes lose 12 s in the mean, and 39 s where all were driven."""
    network, routes, trips = tmp_path / "exit.net.xml", tmp_path / "own.rou.xml", tmp_path / "trips.xml"
    network.write_text(with_exit(1200.0, lanes=3))
    flow = '<flow id="{name}" type="car" route="{way}" begin="1" end="{end}" period="{every}" departLane="{lane}" '
    flow += 'departSpeed="max"/>'
    routes.write_text(
        '<routes><vType id="car" speedFactor="1" sigma="0.2"/><route id="main" edges="part0 main"/>'
        '<route id="exit" edges="part0 exit"/><vehicle id="blocks" type="car" route="exit" depart="0" '
        'departSpeed="max"><stop lane="exit_0" endPos="30" until="200"/></vehicle>'
        + flow.format(name="exit", way="exit", end=150, every=3, lane=0)
        + "".join(flow.format(name=f"main{lane}", way="main", end=240, every=4, lane=lane) for lane in (1, 2))
        + "</routes>"
    )
    world = config_file.validate({"network": {"file": str(network)}, "traffic": {"routes": [str(routes)]}})

    def rule(vehicle):
        return rollout.driver_of("rule", world, sum(vehicle.encode())).decide

    driven = Fleet(world, share, SEED, rule, ("--tripinfo-output", str(trips)))
    driven.drive(360.0)
    arrived = [trip for trip in ElementTree.parse(trips).iter("tripinfo") if float(trip.get("arrival")) > 0.0]
    assert len(arrived) == 171
    assert driven.contacts == 0
    queued_s = [float(trip.get("waitingTime")) for trip in arrived if trip.get("id").startswith("exit")]
    assert max(queued_s) > 100.0
    losses_s = [float(trip.get("timeLoss")) for trip in arrived if trip.get("id").startswith("main")]
    assert np.mean(losses_s) < 3.0
    assert max(losses_s) < 15.0
