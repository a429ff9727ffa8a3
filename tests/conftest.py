import itertools
import random
import re
import sys
import xml.etree.ElementTree as ElementTree
from itertools import product

import numpy as np
import pytest
import torch
from driving import MERGE, Watched, world
from hypothesis import settings

from rail_sumo import assets, cli
from rail_sumo.highway import env as env_module
from rail_sumo.highway.env import HighwayEnv

settings.register_profile("patient", deadline=None)  # a busy machine is no failure
settings.load_profile("patient")


def _corners(scene, index):
    ahead = 0.5 * scene.length_m[index] * np.array([np.cos(scene.heading_rad[index]), np.sin(scene.heading_rad[index])])
    left = 0.5 * scene.width_m[index] * np.array([-np.sin(scene.heading_rad[index]), np.cos(scene.heading_rad[index])])
    centre = np.array([scene.x_m[index], scene.y_m[index]])
    return np.array([centre + a * ahead + b * left for a, b in product((-1, 1), repeat=2)])


def _apart(one, other, headings):
    """Two rectangles are apart if their shadows on a side of either are (separating axes)."""
    for heading in headings:
        for axis in ((np.cos(heading), np.sin(heading)), (-np.sin(heading), np.cos(heading))):
            if max((one @ axis).min(), (other @ axis).min()) >= min((one @ axis).max(), (other @ axis).max()):
                return True
    return False


@pytest.fixture(scope="session")
def touching():
    """A function that names the vehicles of a scene whose rectangles overlap the host's; it knows nothing of SUMO."""

    def of(scene):
        host = _corners(scene, 0)
        reach_m = 0.5 * np.hypot(scene.length_m, scene.width_m)
        near = np.hypot(scene.x_m - scene.x_m[0], scene.y_m - scene.y_m[0]) < reach_m + reach_m[0]
        return [
            scene.ids[index]
            for index in np.flatnonzero(near)[1:]
            if not _apart(host, _corners(scene, index), (scene.heading_rad[0], scene.heading_rad[index]))
        ]

    return of


@pytest.fixture
def left_alone_by():
    """A function that tells whether doing something leaves the caller's global generators alone, or puts them back."""

    def drawn():
        return random.random(), np.random.random(), torch.rand(1).item()  # noqa: NPY002

    def tell(do):
        before = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
        expected = drawn()
        random.setstate(before[0])
        np.random.set_state(before[1])  # noqa: NPY002
        torch.set_rng_state(before[2])
        do()
        return drawn() == expected

    return tell


@pytest.fixture
def network(tmp_path):
    """Write a network of the given elements and return its path as a user would give it."""
    numbers = itertools.count()

    def write(*elements):
        path = tmp_path / f"own{next(numbers)}.net.xml"
        names = dict.fromkeys(re.findall(r'<edge id="([^"]+)"', "".join(elements)))
        nodes = "".join(
            f'<junction id="{name}{end}" type="priority" x="0" y="0" incLanes="" intLanes="" shape="0,0"/>'
            for name in names
            for end in "-+"
            if f'<junction id="{name}{end}"' not in "".join(elements)
        )
        location = '<location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>'
        edges = [element for element in elements if element.startswith("<edge")]
        rest = [element for element in elements if not element.startswith("<edge")]
        path.write_text(f'<net version="1.20">{location}{"".join(edges)}{nodes}{"".join(rest)}</net>')
        return str(path)

    return write


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


@pytest.fixture
def merge(tmp_path):
    path = tmp_path / "merge.net.xml"
    path.write_text(MERGE)
    return {"file": str(path)}


@pytest.fixture
def soon_narrow(tmp_path):
    """Three lanes, the right one of which ends 100 m ahead of the host's start."""
    path = tmp_path / "soon.net.xml"
    path.write_text(re.sub(r'(<lane id="wide.*?)length="996.00"', r'\1length="300.00"', MERGE))
    return {"file": str(path)}


@pytest.fixture
def rail_sumo(monkeypatch, capsys, tmp_path):
    """Run the command line in an empty folder; return its exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["rail-sumo", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    return call
