"""Whom driven cars touch in towns that nobody tuned: python benchmarks/towns.py [--policy road-rail] [--seconds 300].

SUMO's netgenerate draws towns, a grid and a random one for every kind of junction and every number of lanes, every
third of them driven on the left, and its randomTrips who drives there: cars, and a lorry every 8 s. Each town is driven
as it is, and with all cars driven. Prints a Markdown table by kind of junction: trips that ended, contacts, those of
driven cars and those in which one struck, and the time loss. The towns are left in the folder `--out`. SUMO's programs
come with the extra `networks`.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import sysconfig
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd

from rail_sumo import config_file, rollout, roster
from rail_sumo.rollout import EVALUATION, traffic_seed

JUNCTIONS = ("priority", "priority_stop", "right_before_left", "allway_stop", "zipper", "traffic_light")
SHAPES = {
    "grid": "--grid --grid.number 4 --grid.length 150 --grid.attach-length 150",
    "random": "--rand --rand.iterations 60 --rand.min-distance 80 --rand.max-distance 200",
}
LANES = {1: 2.0, 2: 1.2}
"""In a town with so many lanes a car departs every so many seconds."""
LORRY_EVERY_S = 8.0
TOWN_LIMIT_MPS = 13.89


def build(folder: Path) -> list[tuple[str, Path]]:
    """Make the towns that are not there yet; return each with its kind of junction."""
    import sumo

    program = str(Path(sysconfig.get_path("scripts"), "netgenerate"))
    trips = [sys.executable, str(Path(sumo.SUMO_HOME, "tools", "randomTrips.py")), "--validate"]
    trips += ["--fringe-factor", "5", "--min-distance", "300", "-e", "600", "-r", os.devnull]
    trips += ["--trip-attributes", 'departLane="best" departSpeed="max"']

    def run(*command: str) -> None:
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"SUMO_HOME": sumo.SUMO_HOME})

    towns = []
    for number, (junction, shape, lanes) in enumerate(product(JUNCTIONS, SHAPES, LANES)):
        town = folder / f"{junction}-{shape}-{lanes}"
        network = f"{town}.net.xml"
        towns.append((junction, town))
        if Path(f"{town}.lorry.xml").exists():
            continue
        own = f"--default.lanenumber {lanes} --default-junction-type {junction} --default.speed {TOWN_LIMIT_MPS}"
        left = ["--lefthand"] if number % 3 == 2 else []
        run(program, *SHAPES[shape].split(), *own.split(), *left, "--seed", str(number), "-o", network)
        for prefix, every_s, vclass in (("car", LANES[lanes], "passenger"), ("lorry", LORRY_EVERY_S, "truck")):
            who = ["--prefix", prefix, "-p", str(every_s), "--vehicle-class", vclass, "--seed", str(number)]
            run(*trips, "-n", network, *who, "-o", f"{town}.{prefix}.xml")
    return towns


def drive(work: tuple[str, Path, str, float, float]) -> dict[str, object]:
    junction, town, policy, share, seconds = work
    demand = [f"{town}.{who}.xml" for who in ("lorry", "car")]
    world = config_file.load(None, [f'network.file="{town}.net.xml"', f"traffic.routes={demand}", "traffic.begin_s=0"])
    told = {"trips": town.with_suffix(f".{share}.trips.xml"), "contacts": town.with_suffix(f".{share}.contacts.xml")}
    outputs = ["--tripinfo-output", str(told["trips"]), "--collision-output", str(told["contacts"])]
    fleet = rollout.fleet_of(roster.find_driver(policy, world), world, share, traffic_seed(0, EVALUATION, 0), outputs)
    fleet.drive(seconds)
    trips, contacts = (list(ElementTree.parse(file).getroot()) for file in told.values())
    for file in told.values():
        file.unlink()
    return {
        "junctions": junction,
        "share": share,
        "arrived": len(trips),
        "contacts": len(contacts),
        "of driven cars": fleet.contacts,
        "struck": fleet.struck_another,
        "km": sum(float(trip.get("routeLength", 0)) for trip in trips) / 1000,
        "loss_s": sum(float(trip.get("timeLoss", 0)) for trip in trips),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="road-rail")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--out", type=Path, default=Path("build/towns"))
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    towns = build(asked.out.absolute())
    work = [(*town, asked.policy, share, asked.seconds) for town in towns for share in (0.0, 1.0)]
    with get_context("forkserver").Pool(asked.workers, maxtasksperchild=1) as pool:
        rows = pd.DataFrame(list(pool.imap(drive, work)))
    for_all = rows.assign(junctions="all")
    table = pd.concat([rows, for_all]).groupby(["junctions", "share"], sort=False).sum()
    table.insert(4, "time loss s/km", (table.pop("loss_s") / table.pop("km")).round(1))
    print(f"{len(towns)} towns, {asked.policy}, {asked.seconds:g} s\n")
    print(f"| {' | '.join([*table.index.names, *table.columns])} |\n|{' --- |' * (2 + len(table.columns))}")
    for keys, figures in zip(table.index, table.to_dict("records"), strict=True):
        print(f"| {' | '.join(map(str, (*keys, *figures.values())))} |")


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
