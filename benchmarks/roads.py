"""How drivers do on roads of your own: python benchmarks/roads.py ROADS [--policies ...] [--episodes 50] [--out FILE].

ROADS is a text file with a line for each road: its name, a colon, and the options that `rail-sumo eval` takes for it,
with paths relative to that file:

    motorway: --network motorway/osm.sumocfg
    ramp: --network ramp.net.xml --routes ramp.rou.xml --set traffic.begin_s=600

Every policy drives through the same traffic. Prints a Markdown table: means over the episodes that could be driven, in
the tables' units; contacts are all in which the host strikes or is struck; what ended the episodes.
"""

import argparse
import contextlib
import shlex
from collections import Counter
from pathlib import Path

import pandas as pd

from rail_sumo import cli, roster, run

POLICIES = ("road-rail", "road-expert", "rule", "sumo", "random")
COLUMNS = (
    "road",
    "policy",
    "episodes",
    "km/h",
    "overtakes",
    "overtaken",
    "lane changes per km",
    "hard brakings per 100 km",
    "refused",
    "contacts",
    "ends",
)


def options(line: str) -> tuple[str, list[str]]:
    """Return a road's name, and its options as overrides of the configuration."""
    name, _, words = line.partition(":")
    parser = argparse.ArgumentParser()
    parser.add_argument("--network")
    parser.add_argument("--routes", action="append")
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args(shlex.split(words))
    return name.strip(), cli.choice_of(given.network, given.routes, given.set).overrides


def listed(file: Path) -> list[tuple[str, list[str]]]:
    """Return the roads of a file, by `options`; to be called in its folder, which their paths are relative to."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return [options(line) for line in lines if line.strip() and line[0] != "#"]


def from_anywhere(policy: str) -> str:
    """Return a run directory by its absolute path, whether or not it is followed by how it acts; names as they are."""
    folder, colon, mode = policy.partition(":")
    return f"{Path(folder).resolve()}{colon}{mode}" if Path(folder).exists() else policy


def row(name: str, policy: str, episodes: pd.DataFrame) -> tuple[object, ...]:
    driven = episodes[episodes["duration_s"].notna()]
    km = driven["distance_m"].sum() / 1000
    ends = Counter(episodes["end_reason"])
    return (
        name,
        policy,
        len(driven),
        f"{driven['speed_kmh'].mean():.1f}",
        f"{driven['overtakes'].mean():.1f}",
        f"{driven['overtaken'].mean():.1f}",
        f"{driven['lane_changes'].sum() / km:.2f}",
        f"{driven['hard_brakings'].sum() / km * 100:.1f}",
        f"{driven['refused_decisions'].mean():.1f}",
        int(driven["collisions"].sum() + driven["struck"].sum()),
        ", ".join(f"{reason} {number}" for reason, number in ends.most_common()),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roads", type=Path)
    parser.add_argument("--policies", nargs="+", default=list(POLICIES))
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1811)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", help="these roads")
    parser.add_argument("--out", type=Path, help="all episodes, as Parquet")
    given = parser.parse_args()
    given.policies = [from_anywhere(policy) for policy in given.policies]
    print("| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS), flush=True)
    tables = []
    with contextlib.chdir(given.roads.parent):
        for name, overrides in listed(Path(given.roads.name)):
            if given.only and name not in given.only:
                continue
            world = roster.world([], overrides)
            who = {Path(policy).name: roster.find_driver(policy, world) for policy in given.policies}
            episodes, *_ = run.evaluate(
                who, world, episodes=given.episodes, seed=given.seed, workers=given.workers, reference=next(iter(who))
            )
            for policy in who:
                print("| " + " | ".join(map(str, row(name, policy, episodes[episodes["policy"] == policy]))) + " |")
            tables.append(episodes.assign(road=name))
            print(end="", flush=True)
    if given.out:
        partial = given.out.with_name(f".{given.out.name}")
        pd.concat(tables).to_parquet(partial)
        partial.replace(given.out)


if __name__ == "__main__":
    main()
