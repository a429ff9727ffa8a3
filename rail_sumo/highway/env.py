"""The Gymnasium environment: how an episode begins, goes on and ends."""

import math
import sys
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from rail_sumo import assets
from rail_sumo.config import Config
from rail_sumo.config import Lidar as LidarConfig
from rail_sumo.errors import InputError
from rail_sumo.highway import entry, sumo_process, varied
from rail_sumo.highway.adas import Adas, HandsOff, lanes_leading_on
from rail_sumo.highway.lidar import Lidar
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.observation import Layout
from rail_sumo.highway.passing import PassCounter
from rail_sumo.highway.reward import reward
from rail_sumo.highway.simulation import HOST, Simulation
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.traffic import MovingWindow
from rail_sumo.records import SECONDS_PER_STEP, EndReason, Floats, Gaps, HostState, MetaAction, Scene, Trajectory

CRAWL_MPS = 0.1
STANDSTILL_STEPS = 3000
"""A host that has not moved for this many steps (five minutes) will not: the episode ends."""
ALL_ALLOWED = [True] * len(MetaAction)
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
    """

    metadata = {"render_modes": []}  # noqa: RUF012  gymnasium reads it from the class

    def __init__(
        self, config: Config | None = None, *, hands_off: bool | str = False, outputs: Sequence[str] = ()
    ) -> None:
        self.config = config or Config()
        self._hands_off = hands_off
        self._outputs = outputs
        self._settle(varied.draw(self.config, 0))
        self._layout = Layout(self.config.lidar, self.config.observation)
        self.observation_space = spaces.Box(*self._layout.bounds, dtype=np.float64)
        self.action_space = spaces.Discrete(len(MetaAction))
        self._period_steps = round(self.world.episode.decision_period_s / SECONDS_PER_STEP)
        duration_steps = self.world.episode.duration_s / SECONDS_PER_STEP
        self._duration_steps = sys.maxsize if math.isinf(duration_steps) else math.ceil(duration_steps - 1e-6)
        self._simulation: Simulation | None = None
        self._told: list[bool] | None = None
        self._end: EndReason | None = None

    def _settle(self, world: Config) -> None:
        """Read what a world consists of."""
        self.world = world
        """The world of the present episode, in which nothing varies."""
        self.demand = demand.read(world.traffic)
        """The user's own; see `Demand.has_traffic`."""
        self.is_one_of_the_demand = self.demand.has_traffic and world.traffic.host != "added"
        """Whether the host is a vehicle of the demand."""
        self._net_file = assets.network(world.network.file)
        if not self.is_one_of_the_demand:
            course = road.load(world.network.file, world.network.course, limit_factor=world.network.limit_factor)
            self.stretch = (
                Stretch.along(course, world, DEMAND_START_M)
                if self.demand.has_traffic
                else Stretch.in_window(course, world)
            )
            """What the host drives; where it replaces a car, known from `reset` on."""

    @sumo_process.as_input_errors
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; the same seed gives the same traffic."""
        super().reset(seed=seed)
        self.close()
        self._seed = int(self.np_random.integers(2**31)) if seed is None else seed
        if self.config.varied.networks:
            self._settle(varied.draw(self.config, self._seed))
        self._layout.reset()
        self._overtakes = self._overtaken = 0
        self._observations: list[Floats] = []
        self._decisions: list[int] = []
        self._carried_out: list[int] = []
        self._allowed: list[list[bool]] = []
        self._told = None
        self._lane_changing: list[bool] = []
        self._limits_mps: list[float] = []
        self._end = None
        try:
            self._open(np.random.default_rng(self._seed), self._outputs_of_host())
        except BaseException:
            self.close()  # or no other environment could begin in this process
            raise
        return self._look(0), {}

    def _outputs_of_host(self) -> Sequence[str]:
        """Return SUMO's options for outputs, which name the host: of a car yet to be drawn it is drawn once before."""
        if not self._outputs or not self.is_one_of_the_demand:
            return self._outputs
        self._open(np.random.default_rng(self._seed), ())
        assert self._simulation is not None
        name = self._simulation.host.name
        self.close()
        return [name if word == HOST else word for word in self._outputs]

    def _open(self, rng: np.random.Generator, outputs: Sequence[str]) -> None:
        """Put the host and its traffic on the road."""
        traffic, adas = self.world.traffic, self.world.adas
        simulation = self._simulation = Simulation(
            self._net_file,
            demand=self.demand,
            begin_s=traffic.begin_s,
            seed=self._seed,
            outputs=outputs,
            limit_factor=self.world.network.limit_factor,
        )
        self._window: MovingWindow | None = None
        if self.is_one_of_the_demand:
            self.stretch = entry.take_over(simulation, self.world, self.demand, rng)
        else:
            self._add_host(simulation, rng)
            simulation.wait_for_host()
        stretch = self.stretch
        self._lidar = _lidar(self.world.lidar, stretch.road)
        self._passes = PassCounter(stretch.near_m)
        if self._hands_off:
            kind = self._hands_off if isinstance(self._hands_off, str) else None
            self._adas: Adas | HandsOff = HandsOff(adas, keeps_limits=kind is None)
            simulation.host.hand_over(kind)
        else:
            place = stretch.road.place(stretch.start_m)
            assert place is not None  # or nothing were drivable
            limit_mps = stretch.road.edges[place[0]].limit_mps
            start_mps = adas.clipped_mps(adas.start_mps(limit_mps), limit_mps)
            enters_as_traffic = self.demand.has_traffic and adas.starts_by_the_limit
            self._adas = Adas(
                adas, start_mps=max(start_mps, simulation.host.speeds_mps[0]) if enters_as_traffic else start_mps
            )

    def _add_host(self, simulation: Simulation, rng: np.random.Generator) -> None:
        """Add a host of ours to the demand, or to a window of traffic that is made for it."""
        traffic, adas, stretch = self.world.traffic, self.world.adas, self.stretch
        place = stretch.road.place(stretch.start_m)
        assert place is not None  # or nothing were drivable
        simulation.lay_course(stretch.road, adas, sees_m=stretch.sees_m)
        edge = stretch.road.edges[place[0]]
        lanes = lanes_leading_on(edge.ends_in_m(place[1]))
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
            as_traffic=has_traffic and adas.starts_by_the_limit,
        )
        if not has_traffic:
            self._window = MovingWindow(
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

        At the end of an episode `info` holds its `end_reason` and its whole `trajectory` (`records.Trajectory`).
        """
        simulation = self._under_way()
        before = (self._overtakes, self._overtaken, self._adas.refused_decisions)
        observation, driven = self.drive(int(action))
        earned = reward(
            np.array(simulation.host.speeds_mps[-driven:]),
            np.array(self._limits_mps[-driven:]),
            np.array(self._lane_changing[-driven:]),
            self.world.adas,
            overtakes=self._overtakes - before[0],
            overtaken=self._overtaken - before[1],
            refused_decisions=self._adas.refused_decisions - before[2],
            collisions=int(self._end == "collision"),
        )
        crashed = self._end == "collision"
        info = {"end_reason": self._end, "trajectory": self.trajectory()} if self.is_over else {}
        return observation, earned, crashed, self.is_over and not crashed, info

    @sumo_process.as_input_errors
    def drive(self, action: int) -> tuple[Floats, int]:
        """Take one decision and drive until the next falls due; returns the next observation and the steps driven.

        Raises:
            ValueError: no such action.
            InputError: SUMO gives up, for example at a vehicle of the user's demand that cannot drive its route.
        """
        simulation, adas = self._under_way(), self._adas
        due = min(self._period_steps, self._duration_steps - len(self._lane_changing))
        decided = MetaAction(action)
        self._observations.append(self._observation)
        self._decisions.append(decided)
        host = simulation.host.state()
        self._carried_out.append(adas.decide(decided, host, simulation.host.gaps))
        self._allowed.append(self._told or ALL_ALLOWED)
        self._told = None
        driven = 0
        while True:
            was_changing = adas.changing_lane
            command = adas.command(host, simulation.host.gaps, steps=due - driven)
            steps = simulation.run(command)
            driven += steps
            self._lane_changing += [was_changing] * steps
            self._limits_mps += [host.limit_mps] * steps
            ended_change = was_changing and not adas.changing_lane
            if driven >= due or ended_change or simulation.host.contact:
                break
            host = simulation.host.state()
        return self._look(driven), driven

    def _under_way(self) -> Simulation:
        if self._simulation is None or self._end is not None:
            raise RuntimeError("the episode is over; call reset()")
        return self._simulation

    def _look(self, driven: int) -> Floats:
        """Sense, replace vehicles that left the window, and check whether the episode is over."""
        simulation, adas = self._simulation, self._adas
        assert simulation is not None
        scene = simulation.scene()
        overtakes, overtaken = self._passes.update(scene, simulation.is_on_course)
        self._overtakes += overtakes
        self._overtaken += overtaken
        self._scene = scene
        self._end = self._why_over()
        if self._window is not None:
            self._window.update(elapsed_s=driven * SECONDS_PER_STEP, host_changing_lane=adas.changing_lane)
        self._observation = self._layout.observe(
            self._lidar.scan(scene),
            speed_mps=scene.speed_mps[0],
            limit_mps=simulation.host.limit_mps if self.world.observation.speed_limit else math.inf,
            lateral_m=adas.lateral_m,
        )
        return self._observation

    def _why_over(self) -> EndReason | None:
        assert self._simulation is not None
        if self._simulation.host.contact:
            return "collision"
        travelled_m = self._simulation.travelled_m(self._simulation.host.name)
        if travelled_m >= self.world.episode.course_m:
            return "course"
        if len(self._lane_changing) >= self._duration_steps:
            return "duration"
        if travelled_m >= self.stretch.drivable_m:
            return "end of road"
        speeds = self._simulation.host.speeds_mps
        crawls = speeds[-1] < CRAWL_MPS and len(speeds) >= STANDSTILL_STEPS
        return "standstill" if crawls and max(speeds[-STANDSTILL_STEPS:]) < CRAWL_MPS else None

    @property
    def host_name(self) -> str:
        """The id of the host's vehicle in SUMO."""
        return self._simulation.host.name if self._simulation else HOST

    @property
    def n_signals_ahead(self) -> int:
        """How many traffic lights are on the host's way."""
        return self._under_way().host.n_signals_ahead

    @property
    def scene(self) -> Scene:
        """The host and the vehicles around it at the last decision."""
        return self._scene

    @property
    def is_over(self) -> bool:
        """Whether the episode has ended."""
        return self._end is not None

    @property
    def is_alone(self) -> bool:
        """Whether nobody else on the road drives along the host's course, now or later on its way."""
        simulation = self._under_way()
        return not any(map(simulation.heads_for_course, simulation.on_road() - {simulation.host.name}))

    @property
    def flows_vehph(self) -> dict[str, float]:
        """The flow on every edge of the course now, see `Simulation.flows_vehph`."""
        return self._under_way().flows_vehph()

    @property
    def is_changing_lane(self) -> bool:
        """Whether a lane change is under way."""
        return self._adas.changing_lane

    def action_masks(self) -> list[bool]:
        """Return for each meta-action whether a masked policy may choose it now, see `Adas.allowed`.

        The trajectory notes that the supervisor was told.
        """
        if self._told is None:
            assert self._simulation is not None
            host = self._simulation.host
            self._told = self._adas.allowed(host.state(), host.gaps)
        return list(self._told)

    def surroundings(self) -> tuple[HostState, Gaps, Gaps, Gaps]:
        """Return the host's state and the true gaps in its own lane, to its left and to its right."""
        assert self._simulation is not None
        gaps = self._simulation.host.gaps
        return self._simulation.host.state(), gaps(0), gaps(1), gaps(-1)

    def trajectory(self) -> Trajectory:
        """Return the episode so far."""
        assert self._simulation is not None
        return Trajectory(
            observations=np.array(self._observations),
            decisions=np.array(self._decisions, dtype=np.int64),
            carried_out=np.array(self._carried_out, dtype=np.int64),
            allowed=np.array(self._allowed, dtype=np.bool_),
            speed_mps=np.array(self._simulation.host.speeds_mps),
            distance_m=self._simulation.travelled_m(self._simulation.host.name),
            limit_mps=np.array(self._limits_mps),
            lane_changing=np.array(self._lane_changing, dtype=np.bool_),
            overtakes=self._overtakes,
            overtaken=self._overtaken,
            lane_changes=self._adas.lane_changes,
            aborted_lane_changes=self._adas.aborted_lane_changes,
            refused_decisions=self._adas.refused_decisions,
            collisions=self._simulation.host.collisions,
            struck=self._simulation.host.struck,
            hard_brakings_behind=self._simulation.host.hard_brakings_behind,
            min_ttc_s=self._simulation.host.min_ttc_s,
            end_reason=self._end,
            seed=self._seed,
            network=self.stretch.road.name,
        )

    def close(self) -> None:
        """Free the process's simulation; harmless when none is open."""
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None


@lru_cache(maxsize=32)
def _lidar(settings: LidarConfig, course: Road) -> Lidar:
    """Return the LIDAR of a course: one for all episodes, since it remembers which road edges are near where."""
    return Lidar(settings.n_rays, settings.max_range_m, course.boundaries if settings.road_edges else None)


gymnasium.register("RailSumo/Highway-v0", entry_point="rail_sumo.highway.env:HighwayEnv")
