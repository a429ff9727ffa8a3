"""Dataset aggregation: ask the expert what it would have done where the learner went.

Source: Ross, Gordon & Bagnell, "A reduction of imitation learning and structured prediction to no-regret online
learning" (AISTATS 2011), Algorithm 3.1; the demonstrations are its first iteration, all later ones are driven by the
learner alone (beta_i = 0).
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.records import Floats, Trajectory

Advise = Callable[[Floats, int], list[tuple[Trajectory, NDArray[np.int64]]]]
"""(theta, iteration) -> rollouts of theta, and what the expert would have decided in each, shape (n_decisions,)."""


@dataclass(frozen=True)
class DaggerState:
    """What an iteration did."""

    iteration: int
    theta: Floats
    """The policy fitted to all that is labelled by now."""
    step_norm: float
    """How far theta moved."""
    labelled: Demonstrations
    """The demonstrations and every rollout so far, with the expert's decisions."""
    driven: list[Trajectory]


def train(
    theta: Floats,
    labelled: Demonstrations,
    *,
    fit: Callable[[Demonstrations], Floats],
    advise: Advise,
    first_iteration: int = 1,
) -> Iterator[DaggerState]:
    """Run DAgger, yielding a `DaggerState` after every iteration, without end.

    Args:
        theta: the policy cloned so far, shape (size,).
        labelled: what it was cloned from.
        fit: clones anew.
        advise: drives the policy and asks the expert.
        first_iteration: the number of the first iteration yielded.
    """
    for iteration in itertools.count(first_iteration):
        advised = advise(theta, iteration)
        driven, advice = map(list, zip(*advised, strict=True))
        labelled = labelled.joined(Demonstrations.from_trajectories(driven, advice))
        before, theta = theta, fit(labelled)
        yield DaggerState(iteration, theta, float(np.linalg.norm(theta - before)), labelled, driven)
