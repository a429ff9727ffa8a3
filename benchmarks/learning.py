"""How well the learners learn, seed by seed, and that it is the judge RAIL learns from.

    rail-sumo reproduce table1 --seeds 5 && python benchmarks/learning.py runs/reproduce   # every seed's figures
    python benchmarks/learning.py runs/reproduce --control    # RAIL under judges that know nothing, against its clone

A seed's figures are means over its held-out episodes, and ratios to the expert's on the same traffic.
"""

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from rail_sumo import learners, rollout
from rail_sumo.highway import metrics
from rail_sumo.imitation import rail
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.discriminator import Fit
from rail_sumo.policy import ARGMAX
from rail_sumo.run_directory import PROGRESS, RunDirectory
from rail_sumo.studies.experiment import SYSTEMS, Cell
from rail_sumo.studies.reproduce import read_cells

SHOWN = ["speed_kmh", "overtakes", "lane_changes", "lateral_reward"]
FIGURES = [*SHOWN, "refused_decisions", "told_apart", "collisions", "struck"]


def seed_by_seed(out: Path) -> pd.DataFrame:
    """A row per training: the mean speed, ratios to the expert, the gain on a clone of the same seed, the time."""
    cells = read_cells(out / "cells.parquet")
    by_argmax = cells[cells["mode"] == ARGMAX].groupby(["system", "trajectories", "training_seed"])["speed_kmh"].mean()
    cells = cells[cells["as_trained"]]
    means = cells.groupby(["system", "trajectories", "training_seed"], sort=False)[FIGURES].mean()
    rows = []
    for (system, trajectories, seed), driven in means.iterrows():
        if not SYSTEMS[system].trains:
            continue
        ratios = driven[SHOWN] / means.loc[("expert", 0, seed), SHOWN]
        clone = "bc-" + system.partition("-")[2]
        gain = by_argmax.get((system, trajectories, seed)) - by_argmax.get((clone, trajectories, seed), np.nan)
        progress = pd.read_csv(out / "runs" / Cell(system, trajectories, seed).name / PROGRESS)
        rows.append({
            "system": system,
            "trajectories": trajectories,
            "seed": seed,
            "km/h": driven["speed_kmh"],
            **{f"{name}/expert": ratio for name, ratio in ratios.items()},
            "km/h on its clone, both by argmax": gain,
            "refused": driven["refused_decisions"],
            "told apart": driven["told_apart"],
            "contacts": driven["collisions"] + driven["struck"],
            "million steps": progress["environment_steps"].max() / 1e6,
            "minutes": progress["seconds"].max() / 60,
        })  # fmt: skip
    return pd.DataFrame(rows)


class Indifferent:
    """Finds everything as likely the expert's as the learner's."""

    def fit(self, expert, learner, rng) -> Fit:
        return Fit(0.25, 0.5, 0.5)

    def returns(self, trajectories) -> np.ndarray:
        return np.zeros(len(trajectories))


class CoinToss(Indifferent):
    """Scores by chance: the search moves, but nowhere in particular."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def returns(self, trajectories) -> np.ndarray:
        return self._rng.normal(size=len(trajectories))


def control(folder: Path, iterations: int | None, episodes: int) -> None:
    """Train `folder`'s clone under judges that know nothing; a permutation test over the same traffic for each."""
    learned = RunDirectory(folder)
    world, clone = learned.config, learned.clone
    iterations = iterations or world.train.n_iterations
    none = Demonstrations(np.zeros((1, clone.shape.n_features)), np.zeros(1, np.int64), np.zeros(1, np.int64))
    with rollout.workers(2) as pool:
        practice = learners.Practice(learned, pool)

        def evaluate(theta, perturbations, iteration):
            return practice.pairs(replace(clone, theta=theta), perturbations, iteration)

        def speeds(driver):
            seeds = [rollout.traffic_seed(learned.seed, rollout.EVALUATION, episode) for episode in range(episodes)]
            driven = pool.map(rollout.drive, [rollout.Task(driver, world, seed) for seed in seeds])
            return np.array([metrics.row(trajectory, world.adas)["speed_kmh"] for trajectory in driven])

        by_clone = speeds(clone)
        contenders = {f"rail's judge, {world.train.n_iterations} iterations": speeds(learned.policy())}
        for name, judge in (("constant judge", Indifferent()), ("coin toss", CoinToss())):
            states = rail.train(
                clone.theta, none, search=world.search, judge=judge, evaluate=evaluate, seed=learned.seed
            )
            *_, last = itertools.islice(states, iterations)
            contenders[f"{name}, {iterations} iterations"] = speeds(replace(clone, theta=last.theta))
    print(f"clone: {by_clone.mean():.2f} km/h over {episodes} held-out episodes")
    for name, speed in contenders.items():
        test = stats.permutation_test(
            (speed, by_clone), lambda a, b, axis: np.mean(a - b, axis=axis), permutation_type="samples",
            alternative="greater", vectorized=True, n_resamples=9999, rng=0,
        )  # fmt: skip
        gain = np.mean(speed - by_clone)
        print(f"{name}: {speed.mean():.2f} km/h, {gain:+.2f} on its clone, one-sided permutation p = {test.pvalue:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what rail-sumo reproduce wrote")
    parser.add_argument("--control", action="store_true", help="the negative control instead, on seed 0")
    parser.add_argument("--iterations", type=int, help="of the control; as many as the run's without it")
    parser.add_argument("--episodes", type=int, default=16, help="of the control")
    given = parser.parse_args()
    if given.control:
        control(given.folder / "runs" / "rail-2-unmasked-40-seed0", given.iterations, given.episodes)
    else:
        print(seed_by_seed(given.folder).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
