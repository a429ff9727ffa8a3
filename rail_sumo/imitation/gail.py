"""Generative adversarial imitation learning: the judge of RAIL, and PPO's gradients in place of random search.

Source: Ho & Ermon, "Generative adversarial imitation learning" (NeurIPS 2016), with PPO (Schulman et al. 2017) from
sb3-contrib in place of TRPO, as in the paper's comparison. A masked policy is updated over the actions that it was
told it may choose.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.buffers import MaskableRolloutBuffer
from stable_baselines3.common.logger import Logger

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.discriminator import Fit
from rail_sumo.imitation.perceptron import (
    actor,
    flatten,
    kept_in_bounds,
    load_training_state,
    seeded,
    single_threaded,
    training_state,
)
from rail_sumo.policy import N_ACTIONS, Shape, Whitening, unflatten
from rail_sumo.records import Floats, Trajectory

Sample = Callable[[Floats, int], list[Trajectory]]
"""(theta, iteration) -> rollouts whose actions are drawn with the probabilities of theta's policy."""

_Columns = tuple[NDArray[Any], ...]


class DecisionJudge(Protocol):
    """What tells expert and learner apart, decision by decision."""

    def fit(self, expert: Demonstrations, learner: Sequence[Trajectory], rng: np.random.Generator) -> Fit:
        """Learn to tell them apart a little better."""

    def rewards(self, observations: Floats, actions: NDArray[np.int64]) -> Floats:
        """Return how much like the expert each of n decisions looks, shape (n,); more is better."""


@dataclass(frozen=True)
class GailState:
    """What an iteration did."""

    iteration: int
    theta: Floats
    """The policy after the update."""
    step_norm: float
    """How far theta moved."""
    judge_fit: Fit
    driven: list[Trajectory]
    """The rollouts that this update used."""


def train(
    ppo: "Ppo",
    demonstrations: Demonstrations,
    *,
    judge: DecisionJudge,
    sample: Sample,
    seed: int,
    first_iteration: int = 1,
) -> Iterator[GailState]:
    """Run GAIL, yielding a `GailState` after every iteration, without end.

    Args:
        ppo: holds the policy, cloned, and improves it.
        demonstrations: the expert's.
        judge: learns as training goes on.
        sample: drives the policy.
        seed: of the minibatches. Every iteration draws from a child of its own, so that going on after iteration k
            takes `ppo` and the judge as they then were, and `first_iteration` = k + 1; the result is the same.
        first_iteration: the number of the first iteration yielded.
    """
    for iteration in itertools.count(first_iteration):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*b"gail", iteration)))
        before = ppo.theta()
        driven = sample(before, iteration)
        judge_fit = judge.fit(expert=demonstrations, learner=driven, rng=rng)
        ppo.update(driven, judge.rewards, rng)
        theta = ppo.theta()
        yield GailState(iteration, theta, float(np.linalg.norm(theta - before)), judge_fit, driven)


