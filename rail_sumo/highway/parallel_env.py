"""The PettingZoo environment: several cars of one demand, each an agent. Needs pettingzoo, the extra `multi`."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.utils.seeding import np_random
from pettingzoo.utils.env import ParallelEnv

from rail_sumo import assets
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway import sumo_process
from rail_sumo.highway.agent import KEEP_ALONE, Agent
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.observation import bounds
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic import entry
from rail_sumo.highway.traffic.rides import Ride, Rides
from rail_sumo.records import SECONDS_PER_STEP, EndReason, Floats, MetaAction

Infos = dict[str, dict[str, Any]]


class Told(NamedTuple):
    """What `step` returns for one agent."""

    observation: Floats
    reward: float
    crashed: bool
    is_over: bool
    info: dict[str, Any]


class Agents:
    """The agents' names, and their spaces: the same objects at every call, so that seeding one lasts.

    Args:
        hosts: how many agents there are.
        config: the world.

    Raises:
        InputError: there are to be less than one.
    """

    def __init__(self, hosts: int, config: Config) -> None:
        if hosts < 1:
            raise InputError(f"hosts must be at least 1, the number of driven cars; got {hosts}")
        self.names = [f"host_{number}" for number in range(hosts)]
        low, high = bounds(config.lidar, config.observation)
        self.observation_spaces = {name: spaces.Box(low, high, dtype=np.float64) for name in self.names}
        self.action_spaces = {name: spaces.Discrete(len(MetaAction)) for name in self.names}

    def __str__(self) -> str:
        return f"{self.names[0]} to {self.names[-1]}"


METADATA = {"name": "rail_sumo_highway_v0", "render_modes": [], "is_parallelizable": True}


class HighwayParallelEnv(ParallelEnv[str, Floats, int]):
    """Several cars of a demand, each an agent: `host_0`, `host_1` and so on, in the order in which they depart.

    They are the first cars that can be driven after the moment at which `HighwayEnv` would enter with the same seed.
    Each senses, drives, is rewarded and ends as its host does. A car that departs later is an agent from the next
    decision on, and until then keeps its lane; one that has ended is driven on by SUMO.

    All agents decide together, every `episode.decision_period_s` from the first entry on: other than in `HighwayEnv`, a
    lane change that ends in between waits for that. They decide in the order of their names: of two that may move
    into one gap, the second is refused.

    Args:
        config: the world; the default one without it. A shipped network that is given no demand takes the shipped
            demand of its name: the window of made traffic is for a single host.
        hosts: how many agents there are.

    Raises:
        InputError: less than one host, no demand, a demand without vehicles or one of which a vehicle is named, or
            worlds that vary.
    """

    metadata = METADATA
    render_mode = None
    _simulation: Simulation | None = None

    def __init__(self, config: Config | None = None, *, hosts: int = 8) -> None:
        self.config = _with_demand(config or Config())
        self._demand = demand.read(self.config.traffic)
        if not self._demand.has_traffic:
            raise InputError(
                "the demand has no <vehicle>, <flow> or <trip>; every host is one of its cars: name another"
            )
        road.require_readable(self.config.network.file)
        self._net_file = assets.network(self.config.network.file)
        self._all = Agents(hosts, self.config)
        self.possible_agents = self._all.names
        self.agents: list[str] = []
        self._period_steps = round(self.config.episode.decision_period_s / SECONDS_PER_STEP)
        self._rng, _ = np_random()
        self._live: dict[str, Ride] = {}

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the space of what an agent observes, see `HighwayEnv`."""
        return self._all.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the space of the meta-actions."""
        return self._all.action_spaces[agent]

    @sumo_process.as_input_errors
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Floats], Infos]:
        """Begin an episode when the first host departs; the same seed gives the same traffic. Options are ignored.

        Raises:
            InputError: no car departs that could be driven.
            RuntimeError: another simulation is open in this process.
        """
        self.close()
        if seed is not None:
            self._rng, _ = np_random(seed)
        self._seed = int(self._rng.integers(2**31)) if seed is None else seed
        try:
            self._let_first_enter()
        except BaseException:
            self.close()  # or no other environment could begin in this process
            raise
        told = self._tell((), {})
        return {name: one.observation for name, one in told.items()}, {name: one.info for name, one in told.items()}

    def _let_first_enter(self) -> None:
        """Drive until the first host has departed; the demand begins anew for each search after the first."""
        nobody = ""
        for search in entry.searches(self.config, self._demand, np.random.default_rng(self._seed)):
            self.close()
            simulation = self._open(search)
            self._drive_to_next_entry(simulation)
            if self._live:
                return
            nobody = nobody or entry.nobody(self.config, self._demand, self._refused, simulation.now_s)
        raise entry.Nobody(nobody)

    def _open(self, search: entry.Search) -> Simulation:
        simulation = self._simulation = Simulation(
            self._net_file,
            demand=self._demand,
            begin_s=self.config.traffic.begin_s,
            seed=self._seed,
            limit_factor=self.config.network.limit_factor,
        )
        self._rides = Rides(simulation, self.config, keeps_trajectory=True)
        self.vehicles: dict[str, str] = {}
        """The id in SUMO of every agent that has departed, by its name."""
        self._over: dict[str, Told] = {}  # those who have not been told yet that their episode is over
        self._awaited = list(self.possible_agents)
        self._kinds = entry.kinds_of(self._demand)
        self._refused: list[str] = []
        self._search = search
        simulation.run_until(search.from_s - SECONDS_PER_STEP)
        return simulation

    @sumo_process.as_input_errors
    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[dict[str, Floats], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let every agent take one decision, and drive for `episode.decision_period_s`.

        Where no agent is left on the road it drives on until the next host departs. If none will, those that never
        departed become agents for one decision, in which they see zeros and do nothing, and are truncated at the next.

        Returns:
            Observations, rewards, terminations (by a collision of its own), truncations (by all else) and infos, as
            `HighwayEnv` has them, of the agents that were to decide and of those that have become agents since.

        Raises:
            RuntimeError: no agent is left; call `reset`.
            ValueError: an agent has no action, or one that does not exist; an action of an agent that does not exist.
            InputError: SUMO gives up.
        """
        simulation, before = self._simulation, list(self.agents)
        if simulation is None or not before:
            raise RuntimeError("no episode is under way, or it is over; call reset()")
        missing = [name for name in before if name not in actions]
        if missing:
            raise ValueError(f"every agent decides, and there is no action for {', '.join(missing)}")
        unknown = [name for name in actions if name not in self.possible_agents]
        if unknown:
            raise ValueError(f"there is no agent {', '.join(map(str, unknown))}, only {self._all}")
        decisions = {name: MetaAction.of(actions[name]) for name in before}
        told = {name: self._over.pop(name) for name in before if name in self._over}
        for name, ride in self._live.items():
            ride.agent.forget_gaps()  # of those that decided before it, some may have claimed one
            ride.agent.decide(decisions[name])
            ride.command(simulation)
        for steps_left in reversed(range(self._period_steps if self._live else 0)):
            self._drive_a_step(simulation, steps_left)
        self._look(simulation)
        told |= {name: self._over.pop(name) for name in before if name in self._over}
        if not self._live and not self._over:
            self._drive_to_next_entry(simulation)
        told = self._tell(before, told)
        return (
            {name: one.observation for name, one in told.items()},
            {name: one.reward for name, one in told.items()},
            {name: one.crashed for name, one in told.items()},
            {name: one.is_over and not one.crashed for name, one in told.items()},
            {name: one.info for name, one in told.items()},
        )

    # Time goes on.

    def _drive_a_step(self, simulation: Simulation, steps_left: int) -> None:
        """Drive one step; there are so many more until the agents decide."""
        for name, ride in list(self._live.items()):
            self._rides.keep_to_way(ride)
            if ride.agent.host.is_lost or (ride.is_idle and ride.agent.is_spent):
                self._look_from(simulation, name, ride)
            elif ride.is_idle:
                ride.command(simulation)
        left = self._rides.step()
        for name, ride in list(self._live.items()):
            if ride in left:
                self._end_away(name, ride)
        if self._awaited:
            self._let_enter(simulation, steps_left)

    def _let_enter(self, simulation: Simulation, steps_left: int) -> None:
        waited_s = simulation.now_s - self._search.from_s
        departed, config = simulation.departed(), self.config
        is_choosy = waited_s < self._search.choosy_s
        for car, stretch in entry.replaceable(departed, config, self._kinds, self._refused, is_choosy=is_choosy):
            name = self._awaited.pop(0)
            self._live[name] = self._rides.enter(car, stretch=stretch)
            self._live[name].agent.wait(steps_left)
            self.vehicles[name] = car.name
            self._search = self._search._replace(from_s=simulation.now_s, until_s=simulation.now_s + entry.WAIT_S)
            if not self._awaited:
                break

    def _drive_to_next_entry(self, simulation: Simulation) -> None:
        while not self._live and self._may_enter(simulation):
            self._drive_a_step(simulation, 0)
        self._look(simulation)

    def _may_enter(self, simulation: Simulation) -> bool:
        """Whether a host may yet depart."""
        in_time = simulation.now_s <= self._search.until_s
        return bool(self._awaited) and in_time and simulation.expects_vehicles

    # What the agents see, and how they end.

    def _look(self, simulation: Simulation) -> None:
        """Let every agent on the road sense, and end the episodes that are over; also of those who never departed."""
        for name, ride in list(self._live.items()):
            self._look_from(simulation, name, ride)
        if not self._may_enter(simulation):
            self._over |= {name: self._nothing("not begun") for name in self._awaited}
            self._awaited = []

    def _look_from(self, simulation: Simulation, name: str, ride: Ride) -> None:
        agent = ride.agent
        if agent.host.is_lost:
            self._end_away(name, ride)
            self._rides.part(agent.host.name)
            return
        agent.look(simulation.scene(agent.host))
        if agent.end is not None:
            self._over[name] = self._last_of(agent)
            del self._live[name]
            self._rides.part(agent.host.name)

    def _end_away(self, name: str, ride: Ride) -> None:
        """End the episode of one that has left the road, or its course."""
        del self._live[name]
        ride.leave()
        seen = ride.agent.n_steps and len(ride.agent.observation)
        self._over[name] = self._last_of(ride.agent) if seen else self._nothing("left the road")

    def _last_of(self, agent: Agent) -> Told:
        return Told(agent.observation, agent.earned(), agent.end == "collision", True, agent.info(self._seed))

    def _nothing(self, why: EndReason) -> Told:
        """Return what is told to one that has not driven."""
        info = {"action_mask": np.array(KEEP_ALONE, np.int8), "end_reason": why, "is_success": False}
        return Told(np.zeros(self._all.observation_spaces[self.possible_agents[0]].shape), 0.0, False, True, info)

    def _tell(self, before: Sequence[str], told: dict[str, Told]) -> dict[str, Told]:
        """Return what all are told who decided before or will next, in the agents' order."""
        for name, ride in self._live.items():
            agent = ride.agent
            reward = agent.earned() if name in before else 0.0
            told[name] = Told(agent.observation, reward, False, False, agent.info(self._seed))
        for name, last in self._over.items():  # over since they became agents; they are told so at the next step
            info = {"action_mask": np.array(KEEP_ALONE, np.int8)}
            told[name] = Told(last.observation, 0.0, False, False, info)
        self.agents = [name for name in self.possible_agents if name in self._live or name in self._over]
        return {name: told[name] for name in self.possible_agents if name in told}

    def agent(self, name: str) -> Agent:
        """Return an agent that is on the road: its vehicle, its true neighbours, its trajectory so far.

        Raises:
            KeyError: it is not on the road.
        """
        return self._live[name].agent

    def __del__(self) -> None:
        with suppress(Exception):  # while the interpreter shuts down nothing is certain
            self.close()

    def close(self) -> None:
        """Free the process's simulation; harmless when none is open."""
        self.agents, self._live = [], {}
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None


def _with_demand(config: Config) -> Config:
    """Return the world with a demand that hosts may be the cars of.

    Raises:
        InputError: there is none, a host is named or added, or worlds vary.
    """
    traffic, file = config.traffic, config.network.file
    if config.varied.networks:
        raise InputError("several hosts are cars of one demand; leave out varied.networks")
    if not entry.is_drawn(config):
        raise InputError(
            f"several hosts are the demand's first cars; leave out traffic.host, which is '{traffic.host}'"
        )
    if traffic.routes or traffic.additional:
        return config
    assets.network(file)  # or it is not there at all
    if file not in assets.routes_names():
        raise InputError(
            f"several hosts are cars of a demand, and network '{file}' has none; name its files in traffic.routes"
        )
    return config.changed(traffic={"routes": (file,)})
