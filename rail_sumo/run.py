"""Train, evaluate, demonstrate: what the command line does, each in one call."""

import itertools
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
import pandas as pd

from rail_sumo import assets, config, drivers, metrics, report, rollout
from rail_sumo.config import Config, dumps
from rail_sumo.errors import InputError, ObservationError, did_you_mean
from rail_sumo.files import check_file
from rail_sumo.highway import road
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Shape, Whitening
from rail_sumo.records import KMH, Floats, Trajectory
from rail_sumo.rollout import DEMONSTRATION, EVALUATION, TRAINING, LearnedDriver, Task, traffic_seed
from rail_sumo.run_directory import CONFIG, Checkpoint, Row, RunDirectory, require_new

if TYPE_CHECKING:  # torch takes seconds to import, and only training needs it
    from rail_sumo.imitation.discriminator import Judge
    from rail_sumo.imitation.rail import RailState

Driver = str | LearnedDriver | drivers.Expert
WorkerCount = int | Literal["ray"]
Tables = tuple[pd.DataFrame, pd.DataFrame]
"""The `episodes` table and its `summary`."""


class Observer(Protocol):
    """Is told how far long work has come."""

    def start(self, work: str, total: int, done: int = 0) -> None:
        """Work of `total` parts begins, `done` of them already there."""

    def advance(self, figures: Mapping[str, float]) -> None:
        """One more part is done; the figures tell how it went, by the names of the tables' columns."""


class _Silent:
    def start(self, work: str, total: int, done: int = 0) -> None: ...

    def advance(self, figures: Mapping[str, float]) -> None: ...


SILENT = _Silent()


def world(policies: Iterable[str], overrides: Iterable[str] = ()) -> Config:
    """Return the world to evaluate in: the first run directory's among the policies, with `overrides` on top.

    Drivers known by name alone drive in the default world.

    Raises:
        InputError: a policy is neither, or what `config.load` raises.
    """
    folders = [Path(policy) for policy in policies if policy not in drivers.NAMES]
    for folder in folders:
        _require_folder(folder)
    return config.load(folders[0] / CONFIG if folders else None, overrides)


def find_driver(policy: str, world: Config) -> Driver:
    """Return who drives under the name: a driver of ours, an expert's folder, or what a run directory learned.

    Raises:
        InputError: it is neither, damaged, or learned on another observation than the world's.
    """
    if policy == report.EXPERT:  # read once here, not by a worker in every episode
        return drivers.load_expert(world)
    if policy in drivers.NAMES:
        return policy
    if (Path(policy) / assets.MANIFEST).is_file():
        return drivers.load_expert(world, Path(policy))
    _require_folder(Path(policy))
    return RunDirectory(Path(policy)).policy(world)


def evaluate(
    policies: Mapping[str, Driver],
    world: Config,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
) -> Tables:
    """Drive every policy through the same held-out episodes and return the tables.

    Args:
        policies: the name in the tables, and who drives.
        world: the same for all of them.
        episodes: how many; number i has the same traffic for every policy, and in every call with this seed.
        seed: of the traffic, which no training with any seed has met.
        workers: how many processes drive, or "ray". The tables do not depend on it.
        observer: is told of every episode.

    Raises:
        InputError: fewer than one episode, or a network or demand that cannot be driven.
    """
    require_drivable(world, episodes)
    labels = list(itertools.product(policies, range(episodes)))
    tasks = [Task(policies[name], world, traffic_seed(seed, EVALUATION, episode)) for name, episode in labels]
    driven = _drive("eval", tasks, workers, observer)
    rows = [
        {"policy": name, "episode": episode, **metrics.row(trajectory, world.adas)}
        for (name, episode), trajectory in zip(labels, driven, strict=True)
    ]
    table = report.episodes(rows)
    return table, report.summary(table)


def record(
    driver: Driver,
    world: Config,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
) -> Demonstrations:
    """Return what a driver sees and decides in traffic of its own, which no evaluation or training meets."""
    tasks = [Task(driver, world, traffic_seed(seed, DEMONSTRATION, episode)) for episode in range(episodes)]
    return Demonstrations.from_trajectories(list(_drive("record", tasks, workers, observer)))


