"""Whether RAIL's search goes anywhere: python benchmarks/placebo.py RUN [--walks 16] [--episodes 16].

Beside a run's clone, its RAIL and its expert drive the clone moved as far as the search went, each time in another
random direction, all on the same traffic. If those drive as RAIL does, what RAIL owes to its judge is not shown by how
it drives.

It also tells how straight the search went: the square of the way from the clone to the policy, by the sum of the
squares of its steps. Of a random walk that is 1, give or take sqrt(2 / n) for n parameters; of steps that go one way it
is far more. It may be 1 of a search that learns, too: among n directions a few that matter hardly show.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from rail_sumo import rollout, roster
from rail_sumo.highway import metrics
from rail_sumo.rollout import Task, traffic_seed
from rail_sumo.run_directory import PROGRESS, RunDirectory
from rail_sumo.tables import audit

FIGURES = ["speed_kmh", "overtakes", "lane_changes"]
TRAFFIC = 2**20
"""Seed of the traffic, which no training and no table has met."""


def straightness(way: np.ndarray, step_norms: np.ndarray) -> float:
    """Return the square of the way's length by the sum of the squares of the steps'."""
    return float(way @ way / (step_norms @ step_norms))


def elsewhere(theta: np.ndarray, distance: float, rng: np.random.Generator) -> np.ndarray:
    """Return parameters as far from others, in a direction drawn evenly from all."""
    direction = rng.standard_normal(theta.size)
    return theta + distance / np.linalg.norm(direction) * direction


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--walks", type=int, default=16)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    learned = RunDirectory(given.run)
    world, clone, trained = learned.config, learned.clone, learned.policy()
    way = trained.theta - clone.theta
    distance, rng = float(np.linalg.norm(way)), np.random.default_rng(0)
    steps = pd.read_csv(given.run / PROGRESS)["step_norm"].to_numpy()
    print(
        f"{len(steps)} steps; from the clone {distance:.2f}; straightness {straightness(way, steps):.3f}, of a random "
        f"walk 1 ± {math.sqrt(2 / way.size):.3f}"
    )
    expert = roster.find_driver("expert", world)
    who = {"expert": expert, "clone": clone, "rail": trained}
    for walk in range(given.walks):
        who[f"random direction {walk}"] = replace(clone, theta=elsewhere(clone.theta, distance, rng))
    seeds = [traffic_seed(TRAFFIC, rollout.EVALUATION, episode) for episode in range(given.episodes)]
    rows = []
    with rollout.workers(given.workers) as pool:

        def drive(policy):
            return list(pool.map(rollout.drive, [Task(policy, world, seed) for seed in seeds]))

        shown = drive(expert)
        for name, policy in who.items():
            driven = shown if policy is expert else drive(policy)
            table = pd.DataFrame([metrics.row(one, world.adas) for one in driven])
            apart = math.nan if policy is expert else float(audit.told_apart(driven, shown).mean())
            contacts = int(table["collisions"].sum())
            rows.append({"who": name, **table[FIGURES].mean(), "told apart": apart, "contacts": contacts})
    table = pd.DataFrame(rows).set_index("who")
    table[FIGURES] /= table.loc["expert", FIGURES]
    walks = table.index.str.startswith("random")
    print(f"\nby the expert's, {given.episodes} episodes each:\n{table[~walks].round(3).to_string()}")
    print(f"\n{given.walks} random directions:\n{table[walks].describe().loc[['mean', 'std', 'min', 'max']].round(3)}")


if __name__ == "__main__":
    main()
