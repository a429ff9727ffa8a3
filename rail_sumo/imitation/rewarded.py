"""A judge that adds the environment's reward to its own: what RAIL learns from it is no longer imitation alone."""

from collections.abc import Callable, Sequence

import numpy as np

from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.discriminator import Fit
from rail_sumo.imitation.rail import Judge
from rail_sumo.records import Floats, Trajectory


class Rewarded:
    """Adds the environment's reward to another judge's returns, so that a learner may pass its expert.

    Args:
        judge: tells expert from learner.
        weight: what a unit of reward adds.
        reward: what a rollout earned.
        horizon_decisions: decisions in a rollout that nothing cuts short; see `returns`.
    """

    def __init__(
        self, judge: Judge, weight: float, *, reward: Callable[[Trajectory], float], horizon_decisions: int
    ) -> None:
        self._judge = judge
        self._weight = weight
        self._reward = reward
        self._horizon_decisions = horizon_decisions

    def fit(self, expert: Demonstrations, learner: Sequence[Trajectory], rng: np.random.Generator) -> Fit:
        """Train the judge."""
        return self._judge.fit(expert, learner, rng)

    def returns(self, trajectories: Sequence[Trajectory]) -> Floats:
        """Return the judge's return of each rollout plus its weighted reward per decision, shape (n_trajectories,).

        After a collision a positive sum of rewards is divided by the full horizon, a negative one by the decisions
        taken: cutting a rollout short must not pay.
        """
        earned = np.array(list(map(self._per_decision, trajectories)))
        return self._judge.returns(trajectories) + self._weight * earned

    def _per_decision(self, trajectory: Trajectory) -> float:
        earned, decided = self._reward(trajectory), len(trajectory.decisions)
        gains_no_more = trajectory.end_reason == "collision" and earned > 0.0
        return earned / (max(decided, self._horizon_decisions) if gains_no_more else decided)
