"""What each choice in RAIL's search and judge is worth, or in GAIL's: all varied at once, each on as many trainings.

    python benchmarks/ablations.py --out runs/ablations [--learner gail] [--workers 2]

Every training has its own seed and its own combination of choices, and every choice is taken in half of the trainings,
beside each of the others equally often (a Plackett-Burman design, folded over: no choice's effect is mixed up with
another's, nor with any two others' joining). So 24 trainings tell of each choice what 12 against 12 would. The policy
is driven on traffic that is neither trained on nor evaluated on, the same for all; figures are ratios to the expert's.
Trainings of as many iterations and episodes that are in `out` already are taken from there.
"""

import argparse
import itertools
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import kept
import numpy as np
import pandas as pd
import variants
from scipy import stats

from rail_sumo import config, config_file, learners, rollout, roster, run, training
from rail_sumo.imitation import rail
from rail_sumo.imitation.random_search import RandomSearch
from rail_sumo.run_directory import RunDirectory

TRAFFIC = 10**6
"""The seed of the traffic on which all are compared."""
FIRST_SEED = 100
"""Of the trainings, far from those that are reported."""
AVERAGING = 0.95
"""What a theta weighs in the running average, of what the next one does."""
SHOWN = ["speed_kmh", "overtakes", "lane_changes", "lateral_reward"]


@dataclass(frozen=True)
class Choice:
    """What is done by default, and what could be done instead."""

    name: str
    default: str
    instead: str
    override: str = ""
    """As for --set; empty for what the default configuration leaves no choice about."""


RANKS = Choice("shaping", "returns as they are", "their ranks")
CLIP_UP = Choice("step", "by the gradient", "ClipUp")
SHRINKING = Choice("its length", "as it comes", "1 % less each time")
TRAFFICS = Choice("traffic of + and -", "the same", "one each")
MEMORY = Choice("the judge learns from", "the newest iteration", "the last three")
PENALTY = Choice("judge.loss", "least-squares", "with a gradient penalty", "judge.loss=variants:PENALISED")
CHOICES = {
    "rail": [
        Choice("search.n_top", "all 16", "8", "search.n_top=8"),
        Choice("search.step_size", "0.05", "0.1", "search.step_size=0.1"),
        Choice("search.noise_std", "0.1", "0.05", "search.noise_std=0.05"),
        RANKS,
        CLIP_UP,
        SHRINKING,
        TRAFFICS,
        MEMORY,
        Choice("judge.learning_rate", "3e-4", "1e-3", "judge.learning_rate=1e-3"),
        Choice("judge.minibatches", "10", "30", "judge.minibatches=30"),
        Choice("policy.hidden", "32", "64", "policy.hidden=64"),
        Choice("cloning.epochs", "100", "300", "cloning.epochs=300"),
    ],
    "gail": [
        Choice("gail.learning_rate", "3e-4", "1e-3", "gail.learning_rate=1e-3"),
        Choice("gail.batch_size", "1024", "256", "gail.batch_size=256"),
        Choice("gail.epochs", "10", "5", "gail.epochs=5"),
        Choice("gail.discount", "0.99", "0.95", "gail.discount=0.95"),
        Choice("gail.gae_lambda", "0.95", "0.8", "gail.gae_lambda=0.8"),
        Choice("gail.entropy", "0", "0.01", "gail.entropy=0.01"),
        Choice("gail.critic_hidden", "64, 64", "256, 256", "gail.critic_hidden=[256, 256]"),
        PENALTY,
        Choice("judge.learning_rate", "3e-4", "1e-3", "judge.learning_rate=1e-3"),
        Choice("judge.minibatches", "10", "30", "judge.minibatches=30"),
        Choice("judge.reward_clip", "5", "1", "judge.reward_clip=1.0"),
        Choice("policy.hidden", "32", "64", "policy.hidden=64"),
    ],
}
"""By learner."""


def design() -> np.ndarray:
    """Whether a training (row) takes the other way in a choice (column): 24 rows, 12 columns.

    Source: Plackett & Burman (1946): a generating row of 11, turned round, and a row of lows.
    """
    generator = [1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1]
    rows = np.vstack([*(np.roll(generator, shift) for shift in range(11)), np.full(11, -1)])
    rows = np.hstack([rows, np.ones((12, 1))])
    return np.vstack([rows, -rows]) > 0


@dataclass(frozen=True)
class Training:
    """One row of the design."""

    learner: str
    number: int
    taken: frozenset[str]
    """The choices in which it goes the other way."""
    iterations: int
    episodes: int


