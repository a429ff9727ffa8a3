"""What other senses, or another pace of deciding, are worth to RAIL.

    python benchmarks/sensing.py --out runs/sensing [--variants NAME ...] [--seeds 5] [--iterations 100] [--workers 2]

The shipped expert drives by its own senses alone, so the demonstrator is the rule driver, who sees its true neighbours
and can be recorded with any. Every variant learns from 40 drives of it on the same traffic, and figures are ratios to
it on traffic that is neither trained on nor evaluated on, with 95 % t intervals over training seeds; below them what
each variant adds to the first, training by training with the same seed.
"""

import argparse
import tempfile
from pathlib import Path

import kept
import numpy as np
import pandas as pd
from scipy import stats

from rail_sumo import config_file, run, training
from rail_sumo.rollout import Who

VARIANTS = {
    "as it is": [],
    "without the road's edges": ["lidar.road_edges=false"],
    "with the lateral offset": ["observation.lateral_state=true"],
    "with the host's speed": ["observation.host_speed=true"],
    "with the last scan too": ["observation.frames=2"],
    "48 rays": ["lidar.n_rays=48"],
    "a decision every 0.5 s": ["episode.decision_period_s=0.5"],
}
SHOWN = ["speed_kmh", "overtakes", "lane_changes"]
TRAFFIC = 10**6 + 2
FIRST_SEED = 300
EPISODES = 48


def learned(given: tuple[str, int, int]) -> pd.DataFrame:
    """Train one variant with one seed: a row for RAIL and one for its clone."""
    variant, seed, iterations = given
    with tempfile.TemporaryDirectory() as folder:
        shown = Path(folder) / "rule.parquet"
        overrides = [*VARIANTS[variant], f"train.iterations={iterations}"]
        world = config_file.load(None, overrides)
        run.demonstrate("rule", world, shown, episodes=world.train.trajectories, seed=0)
        world = config_file.load(None, [*overrides, f"train.demonstrations={shown}"])
        trained = training.learn(world, Path(folder) / "run", seed=FIRST_SEED + seed)
        policies: dict[str, Who] = {"rail": trained.policy(), "clone": trained.clone, "rule": "rule"}
        table, *_ = run.evaluate(policies, world, episodes=EPISODES, seed=TRAFFIC)
    means = table.groupby("policy", sort=False)[SHOWN].mean()
    ratios = means.loc[["rail", "clone"]] / means.loc["rule"]
    return ratios.reset_index().assign(variant=variant, seed=seed)


def added(ratios: pd.DataFrame) -> pd.DataFrame:
    """Return what each variant adds to the first one's ratios, seed by seed; both are indexed by variant and seed."""
    first = ratios.index[0][0]
    return ratios.sub(ratios.loc[first], level="seed").drop(first, level="variant")


def with_interval(ratios: pd.Series) -> str:
    mean, error = ratios.mean(), stats.sem(ratios) if len(ratios) > 1 else np.nan
    return f"{mean:.3f} +- {error * stats.t.ppf(0.975, len(ratios) - 1):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    parts = {
        f"{variant.replace(' ', '-')}-seed{seed}-{given.iterations}-iterations": (variant, seed, given.iterations)
        for seed in range(given.seeds)
        for variant in given.variants
    }
    done = kept.tables(
        given.out, parts, learned, workers=given.workers, say=lambda rows: rows.round(3).to_string(index=False)
    )
    for policy, rows in done.groupby("policy", sort=False):
        ratios = rows.set_index(["variant", "seed"])[SHOWN]
        tables = {
            "over the rule driver": ratios,
            f"what they add to '{given.variants[0]}', seed by seed": added(ratios),
        }
        for title, table in tables.items():
            if len(table):
                print(f"\n{policy}, {title}, {given.seeds} training seeds")
                print(table.groupby("variant", sort=False).agg(with_interval).to_string())


if __name__ == "__main__":
    main()
