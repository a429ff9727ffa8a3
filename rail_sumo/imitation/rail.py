"""Randomized adversarial imitation learning: Algorithm 1 of Shin & Kim (IJCAI 2019)."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rail_sumo import config
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.random_search import RandomSearch
from rail_sumo.records import Floats, Trajectory

if TYPE_CHECKING:  # its home imports torch, and the algorithm needs none
    from rail_sumo.imitation.discriminator import Fit

Evaluate = Callable[[Floats, Floats, int], tuple[list[Trajectory], list[Trajectory]]]
"""(theta, perturbations, iteration) -> rollouts of theta plus each perturbation, and of theta minus each."""


class Judge(Protocol):
    """What tells expert and learner apart, rollout by rollout."""

    def fit(self, expert: Demonstrations, learner: Sequence[Trajectory], rng: np.random.Generator) -> "Fit":
        """Learn to tell them apart a little better."""

    def returns(self, trajectories: Sequence[Trajectory]) -> Floats:
        """Return how much like the expert each rollout looks, shape (n_trajectories,); more is better."""


@dataclass(frozen=True)
class RailState:
    """What an iteration did."""

    iteration: int
    theta: Floats
    """The policy after the step."""
    step_norm: float
    """How far theta moved; 0.0 where all returns were the same."""
    judge_fit: "Fit"
    mean_return: float
    """Of all rollouts of this update, by the judge after its fit."""
    plus: list[Trajectory]
    minus: list[Trajectory]
    """The perturbed rollouts that this update used: a pair per direction."""


def train(
    theta: Floats,
    demonstrations: Demonstrations,
    *,
    search: config.Search,
    judge: Judge,
    evaluate: Evaluate,
    seed: int,
    first_iteration: int = 1,
) -> Iterator[RailState]:
    """Run RAIL, yielding a `RailState` after every iteration, without end.

    In short, the algorithm: draw directions (line 2); drive theta plus and minus each (3 to 6); let the judge learn
    from these rollouts and the expert's (7 to 9); move theta along the directions by the returns that the judge gives
    (10 to 13). `learners._rail` puts it to work: theta is the clone that `training` has fitted, and `evaluate` is
    `learners.Practice.pairs`.

    It differs from the printed algorithm in line 14, which moves the whitening with the states met so far: the cloned
    weights are valid only with the whitening they were trained under, so that stays as it is. In
    print, the first line's loop ends with an episode; here it is over iterations, and the caller ends it. In print, the
    directions have the standard deviation nu, and lines 4 and 5 scale them by nu again; here they are scaled once.
    docs/learners/rail.md lists what else differs.

    Args:
        theta: the cloned policy, shape (size,).
        demonstrations: the expert's.
        search: N, b, alpha and nu.
        judge: learns as training goes on.
        evaluate: drives the perturbed policies, both of a direction on the same traffic.
        seed: of directions and minibatches. Every iteration draws from a child of its own, so that going on after
            iteration k takes theta, the judge as it then was, and `first_iteration` = k + 1; the result is the same.
        first_iteration: the number of the first iteration yielded.
    """
    ars = RandomSearch(
        theta,
        n_directions=search.n_directions,
        n_top=search.kept,
        step_size=search.step_size,
        noise_std=search.noise_std,
    )
    for iteration in itertools.count(first_iteration):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*b"rail", iteration)))
        deltas = ars.ask(rng)  # line 2
        plus, minus = evaluate(ars.theta, ars.noise_std * deltas, iteration)  # lines 3-6: same traffic for both
        judge_fit = judge.fit(expert=demonstrations, learner=plus + minus, rng=rng)  # lines 7-9, by `judge.loss`
        returns = judge.returns(plus), judge.returns(minus)  # one frozen judge for all
        step_norm = ars.tell(deltas, *returns)  # lines 10-13
        yield RailState(iteration, ars.theta.copy(), step_norm, judge_fit, float(np.mean(returns)), plus, minus)
