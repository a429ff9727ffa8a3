"""The PettingZoo environment in a process of its own."""

from collections.abc import Mapping
from typing import Any

from gymnasium import spaces
from pettingzoo.utils.env import ParallelEnv

from rail_sumo.config import Config
from rail_sumo.highway.isolated import Child
from rail_sumo.highway.parallel_env import METADATA, Agents, HighwayParallelEnv, Infos
from rail_sumo.records import Floats


class IsolatedParallel(ParallelEnv[str, Floats, int]):
    """Does all that `HighwayParallelEnv` does but give its agents away, in a child process; see `Child`.

    Arguments and errors are those of `HighwayParallelEnv`.
    """

    metadata = METADATA
    render_mode = None

    def __init__(self, config: Config, *, hosts: int = 8) -> None:
        self._all = Agents(hosts, config)
        self.possible_agents = self._all.names
        self.agents: list[str] = []
        self._child = Child(HighwayParallelEnv, config, hosts=hosts)

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the space of what an agent observes."""
        return self._all.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the space of the meta-actions."""
        return self._all.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Floats], Infos]:
        """Begin an episode when the first host departs; the same seed gives the same traffic."""
        observations, infos = self._child.ask("reset", seed=seed, options=options)
        self.agents = list(observations)
        return observations, infos

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[dict[str, Floats], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let every agent take one decision, and drive for `episode.decision_period_s`."""
        told = self._child.ask("step", dict(actions))
        _, _, terminations, truncations, _ = told
        self.agents = [name for name in terminations if not terminations[name] and not truncations[name]]
        return told

    def close(self) -> None:
        """End the process; harmless when it has ended."""
        self.agents = []
        self._child.close()
