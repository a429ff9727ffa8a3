"""Is nobody hit where many are driven: benchmarks/shares.py [ROADS] [--policies ...] [--shares ...] [--seeds 10].

ROADS is a list of roads of your own, as `roads.py` takes it; highway5 and ring5 with their demand are driven beside.
Every run begins with an empty road and lasts `--seconds`. Prints a Markdown table: vehicles that were driven, decisions
that they took, contacts in which one of them struck or was struck, and of these those in which it was the one that
struck; teleports of driven vehicles.
"""

import argparse
import contextlib
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
import roads

from rail_sumo import config_file, rollout, roster
from rail_sumo.errors import InputError
from rail_sumo.rollout import EVALUATION, traffic_seed

OURS = [(name, [f'network.file="{name}"', f'traffic.routes=["{name}"]']) for name in ("highway5", "ring5")]


def drive(work: tuple[str, list[str], str, float, int, float]) -> dict[str, object]:
    name, overrides, policy, share, number, seconds = work
    world = config_file.load(None, overrides)
    fleet = rollout.fleet_of(roster.find_driver(policy, world), world, share, traffic_seed(number, EVALUATION, 0))
    told = {"road": name, "policy": policy, "share": share}
    try:
        fleet.drive(world.traffic.begin_s + seconds)
    except InputError as error:
        return told | {"stopped": str(error)}
    teleported = sum(vehicle in fleet.driven for _, vehicle in fleet.teleported)
    return told | {
        "runs": 1,
        "driven": len(fleet.driven),
        "decisions": fleet.decisions,
        "contacts": fleet.contacts,
        "of these struck": fleet.struck_another,
        "teleports": teleported,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roads", type=Path, nargs="?")
    parser.add_argument("--policies", nargs="+", default=["rule", "road-rail", "random"])
    parser.add_argument("--shares", nargs="+", type=float, default=[0.1, 0.5, 1.0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="of the seeds")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    rows = []
    with contextlib.chdir(asked.roads.parent if asked.roads else "."):
        known = OURS + (roads.listed(Path(asked.roads.name)) if asked.roads else [])
        seeds = range(asked.first, asked.first + asked.seeds)
        work = [
            (name, options, policy, share, seed, asked.seconds)
            for (name, options), policy, share, seed in product(known, asked.policies, asked.shares, seeds)
        ]
        with ProcessPoolExecutor(asked.workers, get_context("spawn")) as pool:
            for row in pool.map(drive, work):
                if "stopped" in row:
                    print(f"{row['road']}, {row['policy']}, share {row['share']}: {row['stopped']}", flush=True)
                rows.append(row)
    table = pd.DataFrame(rows).groupby(["road", "policy", "share"], sort=False).sum(numeric_only=True).astype(int)
    print(f"| {' | '.join([*table.index.names, *table.columns])} |\n|{' --- |' * (3 + len(table.columns))}")
    for keys, counts in zip(table.index, table.to_numpy(), strict=True):
        print(f"| {' | '.join(map(str, (*keys, *counts)))} |")


if __name__ == "__main__":
    main()
