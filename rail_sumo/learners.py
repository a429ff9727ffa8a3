"""The learners: what each does from a checkpoint to its next iteration."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rail_sumo import drivers, registry, rollout, roster
from rail_sumo.config import OF_LEARNERS, Config
from rail_sumo.highway.reward import total_reward
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import SAMPLED, PolicyParameters
from rail_sumo.records import Floats, Trajectory
from rail_sumo.rollout import TRAINING, Task, Workers, traffic_seed
from rail_sumo.run_directory import JUDGES, Checkpoint, Row, RunDirectory, Tensors

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
    """All else that the next iteration depends on: numpy arrays of numbers, by names of the learner's own. The
    checkpoint that a training goes on from has them as its `memory`; at the clone that is empty."""
    driven: list[Trajectory]
    """The rollouts that the speed, overtakes and lane changes of this row are of. The steps of all others count too."""
    figures: Row
    """What the learner alone knows: some of the columns of `progress.csv`, `LEARNERS_COLUMNS`."""


class Practice:
    """Drives a learner's training rollouts: of one length, on traffic that is new in every iteration."""

    def __init__(self, run: RunDirectory, pool: Workers) -> None:
        self.run = run
        self._pool = pool
        self._world = run.config.practice(run.config.train.horizon_s)
        self.steps = 0
        """How many SUMO steps it has driven."""

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
        """Drive one rollout of each policy, each on traffic of its own, or on the traffic of these numbers.

        A number is the same traffic in every call of one iteration. Without any they are 0 to n - 1.
        """
        numbers = range(len(policies)) if traffic is None else traffic
        tasks = [self._task(policy, iteration, number) for policy, number in zip(policies, numbers, strict=True)]
        driven = list(self._pool.map(rollout.practise, tasks))
        self._count(driven)
        return driven

    def sampled(self, learner: PolicyParameters, n_rollouts: int, iteration: int) -> list[Trajectory]:
        """Drive by actions sampled with the policy's probabilities."""
        return self.drive([learner.acting(SAMPLED)] * n_rollouts, iteration)

    def advised(
        self, learner: PolicyParameters, adviser: rollout.Who, n_rollouts: int, iteration: int
    ) -> list[tuple[Trajectory, NDArray[np.int64]]]:
        """Drive by the policy; beside each rollout, what the adviser would have decided.

        The traffic is that of `drive` in the same iteration.

        Args:
            learner: who drives.
            adviser: any driver that takes decisions, with the learner's senses, or its name; see `roster.find_driver`.
            n_rollouts: how many rollouts.
            iteration: which one it is.

        Raises:
            InputError: no such driver; SUMO's own, which takes no decisions; or one with other senses.
        """
        who = roster.who_advises(adviser, self._world, learner)
        tasks = [replace(self._task(learner, iteration, i), adviser=who) for i in range(n_rollouts)]
        advised = list(self._pool.map(rollout.practise_advised, tasks))
        self._count(driven for driven, _ in advised)
        return advised

    def _count(self, driven: Iterable[Trajectory]) -> None:
        self.steps += sum(len(trajectory.lane_changing) for trajectory in driven)

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
    reads: tuple[str, ...] = OF_LEARNERS
    """Which of the configuration's sections for learners it reads; keys of others are without effect on it."""


LEARNERS = {
    "rail": Learner(_rail, iterations=160, samples=False, reads=("cloning", "search", "judge", "rail")),
    "gail": Learner(_gail, iterations=160, reads=("cloning", "judge", "gail")),
    "dagger": Learner(_dagger, iterations=20, asks_the_expert=True, reads=("cloning", "dagger")),
    "bc": Learner(_cloning, iterations=0, compared_with_clone=False, reads=("cloning",)),
    "ars": Learner(
        _ars,
        iterations=160,
        samples=False,
        reads_demonstrations=False,
        compared_with_clone=False,
        reads=("search", "ars"),
    ),
}
"""By `train.learner`."""


def learner_of(config: Config) -> Learner:
    """Return the configuration's learner.

    Raises:
        InputError: there is none of that name.
    """
    return registry.find("learner", config.train.learner, LEARNERS)


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
