"""Train PPO under VecNormalize, and compare it with the expert: python examples/ppo_compared.py [--decisions N]."""

import argparse

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from rail_sumo import config_file, run

WORLD = config_file.of({"network": {"file": "highway3"}, "episode": {"course_m": 2000.0}})


class Taught:
    """Drives as a learner decides, on observations normalised as it was trained with."""

    senses = WORLD.senses  # as it was trained with, wherever it drives

    def __init__(self, learner: PPO, normalised: VecNormalize) -> None:
        self._policy, self._normalised = learner.policy, normalised  # each episode has a copy, without environments

    def decide(self, observation, agent):  # noqa: D102
        return int(self._policy.predict(self._normalised.normalize_obs(observation), deterministic=True)[0])


def main(arguments: list[str] | None = None) -> run.Tables:
    """Train, print both speeds, and return the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--decisions", type=int, default=50_000)
    decisions = parser.parse_args(arguments).decisions
    normalised = VecNormalize(DummyVecEnv([lambda: gymnasium.make("RailSumo/Highway-v0", config=WORLD)]))
    learner = PPO("MlpPolicy", normalised, n_steps=min(1024, decisions), device="cpu", seed=0).learn(decisions)
    normalised.close()  # SUMO runs once in a process
    tables = run.evaluate({"ppo": Taught(learner, normalised), "expert": "expert"}, WORLD, episodes=5, seed=0)
    print(tables.summary.query("metric == 'speed_kmh'")[["policy", "mean", "ratio", "ratio_low", "ratio_high"]])
    return tables


if __name__ == "__main__":
    main()