class Ppo:
    """Actor, critic and update of sb3-contrib's MaskablePPO, on rollouts that were driven elsewhere.

    Args:
        theta: the policy to start from, shape (shape.size,).
        shape: the layout of theta; the actor is laid out alike.
        whitening: the policy's own; actor and critic see whitened observations.
        settings: PPO's.
        lowest_reward: the judge's; a collision leads into an absorbing state, which earns it for ever.
        seed: of the critic's first weights.
    """

    def __init__(
        self,
        theta: Floats,
        shape: Shape,
        whitening: Whitening,
        settings: config.Gail,
        *,
        lowest_reward: float,
        seed: int,
    ) -> None:
        self._whitening = whitening
        self._lowest_reward = lowest_reward
        self._batch_size = settings.batch_size
        hidden = [] if shape.hidden is None else [shape.hidden]
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"gail")))
        with seeded(rng):
            self._ppo = MaskablePPO(
                "MlpPolicy",
                _Spaces(shape.n_features),
                learning_rate=settings.learning_rate,
                n_steps=settings.batch_size,  # of a buffer that `update` replaces
                batch_size=settings.batch_size,
                n_epochs=settings.epochs,
                gamma=settings.discount,
                gae_lambda=settings.gae_lambda,
                ent_coef=settings.entropy,
                policy_kwargs={
                    "net_arch": {"pi": hidden, "vf": list(settings.critic_hidden)},
                    "activation_fn": torch.nn.Tanh,
                },
                device="cpu",
            )
        self._ppo.set_logger(Logger(folder=None, output_formats=[]))
        with torch.no_grad():
            for layer, matrix in zip(self._actor(), unflatten(theta, shape), strict=True):
                layer.weight.copy_(torch.tensor(matrix[:, :-1]))
                layer.bias.copy_(torch.tensor(matrix[:, -1]))

    def theta(self) -> Floats:
        """Return the policy, laid out as `policy.unflatten` splits it."""
        return flatten(self._actor())

    @single_threaded()
    def update(
        self,
        driven: Sequence[Trajectory],
        rewards: Callable[[Floats, NDArray[np.int64]], Floats],
        rng: np.random.Generator,
    ) -> None:
        """Improve the policy by rollouts of its own.

        A rollout that the horizon cut short is bootstrapped with the critic's value of its last observation; the last
        decision, whose successor is unknown, is dropped. After a collision nothing is dropped.

        Args:
            driven: rollouts of the policy; one of a single decision tells nothing.
            rewards: the judge's, of observations (n, n_features) and actions (n,).
            rng: orders the minibatches.

        Raises:
            InputError: none of the rollouts tells anything, or the weights do not stay finite.
        """
        parts = [self._valued(trajectory, rewards) for trajectory in driven]
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        if len(columns[0]) % self._batch_size == 1:  # a minibatch of one, whose advantages have no spread
            columns = [column[1:] for column in columns]
        observations, actions, allowed, earned, starts, values, log_probs = columns
        if not len(actions):
            raise InputError("the rollouts hold fewer than two decisions to learn from; set a longer train.horizon_s")
        buffer = MaskableRolloutBuffer(
            len(actions),
            self._ppo.observation_space,
            self._ppo.action_space,
            device=self._ppo.device,
            gae_lambda=self._ppo.gae_lambda,
            gamma=self._ppo.gamma,
        )
        buffer.observations[:, 0], buffer.actions[:, 0, 0], buffer.rewards[:, 0] = observations, actions, earned
        buffer.episode_starts[:, 0], buffer.values[:, 0], buffer.log_probs[:, 0] = starts, values, log_probs
        buffer.action_masks[:, 0] = allowed
        buffer.pos, buffer.full = len(actions), True
        # The stream ends with a rollout's end: nothing follows that has not been added to its last reward.
        buffer.compute_returns_and_advantage(torch.zeros(1), dones=np.ones(1))
        self._ppo.rollout_buffer = buffer
        with kept_in_bounds(self._ppo.policy, "gail.learning_rate"), seeded(rng):
            self._ppo.train()

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all that a later update depends on: weights and Adam's moments."""
        return training_state(self._ppo.policy, self._ppo.policy.optimizer)

    def load_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `state` returned.

        Raises:
            KeyError: a weight is missing.
            ValueError: a weight has another shape than this one's.
        """
        load_training_state(self._ppo.policy, self._ppo.policy.optimizer, state)

    def _actor(self) -> list[torch.nn.Linear]:
        return actor(self._ppo.policy)

    def _valued(self, trajectory: Trajectory, rewards: Callable[[Floats, NDArray[np.int64]], Floats]) -> _Columns:
        """Return the buffer's columns: observation, action, mask, reward, start, value, log-probability."""
        observations = torch.from_numpy(self._whitening(trajectory.observations).astype(np.float32))
        with torch.no_grad():
            values, log_probs, _ = self._ppo.policy.evaluate_actions(
                observations, torch.from_numpy(trajectory.decisions), action_masks=torch.from_numpy(trajectory.allowed)
            )
        earned = rewards(trajectory.observations, trajectory.carried_out)
        starts = np.arange(len(earned)) == 0
        decided = (observations.numpy(), trajectory.decisions, trajectory.allowed)
        columns = (*decided, earned, starts, values.numpy()[:, 0], log_probs.numpy())
        if trajectory.end_reason == "collision":
            earned[-1] += self._ppo.gamma / (1 - self._ppo.gamma) * self._lowest_reward
            return columns
        earned[-2:-1] += self._ppo.gamma * values.numpy()[-1, 0]
        return tuple(column[:-1] for column in columns)


class _Spaces(gymnasium.Env[NDArray[np.float32], np.int64]):
    """What PPO asks of an environment that it never steps."""

    def __init__(self, n_features: int) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (n_features,), np.float32)
        self.action_space = spaces.Discrete(N_ACTIONS)
