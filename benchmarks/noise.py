"""How much of what the search follows is the policy's doing, and how much is traffic's.

    python benchmarks/noise.py runs/first [--noise 0.05 0.1 0.2] [--directions 200]

At a trained policy, every direction is driven forwards and backwards twice, on two traffics that have nothing to do
with each other. The correlation, over directions, of the difference in return on the one traffic and on the other is
the share of that difference which a perturbation owes to itself. The same for the speed and the lane changes that the
returns are to bring about, and, across, how well the return on one traffic foretells them on the other. The judge is
the run's own. It also tells how far that judge has learned its demonstrations by heart: its mean verdict on them,
beside that on drives of the same expert that it never saw.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from rail_sumo import learners, rollout, roster, run, training
from rail_sumo.run_directory import RunDirectory

FIGURES = {
    "return": None,
    "speed": lambda driven: np.array([trajectory.speed_mps.mean() for trajectory in driven]),
    "lane changes": lambda driven: np.array([trajectory.lane_changes for trajectory in driven]),
}


def correlations(learned: RunDirectory, noise_std: float, n_directions: int, pool, payer) -> pd.DataFrame:
    """Correlations over directions: rows are figures on one traffic, columns figures on the other."""
    policy = learned.policy()
    deltas = np.random.default_rng(0).standard_normal((n_directions, policy.shape.size))
    practice = learners.Practice(learned, pool)
    differences = []
    for traffic in (-1, -2):  # no training's iterations
        plus, minus = practice.pairs(policy, noise_std * deltas, 2**31 + traffic)
        differences.append(
            [(figure or payer.returns)(plus) - (figure or payer.returns)(minus) for figure in FIGURES.values()]
        )
    one, other = differences
    across = np.corrcoef(one, other)[: len(FIGURES), len(FIGURES) :]
    return pd.DataFrame((across + across.T) / 2, index=list(FIGURES), columns=list(FIGURES))


def verdicts(learned: RunDirectory, judge, workers: int) -> dict[str, float]:
    """The judge's mean verdict on what it learned from, and on other drives of the same expert."""
    world = learned.config
    shown = training.demonstrations_of(world)
    unseen = run.record(roster.find_driver("expert", world), world, episodes=40, seed=2**31, workers=workers)

    def verdict(drives):
        return float((1 / (1 + np.exp(-judge.rewards(drives.observations, drives.actions)))).mean())

    return {"its demonstrations": verdict(shown), "other drives of the expert": verdict(unseen)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.05, 0.1, 0.2])
    parser.add_argument("--directions", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    learned = RunDirectory(given.run)
    judge = learners.judge_of(learned)
    payer = learners.judge_with_reward(judge, learned.config)
    for whose, mean in verdicts(learned, judge, given.workers).items():
        print(f"the judge's mean verdict on {whose}: {mean:.3f}")
    with rollout.workers(given.workers) as pool:
        for noise_std in given.noise:
            table = correlations(learned, noise_std, given.directions, pool, payer)
            print(f"\nnoise_std {noise_std}, {given.directions} directions:\n{table.round(2).to_string()}", flush=True)


if __name__ == "__main__":
    main()
