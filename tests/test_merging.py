"""From an acceleration lane into dense traffic, in SUMO."""

import libsumo
import numpy as np
import pytest
from driving import KEEP, Watched, always, drive

from rail_sumo.config import Adas
from rail_sumo.config_file import validate
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.records import Command

DENSE = """<routes>
    <vType id="car" sigma="0" speedFactor="1"/>
    <route id="main" edges="main1 merge1 main2"/>
    <route id="ramp" edges="on1 merge1 main2"/>
    <flow id="right" type="car" route="main" begin="0" end="300" period="{period}" departLane="0" departSpeed="max"/>
    <flow id="middle" type="car" route="main" begin="0" end="300" period="{period}" departLane="1" departSpeed="max"/>
    <flow id="ramp" type="car" route="ramp" begin="100" end="300" period="40" departSpeed="max"/>
</routes>"""
"""Two lanes at the capacity that cars with a time gap of a second have, or nearly; they come to a ramp side by side."""


@pytest.mark.parametrize("period_s", [1.6, 1.8])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_host_is_let_in_without_standing_and_makes_no_more_than_one_other_brake_hard(
    make, outputs, touching, tmp_path, period_s, number
):
    demand = tmp_path / "dense.rou.xml"
    demand.write_text(DENSE.format(period=period_s))
    name = f"ramp.{number}"
    traffic = {"routes": [str(demand)], "host": name, "warm_up_s": 60.0}
    env = make(validate({"network": {"file": "onramp"}, "traffic": traffic}))
    driven = drive(env, always(KEEP), seed=number)
    env.close()
    assert driven.end_reason == "end of road"
    assert driven.speed_mps.min() > 5.0
    assert (driven.lane_changes, driven.collisions, driven.struck) == (1, 0, 0)
    assert driven.hard_brakings_behind <= 1  # SUMO's driver who lets it in
    assert (np.diff(driven.speed_mps) >= -0.3).all()
    changes = [(entry.get("from"), entry.get("to")) for entry in outputs("lanechange") if entry.get("id") == name]
    assert changes == [("merge1_0", "merge1_1")], "SUMO moves the host only where the layer does"
    assert not any(touching(scene) for scene in Watched.latest.scenes)


@pytest.mark.parametrize(("gap_m", "lets_pass"), [(1.6, True), (2.4, False)])
def test_a_waiting_host_wants_nothing_of_who_stands_too_near_behind_until_that_one_is_past(gap_m, lets_pass):
    """SUMO's drivers stop for whoever wants to leave its lane: the two stood on i24, a motorway of others, for 85 s."""

    def wants():
        return float(libsumo.vehicle.getParameter(HOST, "laneChangeModel.lcStrategic")) > 0.0

    course = road.load("onramp", ("on1", "merge1", "main2"))
    with Simulation(course.net_file, seed=1) as simulation:
        simulation.lay_course(course, Adas(), sees_m=300.0)
        front_m = course.edges[1].length_m - 30.0
        simulation.add_host(["merge1", "main2"], lane=0, front_m=front_m, speed_mps=0.0)
        length_m = libsumo.vehicletype.getLength("rail_sumo_host")
        libsumo.route.add("main", ["merge1", "main2"])
        libsumo.vehicle.add(
            "near", "main", departLane="1", departPos=f"{front_m - length_m - gap_m:.2f}", departSpeed="0"
        )
        simulation.wait_for_host()
        libsumo.vehicle.setSpeed("near", 0.0)
        wanted = []
        for _ in range(10):
            simulation.run(Command(0.0, asks=1))
            wanted.append(wants())
        assert wanted == [not lets_pass] * 10
        libsumo.vehicle.setSpeed("near", -1.0)
        for _ in range(100):
            simulation.run(Command(0.0, asks=1))
        assert libsumo.vehicle.getRoadID("near") == "main2"
        assert wants()


@pytest.mark.parametrize(("gap_m", "slow_mps", "asks"), [(12.0, 0.0, False), (18.0, 0.0, True), (12.0, 8.0, True)])
def test_the_host_does_not_ask_beside_somebody_who_would_have_it_brake_hard(gap_m, slow_mps, asks):
    """Of who asks and brakes SUMO's drivers take any gap: one that stood pulled out 6 m ahead of a host at 38 km/h.

    From 10 m/s it takes 14.3 m to stop by 3.5 m/s².
    """
    course = road.load("onramp", ("on1", "merge1", "main2"))
    with Simulation(course.net_file, seed=1) as simulation:
        simulation.lay_course(course, Adas(), sees_m=300.0)
        simulation.add_host(["merge1", "main2"], lane=0, front_m=100.0, speed_mps=10.0)
        libsumo.route.add("main", ["merge1", "main2"])
        front_m = 100.0 + gap_m + libsumo.vehicletype.getLength("rail_sumo_host")
        libsumo.vehicle.add(
            "slow", "main", "rail_sumo_host", departLane="1", departPos=f"{front_m:.2f}", departSpeed="0"
        )
        simulation.wait_for_host()
        libsumo.vehicle.setSpeedMode("slow", 0)
        libsumo.vehicle.setSpeed("slow", slow_mps)
        libsumo.vehicle.setLaneChangeMode("slow", 0)
        simulation.run(Command(10.0, asks=1))
        simulation.run(Command(10.0, asks=1))
        insists = float(libsumo.vehicle.getParameter(HOST, "laneChangeModel.lcAssertive"))
        assert (insists < 1e-6) == asks


def test_there_is_such_a_lane():
    merge = road.load("onramp", ("on1", "merge1", "main2")).edges[1]
    assert (merge.n_lanes, merge.leads_on_m[0]) == (4, 0.0)
    assert merge.dead_ends[0]
    leads_off = road.load("onramp", ("main2", "diverge", "main3")).edges[1]
    assert (leads_off.leads_on_m[0], leads_off.dead_ends[0]) == (0.0, False)
