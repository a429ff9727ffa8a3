import itertools
import random
import re
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import settings

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
        )
        location = '<location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>'
        edges = [element for element in elements if element.startswith("<edge")]
        rest = [element for element in elements if not element.startswith("<edge")]
        path.write_text(f'<net version="1.20">{location}{"".join(edges)}{nodes}{"".join(rest)}</net>')
        return str(path)

    return write
