"""Drives in worlds of a test's own, and somebody who watches them."""

import dataclasses
import math
from contextlib import contextmanager

import gymnasium
import numpy as np

import rail_sumo  # noqa: F401  registers the environment
from rail_sumo.config_file import validate
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.records import MetaAction

KEEP, ACCELERATE, DECELERATE, LEFT, RIGHT = MetaAction
LANE_M = 3.2
UNSEEN = 1_900_000_000
"""Traffic seeds from here on: beyond those anybody trains or tunes on by hand."""
LATE_M = 0.25
"""How far before the border the host becomes a vehicle of the next lane, there and back."""


def world(**sections):
    """The default world for 60 s with some slow vehicles in it, set speeds of 40 to 80 km/h on any road; by section.

    To a demand the host is added.
    """
    tree = {
        "episode": {"course_m": math.inf, "duration_s": 60.0},
        "traffic": {"speed_low_kmh": 40.0},
        "adas": {"min_speed_kmh": 40.0, "start_speed_kmh": 60.0, "max_speed_kmh": 80.0},
    }
    tree |= {name: tree.get(name, {}) | changes for name, changes in sections.items()}
    if tree["traffic"].get("routes"):
        tree["traffic"].setdefault("host", "added")
        tree["traffic"].pop("speed_low_kmh")  # of made traffic
    return validate(tree)


BY_THE_LIMIT = {"max_speed_kmh": "limit", "min_speed_kmh": "limit/2", "start_speed_kmh": "limit*3/4"}
EMPTY = {"vehicles": 0}


@contextmanager
def registered(brief):
    """Give what makes environments as Gymnasium has them registered, of this world if none is given; all are closed."""
    made = []

    def make(**given):
        made.append(gymnasium.make("RailSumo/Highway-v0", **{"config": brief, **given}))
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


ON_RAMP = "main1 merge1 main2 diverge"
"""The edges of the shipped `onramp` from which `main3` leads on and `off` leads off."""
ONE = '<vehicle id="one" type="car" route="through" depart="0" departLane="1" departSpeed="max"/>'
"""A car that drives through; see `on_ramp`."""


def on_ramp(folder, elements):
    """Return route files for the shipped `onramp`, in which elements may name the routes `through` and `off`."""
    routes = folder / "own.rou.xml"
    routes.write_text(
        f'<routes><vType id="car" sigma="0"/><route id="through" edges="{ON_RAMP} main3"/>'
        f'<route id="off" edges="{ON_RAMP} off"/>{elements}</routes>'
    )
    return [str(routes)]


def led_off(folder, share=1.0):
    """Return additional files by which a share of those who come to `merge1` of the `onramp` are led off."""
    path = folder / "rerouter.add.xml"
    path.write_text(
        f'<additional><rerouter id="r" edges="merge1" probability="{share}"><interval begin="0" end="9999">'
        '<destProbReroute id="off"/></interval></rerouter></additional>'
    )
    return [str(path)]


def closing(folder, lanes, begin_s=0.0, end_s=9999.0, *, edge="part0", disallow="all"):
    """Return additional files that close lanes for a time, from an edge on."""
    path = folder / "works.add.xml"
    elements = "".join(f'<closingLaneReroute id="{lane}" disallow="{disallow}"/>' for lane in lanes)
    path.write_text(
        f'<additional><rerouter id="works" edges="{edge}"><interval begin="{begin_s}" end="{end_s}">{elements}'
        "</interval></rerouter></additional>"
    )
    return [str(path)]


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
