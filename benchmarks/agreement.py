"""Whether our counts are SUMO's: python benchmarks/agreement.py [--episodes 20] [--set KEY=VALUE].

SUMO writes its own account of every episode, lanechange-output and collision-output; an onlooker notes where the host
is, sideways, after every step. On a straight road, cut into edges or not, the three must agree:

    host's entries in lanechange-output = lane changes + 2 x aborted ones that had crossed over

since an aborted change that had become a vehicle of the next lane is two entries, there and back; one that the
episode's end cuts short adds those it had made by then. With SUMO's own driver every entry is a lane change.
"""

import argparse
import dataclasses
import functools
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from unittest import mock

import libsumo

from rail_sumo import config_file
from rail_sumo.highway import env
from rail_sumo.highway.adas import LATE_LATERAL_M
from rail_sumo.highway.simulation import HOST, Simulation
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


def episode(task: Task) -> dict[str, int]:
    left_m: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        files = {kind: Path(folder, f"{kind}.xml") for kind in ("lanechange", "collision")}
        outputs = [word for kind, file in files.items() for word in (f"--{kind}-output", str(file))]
        with mock.patch.object(env, "Simulation", functools.partial(Watched, left_m=left_m)):
            driven = drive(dataclasses.replace(task, outputs=tuple(outputs)))
        entries = {kind: list(ElementTree.parse(file).getroot()) for kind, file in files.items()}
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1811)
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    given = parser.parse_args()
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
