"""Whether anybody is touched, whatever is decided: python benchmarks/safety.py [--episodes 100] [--set KEY=VALUE].

Drives episodes of 300 s on traffic that nothing was tuned on, by the random and the rule driver. An onlooker who knows
nothing of SUMO's collisions compares the host's rectangle with everybody's after every step of 0.1 s. A contact is one
vehicle that the host's rectangle overlaps, however many steps it lasts.
"""

import argparse
import functools
import time
from collections.abc import Callable, Iterable
from unittest import mock

import libsumo
import numpy as np

from rail_sumo import config_file
from rail_sumo.highway import env
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.records import Floats, Scene
from rail_sumo.rollout import EVALUATION, Task, drive, traffic_seed, workers


def corners(scene: Scene, index: int) -> Floats:
    cos, sin = np.cos(scene.heading_rad[index]), np.sin(scene.heading_rad[index])
    ahead = 0.5 * scene.length_m[index] * np.array([cos, sin])
    left = 0.5 * scene.width_m[index] * np.array([-sin, cos])
    centre = np.array([scene.x_m[index], scene.y_m[index]])
    return np.array([centre + a * ahead + b * left for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))])


def touched(scene: Scene) -> set[str]:
    """Whose rectangle overlaps the host's: no side of either parts the two (separating axes)."""
    reach = 0.5 * np.hypot(scene.length_m, scene.width_m)
    near = np.hypot(scene.x_m - scene.x_m[0], scene.y_m - scene.y_m[0]) < reach + reach[0]
    found = set()
    for index in np.flatnonzero(near)[1:]:
        host, other = corners(scene, 0), corners(scene, index)
        headings = np.array([scene.heading_rad[0], scene.heading_rad[index]])
        axes = np.column_stack([np.cos(headings), np.sin(headings), -np.sin(headings), np.cos(headings)]).reshape(-1, 2)
        one, two = host @ axes.T, other @ axes.T
        if np.all(np.maximum(one.min(axis=0), two.min(axis=0)) < np.minimum(one.max(axis=0), two.max(axis=0))):
            found.add(scene.ids[index])
    return found


class Watched(Simulation):
    """Looks after every step."""

    def __init__(self, *arguments, seen: dict[str, int], **named) -> None:
        super().__init__(*arguments, **named)
        self._seen = seen
        self._touching: set[str] = set()

    def _step(self) -> None:
        super()._step()
        touching = touched(self.scene())
        self._seen["contacts"] += len(touching - self._touching)
        self._touching = touching
        others = [
            pair for pair in libsumo.simulation.getCollisions() if self.host.name not in (pair.collider, pair.victim)
        ]
        self._seen["among others"] += len(others)


def episode(task: Task) -> dict[str, float]:
    seen = {"contacts": 0, "among others": 0}
    with mock.patch.object(env, "Simulation", functools.partial(Watched, seen=seen)):
        driven = drive(task)
    return {
        "episodes": 1,
        "hours": 0.1 * len(driven.lane_changing) / 3600,
        "collisions": driven.collisions,
        "struck": driven.struck,
        **seen,
        "braking": -np.diff(driven.speed_mps).min() / 0.1,
        "ttc": driven.min_ttc_s,
        "changes": driven.lane_changes,
        "aborted": driven.aborted_lane_changes,
    }


COLUMNS: dict[str, Callable[[Iterable[float]], float]] = {
    "episodes": sum,
    "hours": sum,
    "changes": sum,
    "aborted": sum,
    "collisions": sum,
    "struck": sum,
    "contacts": sum,
    "among others": sum,
    "braking": max,
    "ttc": min,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1811)
    parser.add_argument("--drivers", nargs="+", default=["random", "rule"])
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    given = parser.parse_args()
    world = config_file.load(overrides=["episode.course_m=inf", "episode.duration_s=300", *given.set])
    print(f"{'driver':8}" + "".join(f"{name:>14}" for name in COLUMNS), flush=True)
    started = time.perf_counter()
    with workers(2) as pool:
        for driver in given.drivers:
            seeds = [traffic_seed(given.seed, EVALUATION, number) for number in range(given.episodes)]
            rows = list(pool.map(episode, [Task(driver, world, seed) for seed in seeds]))
            cells = [total(row[name] for row in rows) for name, total in COLUMNS.items()]
            print(f"{driver:8}" + "".join(f"{cell:>14.6g}" for cell in cells), flush=True)
    print(f"braking: hardest, m/s²; ttc: smallest, s; {time.perf_counter() - started:.0f} s of wall-clock time")


if __name__ == "__main__":
    main()
