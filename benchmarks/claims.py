"""What the paper claims beyond its Table 1, in the cells that `rail-sumo reproduce` left in a folder.

    rail-sumo reproduce table1 && python benchmarks/claims.py runs/reproduce
    python benchmarks/claims.py docs/data    # from the cells that the documents' tables are made of

Learners are compared with one another as the table compares them with the expert: on the same traffic, training by
training, over the seeds that both were trained with. Whatever is finished in the folder counts, of Figures 3 and 4 too.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from rail_sumo import config, training
from rail_sumo.policy import ARGMAX, SAMPLED
from rail_sumo.records import MetaAction
from rail_sumo.studies.experiment import SYSTEMS
from rail_sumo.studies.reproduce import compare, ratio_with_interval, read_cells, scores, with_interval
from rail_sumo.tables import report, statistics

PAIRS = (
    (("rail-2", ARGMAX), ("bc-2", ARGMAX)),
    (("rail-2", ARGMAX), ("bc-2", SAMPLED)),
    (("rail-1", ARGMAX), ("bc-1", ARGMAX)),
    (("rail-1", ARGMAX), ("bc-1", SAMPLED)),
    (("rail-1", ARGMAX), ("rail-2", ARGMAX)),
    (("rail-2", ARGMAX), ("gail-2", SAMPLED)),
    (("rail-2", ARGMAX), ("dagger-2", SAMPLED)),
    (("rail-2", ARGMAX), ("rail-2-unmasked", ARGMAX)),
    (("rail-2-unmasked", ARGMAX), ("bc-2-unmasked", SAMPLED)),
    (("rail-2-unmasked", ARGMAX), ("gail-2-unmasked", SAMPLED)),
    (("rail-2", ARGMAX), ("expert", "")),
)
METRICS = ("speed_kmh", "overtakes", "lane_changes")
OF_THE_PAPER = 16
"""Episodes that its table's means are of."""


def ratios(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per system, mode and number of trajectories: ratios to the expert on the same seeds, with intervals."""
    driven_by_expert = cells[cells["system"] == report.EXPERT]
    rows = []
    for (system, mode, trajectories), driven in cells.groupby(["system", "mode", "trajectories"], sort=False):
        if system == report.EXPERT:
            continue
        table = compare(pd.concat([driven, driven_by_expert])).set_index(["system", "metric"])
        of_the_expert = {
            metric: ratio_with_interval(*map(float, table.loc[(system, metric), ["ratio", "ratio_low", "ratio_high"]]))
            for metric in (*METRICS, "lateral_reward")
        }
        figures = {
            name: with_interval(figure["mean"], figure["low"], figure["high"], decimals)
            for name, metric, decimals in (("refused", "refused_decisions", 1), ("told apart", "told_apart", 2))
            for figure in [table.loc[(system, metric)]]
        }
        seeds = driven["training_seed"].nunique()
        row = {"": SYSTEMS[system].label, "mode": mode, "shown": trajectories, "seeds": seeds}
        rows.append(row | of_the_expert | figures)
    return pd.DataFrame(rows)


def differences(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per pair, number of trajectories and metric: one minus the other, with its 95 % interval over trainings."""
    rows = []
    for (one, other), shown in itertools.product(PAIRS, sorted(set(cells["trajectories"]) - {0})):
        of_it = cells[cells["trajectories"].isin([0, shown])]
        ours, theirs = (of_it[(of_it["system"] == name) & (of_it["mode"] == mode)] for name, mode in (one, other))
        seeds = set(ours["training_seed"]) & set(theirs["training_seed"])
        if not seeds:
            continue
        for metric in (*METRICS, "told_apart"):
            pair = [
                statistics.units(scores(driven[driven["training_seed"].isin(seeds)], metric), trained=True)
                for driven in (ours, theirs)
            ]
            difference, low, high = statistics.difference(*pair)
            rows.append({
                "one": " ".join(one), "minus": " ".join(other), "shown": shown, "seeds": len(seeds), "metric": metric,
                "difference": difference, "low": low, "high": high,
            })  # fmt: skip
    return pd.DataFrame(rows)


def lane_changing(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per system, mode and trajectories: what share of the lane changes begun was taken back, what one cost."""
    by = ["system", "mode", "trajectories"]
    sums = cells.groupby(by, sort=False)[
        ["lane_changes", "aborted_lane_changes", "lateral_reward", "collisions", "struck"]
    ].sum()
    begun = sums["lane_changes"] + sums["aborted_lane_changes"]
    return pd.DataFrame({
        "taken back": sums["aborted_lane_changes"] / begun,
        "lateral reward of one": sums["lateral_reward"] / sums["lane_changes"],
        "contacts": sums["collisions"] + sums["struck"],
        "episodes": cells.groupby(by, sort=False).size(),
    })  # fmt: skip


def correlations(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per system and mode: how its episodes correlate with the expert's on the same traffic, by metric."""
    by_traffic = ["training_seed", "episode"]
    theirs = cells[cells["system"] == report.EXPERT].set_index(by_traffic)
    rows = {
        (system, mode): {metric: driven.set_index(by_traffic)[metric].corr(theirs[metric]) for metric in METRICS}
        for (system, mode), driven in cells.groupby(["system", "mode"], sort=False)
        if system != report.EXPERT
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def chance_ratios(cells: pd.DataFrame) -> pd.DataFrame:
    """A row per metric: between which ratios 95 % lie of the expert's mean over 16 episodes to its own over 16 others.

    As the paper compares: by chance alone, what any system would come to that drives just as its expert.
    """
    driven, rng = cells[cells["system"] == report.EXPERT], np.random.default_rng(0)
    rows = []
    for metric in (*METRICS, "lateral_reward"):
        ours, theirs = rng.choice(driven[metric].to_numpy(dtype=float), (2, 100_000, OF_THE_PAPER)).mean(axis=2)
        low, high = np.quantile(ours / theirs, [0.025, 0.975])
        rows.append({"metric": metric, "low": low, "high": high})
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what rail-sumo reproduce wrote")
    cells = read_cells(parser.parse_args().folder / "cells.parquet")
    world = config.Config()
    print(ratios(cells).to_string(index=False), end="\n\n")
    print(differences(cells).round(3).to_string(index=False))
    print(f"\n{lane_changing(cells).round(3).to_string()}")
    cells = cells[cells["trajectories"].isin([0, world.train.trajectories])]
    print(f"\ncorrelation of episodes with the expert's\n{correlations(cells).round(2).to_string()}")
    print(f"\nthe expert beside itself, {OF_THE_PAPER} episodes each:")
    print(chance_ratios(cells).round(3).to_string(index=False))
    shown = training.demonstrations_of(world)
    sideways = np.isin(shown.actions, (MetaAction.LEFT, MetaAction.RIGHT)).sum() / shown.n_episodes
    print(f"\nthe demonstrations begin {sideways:.2f} lane changes an episode")


if __name__ == "__main__":
    main()
