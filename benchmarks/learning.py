"""How well RAIL learns, seed by seed, and that it is the judge it learns from.

    python benchmarks/learning.py --seeds 5 --layers 2      # trains runs/learning/two-layer-SEED, prints every seed
    python benchmarks/learning.py --control                 # RAIL under judges that know nothing, against its clone

Runs that exist already are read, not trained again. A seed's figures are means over held-out traffic; those over all
seeds are interquartile means with intervals, which of few seeds are too narrow (see `rail_sumo.statistics`).
"""

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from rail_sumo import config, metrics, rollout, run, statistics, training
from rail_sumo.imitation import rail
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.discriminator import JudgeLoss
from rail_sumo.run_directory import RunDirectory

SHOWN = ["speed_kmh", "overtakes", "lane_changes", "lateral_reward", "collisions", "struck"]


def seed_by_seed(layers: int, n_seeds: int, out: Path, overrides: list[str]) -> None:
    rows, driven = [], []
    for seed in range(n_seeds):
        folder = out / f"{'one' if layers == 1 else 'two'}-layer-{seed}"
        world = config.load(None, [f"policy.layers={layers}", *overrides])
        if not (folder / "episodes.parquet").exists():
            run.train(world, folder, seed=seed, workers=2, resume=folder.exists())
        driven.append(pd.read_parquet(folder / "episodes.parquet"))
        means = driven[-1].groupby("policy")[SHOWN].mean()
        seconds = pd.read_csv(folder / "progress.csv")["seconds"].iloc[-1]
        ratios = means.loc["rail"] / means.loc["expert"]
        rows.append({
            "seed": seed,
            **means.loc["rail"],
            "clone_kmh": means.loc["clone", "speed_kmh"],
            "speed/expert": ratios["speed_kmh"],
            "overtakes/expert": ratios["overtakes"],
            "changes/expert": ratios["lane_changes"],
            "lateral/expert": ratios["lateral_reward"],
            "training_s": seconds,
        })  # fmt: skip
        print(pd.DataFrame(rows).round(3).to_string(index=False), flush=True)
    print(over_all_seeds(driven).round(3).to_string(index=False))


def over_all_seeds(driven: list[pd.DataFrame]) -> pd.DataFrame:
    """Ratios of interquartile means to the expert's over all seeds' episodes, with 95 % intervals over both."""
    rows = []
    for metric in ("speed_kmh", "overtakes", "lane_changes", "lateral_reward"):
        rail, clone, expert = (
            np.array([table.loc[table["policy"] == policy, metric] for table in driven])
            for policy in ("rail", "clone", "expert")
        )
        low, high = statistics.interval(statistics.ratio_of_iqms, rail, expert)
        gain_low, gain_high = statistics.interval(statistics.mean_difference, rail, clone)
        rows.append({
            "metric": metric,
            "rail/expert": statistics.ratio_of_iqms(rail, expert),
            "low": low,
            "high": high,
            "rail-clone": statistics.mean_difference(rail, clone),
            "low ": gain_low,
            "high ": gain_high,
            "P(rail above clone)": statistics.probability_of_improvement(rail, clone),
        })  # fmt: skip
    return pd.DataFrame(rows)


class Indifferent:
    """Finds everything as likely the expert's as the learner's."""

    def fit(self, expert, learner, rng) -> JudgeLoss:
        return JudgeLoss(0.25, 0.5, 0.5)

    def returns(self, trajectories) -> np.ndarray:
        return np.zeros(len(trajectories))


class CoinToss(Indifferent):
    """Scores by chance: the search moves, but nowhere in particular."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def returns(self, trajectories) -> np.ndarray:
        return self._rng.normal(size=len(trajectories))


def control(folder: Path, iterations: int, episodes: int) -> None:
    """Train `folder`'s clone under judges that know nothing; a permutation test over the same traffic for each."""
    learned = RunDirectory(folder)
    world, clone = learned.config, learned.clone
    none = Demonstrations(np.zeros((1, clone.shape.n_features)), np.zeros(1, np.int64), np.zeros(1, np.int64))
    with rollout.workers(2) as pool:
        practice = training.Practice(learned, pool)

        def evaluate(theta, perturbations, iteration):
            return practice.pairs(replace(clone, theta=theta), perturbations, iteration)

        def speeds(driver):
            seeds = [rollout.traffic_seed(learned.seed, rollout.EVALUATION, episode) for episode in range(episodes)]
            driven = pool.map(rollout.drive, [rollout.Task(driver, world, seed) for seed in seeds])
            return np.array([metrics.row(trajectory, world.adas)["speed_kmh"] for trajectory in driven])

        by_clone = speeds(clone)
        contenders = {"rail's judge, the whole training": speeds(learned.policy(world))}
        for name, judge in (("constant judge", Indifferent()), ("coin toss", CoinToss())):
            states = rail.train(
                clone.theta, none, search=world.search, judge=judge, evaluate=evaluate, seed=learned.seed
            )
            theta = next(itertools.islice(states, iterations - 1, None)).theta
            contenders[name] = speeds(replace(clone, theta=theta))
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
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--layers", type=int, choices=(1, 2), default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/learning"))
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo train")
    parser.add_argument("--control", action="store_true", help="the negative control instead, on the first run")
    parser.add_argument("--iterations", type=int, default=30, help="of the control")
    parser.add_argument("--episodes", type=int, default=16, help="of the control")
    given = parser.parse_args()
    if given.control:
        control(given.out / "two-layer-0", given.iterations, given.episodes)
    else:
        seed_by_seed(given.layers, given.seeds, given.out, given.set)


if __name__ == "__main__":
    main()
