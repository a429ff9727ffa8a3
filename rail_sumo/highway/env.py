"""The Gymnasium environment: how an episode begins, goes on and ends."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rail_sumo import assets
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway import rendering, sumo_process, varied
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.observation import bounds
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.traffic import entry
from rail_sumo.highway.traffic.companions import Companions
from rail_sumo.highway.traffic.moving_window import MovingWindow
from rail_sumo.highway.traffic.rides import Decide, keep_to_way
from rail_sumo.highway.vehicle import lane_ends
from rail_sumo.records import SECONDS_PER_STEP, Floats, Gaps, HostState, MetaAction, Scene, Trajectory

DEMAND_START_M = 10.0
"""Place on the course where the host enters the user's own traffic."""


class HighwayEnv(gymnasium.Env[Floats, np.int64]):
    """One host vehicle on a highway; a step is one decision of its supervisor.

    Observation: the LIDAR scan, named by `highway.observation.feature_names`. Actions: `MetaAction`. Reward:
    `highway.reward`. Terminates on a collision of the host, truncates at the end of the course, the duration or the
    road. libsumo holds one simulation a process, so an instance takes it over at `reset` and frees it at `close`.

    Args:
        config: the world; the default one without it.
        hands_off: leave the host to SUMO's own driver and ignore the actions; with the id of one of the demand's
            vehicle types, as a vehicle of that type.
        outputs: further options of SUMO's, such as those of its own reports, which are whole once an episode is closed.
        render_mode: "rgb_array": `render` returns the road around the host from above, at its last decision; "human":
            every decision is shown so in a window. Needs the extra `render`.
        companions: returns what decides for one of the `traffic.driven` vehicles around the host, by its id.

    Raises:
        InputError: a world that cannot be driven, nobody decides for `traffic.driven`, another render mode, or what it
            needs is not installed.
    """

    metadata = rendering.metadata_of(Config())
    _simulation: Simulation | None = None

    def __init__(
        self,
        config: Config | None = None,
        *,
        hands_off: bool | str = False,
        outputs: Sequence[str] = (),
        render_mode: str | None = None,
        companions: Callable[[str], Decide] | None = None,
    ) -> None:
        self.config = config or Config()
        self._decider_of = companions
        self.companions: Companions | None = None
        """The driven vehicles around the host; None while there are none."""
        self.render_mode = render_mode
        self._renderer = rendering.Renderer(self.config, render_mode)
        self.metadata = rendering.metadata_of(self.config)
        self._hands_off = hands_off
        self._outputs = outputs
        self._settle(varied.draw(self.config, 0))
        if self.config.traffic.driven and companions is None:
            raise InputError(
                f"traffic.driven is {self.config.traffic.driven}, and nobody decides for these vehicles; give the "
                "environment `companions`, which returns what decides for one of them, or set traffic.driven to 0"
            )
        self.observation_space = spaces.Box(*bounds(self.config.lidar, self.config.observation), dtype=np.float64)
        self.action_space = spaces.Discrete(len(MetaAction))
        self._agent: Agent | None = None

    def _settle(self, world: Config) -> None:
        """Read what a world consists of."""
        self.world = world
        """The world of the present episode, in which nothing varies."""
        self.demand = demand.read(world.traffic)
        """The user's own; see `Demand.has_traffic`."""
        self.is_one_of_the_demand = self.demand.has_traffic and world.traffic.host != "added"
        """Whether the host is a vehicle of the demand."""
        if self.is_one_of_the_demand and not entry.is_drawn(world):
            demand.require_vehicle(self.demand, world.traffic.host)
        if isinstance(self._hands_off, str):
            demand.require_type(self.demand, self._hands_off)
        self._net_file = assets.network(world.network.file)
        if not self.is_one_of_the_demand:
            course = road.load(world.network.file, world.network.course, limit_factor=world.network.limit_factor)
            self.stretch = (
                Stretch.along(course, world, DEMAND_START_M)
                if self.demand.has_traffic
                else Stretch.in_window(course, world)
            )
            """What the host drives at first; where it replaces a car, known from `reset` on."""

    @sumo_process.as_input_errors
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; the same seed gives the same traffic."""
        super().reset(seed=seed)
        self._free()
        self._seed = int(self.np_random.integers(2**31)) if seed is None else seed
        if self.config.varied.networks:
            self._settle(varied.draw(self.config, self._seed))
            self._renderer.forget()  # its colours are for the limits of one network
        try:
            self._open(np.random.default_rng(self._seed), self._outputs_of_host())
        except BaseException:
            self.close()  # or no other environment could begin in this process
            raise
        observation = self._look(0)
        self._renderer.show(self.agent)
        return observation, self.agent.info(self._seed)

    def _outputs_of_host(self) -> Sequence[str]:
        """Return SUMO's options for outputs, which name the host: of a car yet to be drawn it is drawn once before."""
        if not self._outputs or not self.is_one_of_the_demand:
            return self._outputs
        self._open(np.random.default_rng(self._seed), ())
        assert self._simulation is not None
        name = self._simulation.host.name
        self._free()
        return [name if word == HOST else word for word in self._outputs]

    def _open(self, rng: np.random.Generator, outputs: Sequence[str]) -> None:
        """Put the host and its traffic on the road."""
        traffic, adas = self.world.traffic, self.world.adas
        self._traffic: MovingWindow | None = None
        self.companions = None
        if self.is_one_of_the_demand:
            simulation = self._take_over(rng, outputs)
        else:
            simulation = self._simulate(outputs)
            self._add_host(simulation, rng)
            simulation.wait_for_host()
        self._agent = Agent(
            simulation.host,
            self.stretch,
            self.world,
            hands_off=self._hands_off,
            enters_as_traffic=self.demand.has_traffic and adas.starts_by_the_limit,
            in_demand=self.demand.has_traffic,
        )
        if self._traffic is not None and self._decider_of is not None and traffic.driven:
            self.companions = Companions(
                simulation, self._traffic, self.stretch, self.world, self._decider_of, hands_off=self._hands_off
            )

    def _simulate(self, outputs: Sequence[str]) -> Simulation:
        self._simulation = Simulation(
            self._net_file,
            demand=self.demand,
            begin_s=self.world.traffic.begin_s,
            seed=self._seed,
            outputs=outputs,
            limit_factor=self.world.network.limit_factor,
        )
        return self._simulation

    def _take_over(self, rng: np.random.Generator, outputs: Sequence[str]) -> Simulation:
        """Make a car of the demand the host; the demand begins anew for each search after the first."""
        first: entry.Nobody | None = None
        for search in entry.searches(self.world, self.demand, rng):
            self._free()
            simulation = self._simulate(outputs)
            try:
                self.stretch = entry.take_over(simulation, self.world, self.demand, search)
            except entry.Nobody as nobody:
                first = first or nobody
            else:
                return simulation
        assert first is not None
        raise first

    def _add_host(self, simulation: Simulation, rng: np.random.Generator) -> None:
        """Add a host of ours to the demand, or to a window of traffic that is made for it."""
        traffic, adas, stretch = self.world.traffic, self.world.adas, self.stretch
        place = stretch.road.place(stretch.start_m)
        assert place is not None  # or nothing were drivable
        simulation.lay_course(stretch.road, adas, sees_m=stretch.sees_m, shares_type=traffic.driven > 0)
        edge = stretch.road.edges[place[0]]
        lanes = lane_ends.leading_on(edge.ends_in_m(place[1]), edge.limit_mps)
        lane = lanes[int(rng.integers(len(lanes)))]
        has_traffic = self.demand.has_traffic
        if has_traffic:
            simulation.run_without_host(traffic.warm_up_s)
            if not simulation.on_road():
                first_s, last_s = self.demand.departs_s
                raise InputError(
                    f"no vehicle of the demand is on the road at {traffic.begin_s + traffic.warm_up_s:.0f} s; its "
                    f"vehicles depart from {first_s:.0f} to {last_s:.0f} s: set traffic.begin_s to a time with "
                    f"traffic, or lengthen traffic.warm_up_s"
                )
        simulation.add_host(
            stretch.road.laps(place[0], place[1] + stretch.farthest_m),
            lane=lane,
            front_m=place[1],
            speed_mps=adas.clipped_mps(adas.start_mps(edge.limit_mps), edge.limit_mps),
            fastest_mps=edge.enters_mps(lane, place[1], adas.comfort_braking_mps2),
            as_traffic=has_traffic and adas.starts_by_the_limit,
        )
        if not has_traffic:
            self._traffic = MovingWindow(
                simulation,
                stretch.road,
                traffic,
                host_s_m=stretch.start_m,
                host_lane=lane,
                farthest_m=stretch.farthest_m,
                rng=rng,
            )

    def step(self, action: int | np.int64) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Take one decision and drive until the next falls due.

        `info` holds the `action_mask` (see `action_masks`, int8), and which meta-action was `carried_out`: 0, to keep,
        where the one that was asked for was not. At the end of an episode it also holds what it came to, by the names
        of the `episodes` table, and `is_success`: whether it ended without a contact. Its whole course is `trajectory`.
        """
        observation, _ = self.drive(action)
        agent = self.agent
        self._renderer.show(agent)
        crashed = agent.end == "collision"
        return observation, agent.earned(), crashed, self.is_over and not crashed, agent.info(self._seed)

    @sumo_process.as_input_errors
    def drive(self, action: int | np.int64) -> tuple[Floats, int]:
        """Take one decision and drive until the next falls due; returns the next observation and the steps driven.

        Raises:
            ValueError: no such action.
            InputError: SUMO gives up, for example at a vehicle of the user's demand that cannot drive its route.
        """
        simulation, agent = self._under_way(), self.agent
        before, step = agent.n_steps, self.companions.step if self.companions else None
        agent.decide(MetaAction.of(action))
        while True:
            agent.note(simulation.run(agent.command(), step))
            if simulation.has_arrived and agent.arrive():
                return agent.observation, agent.n_steps - before
            keep_to_way(agent, simulation, self.world)
            if agent.is_due:
                break
        driven = agent.n_steps - before
        return self._look(driven), driven

    def _under_way(self) -> Simulation:
        if self.is_over:
            raise RuntimeError("the episode is over; call reset()")
        if self._simulation is None:
            raise RuntimeError("no episode has begun, or the environment was closed; call reset()")
        return self._simulation

    def _look(self, driven: int) -> Floats:
        """Sense, check whether the episode is over, and replace vehicles that left the window."""
        assert self._simulation is not None
        observation = self.agent.look(self._simulation.scene())
        traffic = self.companions or self._traffic
        if traffic is not None:
            changing_lane = [self.host_name] if self.agent.is_changing_lane else []
            traffic.update(elapsed_s=driven * SECONDS_PER_STEP, changing_lane=changing_lane)
        return observation

    @property
    def agent(self) -> Agent:
        """The host, as it is driven."""
        assert self._agent is not None  # from the first reset on
        return self._agent

    def watch(self, look: Callable[["Simulation"], None]) -> None:
        """Call something now and after every step of the present episode, to look and change nothing."""
        simulation = self._under_way()
        simulation.watch = partial(look, simulation)
        look(simulation)

    @property
    def host_name(self) -> str:
        """The id of the host's vehicle in SUMO."""
        return self._simulation.host.name if self._simulation else HOST

    @property
    def n_signals_ahead(self) -> int:
        """How many traffic lights are on the host's way."""
        return self.agent.host.n_signals_ahead

    @property
    def scene(self) -> Scene:
        """The host and the vehicles around it at the last decision."""
        return self.agent.scene

    @property
    def is_over(self) -> bool:
        """Whether the episode has ended."""
        return self._agent is not None and self._agent.end is not None

    @property
    def is_alone(self) -> bool:
        """Whether nobody else on the road drives along the host's course, now or later on its way."""
        host = self.agent.host
        return not any(map(host.heads_for_course, self._under_way().on_road() - {host.name}))

    @property
    def n_waiting(self) -> int:
        """How many vehicles are due to depart, and find no room yet."""
        return self._under_way().n_waiting

    def routes_m(self) -> list[float]:
        """Return how long each of the routes is that anybody drives now."""
        return self._under_way().routes_m()

    def long_reds(self) -> dict[str, tuple[float, list[str]]]:
        """Return for which traffic lights somebody waits for very long, how long, and on which edges."""
        return self._under_way().long_reds()

    @property
    def flows_vehph(self) -> dict[str, float]:
        """The flow on every edge of the course now, see `Host.flows_vehph`."""
        return self.agent.host.flows_vehph()

    @property
    def is_changing_lane(self) -> bool:
        """Whether a lane change is under way."""
        return self.agent.is_changing_lane

    def action_masks(self) -> list[bool]:
        """Return for each meta-action whether a masked policy may choose it now, see `Adas.allowed`.

        The trajectory notes that the supervisor was told.
        """
        return self.agent.action_masks()

    def surroundings(self) -> tuple[HostState, Gaps, Gaps, Gaps]:
        """Return the host's state and the true gaps in its own lane, to its left and to its right."""
        return self.agent.surroundings()

    def trajectory(self) -> Trajectory:
        """Return the episode so far."""
        return self.agent.trajectory(self._seed)

    def render(self) -> NDArray[np.uint8] | None:
        """Return the road around the host at its last decision, shape (384, 960, 3), in the mode "rgb_array".

        In the mode "human" the window has it already. In no mode there is nothing to show; gymnasium warns.

        Raises:
            RuntimeError: no episode has begun.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() shows nothing without a render_mode; make the environment with one")
        return self._renderer.frame(self._agent) if self.render_mode == "rgb_array" else None

    def __del__(self) -> None:
        with suppress(Exception):  # while the interpreter shuts down nothing is certain
            self.close()

    def close(self) -> None:
        """Free the process's simulation, and close the window; harmless when neither is open."""
        self._free()
        self._renderer.close()

    def _free(self) -> None:
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None
