"""What the paper claims beyond its Table 1, in the cells that `rail-sumo reproduce` left in a folder.

    rail-sumo reproduce table1 && python benchmarks/claims.py runs/reproduce

Learners are set beside one another as the table sets them beside the expert: episode by episode on the same traffic, on
the training seeds that both were trained with. Whatever is finished in the folder counts, of Figures 3 and 4 too.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from rail_sumo import config, report, training
from rail_sumo.records import MetaAction
from rail_sumo.reproduce import ROWS, compare, scores
from rail_sumo.statistics import interval, mean_difference

PAIRS = (
    (("rail", 2), ("bc", 2)),
    (("rail", 1), ("bc", 1)),
    (("rail", 1), ("rail", 2)),
    (("rail", 2), ("gail", 2)),
    (("rail", 2), ("dagger", 2)),
    (("rail", 2), ("expert", 0)),
)
METRICS = ("speed_kmh", "overtakes", "lane_changes")


def ratios(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per learner and number of trajectories: ratios to the expert on the same seeds, with 95 % intervals."""
    driven_by_expert = cells[cells["learner"] == report.EXPERT]
    rows = []
    for (learner, layers, trajectories), driven in cells.groupby(["learner", "layers", "trajectories"]):
        if learner == report.EXPERT:
            continue
        expert = driven_by_expert[driven_by_expert["training_seed"].isin(driven["training_seed"])]
        table = compare(pd.concat([driven, expert])).set_index(["learner", "metric"])
        of_the_expert = {
            metric: "{ratio:.3f} ({ratio_low:.3f} to {ratio_high:.3f})".format_map(table.loc[(learner, metric)])
            for metric in (*METRICS, "lateral_reward")
        }
        seeds = driven["training_seed"].nunique()
        rows.append({"": ROWS[learner, layers], "shown": trajectories, "seeds": seeds, **of_the_expert})
    return pd.DataFrame(rows)


def differences(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per pair and metric: the mean difference, one minus the other, with its 95 % interval."""
    rows = []
    for one, other in PAIRS:
        ours, theirs = (
            cells[(cells["learner"] == name) & (cells["layers"] == layers)] for name, layers in (one, other)
        )
        seeds = set(ours["training_seed"]) & set(theirs["training_seed"])
        if not seeds:
            continue
        for metric in METRICS:
            pair = [scores(driven[driven["training_seed"].isin(seeds)], metric) for driven in (ours, theirs)]
            low, high = interval(mean_difference, *pair)
            rows.append({
                "one": ROWS[one], "minus": ROWS[other], "seeds": len(seeds), "metric": metric,
                "difference": float(mean_difference(*pair)), "low": low, "high": high,
            })  # fmt: skip
    return pd.DataFrame(rows)


def lane_changing(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per learner: what share of the lane changes begun was taken back, and what a completed one cost."""
    sums = cells.groupby(["learner", "layers"], sort=False)[
        ["lane_changes", "aborted_lane_changes", "lateral_reward", "collisions", "struck"]
    ].sum()
    begun = sums["lane_changes"] + sums["aborted_lane_changes"]
    return pd.DataFrame({
        "taken back": sums["aborted_lane_changes"] / begun,
        "lateral reward of one": sums["lateral_reward"] / sums["lane_changes"],
        "contacts": sums["collisions"] + sums["struck"],
        "episodes": cells.groupby(["learner", "layers"], sort=False).size(),
    })  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what rail-sumo reproduce wrote")
    cells = pd.read_parquet(parser.parse_args().folder / "cells.parquet")
    world = config.Config()
    print(ratios(cells).to_string(index=False), end="\n\n")
    cells = cells[cells["trajectories"].isin([0, world.train.trajectories])]
    print(differences(cells).round(2).to_string(index=False))
    print(f"\n{lane_changing(cells).round(3).to_string()}")
    shown = training.demonstrations_of(world)
    sideways = np.isin(shown.actions, (MetaAction.LEFT, MetaAction.RIGHT)).sum() / shown.n_episodes
    print(f"\nthe demonstrations begin {sideways:.2f} lane changes an episode")


if __name__ == "__main__":
    main()
