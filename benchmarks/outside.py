"""Behaviour cloning and GAIL as another library has them (imitation, https://imitation.readthedocs.io), beside ours.

    imitation/bin/python benchmarks/outside.py [--seeds 3] [--rounds 40]

The demonstrations, the network, the whitening, the judge's minibatches and the rollouts' length are ours, and a round
has about as many decisions; all else is as that library has it by default. It knows no masks: all policies but one are
unmasked. One difference is a handicap: its judge sees the lane changes that the learner asks for, ours those that are
carried out (docs/learning.md tells what that does). Every policy is driven in both modes. The library pins an old
gymnasium, and so wants an environment of its own; the README beside this tells how to make it.
"""

import argparse
from dataclasses import replace

import gymnasium
import numpy as np
import pandas as pd
import torch
from imitation.algorithms import bc
from imitation.algorithms.adversarial.gail import GAIL
from imitation.data.types import Transitions
from imitation.rewards.reward_nets import BasicRewardNet
from imitation.util import logger
from imitation.util.networks import RunningNorm
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import DummyVecEnv

from rail_sumo import config_file, learners, rollout, roster, run, training
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation import bc as ours
from rail_sumo.imitation.perceptron import flatten
from rail_sumo.policy import ARGMAX, SAMPLED, PolicyParameters, Shape, Whitening

SHOWN = ["speed_kmh", "overtakes", "lane_changes", "refused_decisions", "collisions"]
EPISODES = 16


class Whitened(gymnasium.ObservationWrapper):
    """What the policy's first layer sees."""

    def __init__(self, env, whitening: Whitening) -> None:
        super().__init__(env)
        self._whitening = whitening
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, env.observation_space.shape, np.float32)

    def observation(self, observation):
        return whitened(observation, self._whitening)


def whitened(observations, whitening: Whitening):
    return ((observations - whitening.mean) / whitening.std).astype(np.float32)


def transitions(demonstrations, whitening: Whitening) -> Transitions:
    """Decisions as that library wants them; what follows an episode's last is itself, and the episode is over."""
    seen = whitened(demonstrations.observations, whitening)
    last = np.append(np.diff(demonstrations.episode) != 0, True)
    after = np.where(last[:, None], seen, np.roll(seen, -1, axis=0))
    return Transitions(seen, demonstrations.actions, np.array([{}] * len(seen)), after, last)


def learned(policy: ActorCriticPolicy, start: PolicyParameters) -> PolicyParameters:
    """Return the policy's actor as one of our drivers."""
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    return replace(start, theta=flatten(module for module in modules if isinstance(module, torch.nn.Linear)))


def taught(world, demonstrations, seed: int, rounds: int) -> dict[str, PolicyParameters]:
    """Return the drivers that the two libraries learn from the same demonstrations."""
    whitening = Whitening.of(demonstrations.observations)
    shape = Shape(len(feature_names(world.lidar, world.observation)), world.policy.hidden)
    our_clone, our_masked = (
        PolicyParameters(
            ours.clone(demonstrations, shape, whitening, world.cloning, seed, masked=masked),
            shape,
            whitening,
            masked=masked,
        )
        for masked in (False, True)
    )
    quiet = logger.configure(None, format_strs=[])
    shown = transitions(demonstrations, whitening)
    practice = world.practice(world.train.horizon_s)
    venv = DummyVecEnv([lambda: Whitened(HighwayEnv(practice), whitening)])
    venv.seed(seed)
    ppo = PPO(
        "MlpPolicy",
        venv,
        n_steps=world.gail.rollouts * learners.horizon_decisions(world),
        batch_size=world.gail.batch_size,
        policy_kwargs={"net_arch": {"pi": [shape.hidden], "vf": list(world.gail.critic_hidden)}},
        seed=seed,
        device="cpu",
    )
    cloning = bc.BC(
        observation_space=venv.observation_space,
        action_space=venv.action_space,
        rng=np.random.default_rng(seed),
        policy=ppo.policy,
        demonstrations=shown,
        batch_size=world.cloning.batch_size,
        custom_logger=quiet,
        device="cpu",
    )
    cloning.train(n_epochs=world.cloning.epochs, progress_bar=False)
    their_clone = learned(ppo.policy, our_clone)
    judge = BasicRewardNet(
        venv.observation_space, venv.action_space, use_next_state=False, normalize_input_layer=RunningNorm
    )
    trainer = GAIL(
        demonstrations=shown,
        demo_batch_size=world.judge.batch_size,
        n_disc_updates_per_round=world.judge.minibatches,
        venv=venv,
        gen_algo=ppo,
        reward_net=judge,
        custom_logger=quiet,
        allow_variable_horizon=True,  # decisions also fall due when a lane change ends
    )
    trainer.train(rounds * ppo.n_steps)
    venv.close()
    policies = {
        "cloning, ours, masked": our_masked,
        "cloning, ours": our_clone,
        "cloning, imitation": their_clone,
        f"GAIL, imitation, {rounds} rounds": learned(ppo.policy, our_clone),
    }
    return {f"{name}, {mode}": policy.acting(mode) for name, policy in policies.items() for mode in (ARGMAX, SAMPLED)}


def cell(given: tuple[int, int]) -> pd.DataFrame:
    """Teach with one seed, and drive its held-out episodes."""
    seed, rounds = given
    world = config_file.load()
    torch.set_num_threads(1)
    demonstrations = training.demonstrations_of(world)
    policies = {**taught(world, demonstrations, seed, rounds), "expert": roster.find_driver("expert", world)}
    return run.evaluate(policies, world, episodes=EPISODES, seed=seed)[0].assign(seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=40, help="of GAIL, each of 32 rollouts as in ours")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with rollout.workers(given.workers) as pool:
        driven = pd.concat(pool.map(cell, [(seed, given.rounds) for seed in range(given.seeds)]))
    means = driven.groupby(["policy", "seed"], sort=False)[SHOWN].mean()
    print(means.round(2).to_string())
    print("\nmeans over the seeds, over the expert's:")
    over = means.groupby("policy", sort=False).mean()
    print((over / over.loc["expert"])[["speed_kmh", "overtakes", "lane_changes"]].round(3).to_string())


if __name__ == "__main__":
    main()
