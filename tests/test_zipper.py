"""Where two lanes become one and drivers take turns: pure, and in SUMO."""

from pathlib import Path

import libsumo
import numpy as np
import pytest
from driving import UNSEEN
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo import config_file, rollout
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic.fleet import Fleet
from rail_sumo.highway.vehicle.zipper import Approach, goes_first

NETWORK = str(Path(__file__).with_name("zipper.net.xml"))
"""A road and a ramp become the two lanes of `both`, these become `one`, which a second ramp joins."""
FLOW = '<flow id="{0}" type="car" route="{0}" begin="1" end="300" period="exp({1})" departSpeed="desired"/>'
DENSE = (
    '<routes><vType id="car" speedFactor="normc(1,0.1,0.8,1.2)"/><route id="left" edges="left both one out"/>'
    '<route id="right" edges="right both one out"/><route id="ramp" edges="ramp out"/>'
    + FLOW.format("left", 0.195)
    + FLOW.format("right", 0.155)
    + FLOW.format("ramp", 0.115)
    + "</routes>"
)
"""1,700 vehicles an hour come together in one lane."""
MEETING = ("both", "one", "out", ":")


def test_of_each_lane_it_is_known_which_others_join_it():
    main, ramp = road.load(NETWORK, ("left", "both", "one", "out")), road.load(NETWORK, ("ramp", "out"))
    assert main.zips_with == {"both_0": ("both_1",), "both_1": ("both_0",), "one_0": ("ramp_0",)}
    assert ramp.zips_with == {"ramp_0": ("one_0",)}
    assert not road.load("onramp").zips_with


@pytest.mark.parametrize(
    ("ours", "theirs", "first"),
    [
        ((50.0, 20.0), (40.0, 20.0), False),  # who is ahead, ...
        ((50.0, 20.0), (49.0, 20.0), False),
        ((50.0, 20.0), (40.0, 8.0), False),  # ... slower too, where braking for a second keeps us behind, ...
        ((50.0, 20.0), (46.0, 8.0), True),  # ... and else who is there first
        ((50.0, 20.0), (46.0, 19.0), False),
        ((8.0, 0.0), (5.0, 0.0), False),  # of those who stand, the nearer
    ],
)
def test_who_goes_first_is_who_is_ahead_or_else_there_first(ours, theirs, first):
    own, other = Approach("own", *ours, 4.5), Approach("other", *theirs, 4.5)
    assert goes_first(own, other) is first
    assert goes_first(other, own) is not first


APPROACHES = st.tuples(st.floats(0.0, 200.0), st.floats(0.0, 40.0), st.floats(1.0, 9.0))


@given(APPROACHES, APPROACHES)
def test_two_are_always_of_one_mind_who_goes_first(one, other):
    first, second = Approach("a", *one), Approach("b", *other)
    assert goes_first(first, second) != goes_first(second, first)


def test_where_lanes_join_driven_cars_take_turns_and_brake_no_more_than_comfortably(tmp_path, monkeypatch):
    """Left to SUMO's zipper one in five braked by more than 3.5 m/s², up to 9; of SUMO's own one in four."""
    file = tmp_path / "dense.rou.xml"
    file.write_text(DENSE)
    world = config_file.validate({"network": {"file": NETWORK}, "traffic": {"routes": [str(file)]}})
    speeds_mps, lets_in, step = {}, set(), Simulation.step

    def watching(simulation):
        gone = step(simulation)
        for name in libsumo.vehicle.getIDList():
            if libsumo.vehicle.getLaneID(name).startswith(MEETING):
                speeds_mps.setdefault(name, []).append(libsumo.vehicle.getSpeed(name))
        lets_in.update(host.name.rpartition(".")[0] for host in simulation.hosts if host.lets_in)
        return gone

    monkeypatch.setattr(Simulation, "step", watching)
    driven = Fleet(world, 1.0, UNSEEN, lambda name: rollout.driver_of("rule", world, sum(name.encode())).decide)
    driven.drive(200.0)
    assert driven.contacts == 0
    assert lets_in == {"left", "right", "ramp"}
    assert len(speeds_mps) > 60
    assert min(np.diff(speeds).min() for speeds in speeds_mps.values() if len(speeds) > 1) > -0.25
    assert min(map(min, speeds_mps.values())) > 10.0