def demonstrate(
    driver: str,
    world: Config,
    out: Path,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    overwrite: bool = False,
    observer: Observer = SILENT,
) -> Demonstrations:
    """Record a driver, by name, expert's folder or run directory, into a file; see `record` and `evaluate`.

    Raises:
        InputError: the file `out` exists and is not to be overwritten, or cannot be written; bad input of any kind.
    """
    if driver == "sumo":
        raise InputError(
            "driver 'sumo' takes no decisions that could be recorded; take rule, expert or a run directory"
        )
    check_file(out, overwrite=overwrite)
    require_drivable(world, episodes)
    who = find_driver(driver, world)
    demonstrations = record(who, world, episodes=episodes, seed=seed, workers=workers, observer=observer)
    about = {"driver": driver, "seed": str(seed), "config": dumps(world)}
    demonstrations.save(out, features=feature_names(world.lidar, world.observation), about=about)
    return demonstrations


def train(
    config: Config,
    out: Path,
    *,
    seed: int,
    workers: WorkerCount = 1,
    resume: bool = False,
    observer: Observer = SILENT,
) -> Tables:
    """Clone the demonstrations, improve the clone by RAIL, and set both beside the shipped expert on held-out traffic.

    The run directory `out` appears once there is a clone. From then on training may be interrupted at any moment,
    by kill -9 too, and with `resume` goes on to the very same policy, or to more iterations.

    Raises:
        InputError: `out` exists, or with `resume` is no run of this configuration, seed and files, or one of more
            iterations already; anything that is wrong with the configuration, the network, the demand or the
            demonstrations.
    """
    run = RunDirectory(out) if resume else None
    if run is None:
        require_new(out)
    require_drivable(config, config.train.evaluation_episodes)
    demonstrations = _demonstrations(config)
    inputs = _inputs(config)
    if run is None:
        run = _start(config, out, seed, inputs, demonstrations)
    else:
        run.go_on(config, seed, inputs)
    _improve(run, demonstrations, workers, observer)

    policies: dict[str, Driver] = {"rail": run.policy(config), "clone": run.clone}
    with suppress(ObservationError):  # the shipped expert senses something else: there is nothing to set beside
        policies[report.EXPERT] = drivers.load_expert(config)
    episodes = config.train.evaluation_episodes
    tables = evaluate(policies, config, episodes=episodes, seed=seed, workers=workers, observer=observer)
    report.write(*tables, out, overwrite=True)
    return tables


def require_drivable(world: Config, episodes: int = 1) -> None:
    """Raise InputError for what can be known to be wrong before anybody drives."""
    if episodes < 1:
        raise InputError(f"episodes must be at least 1; got {episodes}")
    HighwayEnv(world)


def _require_folder(policy: Path) -> None:
    if not policy.exists():
        raise InputError(
            f"policy '{policy}' is neither a run directory nor a driver{did_you_mean(str(policy), drivers.NAMES)}"
        )
    if not (policy / assets.MANIFEST).is_file():
        RunDirectory(policy)


def _drive(work: str, tasks: list[Task], workers: WorkerCount, observer: Observer) -> Iterator[Trajectory]:
    observer.start(work, len(tasks))
    with rollout.workers(workers) as pool:
        for trajectory in pool.map(rollout.drive, tasks):
            observer.advance(_figures([trajectory]))
            yield trajectory


def _demonstrations(config: Config) -> Demonstrations:
    features = feature_names(config.lidar, config.observation)
    return Demonstrations.load(_demonstrations_file(config), features=features).take(config.train.trajectories)


def _demonstrations_file(config: Config) -> Path:
    name = config.train.demonstrations
    return assets.expert(assets.EXPERT_DEMONSTRATIONS) if name == "expert" else Path(name)


