"""Eight cars driven by one policy, each by what it sees: python examples/eight_agents.py [--network NAME]."""

import argparse

import rail_sumo
from rail_sumo import config_file


def main(arguments: list[str] | None = None) -> dict[str, dict]:
    """Drive an episode and print a table; return each agent's figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--network", default="ring5", help="one of the shipped networks")
    parser.add_argument("--seconds", type=float, default=120.0, help="how long each drives")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    world = config_file.of({"network": {"file": given.network}, "episode": {"duration_s": given.seconds}})
    driver = rail_sumo.load_driver("road-rail")
    env = rail_sumo.parallel_env(8, world.seen_with(driver.senses))
    observations, infos = env.reset(seed=given.seed)
    ended = {}
    while env.agents:
        actions = {name: driver.act(observations[name], infos[name]["action_mask"]) for name in env.agents}
        observations, _, terminations, truncations, infos = env.step(actions)
        ended |= {name: infos[name] for name in infos if terminations[name] or truncations[name]}
    print(f"{'agent':8} {'vehicle':12} {'km/h':>5} {'overtakes':>9} {'lane changes':>12}  end")
    for name, told in sorted(ended.items()):
        figures = f"{told['speed_kmh']:5.1f} {told['overtakes']:9} {told['lane_changes']:12}"
        print(f"{name:8} {env.vehicles[name]:12} {figures}  {told['end_reason']}")
    env.close()
    return ended


if __name__ == "__main__":
    main()
