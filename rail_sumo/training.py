"""Which learner, on which rollouts: a run from its clone to its last iteration, every one saved as it is done."""

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rail_sumo import assets, drivers, metrics, rollout
from rail_sumo.config import Config
from rail_sumo.highway import demand
from rail_sumo.highway.observation import feature_names
from rail_sumo.highway.reward import total_reward
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.records import Floats, Trajectory
from rail_sumo.rollout import SILENT, TRAINING, Observer, Task, WorkerCount, Workers, traffic_seed
from rail_sumo.run_directory import JUDGES, Checkpoint, Row, RunDirectory, Tensors, require_new

if TYPE_CHECKING:  # torch takes seconds to import, and not every command trains
    from rail_sumo.imitation import rail
    from rail_sumo.imitation.discriminator import Judge, JudgeLoss

PPO, MOMENTS = "ppo.", "moments."
"""What the names of PPO's tensors, and of the observations' moments, begin with in a checkpoint."""


@dataclass(frozen=True)
class Iteration:
    """What an iteration came to, whichever the learner."""

    learned: PolicyParameters
    memory: Tensors
    """All else that the next iteration depends on."""
    driven: list[Trajectory]
    figures: Row
    """What the learner alone knows: some of the columns of `progress.csv`."""


def learn(
    config: Config, out: Path, *, seed: int, workers: WorkerCount = 1, resume: bool = False, observer: Observer = SILENT
) -> RunDirectory:
    """Start a run, or take it up again, and bring it to its last iteration.

    Raises:
        InputError: as in `run.train`.
    """
    config = config.resolved()
    run = RunDirectory(out) if resume else None
    if run is None:
        require_new(out)
    if learner_of(config).asks_the_expert:
        drivers.load_expert(config)  # or there is nobody to ask
    demonstrations = demonstrations_of(config)
    inputs = inputs_of(config)
    if run is None:
        run = RunDirectory.create(out, config, seed, inputs, _start(config, demonstrations, seed))
    else:
        run.go_on(config, seed, inputs)

    checkpoint = run.checkpoint()
    observer.start(config.train.learner, config.train.n_iterations, done=checkpoint.iteration)
    started = time.perf_counter() - (checkpoint.progress[-1]["seconds"] if checkpoint.progress else 0.0)
    with rollout.workers(workers) as pool:
        iterations = learner_of(config).iterate(Practice(run, pool), checkpoint, demonstrations)
        for iteration in itertools.islice(iterations, config.train.n_iterations - checkpoint.iteration):
            row = _progress(iteration, checkpoint.progress, time.perf_counter() - started)
            checkpoint = Checkpoint(iteration.learned, iteration.memory, (*checkpoint.progress, row))
            run.save(checkpoint)
            observer.advance(row)
    return run


class Practice:
    """Drives a learner's training rollouts: of one length, on traffic that is new in every iteration."""

    def __init__(self, run: RunDirectory, pool: Workers) -> None:
        self.run = run
        self._pool = pool
        self._world = run.config.practice(run.config.train.horizon_s)

    def pairs(
        self, learner: PolicyParameters, perturbations: Floats, iteration: int, *, shared_traffic: bool = True
    ) -> tuple[list[Trajectory], list[Trajectory]]:
        """Drive theta plus and minus each perturbation, both on the same traffic unless told otherwise."""
        n = len(perturbations)
        thetas = [*(learner.theta + perturbations), *(learner.theta - perturbations)]
        traffic = [*range(n), *range(n)] if shared_traffic else range(2 * n)
        tasks = [
            self._task(replace(learner, theta=theta), iteration, number)
            for theta, number in zip(thetas, traffic, strict=True)
        ]
        driven = list(self._pool.map(rollout.drive, tasks))
        return driven[:n], driven[n:]

    def sampled(self, learner: PolicyParameters, n_rollouts: int, iteration: int) -> list[Trajectory]:
        """Drive by actions sampled with the policy's probabilities."""
        sampling = replace(learner, samples=True)
        return list(self._pool.map(rollout.drive, [self._task(sampling, iteration, i) for i in range(n_rollouts)]))

    def advised(
        self, learner: PolicyParameters, adviser: drivers.Expert, n_rollouts: int, iteration: int
    ) -> list[tuple[Trajectory, NDArray[np.int64]]]:
        """Drive by the policy; beside each rollout, what the adviser would have decided."""
        tasks = [replace(self._task(learner, iteration, i), adviser=adviser) for i in range(n_rollouts)]
        return list(self._pool.map(rollout.drive_advised, tasks))

    def _task(self, driver: PolicyParameters, iteration: int, number: int) -> Task:
        return Task(driver, self._world, traffic_seed(self.run.seed, TRAINING, iteration, number))


