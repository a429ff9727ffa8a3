"""Whether our counts are SUMO's: python benchmarks/agreement.py [--episodes 20] [--set KEY=VALUE] [--roads ROADS].

SUMO writes its own account of every episode, lanechange-output and collision-output; an onlooker notes where the host
is, sideways, after every step. On a straight road, cut into edges or not, the three must agree:

    host's entries in lanechange-output = lane changes + 2 x aborted ones that had crossed over

since an aborted change that had become a vehicle of the next lane is two entries, there and back; one that the
episode's end cuts short adds those it had made by then. With SUMO's own driver every entry is a lane change.

On roads of your own (ROADS as in roads.py) lanes bend and have other numbers on the next edge, and the onlooker cannot
tell. There every time that the assistance layer has the host cross over must be one entry of SUMO's; lane changes, and
aborted ones there and back, must come to as many; contacts must be those of collision-output, and the host must not
teleport.
"""

import argparse
import contextlib
import dataclasses
import functools
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import libsumo
from roads import listed

from rail_sumo import config_file
from rail_sumo.errors import InputError
from rail_sumo.highway import env
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.vehicle.adas import LATE_LATERAL_M
from rail_sumo.records import Command, Trajectory
from rail_sumo.rollout import EVALUATION, Task, drive, traffic_seed, workers


class Watched(Simulation):
    """Notes where the host is sideways after every step, from the centre of its first lane."""

    def __init__(self, *arguments, left_m: list[float], **named) -> None:
        super().__init__(*arguments, **named)
        self._left_m = left_m

    def _step(self) -> None:
        super()._step()
        left_m = libsumo.vehicle.getPosition(self.host.name)[1]
        if not self._left_m:
            self._centre_m = left_m - libsumo.vehicle.getLateralLanePosition(self.host.name)
        self._left_m.append(left_m - self._centre_m)


def account(left_m: list[float], lane_m: float) -> tuple[int, int, int]:
    """(lane changes, aborted ones, entries SUMO must have made) of a host that was here sideways after each step."""
    lane, offset, farthest = round(left_m[0] / lane_m), 0.0, 0.0
    changes = aborted = entries = 0
    for now in left_m:
        offset = abs(now - lane * lane_m)
        farthest = max(farthest, offset)
        settled = round(now / lane_m)
        if abs(now - settled * lane_m) < 1e-6 and farthest > 1e-6:
            aborted += settled == lane
            changes += abs(settled - lane)
            entries += abs(settled - lane) or 2 * (farthest >= 0.5 * lane_m - LATE_LATERAL_M - 1e-9)
            lane, offset, farthest = settled, 0.0, 0.0
    if farthest >= 0.5 * lane_m - LATE_LATERAL_M - 1e-9:
        is_back = offset < farthest and offset <= 0.5 * lane_m + LATE_LATERAL_M + 1e-9
        entries += 2 if is_back else 1
    return changes, aborted, entries


def driven_and_told(
    task: Task, watched: Callable[..., Simulation]
) -> tuple[Trajectory, dict[str, list[ElementTree.Element]]]:
    """Drive an episode in a simulation that is watched; beside it, SUMO's own entries by the kind of output."""
    with tempfile.TemporaryDirectory() as folder:
        files = {kind: Path(folder, f"{kind}.xml") for kind in ("lanechange", "collision")}
        outputs = [word for kind, file in files.items() for word in (f"--{kind}-output", str(file))]
        with mock.patch.object(env, "Simulation", watched):
            driven = drive(dataclasses.replace(task, outputs=tuple(outputs)))
        return driven, {kind: list(ElementTree.parse(file).getroot()) for kind, file in files.items()}


def episode(task: Task) -> dict[str, int]:
    left_m: list[float] = []
    driven, entries = driven_and_told(task, functools.partial(Watched, left_m=left_m))
    changes, aborted, expected = account(left_m, 3.2)
    return {
        "lane changes": driven.lane_changes,
        "of an onlooker": changes,
        "aborted": driven.aborted_lane_changes,
        "of an onlooker ": aborted,
        "SUMO's entries": sum(entry.get("id") == HOST for entry in entries["lanechange"]),
        "identity": expected,
        "collisions": driven.collisions + driven.struck,
        "SUMO's": sum(HOST in (entry.get("collider"), entry.get("victim")) for entry in entries["collision"]),
    }


