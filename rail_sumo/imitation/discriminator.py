"""The judge: tells the expert's decisions from the learner's, and rewards what it takes for the expert's.

Source: least-squares GAN (Mao et al. 2017) in Shin & Kim (IJCAI 2019), with one change. Their D is linear, so that
some of its outputs leave (0, 1), where log D - log(1 - D) is undefined and a clamp decides the reward. Ours ends in a
sigmoid, which makes that reward the network's own output, the logit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rail_sumo import config
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.perceptron import load_training_state, perceptron, single_threaded, training_state
from rail_sumo.policy import N_ACTIONS, Whitening
from rail_sumo.records import Floats, Trajectory

EXPERT_LABEL = 1.0
LEARNER_LABEL = 0.0


@dataclass(frozen=True)
class JudgeLoss:
    """How well the judge tells expert and learner apart after a fit."""

    loss: float
    """Least-squares loss; 0.25 when they look the same, 0.0 when nothing is in doubt."""
    expert_mean: float
    """Mean of D over the expert's pairs."""
    learner_mean: float
    """Mean of D over the learner's pairs."""


class Judge:
    """D(observation, action) in (0, 1), the expert's label at 1.

    Args:
        whitening: observations are centred and scaled by it before they are judged.
        settings: network, training and reward.
        seed: of the first weights; all other chance is handed to `fit`.
        horizon_decisions: decisions in a rollout that nothing cuts short; see `returns`.
    """

    def __init__(self, whitening: Whitening, settings: config.Judge, seed: int, horizon_decisions: int) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"judge")))
        self._whitening = whitening
        self._settings = settings
        self._horizon_decisions = horizon_decisions
        self._logit = perceptron([len(whitening.mean) + N_ACTIONS, *settings.hidden, 1], rng)
        self._adam = torch.optim.Adam(self._logit.parameters(), lr=settings.learning_rate)

    @single_threaded()
    def fit(self, expert: Demonstrations, learner: Sequence[Trajectory], rng: np.random.Generator) -> JudgeLoss:
        """Train on minibatches of `batch_size` pairs from either side, drawn with replacement.

        Args:
            expert: what was demonstrated.
            learner: the iteration's rollouts.
            rng: draws the minibatches.
        """
        expert_pairs = self._pairs(expert.observations, expert.actions)
        learner_pairs = self._pairs(*_decisions(learner))
        for _ in range(self._settings.minibatches):
            expert_batch = _draw(expert_pairs, self._settings.batch_size, rng)
            learner_batch = _draw(learner_pairs, self._settings.batch_size, rng)
            loss = self._loss(expert_batch, learner_batch)
            self._adam.zero_grad()
            loss.backward()
            self._adam.step()

        with torch.inference_mode():
            on_expert, on_learner = self._judge(expert_pairs), self._judge(learner_pairs)
        return JudgeLoss(least_squares(on_expert, on_learner).item(), on_expert.mean().item(), on_learner.mean().item())

    @single_threaded()
    def rewards(self, observations: Floats, actions: NDArray[np.int64]) -> Floats:
        """Return log D - log(1 - D), clipped at ±reward_clip, of each of n pairs.

        Args:
            observations: shape (n, n_features).
            actions: shape (n,).
        """
        with torch.inference_mode():
            logits = self._logit(self._pairs(observations, actions))[:, 0]
        return logits.numpy().astype(np.float64).clip(-self._settings.reward_clip, self._settings.reward_clip)

    def returns(self, trajectories: Sequence[Trajectory]) -> Floats:
        """Return each rollout's mean reward per decision, shape (n_trajectories,).

        A collision leads into an absorbing state, which earns the lowest reward from there to the horizon, and for one
        decision at least: where most rewards are negative, cutting them short must not pay (Kostrikov et al. 2019).

        Raises:
            ValueError: a rollout without a decision.
        """
        if not trajectories:
            return np.empty(0)
        rewards = self.rewards(*_decisions(trajectories))
        ends = np.cumsum([len(trajectory.actions) for trajectory in trajectories])
        return np.array(
            [
                self._return(of_rollout, crashed=trajectory.end_reason == "collision")
                for of_rollout, trajectory in zip(np.split(rewards, ends[:-1]), trajectories, strict=True)
            ]
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all that a later fit depends on: weights and Adam's moments."""
        return training_state(self._logit, self._adam)

    def load_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `state` returned.

        Raises:
            KeyError: a weight is missing.
            ValueError: a weight has another shape than this judge's.
        """
        load_training_state(self._logit, self._adam, state)

    def _pairs(self, observations: Floats, actions: NDArray[np.int64]) -> Tensor:
        """Return the network's inputs, shape (n, n_features + 5): whitened observation, one-hot action."""
        pairs = np.hstack([self._whitening(observations), np.eye(N_ACTIONS)[actions]])
        return torch.from_numpy(pairs.astype(np.float32))

    def _judge(self, pairs: Tensor) -> Tensor:
        return torch.sigmoid(self._logit(pairs)[:, 0])

    def _loss(self, expert: Tensor, learner: Tensor) -> Tensor:
        return least_squares(self._judge(expert), self._judge(learner))

    def _return(self, rewards: Floats, *, crashed: bool) -> float:
        if not crashed:
            return float(rewards.mean())
        absorbed = max(self._horizon_decisions - len(rewards), 1)
        return float((rewards.sum() - self._settings.reward_clip * absorbed) / (len(rewards) + absorbed))


def least_squares(on_expert: Tensor, on_learner: Tensor) -> Tensor:
    """Return the discriminator's least-squares loss from D on either side (Algorithm 1, lines 8 and 9)."""
    return 0.5 * (on_expert - EXPERT_LABEL).square().mean() + 0.5 * (on_learner - LEARNER_LABEL).square().mean()


def _draw(pairs: Tensor, n: int, rng: np.random.Generator) -> Tensor:
    return pairs[torch.from_numpy(rng.integers(len(pairs), size=n))]


def _decisions(trajectories: Sequence[Trajectory]) -> tuple[Floats, NDArray[np.int64]]:
    """Return what was seen and carried out in all of them, end to end.

    An expert that is masked never asks for what would be refused. Were the learner judged by what it asks for, lane
    changes that were refused would count as such, and it would have to drive with fewer than the expert.
    """
    if not all(len(trajectory.actions) for trajectory in trajectories):
        raise ValueError("a rollout must have at least one decision to be judged by")
    observations = np.concatenate([trajectory.observations for trajectory in trajectories])
    return observations, np.concatenate([trajectory.carried_out for trajectory in trajectories])
