"""What a clone owes to the trajectories that it was shown: other ones of the same expert's, as many at a time.

    python benchmarks/shown.py [--out runs/shown] [--workers 2]

Tables by trajectories show all trainings the same ones, the first of the demonstrations, so that their intervals do not
tell what others would have come to. Here the shipped expert's 40 are dealt out in groups, a clone is made of each, all
with the same first weights, and driven in either mode on traffic that no training meets. Figures are ratios to
the expert's: the mean over groups, the least and the greatest.
"""

import argparse
import tempfile
from pathlib import Path

import kept
import numpy as np
import pandas as pd

from rail_sumo import config_file, roster, run, training
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import ARGMAX, SAMPLED

GROUPS = {1: 10, 5: 8, 10: 4}
"""How many groups, by the number of trajectories in each."""
SEED, TRAFFIC, EPISODES = 300, 10**6 + 2, 32
METRICS = ["speed_kmh", "overtakes", "lane_changes", "lateral_reward"]


def dealt(every: Demonstrations, shown: int, number: int) -> Demonstrations:
    """Return group `number` of so many trajectories each."""
    return every.only(np.unique(every.episode)[number * shown : (number + 1) * shown])


def clone(given: tuple[int, int]) -> pd.DataFrame:
    """A row per mode: ratios to the expert of a clone that was shown group `number` of `shown` trajectories."""
    shown, number = given
    world = config_file.load(None, ["train.learner=bc", f"train.trajectories={shown}"])
    every = training.demonstrations_of(world.changed(train={"trajectories": shown * GROUPS[shown]}))
    group = dealt(every, shown, number)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "group.parquet"
        group.save(file, features=feature_names(world.lidar, world.observation), about={})
        learned = training.learn(
            world.changed(train={"demonstrations": str(file)}), Path(folder) / "run", seed=SEED
        ).policy()
    who = {mode: learned.acting(mode) for mode in (ARGMAX, SAMPLED)} | {"expert": roster.find_driver("expert", world)}
    episodes, *_ = run.evaluate(who, world, episodes=EPISODES, seed=TRAFFIC)
    means = episodes.groupby("policy", sort=False)[METRICS].mean()
    ratios = means.loc[[ARGMAX, SAMPLED]] / means.loc["expert"]
    return ratios.reset_index().assign(shown=shown, number=number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/shown"))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    parts = {f"{shown}-trajectories-{k}": (shown, k) for shown, groups in GROUPS.items() for k in range(groups)}
    done = kept.tables(
        given.out, parts, clone, workers=given.workers, say=lambda rows: str(rows[METRICS].round(3).values)
    )
    table = done.groupby(["policy", "shown"])[METRICS].agg(["mean", "min", "max"])
    print(table.round(2).to_string())


if __name__ == "__main__":
    main()
