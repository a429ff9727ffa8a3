"""Where learned drivers decide otherwise than their expert would, on roads that neither has met.

    python benchmarks/differences.py RUN[:argmax|:sampled]... [--episodes 32] [--workers 2]

At every decision of a learned driver its expert is asked too. Runs are taken together, as trainings of one learner:
figures are shares of all their decisions. The area under the ROC curve tells how well a fresh classifier tells the
learner's decisions from those of the expert's own drives (0.5 is not at all); its interval is over the runs.
"""

import argparse

import numpy as np
import pandas as pd

from rail_sumo import drivers, rollout, roster
from rail_sumo.records import MetaAction
from rail_sumo.rollout import Task, traffic_seed
from rail_sumo.tables import audit, statistics

TRAFFIC = 10**6 + 2
"""The seed of the traffic, which nobody trains or is evaluated on."""
NEAR_M = 60.0
SITUATIONS = {
    "changing lanes": lambda seen, allowed: ~allowed[:, MetaAction.ACCELERATE],
    f"nobody within {NEAR_M:.0f} m ahead": lambda seen, allowed: seen[:, 0] >= NEAR_M,
    "behind somebody, a lane beside open": lambda seen, allowed: allowed[:, [MetaAction.LEFT, MetaAction.RIGHT]].any(1),
    "behind somebody, no lane open": lambda seen, allowed: np.ones(len(seen), np.bool_),
}
"""A decision belongs to the first of these that holds, by its observation (ray 0 points ahead) and mask."""


def situation(seen: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """The number of the first situation that each decision was made in."""
    return np.argmax([holds(seen, allowed) for holds in SITUATIONS.values()], axis=0)


def decisions(trajectories, advised) -> pd.DataFrame:
    """A row per decision: the situation, what was asked for, and what the expert would have asked for."""
    names = [action.name.lower() for action in MetaAction]
    return pd.concat(
        pd.DataFrame({
            "situation": pd.Categorical.from_codes(situation(one.observations, one.allowed), list(SITUATIONS)),
            "learner": pd.Categorical.from_codes(one.decisions, names),
            "expert": pd.Categorical.from_codes(advice, names),
        })
        for one, advice in zip(trajectories, advised, strict=True)
    )  # fmt: skip


def by_situation(made: pd.DataFrame) -> pd.DataFrame:
    """A row per situation: how many of all decisions, how many as the expert would, and what both change lanes by."""
    sideways = ["left", "right"]
    rows = made.assign(
        agree=made["learner"].astype(str) == made["expert"].astype(str),
        learner_changes=made["learner"].isin(sideways),
        expert_changes=made["expert"].isin(sideways),
    ).groupby("situation", observed=True)
    table = rows[["agree", "learner_changes", "expert_changes"]].mean()
    return table.assign(share=rows.size() / len(made))[["share", "agree", "learner_changes", "expert_changes"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    world = roster.world(given.runs)
    expert = drivers.load_expert(world)
    seeds = [traffic_seed(TRAFFIC, rollout.EVALUATION, episode) for episode in range(given.episodes)]
    made, areas = [], []
    with rollout.workers(given.workers) as pool:
        alone = list(pool.map(rollout.drive, [Task(expert, world, seed) for seed in seeds]))
        for name in given.runs:
            learned = roster.find_driver(name, world)
            driven = pool.map(rollout.practise_advised, [Task(learned, world, seed, adviser=expert) for seed in seeds])
            trajectories, advised = zip(*driven, strict=True)
            made.append(decisions(trajectories, advised))
            areas.append(audit.told_apart(trajectories, alone))
    area = statistics.mean(statistics.units(areas, trained=True))
    print(f"area under the ROC curve {area.value:.3f} ({area.low:.3f} to {area.high:.3f})")
    table = pd.concat(made)
    print(f"\n{by_situation(table).round(4).to_string()}")
    print("\nof what the expert would decide (rows), what the learner decides:")
    print(pd.crosstab(table["expert"], table["learner"], normalize="index", dropna=False).round(3).to_string())
    print("\nshares of all decisions:")
    print(
        pd.DataFrame({who: table[who].value_counts(normalize=True) for who in ("learner", "expert")})
        .round(4)
        .to_string()
    )


if __name__ == "__main__":
    main()