class Noted(Simulation):
    """Notes who the host is, how often it is told to cross over, and whether it teleports."""

    def __init__(self, *arguments, noted: dict[str, Any], **named) -> None:
        super().__init__(*arguments, **named)
        self._noted = noted

    def run(self, command: Command, step: Callable[[], None] | None = None) -> int:
        self._noted["host"] = self.host.name
        self._noted["crossings"] += command.cross != 0
        return super().run(command, step)

    def _step(self) -> None:
        super()._step()
        self._noted["moved"] = self.host.sumos_lane_changes
        self._noted["teleports"] += self.host.name in libsumo.simulation.getStartingTeleportIDList()


def episode_on_road(task: Task) -> dict[str, int]:
    noted: dict[str, Any] = {"host": HOST, "crossings": 0, "moved": 0, "teleports": 0}
    try:
        driven, entries = driven_and_told(task, functools.partial(Noted, noted=noted))
    except InputError:  # it could not begin
        return {}
    host = noted["host"]
    own = sum(entry.get("id") == host for entry in entries["lanechange"])
    crossings = driven.lane_changes if task.driver == "sumo" else noted["crossings"] + noted["moved"]
    there_and_back = 2 * driven.aborted_lane_changes + 1  # one may be under way at the end
    contacts = driven.collisions + driven.struck
    sumos = sum(host in (entry.get("collider"), entry.get("victim")) for entry in entries["collision"])
    agree = (
        own == crossings
        and driven.lane_changes <= crossings <= driven.lane_changes + there_and_back
        and contacts == sumos
        and not noted["teleports"]
    )
    return {
        "episodes": 1,
        "lane changes": driven.lane_changes,
        "aborted": driven.aborted_lane_changes,
        "crossings": crossings,
        "SUMO's entries": own,
        "contacts": contacts,
        "SUMO's": sumos,
        "teleports": noted["teleports"],
        "disagree": not agree,
    }


def on_roads(file: Path, episodes: int, seed: int) -> None:
    """Print a line for each road and driver."""
    seeds = [traffic_seed(seed, EVALUATION, number) for number in range(episodes)]
    disagreeing, heading = 0, ""
    with contextlib.chdir(file.parent), workers(2, fresh=True) as pool:
        for name, overrides in listed(Path(file.name)):
            world = config_file.load(None, [*overrides, "episode.duration_s=300"])
            for driver in ("random", "rule", "sumo"):
                rows = [row for row in pool.map(episode_on_road, [Task(driver, world, s) for s in seeds]) if row]
                totals = {key: sum(row[key] for row in rows) for key in rows[0]} if rows else {}
                if totals and not heading:
                    heading = f"{'road':24}{'driver':8}" + "".join(f"{key:>15}" for key in totals)
                    print(heading)
                print(f"{name:24}{driver:8}" + "".join(f"{total:>15}" for total in totals.values()), flush=True)
                disagreeing += totals.get("disagree", 0)
    print(f"episodes in which any two disagree: {disagreeing}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1811)
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    parser.add_argument("--roads", type=Path, help="on these instead; see roads.py")
    given = parser.parse_args()
    if given.roads:
        on_roads(given.roads, given.episodes, given.seed)
        return
    world = config_file.load(overrides=["episode.course_m=inf", "episode.duration_s=300", *given.set])
    seeds = [traffic_seed(given.seed, EVALUATION, number) for number in range(given.episodes)]
    disagreeing, heading = 0, ""
    with workers(2) as pool:
        for driver in ("random", "rule", "sumo"):
            rows = list(pool.map(episode, [Task(driver, world, seed) for seed in seeds]))
            if not heading:
                heading = f"{'driver':8}{'episodes':>9}" + "".join(f"{name.strip():>16}" for name in rows[0])
                print(heading)
            totals = [sum(row[name] for row in rows) for name in rows[0]]
            print(f"{driver:8}{len(rows):>9}" + "".join(f"{total:>16}" for total in totals), flush=True)
            for row in rows:
                ours, onlooker, aborted, returned, entries, identity, collisions, sumos = row.values()
                agree = (ours, aborted, entries, collisions) == (onlooker, returned, identity, sumos)
                disagreeing += not agree
    print(f"episodes in which any two disagree: {disagreeing}")


if __name__ == "__main__":
    main()
