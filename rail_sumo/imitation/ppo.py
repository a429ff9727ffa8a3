"""The expert: PPO that never samples an invalid action (the paper's "PPO with specific action controls").

Learns from the environment's reward (`highway.reward`).
"""

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.perceptron import actor, generators_put_back, kept_in_bounds, single_threaded
from rail_sumo.records import Floats

ATTEMPTS = 10
"""How many episodes are tried for one that can begin."""

REWARD_SCALE = 0.1
"""A decision earns around ten steps' reward; PPO's defaults are meant for rewards of about 1."""

CLONING_EPOCHS, CLONING_BATCH, CLONING_RATE = 30, 256, 1e-3
"""Of what the network begins as."""

LIBRARY_SEEDS = 2**32
"""numpy's global generator, which stable-baselines3 seeds, takes seeds below this."""

Layers = list[tuple[Floats, Floats]]


class ScaledHighway(HighwayEnv):
    """The environment as the expert trains on it: observations in units of about 1, smaller rewards, training episodes.

    Args:
        config: the world.
        scale: divides the observation, shape (n_features,).
        traffic_seeds: one for each episode; without end.
    """

    def __init__(self, config: Config, scale: Floats, traffic_seeds: Iterator[int]) -> None:
        super().__init__(config)
        self._scale = scale
        self._traffic_seeds = traffic_seeds

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Floats, dict]:
        """Begin an episode on traffic of its own; where it cannot begin, on the next."""
        for _ in range(ATTEMPTS - 1):
            with suppress(InputError):
                return self._begin()
        return self._begin()

    def _begin(self) -> tuple[Floats, dict]:
        observation, info = super().reset(seed=next(self._traffic_seeds))
        return observation / self._scale, info

    def step(self, action: int | np.int64) -> tuple[Floats, float, bool, bool, dict]:
        """Take one decision."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation / self._scale, REWARD_SCALE * reward, terminated, truncated, info


class _Progress(BaseCallback):
    """Tells the observer of every decision, and leaves the policy as it is while the critic learns first."""

    def __init__(self, observer: Callable[[int], None], critic_first: int) -> None:
        super().__init__()
        self._observer = observer
        self._critic_first = critic_first
        self._updates = 0

    def _on_rollout_start(self) -> None:
        moves = self._updates >= self._critic_first
        for module in actor(self.model.policy):
            module.requires_grad_(moves)
        self._updates += 1

    def _on_step(self) -> bool:
        self._observer(self.num_timesteps)
        return True


def scale_of(config: Config) -> Floats:
    """Return what an observation is divided by: the range for distances, 10 m/s for the rest."""
    names = feature_names(config.lidar, config.observation)
    return np.where([name.startswith("distance") for name in names], config.lidar.max_range_m, 10.0)


@single_threaded()
@generators_put_back()
def train(
    config: Config,
    seed: int,
    traffic_seeds: Iterator[int],
    observer: Callable[[int], None] = lambda _: None,
    first: Demonstrations | None = None,
) -> Layers:
    """Train the expert and return its network, whose inputs are plain observations.

    Args:
        config: the world, and the recipe in its section `expert`.
        seed: of the networks and the sampling.
        traffic_seeds: one for each episode; without end.
        observer: is told the number of decisions taken so far.
        first: what is cloned before PPO begins, if anything.

    Returns:
        (weights, biases) of each layer from input to output, for `drivers.Expert`.

    Raises:
        InputError: the weights do not stay finite.
    """
    expert = config.expert
    world = config.practice(expert.horizon_s)
    scale = scale_of(config)
    env = ScaledHighway(world, scale, traffic_seeds)
    try:
        model = MaskablePPO(
            "MlpPolicy",
            env,
            # SB3 reports 0 progress left in the last update; one update's share is added, so that its rate is not 0.
            learning_rate=lambda left: expert.learning_rate * (left + 1 / expert.updates),
            n_steps=expert.decisions_per_update,
            batch_size=expert.batch_size,
            n_epochs=expert.epochs,
            gamma=expert.discount,
            ent_coef=expert.entropy,
            policy_kwargs={"net_arch": list(expert.hidden), "activation_fn": torch.nn.Tanh},
            seed=seed % LIBRARY_SEEDS,
            device="cpu",
        )
        if first is not None:
            _clone(model, first, scale, seed)
        progress = _Progress(observer, expert.critic_first)
        with kept_in_bounds(model.policy, "expert.learning_rate"):
            model.learn(expert.updates * expert.decisions_per_update, callback=progress)
    finally:
        env.close()
    return _layers(model, scale)


def _clone(model: MaskablePPO, shown: Demonstrations, scale: Floats, seed: int) -> None:
    """Raise the probability of what was decided, among what was allowed: behaviour cloning of the policy's network."""
    observations = torch.as_tensor(shown.observations / scale, dtype=torch.float32)
    actions, allowed = torch.as_tensor(shown.actions), torch.as_tensor(shown.allowed)
    adam = torch.optim.Adam(model.policy.parameters(), CLONING_RATE)
    rng = np.random.default_rng(seed)
    for _ in range(CLONING_EPOCHS):
        for batch in torch.as_tensor(rng.permutation(len(actions))).split(CLONING_BATCH):
            _, log_probability, _ = model.policy.evaluate_actions(
                observations[batch], actions[batch], action_masks=allowed[batch]
            )
            adam.zero_grad()
            (-log_probability.mean()).backward()
            adam.step()


def _layers(model: MaskablePPO, scale: Floats) -> Layers:
    """Read the policy's network out, the observation's scale folded into its first layer."""
    layers = [
        (layer.weight.detach().double().numpy().copy(), layer.bias.detach().double().numpy().copy())
        for layer in actor(model.policy)
    ]
    layers[0] = (layers[0][0] / scale, layers[0][1])
    return layers
