"""Which learner, on which rollouts: a run from its clone to its last iteration, every one saved as it is done."""

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rail_sumo import assets, drivers, registry, rollout
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway import metrics, varied
from rail_sumo.highway.network import demand
from rail_sumo.highway.observation import feature_names
from rail_sumo.highway.reward import total_reward
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import ARGMAX, SAMPLED, PolicyParameters, Shape, Whitening
from rail_sumo.records import Floats, Trajectory
from rail_sumo.rollout import SILENT, TRAINING, Observer, Task, WorkerCount, Workers, traffic_seed
from rail_sumo.run_directory import JUDGES, PROGRESS_COLUMNS, Checkpoint, Row, RunDirectory, Tensors, require_new

if TYPE_CHECKING:  # torch takes seconds to import, and not every command trains
    from rail_sumo.imitation import rail
    from rail_sumo.imitation.discriminator import Discriminator, Fit

PPO, MOMENTS = "ppo.", "moments."
"""What the names of PPO's tensors, and of the observations' moments, begin with in a checkpoint."""


@dataclass(frozen=True)
class Iteration:
    """The result of one iteration of any learner."""

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
    given, config = config, resolved(config)
    require_loss(config)
    run = RunDirectory(out) if resume else None
    if run is None:
        require_new(out)
    if learner_of(config).asks_the_expert:
        drivers.require_same_senses(drivers.load_expert(config), config, "the expert, who is to be asked,")
    demonstrations = demonstrations_of(given)
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
        driven = self.drive(
            [replace(learner, theta=theta) for theta in thetas],
            iteration,
            traffic=[*range(n), *range(n)] if shared_traffic else None,
        )
        return driven[:n], driven[n:]

    def drive(
        self, policies: Sequence[PolicyParameters], iteration: int, *, traffic: Sequence[int] | None = None
    ) -> list[Trajectory]:
        """Drive one rollout of each policy, each on traffic of its own, or on the traffic of these numbers."""
        numbers = range(len(policies)) if traffic is None else traffic
        tasks = [self._task(policy, iteration, number) for policy, number in zip(policies, numbers, strict=True)]
        return list(self._pool.map(rollout.practise, tasks))

    def sampled(self, learner: PolicyParameters, n_rollouts: int, iteration: int) -> list[Trajectory]:
        """Drive by actions sampled with the policy's probabilities."""
        return self.drive([learner.acting(SAMPLED)] * n_rollouts, iteration)

    def advised(
        self, learner: PolicyParameters, adviser: drivers.Expert, n_rollouts: int, iteration: int
    ) -> list[tuple[Trajectory, NDArray[np.int64]]]:
        """Drive by the policy; beside each rollout, what the adviser would have decided."""
        tasks = [replace(self._task(learner, iteration, i), adviser=adviser) for i in range(n_rollouts)]
        return list(self._pool.map(rollout.practise_advised, tasks))

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
        figures = figures_of(state.judge_fit) | {"mean_return": state.mean_return, "step_norm": state.step_norm}
        learned = replace(start, theta=state.theta)
        yield Iteration(learned, memory_of(judge), [*state.plus, *state.minus], figures)


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
        figures = figures_of(state.judge_fit) | {"mean_return": mean_return, "step_norm": state.step_norm}
        memory = memory_of(judge) | _named(PPO, ppo.state())
        yield Iteration(replace(start, theta=state.theta), memory, state.driven, figures)