def _rail(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    from rail_sumo.imitation import rail

    run, start = practice.run, checkpoint.learned
    judge = judge_of(run)
    for state in rail.train(
        start.theta,
        demonstrations,
        search=run.config.search,
        judge=judge_with_reward(judge, run.config),
        evaluate=lambda theta, perturbations, number: practice.pairs(
            replace(start, theta=theta), perturbations, number
        ),
        seed=run.seed,
        first_iteration=checkpoint.iteration + 1,
    ):
        figures = _verdict(state.judge_loss) | {"mean_return": state.mean_return, "step_norm": state.step_norm}
        learned = replace(start, theta=state.theta)
        yield Iteration(learned, _named(JUDGES, judge.state()), [*state.plus, *state.minus], figures)


def _gail(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    from rail_sumo.imitation import gail

    run, start = practice.run, checkpoint.learned
    judge = judge_of(run)
    ppo = gail.Ppo(
        start.theta,
        start.shape,
        start.whitening,
        run.config.gail,
        lowest_reward=-run.config.judge.reward_clip,
        seed=run.seed,
    )
    if checkpoint.memory:
        ppo.load_state(_part(PPO, checkpoint.memory))
    for state in gail.train(
        ppo,
        demonstrations,
        judge=judge,
        sample=lambda theta, number: practice.sampled(replace(start, theta=theta), run.config.gail.rollouts, number),
        seed=run.seed,
        first_iteration=checkpoint.iteration + 1,
    ):
        mean_return = float(judge.returns(state.driven).mean())
        figures = _verdict(state.judge_loss) | {"mean_return": mean_return, "step_norm": state.step_norm}
        memory = _named(JUDGES, judge.state()) | _named(PPO, ppo.state())
        yield Iteration(replace(start, theta=state.theta), memory, state.driven, figures)


def _dagger(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    from rail_sumo.imitation import bc, dagger

    run, start = practice.run, checkpoint.learned
    expert = drivers.load_expert(run.config)
    for state in dagger.train(
        start.theta,
        Demonstrations(**checkpoint.memory) if checkpoint.memory else demonstrations,
        fit=lambda labelled: bc.clone(labelled, start.shape, start.whitening, run.config.cloning, run.seed),
        advise=lambda theta, number: practice.advised(
            replace(start, theta=theta), expert, run.config.dagger.rollouts, number
        ),
        first_iteration=checkpoint.iteration + 1,
    ):
        learned = replace(start, theta=state.theta)
        yield Iteration(learned, dict(vars(state.labelled)), state.driven, {"step_norm": state.step_norm})


def _ars(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    from rail_sumo.imitation import ars

    run, start = practice.run, checkpoint.learned
    moments = _part(MOMENTS, checkpoint.memory)
    for state in ars.train(
        start.theta,
        ars.Moments(**moments) if moments else ars.Moments.none(start.shape.n_features),
        search=run.config.search,
        whiten=run.config.ars.whitening,
        evaluate=lambda theta, whitening, perturbations, number: practice.pairs(
            replace(start, theta=theta, whitening=whitening), perturbations, number
        ),
        returns=lambda driven: np.array([total_reward(trajectory, run.config.adas) for trajectory in driven]),
        seed=run.seed,
        first_iteration=checkpoint.iteration + 1,
    ):
        learned = replace(start, theta=state.theta, whitening=state.whitening)
        figures = {"mean_return": state.mean_return, "step_norm": state.step_norm}
        yield Iteration(learned, _named(MOMENTS, vars(state.moments)), state.driven, figures)


def _cloning(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    """Behaviour cloning is done before the first iteration."""
    return iter(())


@dataclass(frozen=True)
class Learner:
    """What tells one learner from another."""

    iterate: Callable[[Practice, Checkpoint, Demonstrations], Iterator[Iteration]]
    """Goes on from a checkpoint, without end."""
    reads_demonstrations: bool = True
    """Whether it is shown any, and starts from their clone."""
    improves_its_clone: bool = True
    """Whether it comes to more than that."""
    asks_the_expert: bool = False


LEARNERS = {
    "rail": Learner(_rail),
    "gail": Learner(_gail),
    "dagger": Learner(_dagger, asks_the_expert=True),
    "bc": Learner(_cloning, improves_its_clone=False),
    "ars": Learner(_ars, reads_demonstrations=False, improves_its_clone=False),
}
"""By `train.learner`."""


def learner_of(config: Config) -> Learner:
    """Return the configuration's learner."""
    return LEARNERS[config.train.learner]


def _start(config: Config, demonstrations: Demonstrations, seed: int) -> PolicyParameters:
    """Return what the first iteration starts from: a clone, or for a learner without demonstrations a fresh network."""
    from rail_sumo.imitation import bc

    whitening = Whitening.of(demonstrations.observations)
    untrained = config.cloning.model_copy(update={"epochs": 0})
    cloning = config.cloning if learner_of(config).reads_demonstrations else untrained
    n_features = len(feature_names(config.lidar, config.observation))
    shape = Shape(n_features, config.policy.hidden if config.policy.layers == 2 else None)
    return PolicyParameters(bc.clone(demonstrations, shape, whitening, cloning, seed), shape, whitening)


def judge_of(run: RunDirectory) -> "Judge":
    """Return a run's judge as it stands after the run's last iteration."""
    from rail_sumo.imitation.discriminator import Judge

    judge = Judge(run.clone.whitening, run.config.judge, run.seed, horizon_decisions(run.config))
    memory = run.checkpoint().memory
    if memory:
        judge.load_state(_part(JUDGES, memory))
    return judge


def judge_with_reward(judge: "Judge", config: Config) -> "rail.Judge":
    """Return what scores RAIL's rollouts: the judge, with the environment's reward added if that has a weight."""
    from rail_sumo.imitation.rewarded import Rewarded

    if not config.rail.reward_weight:
        return judge
    return Rewarded(
        judge,
        config.rail.reward_weight,
        reward=partial(total_reward, adas=config.adas),
        horizon_decisions=horizon_decisions(config),
    )


def horizon_decisions(config: Config) -> int:
    """Return the number of decisions in a training rollout that nothing cuts short."""
    return round(config.train.horizon_s / config.episode.decision_period_s)


def _verdict(loss: "JudgeLoss") -> dict[str, float]:
    return {
        "judge_loss": loss.loss,
        "judge_expert_mean": loss.expert_mean,
        "judge_learner_mean": loss.learner_mean,
    }


def _named(prefix: str, tensors: Mapping[str, NDArray[Any]]) -> Tensors:
    return {prefix + name: tensor for name, tensor in tensors.items()}


def _part(prefix: str, tensors: Tensors) -> Tensors:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _progress(iteration: Iteration, before: tuple[Row, ...], seconds: float) -> Row:
    steps_before = before[-1]["environment_steps"] if before else 0
    return {
        "iteration": len(before) + 1,
        "environment_steps": steps_before + sum(len(trajectory.lane_changing) for trajectory in iteration.driven),
        "seconds": round(seconds, 3),
        **iteration.figures,
        **metrics.means(iteration.driven),
    }


def demonstrations_of(config: Config) -> Demonstrations:
    """Return the demonstrations that a configuration names; for a learner that is shown nothing, a blank one.

    Raises:
        InputError: there are none, or fewer than wanted, or they are damaged or of another observation.
    """
    features = feature_names(config.lidar, config.observation)
    if not learner_of(config).reads_demonstrations:
        return Demonstrations(np.zeros((1, len(features))), np.zeros(1, np.int64), np.zeros(1, np.int64))
    shown = Demonstrations.load(_demonstrations_file(config), features=features, demonstrating=config.demonstrating)
    return shown.take(config.train.trajectories)


def _demonstrations_file(config: Config) -> Path:
    name = config.train.demonstrations
    return assets.expert(assets.EXPERT_DEMONSTRATIONS, config.train.expert_folder) if name == "expert" else Path(name)


def inputs_of(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that a training with this configuration reads, by the key that names it."""
    routes, additional = demand.check(config.traffic.routes, config.traffic.additional)
    inputs = {
        "network.file": assets.sha256(assets.network(config.network.file)),
        "traffic.routes": " ".join(map(assets.sha256, routes)),
    }
    if additional:
        inputs["traffic.additional"] = " ".join(map(assets.sha256, additional))
    if learner_of(config).reads_demonstrations:
        inputs["train.demonstrations"] = assets.sha256(_demonstrations_file(config))
    if learner_of(config).asks_the_expert:
        inputs |= expert_input(config)
    return inputs


def expert_input(config: Config) -> dict[str, str]:
    """Return the SHA-256 of the expert that a configuration names, by the key that names it."""
    return {"train.expert": assets.sha256(assets.expert(assets.EXPERT_POLICY, config.train.expert_folder))}
