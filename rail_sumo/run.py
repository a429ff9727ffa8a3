"""Train, evaluate, demonstrate; and the run directory, which at every moment can be evaluated and resumed."""

import csv
import io
import itertools
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import safetensors.numpy
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from rail_sumo import assets, config, drivers, metrics, report, rollout
from rail_sumo.config import Config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.highway import road
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Shape, Whitening
from rail_sumo.records import KMH, Floats, Trajectory
from rail_sumo.rollout import DEMONSTRATION, EVALUATION, TRAINING, LearnedDriver, Task, traffic_seed

Workers = int | Literal["ray"]
Tensors = dict[str, NDArray[Any]]
Tables = tuple[pd.DataFrame, pd.DataFrame]
"""The `episodes` and the `summary` table."""

CONFIG, POLICY, CLONE, JUDGE = "config.toml", "policy.safetensors", "clone.safetensors", "judge.safetensors"
PROGRESS, CHECKPOINT = "progress.csv", "checkpoint.safetensors"


class Observer:
    """Is told how far long work has come. This one keeps it to itself; the command line's draws bars."""

    def start(self, work: str, total: int, done: int = 0) -> None:
        """Work of `total` parts begins, `done` of them already there."""

    def advance(self, **figures: float) -> None:
        """One more part is done; `figures` tell how it went."""


SILENT = Observer()


def world(policies: Iterable[str], overrides: Iterable[str] = ()) -> Config:
    """Return the configuration to evaluate in: the first run directory's among the policies, with overrides on top.

    Drivers by name alone drive in the default world.

    Raises:
        InputError: the directory is missing, or what `config.load` raises.
    """
    runs = (Path(policy) for policy in policies if policy not in drivers.NAMES)
    first = next(runs, None)
    return config.load(first and _existing(first) / CONFIG, overrides)


def driver(policy: str, config: Config) -> str | LearnedDriver:
    """Return who drives: a driver by its name, or the policy of a run directory."""
    return policy if policy in drivers.NAMES else load_policy(Path(policy), config)


def evaluate(
    policies: Mapping[str, str | LearnedDriver],
    config: Config,
    *,
    episodes: int,
    seed: int,
    workers: Workers = 1,
    observer: Observer = SILENT,
) -> Tables:
    """Drive every policy through the same held-out episodes and return the `episodes` and `summary` tables.

    Args:
        policies: name in the tables -> who drives.
        config: the world, for all of them.
        episodes: how many, at least one; episode i has the same traffic for every policy and every call with `seed`.
        workers: processes that drive, or "ray"; the tables do not depend on it.
    """
    _check(config, episodes)
    labels = list(itertools.product(policies, range(episodes)))
    tasks = (Task(policies[name], config, traffic_seed(seed, EVALUATION, episode)) for name, episode in labels)
    observer.start("evaluate", len(labels))
    rows = []
    with rollout.workers(workers) as pool:
        for (name, episode), trajectory in zip(labels, pool.map(rollout.drive, tasks), strict=True):
            rows.append({"policy": name, "episode": episode, **metrics.row(trajectory, config.adas)})
            observer.advance(speed_kmh=rows[-1]["speed_kmh"])
    table = report.episodes(rows)
    return table, report.summary(table)


def demonstrate(
    who: str | LearnedDriver,
    config: Config,
    *,
    episodes: int,
    seed: int,
    workers: Workers = 1,
    observer: Observer = SILENT,
) -> Demonstrations:
    """Record what a driver sees and decides in `episodes` episodes of its own traffic."""
    _check(config, episodes)
    tasks = (Task(who, config, traffic_seed(seed, DEMONSTRATION, episode)) for episode in range(episodes))
    observer.start("record", episodes)
    driven = []
    with rollout.workers(workers) as pool:
        for trajectory in pool.map(rollout.drive, tasks):
            driven.append(trajectory)
            observer.advance(speed_kmh=_speed_kmh([trajectory]))
    return Demonstrations.from_trajectories(driven)


def train(
    config: Config,
    out: Path,
    *,
    seed: int,
    workers: Workers = 1,
    resume: bool = False,
    observer: Observer = SILENT,
) -> Tables:
    """Clone the demonstrations, improve the clone by RAIL, and set both beside the expert on held-out traffic.

    The run directory `out` appears whole once there is a clone, and from then on is complete at every moment:
    after an interruption, a killed process included, `resume` goes on to the very same policy.

    Raises:
        InputError: bad input of any kind; `out` exists, or with `resume` is no run of this configuration and seed.
    """
    # Here, because torch takes seconds to import and only training needs it.
    from rail_sumo.imitation import bc, rail
    from rail_sumo.imitation.discriminator import Judge

    _check(config, config.train.evaluation_episodes)
    if resume:
        _check_same(out, config, seed)
    else:
        check_new(out)
    features = feature_names(config.lidar, config.observation)
    demonstrations = _demonstrations(config, features)
    whitening = Whitening.of(demonstrations.observations)
    shape = Shape(len(features), config.policy.hidden if config.policy.layers == 2 else None)
    horizon = round(config.train.horizon_s / config.episode.decision_period_s)
    judge = Judge(len(features), whitening, config.judge, seed, horizon)

    if not resume:
        theta = bc.clone(demonstrations, shape, whitening, config.cloning, seed)
        _create(out, config, seed, LearnedDriver(theta, shape, whitening), features, judge.state())
    saved = Checkpoint.load(out)
    judge.load_state(saved.judge)
    clone = load_policy(out, config, CLONE)

    observer.start("train", config.train.iterations, done=saved.iteration)
    with rollout.workers(workers) as pool:
        evaluate_directions = partial(_directions, pool.map, clone, _training_world(config), seed)
        states = rail.train(
            saved.theta,
            demonstrations,
            search=config.search,
            judge=judge,
            evaluate=evaluate_directions,
            seed=seed,
            first_iteration=saved.iteration + 1,
        )
        progress = Progress.load(out, saved.iteration)
        for state in itertools.islice(states, config.train.iterations - saved.iteration):
            progress.append(state)
            learned = LearnedDriver(state.theta, shape, whitening)
            _save(out, learned, features, progress, Checkpoint(seed, state.iteration, state.theta, judge.state()))
            observer.advance(**progress.rows[-1])

    policies = {"rail": load_policy(out, config), "clone": clone, "expert": "expert"}
    tables = evaluate(
        policies,
        config,
        episodes=config.train.evaluation_episodes,
        seed=seed,
        workers=workers,
        observer=observer,
    )
    report.write(*tables, out, overwrite=True)
    return tables
