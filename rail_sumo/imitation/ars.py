"""Augmented random search on the environment's own reward: RAIL's search without the imitation, for comparison.

Source: Mania, Guy & Recht, "Simple random search of static linear policies is competitive for reinforcement learning"
(NeurIPS 2018). Whitening on: their V2; off: V1. With n_top < N: V2-t and V1-t.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rail_sumo import config
from rail_sumo.imitation.random_search import RandomSearch
from rail_sumo.policy import Whitening
from rail_sumo.records import Floats, Trajectory

EvaluateWhitened = Callable[[Floats, Whitening, Floats, int], tuple[list[Trajectory], list[Trajectory]]]
"""(theta, whitening, perturbations, iteration) -> rollouts of theta plus each perturbation, and minus each."""


@dataclass(frozen=True)
class Moments:
    """How many observations were met so far, their mean, and their summed squared distances from it."""

    count: Floats
    """Shape (1,)."""
    mean: Floats
    """(n_features,)."""
    squares: Floats
    """(n_features,)."""

    @classmethod
    def none(cls, n_features: int) -> "Moments":
        """Nothing met yet."""
        return cls(np.zeros(1), np.zeros(n_features), np.zeros(n_features))

    def joined(self, observations: Floats) -> "Moments":
        """Return those with more observations, shape (n, n_features), by Chan, Golub & LeVeque (1983)."""
        count, mean = self.count + len(observations), observations.mean(axis=0)
        shift = mean - self.mean
        return Moments(
            count,
            self.mean + shift * len(observations) / count,
            self.squares
            + np.square(observations - mean).sum(axis=0)
            + np.square(shift) * self.count * len(observations) / count,
        )

    @property
    def whitening(self) -> Whitening:
        """Their mean and standard deviation; the scale is kept where nothing varied or nothing was met."""
        return Whitening.by(self.mean, np.sqrt(self.squares / np.maximum(self.count, 1.0)))


@dataclass(frozen=True)
class ArsState:
    """What an iteration did."""

    iteration: int
    theta: Floats
    """The policy after the step."""
    whitening: Whitening
    """What theta's observations are whitened by from now on."""
    moments: Moments
    step_norm: float
    """How far theta moved; 0.0 where all returns were the same."""
    mean_return: float
    """Mean return of the perturbed rollouts that this update used."""
    driven: list[Trajectory]


def train(
    theta: Floats,
    moments: Moments,
    *,
    search: config.Search,
    whiten: bool,
    evaluate: EvaluateWhitened,
    returns: Callable[[list[Trajectory]], Floats],
    seed: int,
    first_iteration: int = 1,
) -> Iterator[ArsState]:
    """Run the search, yielding an `ArsState` after every iteration, without end.

    Args:
        theta: where to start, shape (size,).
        moments: of the observations met so far.
        search: N, b, alpha and nu.
        whiten: whether the policy sees observations whitened by `moments` (V2) or as they are (V1).
        evaluate: drives the perturbed policies, both of a direction on the same traffic.
        returns: each rollout's, shape (n_rollouts,); more is better.
        seed: of directions. Every iteration draws from a child of its own.
        first_iteration: the number of the first iteration yielded.
    """
    ars = RandomSearch(
        theta,
        n_directions=search.n_directions,
        n_top=search.kept,
        step_size=search.step_size,
        noise_std=search.noise_std,
    )
    as_they_are = Moments.none(len(moments.mean)).whitening
    for iteration in itertools.count(first_iteration):
        deltas = ars.ask(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*b"ars", iteration))))
        whitening = moments.whitening if whiten else as_they_are
        plus, minus = evaluate(ars.theta, whitening, ars.noise_std * deltas, iteration)
        returns_plus, returns_minus = returns(plus), returns(minus)
        step_norm = ars.tell(deltas, returns_plus, returns_minus)
        driven = [*plus, *minus]
        moments = moments.joined(np.concatenate([trajectory.observations for trajectory in driven]))
        yield ArsState(
            iteration,
            ars.theta.copy(),
            moments.whitening if whiten else as_they_are,
            moments,
            step_norm,
            float(np.mean([returns_plus, returns_minus])),
            driven,
        )
