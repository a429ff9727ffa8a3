"""SUMO's car-following models as made traffic, beside one another: python benchmarks/car_following.py [--episodes 20].

For each model, under three drivers of the host: how often the other vehicles brake hard (above 3.5 m/s², averaged over
half a second), how many contacts there are, and what a step costs SUMO. How policies fare under another model without
learning anew: rail-sumo eval runs/first expert rule --set traffic.car_following=IDM.
"""

import argparse
import time
from collections import defaultdict
from typing import get_args
from unittest import mock

import libsumo
from rich.console import Console
from rich.table import Table

from rail_sumo import config_file
from rail_sumo.config import Config, Traffic
from rail_sumo.highway import env
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.vehicle.hard_braking import hard_brakings
from rail_sumo.records import SECONDS_PER_STEP
from rail_sumo.rollout import EVALUATION, Task, drive, traffic_seed


class Watched(Simulation):
    """Notes after every step each vehicle's speed, the contacts, and how long SUMO's step took."""

    speeds_mps: defaultdict[tuple[int, str], list[float]]
    contacts: set[tuple[int, str, str]]
    step_s: list[float]
    number = 0

    def _step(self) -> None:
        self.host.drive()
        started = time.perf_counter()
        libsumo.simulation.step()
        self.step_s.append(time.perf_counter() - started)
        self.host.note()
        for name in libsumo.vehicle.getIDList():
            if name != HOST:
                self.speeds_mps[self.number, name].append(libsumo.vehicle.getSpeed(name))
        self.contacts.update((self.number, one.collider, one.victim) for one in libsumo.simulation.getCollisions())


def watch(world: Config, driver: str, episodes: int) -> tuple[float, int, float]:
    """Return hard brakings per vehicle and hour, contacts, and microseconds a step."""
    Watched.speeds_mps, Watched.contacts, Watched.step_s = defaultdict(list), set(), []
    with mock.patch.object(env, "Simulation", Watched):
        for Watched.number in range(episodes):
            drive(Task(driver, world, traffic_seed(2711, EVALUATION, Watched.number)))
    hours = SECONDS_PER_STEP * sum(map(len, Watched.speeds_mps.values())) / 3600
    brakings = sum(map(hard_brakings, Watched.speeds_mps.values()))
    return brakings / hours, len(Watched.contacts), 1e6 * sum(Watched.step_s) / len(Watched.step_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    given = parser.parse_args()
    table = Table("model", "host", "hard brakings / vehicle-hour", "contacts", "µs a step")
    for model in get_args(Traffic.model_fields["car_following"].annotation):
        named = ["episode.course_m=inf", "episode.duration_s=300", f"traffic.car_following={model}", *given.set]
        world = config_file.load(overrides=named)
        for driver in ("keep", "random", "rule"):
            brakings, contacts, step_us = watch(world, driver, given.episodes)
            table.add_row(model, driver, f"{brakings:.1f}", str(contacts), f"{step_us:.0f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