def _inputs(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that a training with this configuration reads, by the key that names it."""
    demand = road.check_demand(config.traffic.routes)
    return {
        "network.file": assets.sha256(assets.network(config.network.file)),
        "traffic.routes": " ".join(map(assets.sha256, demand)),
        "train.demonstrations": assets.sha256(_demonstrations_file(config)),
    }


def _start(
    config: Config, out: Path, seed: int, inputs: Mapping[str, str], demonstrations: Demonstrations
) -> RunDirectory:
    from rail_sumo.imitation import bc

    whitening = Whitening.of(demonstrations.observations)
    n_features = len(feature_names(config.lidar, config.observation))
    shape = Shape(n_features, config.policy.hidden if config.policy.layers == 2 else None)
    theta = bc.clone(demonstrations, shape, whitening, config.cloning, seed)
    clone = LearnedDriver(theta, shape, whitening)
    return RunDirectory.create(out, config, seed, inputs, clone, _judge(config, clone, seed).state())


def _judge(config: Config, clone: LearnedDriver, seed: int) -> "Judge":
    from rail_sumo.imitation.discriminator import Judge

    horizon_decisions = round(config.train.horizon_s / config.episode.decision_period_s)
    return Judge(clone.shape.n_features, clone.whitening, config.judge, seed, horizon_decisions)


def _improve(run: RunDirectory, demonstrations: Demonstrations, workers: WorkerCount, observer: Observer) -> None:
    """Go on with RAIL from the run's checkpoint to its last iteration, saving after each."""
    from rail_sumo.imitation import rail

    checkpoint = run.checkpoint()
    judge = _judge(run.config, run.clone, run.seed)
    judge.load_state(checkpoint.judge)
    n_iterations = run.config.train.iterations
    observer.start("train", n_iterations, done=checkpoint.iteration)
    started = time.perf_counter() - (checkpoint.progress[-1]["seconds"] if checkpoint.progress else 0.0)
    with rollout.workers(workers) as pool:
        states = rail.train(
            checkpoint.theta,
            demonstrations,
            search=run.config.search,
            judge=judge,
            evaluate=partial(_rollouts, pool, run),
            seed=run.seed,
            first_iteration=checkpoint.iteration + 1,
        )
        for state in itertools.islice(states, n_iterations - checkpoint.iteration):
            row = _progress(state, judge, checkpoint.progress, time.perf_counter() - started)
            checkpoint = Checkpoint(state.theta, judge.state(), (*checkpoint.progress, row))
            run.save(checkpoint)
            observer.advance(row)


def _rollouts(
    pool: rollout.Workers, run: RunDirectory, theta: Floats, perturbations: Floats, iteration: int
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Drive theta plus and minus each perturbation, both on the same traffic, which is new in every iteration."""
    episode = run.config.episode.model_copy(update={"course_m": math.inf, "duration_s": run.config.train.horizon_s})
    world = run.config.model_copy(update={"episode": episode})
    tasks = [
        Task(
            replace(run.clone, theta=theta + sign * delta),
            world,
            traffic_seed(run.seed, TRAINING, iteration, direction),
        )
        for sign in (1.0, -1.0)
        for direction, delta in enumerate(perturbations)
    ]
    driven = list(pool.map(rollout.drive, tasks))
    return driven[: len(perturbations)], driven[len(perturbations) :]


def _progress(state: "RailState", judge: "Judge", before: tuple[Row, ...], seconds: float) -> Row:
    driven = [*state.plus, *state.minus]
    steps_before = before[-1]["environment_steps"] if before else 0
    return {
        "iteration": state.iteration,
        "environment_steps": steps_before + sum(len(trajectory.lane_changing) for trajectory in driven),
        "seconds": round(seconds, 3),
        "mean_return": float(np.mean(judge.returns(driven))),
        "judge_loss": state.judge_loss.loss,
        "judge_expert_mean": state.judge_loss.expert_mean,
        "judge_learner_mean": state.judge_loss.learner_mean,
        **_figures(driven),
        "step_norm": state.step_norm,
    }


def _figures(driven: list[Trajectory]) -> dict[str, float]:
    return {
        "speed_kmh": float(np.mean([trajectory.speed_mps[1:].mean() for trajectory in driven])) * KMH,
        "overtakes": float(np.mean([trajectory.overtakes for trajectory in driven])),
        "lane_changes": float(np.mean([trajectory.lane_changes for trajectory in driven])),
    }
