"""The judge: tells the expert's decisions from the learner's, and rewards what it takes for the expert's.

Source: least-squares GAN (Mao et al. 2017) in Shin & Kim (IJCAI 2019), who keep D within (0, 1) "experimentally": where
it leaves that range, log D - log(1 - D) is undefined. Here D is the sigmoid of the network's output, which makes that
reward the output itself, the logit. Other losses: `losses`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rail_sumo import config, registry
from rail_sumo.errors import InputError
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.losses import LOSSES
from rail_sumo.imitation.perceptron import (
    load_training_state,
    perceptron,
    require_in_bounds,
    single_threaded,
    training_state,
)
from rail_sumo.policy import N_ACTIONS, Whitening
from rail_sumo.records import Floats, Trajectory


@dataclass(frozen=True)
class Fit:
    """The judge's loss and mean verdicts of one fit."""

    loss: float
    """Mean over the fit's minibatches of what the judge minimises."""
    expert_mean: float
    """Mean of D over all of the expert's pairs, after the fit."""
    learner_mean: float
    """Mean of D over all of the learner's pairs, after the fit."""


class Discriminator:
    """D(observation, action), 1 for the expert and 0 for the learner.

    Args:
        whitening: observations are centred and scaled by it before they are judged.
        settings: network, loss, training and reward.
        seed: of the first weights; all other chance is handed to `fit`.
        horizon_decisions: decisions in a rollout that nothing cuts short; see `returns`.

    Raises:
        InputError: there is no such loss.
    """

    def __init__(self, whitening: Whitening, settings: config.Judge, seed: int, horizon_decisions: int) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"judge")))
        self._whitening = whitening
        self._settings = settings
        self._horizon_decisions = horizon_decisions
        self._loss = registry.find("loss", settings.loss, LOSSES)
        self._network = perceptron([len(whitening.mean) + N_ACTIONS, *settings.hidden, 1], rng)
        self._adam = torch.optim.Adam(self._network.parameters(), lr=settings.learning_rate)

    @single_threaded()
    def fit(self, expert: Demonstrations, learner: Sequence[Trajectory], rng: np.random.Generator) -> Fit:
        """Train on minibatches of `batch_size` pairs from either side, drawn with replacement.

        Args:
            expert: what was demonstrated.
            learner: the iteration's rollouts.
            rng: draws the minibatches, and whatever the loss draws.

        Raises:
            InputError: the loss is not one finite number, or its weights are beyond all bounds.
        """
        expert_pairs = self._pairs(expert.observations, expert.actions)
        learner_pairs = self._pairs(*_decisions(learner))
        losses = []
        for _ in range(self._settings.minibatches):
            expert_batch = _draw(expert_pairs, self._settings.batch_size, rng)
            learner_batch = _draw(learner_pairs, self._settings.batch_size, rng)
            loss = self._loss.minimised(self._outputs, expert_batch, learner_batch, rng)
            if not isinstance(loss, torch.Tensor) or loss.numel() != 1 or not loss.requires_grad:
                raise InputError(
                    f"judge.loss '{self._settings.loss}' minimises {_described(loss)}; it must return one number that "
                    "depends on the judge's outputs, a tensor of shape ()"
                )
            self._adam.zero_grad()
            loss.backward()
            self._adam.step()
            losses.append(loss.item())
        wrong = [loss for loss in losses if not math.isfinite(loss)]
        if wrong:
            raise InputError(f"judge.loss '{self._settings.loss}' came to {wrong[0]}; it must be a finite number")
        require_in_bounds(self._network, "judge.learning_rate")

        with torch.inference_mode():
            means = [self._loss.verdict(self._outputs(pairs)).mean().item() for pairs in (expert_pairs, learner_pairs)]
        return Fit(float(np.mean(losses)), *means)

    @single_threaded()
    def rewards(self, observations: Floats, actions: NDArray[np.int64]) -> Floats:
        """Return the loss's reward, clipped at ±reward_clip, of each of n pairs; by default log D - log(1 - D).

        Args:
            observations: shape (n, n_features).
            actions: shape (n,).

        Raises:
            InputError: the loss does not give every pair a reward that is a finite number.
        """
        with torch.inference_mode():
            rewards = self._loss.reward(self._outputs(self._pairs(observations, actions)))
        if rewards.shape != (len(actions),):
            raise InputError(
                f"the reward of judge.loss '{self._settings.loss}' must be one number for each of {len(actions)} "
                f"decisions; it has shape {tuple(rewards.shape)}"
            )
        if not torch.isfinite(rewards).all():
            raise InputError(f"the reward of judge.loss '{self._settings.loss}' must be finite; it is not always")
        return rewards.numpy().astype(np.float64).clip(-self._settings.reward_clip, self._settings.reward_clip)

    @single_threaded()
    def verdicts(self, trajectory: Trajectory) -> Floats:
        """Return for each of a trajectory's decisions how much it is like the expert's, shape (n_decisions,)."""
        with torch.inference_mode():
            verdicts = self._loss.verdict(self._outputs(self._pairs(*_decisions([trajectory]))))
        return verdicts.numpy().astype(np.float64)

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
        ends = np.cumsum([len(trajectory.decisions) for trajectory in trajectories])
        return np.array(
            [
                self._return(of_rollout, crashed=trajectory.end_reason == "collision")
                for of_rollout, trajectory in zip(np.split(rewards, ends[:-1]), trajectories, strict=True)
            ]
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all that a later fit depends on: weights and Adam's moments."""
        return training_state(self._network, self._adam)

    def load_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `state` returned.

        Raises:
            KeyError: a weight is missing.
            ValueError: a weight has another shape than this judge's.
        """
        load_training_state(self._network, self._adam, state)

    def _pairs(self, observations: Floats, actions: NDArray[np.int64]) -> Tensor:
        """Return the network's inputs, shape (n, n_features + 5): whitened observation, one-hot action."""
        pairs = np.hstack([self._whitening(observations), np.eye(N_ACTIONS)[actions]])
        return torch.from_numpy(pairs.astype(np.float32))

    def _outputs(self, pairs: Tensor) -> Tensor:
        return self._network(pairs)[:, 0]

    def _return(self, rewards: Floats, *, crashed: bool) -> float:
        if not crashed:
            return float(rewards.mean())
        absorbed = max(self._horizon_decisions - len(rewards), 1)
        return float((rewards.sum() - self._settings.reward_clip * absorbed) / (len(rewards) + absorbed))


def _described(loss: object) -> str:
    if not isinstance(loss, torch.Tensor):
        return f"{loss!r:.40}"
    return f"a tensor of shape {tuple(loss.shape)}" + ("" if loss.requires_grad else " that does not depend on them")


def _draw(pairs: Tensor, n: int, rng: np.random.Generator) -> Tensor:
    return pairs[torch.from_numpy(rng.integers(len(pairs), size=n))]


def _decisions(trajectories: Sequence[Trajectory]) -> tuple[Floats, NDArray[np.int64]]:
    """Return what was seen and carried out in all of them, end to end.

    The expert's data hold no refused lane changes. If refused requests counted as lane changes, an unmasked learner
    would be pushed below the expert's number.
    """
    if not all(len(trajectory.decisions) for trajectory in trajectories):
        raise ValueError("a rollout must have at least one decision to be judged by")
    observations = np.concatenate([trajectory.observations for trajectory in trajectories])
    return observations, np.concatenate([trajectory.carried_out for trajectory in trajectories])