def _dagger(practice: Practice, checkpoint: Checkpoint, demonstrations: Demonstrations) -> Iterator[Iteration]:
    from rail_sumo.imitation import bc, dagger

    run, start = practice.run, checkpoint.learned
    expert = drivers.load_expert(run.config)
    for state in dagger.train(
        start.theta,
        Demonstrations(**checkpoint.memory) if checkpoint.memory else demonstrations,
        fit=lambda labelled: bc.clone(
            labelled, start.shape, start.whitening, run.config.cloning, run.seed, masked=start.masked
        ),
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
    iterations: int
    """How many there are unless `train.iterations` tells; 0 if there can be none."""
    samples: bool = True
    """Whether its policy acts by sampling unless `policy.mode` tells; else by its most probable action."""
    reads_demonstrations: bool = True
    """Whether it is shown any, and starts from their clone."""
    compared_with_clone: bool = True
    """Whether `run.train` also evaluates the clone that it started from."""
    asks_the_expert: bool = False


LEARNERS = {
    "rail": Learner(_rail, iterations=160, samples=False),
    "gail": Learner(_gail, iterations=160),
    "dagger": Learner(_dagger, iterations=20, asks_the_expert=True),
    "bc": Learner(_cloning, iterations=0, compared_with_clone=False),
    "ars": Learner(_ars, iterations=160, samples=False, reads_demonstrations=False, compared_with_clone=False),
}
"""By `train.learner`."""


def learner_of(config: Config) -> Learner:
    """Return the configuration's learner.

    Raises:
        InputError: there is none of that name.
    """
    return registry.find("learner", config.train.learner, LEARNERS)


def require_loss(config: Config) -> None:
    """Raise InputError if there is no loss of the name that the judge is to minimise."""
    from rail_sumo.imitation.losses import LOSSES

    registry.find("loss", config.judge.loss, LOSSES)


def resolved(config: Config) -> Config:
    """Return the configuration as a run keeps it: iterations and mode written out, and files by their absolute paths.

    Raises:
        InputError: there is no such learner, or it has no iterations and some are wanted.
    """
    learner = learner_of(config)
    iterations, mode = config.train.iterations, config.policy.mode
    if not learner.iterations and iterations not in ("default", 0):
        raise InputError(f"learner '{config.train.learner}' has no iterations, got {iterations}; leave them out")
    given = config.train
    return config.changed(
        network={"file": assets.absolute(config.network.file)},
        traffic={name: tuple(map(assets.absolute, getattr(config.traffic, name))) for name in ("routes", "additional")},
        varied={"networks": tuple(map(assets.absolute, config.varied.networks))},
        train={
            "iterations": learner.iterations if iterations == "default" else iterations,
            "expert": assets.absolute(given.expert),
            "demonstrations": given.demonstrations
            if given.demonstrations == "expert"
            else assets.absolute(given.demonstrations),
        },
        policy={"mode": (SAMPLED if learner.samples else ARGMAX) if mode == "default" else mode},
    )


def _start(config: Config, demonstrations: Demonstrations, seed: int) -> PolicyParameters:
    """Return what the first iteration starts from: a clone, or for a learner without demonstrations a fresh network."""
    from rail_sumo.imitation import bc

    whitening = Whitening.of(demonstrations.observations)
    untrained = config.cloning.model_copy(update={"epochs": 0})
    cloning = config.cloning if learner_of(config).reads_demonstrations else untrained
    n_features = len(feature_names(config.lidar, config.observation))
    shape = Shape(n_features, config.policy.hidden if config.policy.layers == 2 else None)
    masked, samples = config.policy.masked, config.policy.mode == SAMPLED
    theta = bc.clone(demonstrations, shape, whitening, cloning, seed, masked=masked)
    return PolicyParameters(theta, shape, whitening, samples, masked)


def judge_of(run: RunDirectory) -> "Discriminator":
    """Return a run's judge as it stands after the run's last iteration."""
    judge = _untrained_judge(run)
    memory = run.checkpoint().memory
    if memory:
        judge.load_state(_part(JUDGES, memory))
    return judge


def _untrained_judge(run: RunDirectory) -> "Discriminator":
    from rail_sumo.imitation.discriminator import Discriminator

    return Discriminator(run.clone.whitening, run.config.judge, run.seed, horizon_decisions(run.config))


def verdicts(run: RunDirectory, trajectory: Trajectory) -> Sequence[float]:
    """Return what a run's judge makes of each decision of a drive: 1 as if it were the expert's, 0 the learner's.

    Nothing where the run's learner has no judge.
    """
    weights = run.judge()
    if not weights:
        return ()
    judge = _untrained_judge(run)
    judge.load_state(weights)
    return judge.verdicts(trajectory).tolist()


def memory_of(judge: "Discriminator") -> Tensors:
    """Return what `judge_of` needs to go on with a judge: a part of an iteration's memory."""
    return _named(JUDGES, judge.state())


def judge_with_reward(judge: "Discriminator", config: Config) -> "rail.Judge":
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


def figures_of(fit: "Fit") -> dict[str, float]:
    """Return what a judge's fit came to, by the columns of `progress.csv`."""
    return {
        "judge_loss": fit.loss,
        "judge_expert_mean": fit.expert_mean,
        "judge_learner_mean": fit.learner_mean,
    }


def _named(prefix: str, tensors: Mapping[str, NDArray[Any]]) -> Tensors:
    return {prefix + name: tensor for name, tensor in tensors.items()}


def _part(prefix: str, tensors: Tensors) -> Tensors:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _progress(iteration: Iteration, before: tuple[Row, ...], seconds: float) -> Row:
    unknown = sorted(iteration.figures.keys() - set(PROGRESS_COLUMNS))
    if unknown:
        raise ValueError(f"'{unknown[0]}' is no column of progress.csv; figures may be: {', '.join(PROGRESS_COLUMNS)}")
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
    return (
        assets.expert(assets.EXPERT_DEMONSTRATIONS, assets.expert_folder(config.train.expert))
        if name == "expert"
        else Path(name)
    )


def inputs_of(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that a training with this configuration reads, by the key that names it."""
    inputs = world_inputs(config)
    if learner_of(config).reads_demonstrations:
        inputs["train.demonstrations"] = assets.sha256(_demonstrations_file(config))
    if learner_of(config).asks_the_expert:
        inputs |= expert_input(config)
    return inputs


def world_inputs(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that driving in this configuration reads, by the key that names it."""
    traffic = demand.read(config.traffic)
    inputs = {
        "network.file": assets.sha256(assets.network(config.network.file)),
        "traffic.routes": " ".join(map(assets.sha256, traffic.routes)),
    }
    if config.varied.networks:
        files = [file for name in config.varied.networks for file in varied.files_of(name)]
        inputs["varied.networks"] = " ".join(map(assets.sha256, files))
    others = [file for file in traffic.files if file not in traffic.routes]
    if others:
        inputs["traffic.additional"] = " ".join(map(assets.sha256, others))
    return inputs


def expert_input(config: Config) -> dict[str, str]:
    """Return the SHA-256 of the expert that a configuration names, by the key that names it."""
    return {
        "train.expert": assets.sha256(assets.expert(assets.EXPERT_POLICY, assets.expert_folder(config.train.expert)))
    }