def train(this: Training) -> pd.DataFrame:
    """Train with the choices taken; a row for the last policy and one for its clone, and for RAIL's average theta."""
    choices = CHOICES[this.learner]
    overrides = [choice.override for choice in choices if choice.name in this.taken and choice.override]
    world = config_file.load(None, [*overrides, f"train.learner={this.learner}"])
    with tempfile.TemporaryDirectory() as folder:
        policies = (_rail if this.learner == "rail" else _gail)(this, world, Path(folder) / "run")
    table, *_ = run.evaluate(
        {**policies, "expert": roster.find_driver("expert", world)}, world, episodes=this.episodes, seed=TRAFFIC
    )
    means = table.groupby("policy", sort=False)[[*SHOWN, "collisions"]].mean()
    ratios = means.loc[list(policies)].assign(**means[SHOWN].loc[list(policies)] / means[SHOWN].loc["expert"])
    taken = {choice.name: choice.name in this.taken for choice in choices}
    return ratios.reset_index().assign(number=this.number, **taken)


def _learned(this: Training, world: config.Config, out: Path, iterations: int) -> RunDirectory:
    return training.learn(world.changed(train={"iterations": iterations}), out, seed=FIRST_SEED + this.number)


def _rail(this: Training, world: config.Config, out: Path) -> dict[str, run.Who]:
    search = variants.Ranked if RANKS.name in this.taken else RandomSearch
    search = variants.clipped_up(search) if CLIP_UP.name in this.taken else search
    search = variants.shrinking(search) if SHRINKING.name in this.taken else search
    begun = _learned(this, world, out, 0)
    clone, judge = begun.clone, learners.judge_of(begun)
    with rollout.workers(1) as pool, mock.patch.object(rail, "RandomSearch", search):
        practice = learners.Practice(begun, pool)
        states = rail.train(
            clone.theta,
            training.demonstrations_of(world),
            search=world.search,
            judge=variants.Remembering(judge) if MEMORY.name in this.taken else judge,
            evaluate=lambda theta, perturbations, number: practice.pairs(
                replace(clone, theta=theta), perturbations, number, shared_traffic=TRAFFICS.name not in this.taken
            ),
            seed=FIRST_SEED + this.number,
        )
        thetas = [state.theta for state in itertools.islice(states, this.iterations)]
    average = np.average(thetas, axis=0, weights=AVERAGING ** np.arange(len(thetas), 0, -1))
    return {"last": replace(clone, theta=thetas[-1]), "average": replace(clone, theta=average), "clone": clone}


def _gail(this: Training, world: config.Config, out: Path) -> dict[str, run.Who]:
    learned = _learned(this, world, out, this.iterations)
    return {"last": learned.policy(), "clone": learned.clone}


def effects(trainings: pd.DataFrame, choices: list[Choice], metric: str) -> pd.DataFrame:
    """What the other way adds to a metric, with its 95 % interval: least squares with a term for every choice."""
    signs = trainings[[choice.name for choice in choices]].to_numpy() * 2.0 - 1.0
    terms = np.column_stack([np.ones(len(signs)), signs])
    values = trainings[metric].to_numpy()
    solved, *_ = np.linalg.lstsq(terms, values)
    freedom = len(values) - terms.shape[1]
    error = np.sqrt(((values - terms @ solved) ** 2).sum() / freedom / len(values))
    reach = 2 * error * stats.t.ppf(0.975, freedom)
    effect = 2 * solved[1:]
    return pd.DataFrame({"effect": effect, "low": effect - reach, "high": effect + reach}, [c.name for c in choices])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learner", choices=CHOICES, default="rail")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--episodes", type=int, default=48, help="of each policy's evaluation")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    choices = CHOICES[given.learner]
    names = np.array([choice.name for choice in choices])
    parts = {
        f"{given.learner}{number}-{given.iterations}-iterations-{given.episodes}-episodes": Training(
            given.learner, number, frozenset(names[row]), given.iterations, given.episodes
        )
        for number, row in enumerate(design())
    }
    done = kept.tables(
        given.out, parts, train, workers=given.workers, say=lambda rows: str(rows[SHOWN].round(3).values)
    )
    for policy, rows in done.groupby("policy"):
        print(f"\n{policy}: " + ", ".join(f"{name} {rows[name].mean():.3f}" for name in [*SHOWN, "collisions"]))
    for metric in SHOWN:
        print(f"\n{metric}, ratio to the expert's: what the other way adds")
        table = effects(done[done["policy"] == "last"], choices, metric).assign(
            default=[choice.default for choice in choices], instead=[choice.instead for choice in choices]
        )
        print(table.round(3).to_string())


if __name__ == "__main__":
    main()
