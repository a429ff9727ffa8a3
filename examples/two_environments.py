"""Two worlds side by side, two environments each: python examples/two_environments.py [--decisions N]."""

import argparse

import gymnasium
import numpy as np

import rail_sumo  # noqa: F401  registers the environment
from rail_sumo.records import MetaAction

WORLDS = {"light": {"traffic": {"vehicles": 6}}, "dense": {"traffic": {"vehicles": 36}}}
N = 2  # of each world, each in a process of its own


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Accelerate whenever a decision falls due; return the mean speed of whole episodes in each world, in km/h."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--decisions", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of an episode")
    given = parser.parse_args(arguments)
    worlds, found = {}, {name: [] for name in WORLDS}
    for name, world in WORLDS.items():
        config = world | {"episode": {"duration_s": given.seconds}}
        worlds[name] = gymnasium.make_vec("RailSumo/Highway-v0", N, config=config)
        worlds[name].reset(seed=1)
    for _ in range(given.decisions):
        for name, envs in worlds.items():
            *_, infos = envs.step(np.full(N, MetaAction.ACCELERATE))
            found[name] += infos["speed_kmh"][infos["_speed_kmh"]].tolist() if "speed_kmh" in infos else []
    speeds = {name: float(np.mean(of_episodes)) for name, of_episodes in found.items()}
    for name, envs in worlds.items():
        envs.close()
        print(f"{name}: {speeds[name]:.1f} km/h in {len(found[name])} episodes")
    return speeds


if __name__ == "__main__":
    main()
