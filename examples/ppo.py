"""Train PPO with masked actions, evaluated in a process of its own: python examples/ppo.py [--decisions N]."""

import argparse

import gymnasium
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.callbacks import MaskableEvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import rail_sumo  # noqa: F401  registers the environment

WORLD = {"network": {"file": "highway3"}, "episode": {"course_m": 2000.0}}


def normalised(*, trains: bool) -> VecNormalize:
    """Return the environment, normalised. The one to evaluate on is isolated: SUMO runs once in a process."""
    env = DummyVecEnv([lambda: Monitor(gymnasium.make("RailSumo/Highway-v0", config=WORLD, isolated=not trains))])
    return VecNormalize(env, training=trains, norm_reward=trains)


def main(arguments: list[str] | None = None) -> float:
    """Train, and return the best mean reward of an evaluation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--decisions", type=int, default=50_000)
    parser.add_argument("--between", type=int, default=5_000, help="decisions from one evaluation to the next")
    given = parser.parse_args(arguments)
    evaluation = MaskableEvalCallback(normalised(trains=False), n_eval_episodes=5, eval_freq=given.between)
    n_steps = min(1024, given.between)
    model = MaskablePPO("MlpPolicy", normalised(trains=True), n_steps=n_steps, device="cpu", seed=0)
    model.learn(given.decisions, callback=evaluation)
    for env in (model.get_env(), evaluation.eval_env):
        env.close()
    print(f"best of its evaluations: a reward of {evaluation.best_mean_reward:.1f} an episode")
    return evaluation.best_mean_reward


if __name__ == "__main__":
    main()
