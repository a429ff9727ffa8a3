"""One driven vehicle: its scan, its assistance layer, its counts and its trajectory."""

import math
import sys
from dataclasses import replace
from functools import lru_cache
from statistics import fmean
from typing import Any

import numpy as np

from rail_sumo.config import Config
from rail_sumo.config import Lidar as LidarConfig
from rail_sumo.highway import metrics
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.observation import Layout
from rail_sumo.highway.reward import reward
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.vehicle.adas import Adas, HandsOff
from rail_sumo.highway.vehicle.host import Host
from rail_sumo.highway.vehicle.lidar import Lidar
from rail_sumo.highway.vehicle.passing import PassCounter
from rail_sumo.records import (
    SECONDS_PER_STEP,
    Command,
    EndReason,
    Floats,
    Gaps,
    HostState,
    MetaAction,
    Scene,
    Trajectory,
)

CRAWL_MPS = 0.1
STANDSTILL_STEPS = 3000
"""A host that stands, and has driven less than 30 m in so many steps (five minutes), ends its episode. SUMO teleports
those who stand in the way for so long, so that in a jam it might creep on for hours."""
ALL_ALLOWED = [True] * len(MetaAction)
KEEP_ALONE = [action is MetaAction.KEEP for action in MetaAction]
"""What is allowed to a vehicle that is not on the road."""


class Agent:
    """Drives one vehicle that is on the road, decision by decision, and keeps account of it.

    Between two looks: `decide`, then `command` and `note` until `is_due`.

    Args:
        host: its vehicle in SUMO.
        stretch: what it drives, from where to where.
        world: how it senses, how it drives, when its episode ends.
        hands_off: leave it to SUMO's own driver; see `HighwayEnv`.
        enters_as_traffic: whether its first set speed is no lower than the speed that it has entered with.
        in_demand: whether it drives in a demand, and not in made traffic.
        keeps_trajectory: whether its observations, decisions and steps are kept for `earned` and `trajectory`.
    """

    def __init__(
        self,
        host: Host,
        stretch: Stretch,
        world: Config,
        *,
        hands_off: bool | str = False,
        enters_as_traffic: bool = False,
        in_demand: bool = False,
        keeps_trajectory: bool = True,
    ) -> None:
        self.host = host
        self.stretch = stretch
        self._world = world
        self._keeps_trajectory = keeps_trajectory
        self.n_steps = 0
        """How many SUMO steps it has driven."""
        self.adas: Adas | HandsOff
        if hands_off:
            kind = hands_off if isinstance(hands_off, str) else None
            self.adas = HandsOff(world.adas, keeps_limits=kind is None)
            host.hand_over(kind)
        else:
            start_mps = self._start_mps(enters_as_traffic=enters_as_traffic)
            self.adas = Adas(
                world.adas,
                start_mps=start_mps,
                settle_s=world.adas.settles_s(in_demand=in_demand),
                gain_s=world.adas.gains_within_s(in_demand=in_demand),
            )
        self.lidar = _lidar(world.lidar, stretch.road)
        self._layout = Layout(world.lidar, world.observation)
        self._passes = PassCounter(stretch.near_m)
        self._period_steps = round(world.episode.decision_period_s / SECONDS_PER_STEP)
        duration_steps = world.episode.duration_s / SECONDS_PER_STEP
        self._duration_steps = sys.maxsize if math.isinf(duration_steps) else math.ceil(duration_steps - 1e-6)
        self._state: HostState | None = None  # as it is now, once somebody has asked
        self._mask: list[bool] | None = None  # likewise
        self._gaps: dict[int, Gaps] = {}  # likewise, by side
        self._is_told = False
        self._left = 0  # steps until the next decision
        self._was_changing = False
        self.end: EndReason | None = None
        """Why its episode is over; None while it is under way."""
        self.observation: Floats = np.empty(0)
        """What it saw at the last look."""
        self.scene: Scene
        """Itself and the vehicles around it at the last look."""
        self.decided: tuple[MetaAction, MetaAction] | None = None
        """Its last decision, and what of it was carried out; None before the first."""
        self.overtakes = self.overtaken = 0
        self._travelled_m = 0.0  # at the last look, ...
        self._n_looked_back = 1  # ... when the host had noted so many speeds
        self._at_decision = (0, 0, 0, 0)  # steps, overtakes, overtaken and refused decisions when it last decided
        self._observations: list[Floats] = []
        self._decisions: list[int] = []
        self._carried_out: list[int] = []
        self._allowed: list[list[bool]] = []
        self._decision_step: list[int] = []
        self._decision_place: list[tuple[float, float, float]] = []
        self._lane_changing: list[bool] = []
        self._limits_mps: list[float] = []

    def _start_mps(self, *, enters_as_traffic: bool) -> float:
        adas, place = self._world.adas, self.stretch.road.place(self.stretch.start_m)
        assert place is not None  # or nothing were drivable
        limit_mps = self.stretch.road.edges[place[0]].limit_mps
        start_mps = adas.clipped_mps(adas.start_mps(limit_mps), limit_mps)
        return max(start_mps, self.host.speeds_mps[0]) if enters_as_traffic else start_mps

    def follow(self, stretch: Stretch) -> None:
        """Drive another course from where it is; its set speed and a lane change under way are kept.

        Args:
            stretch: the course, from the place where its vehicle is now.
        """
        self.stretch = replace(stretch, start_m=stretch.start_m - self.host.travelled_m)  # as if it had come from there
        self.host.follow(stretch.road)
        self.lidar = _lidar(self._world.lidar, stretch.road)
        self._state = self._mask = self.end = None
        self._gaps = {}

    # Between two decisions.

    def look(self, scene: Scene) -> Floats:
        """Sense, count who was passed, and notice whether the episode is over; returns the observation."""
        overtakes, overtaken = self._passes.update(scene, self.host.is_on_course)
        self.overtakes += overtakes
        self.overtaken += overtaken
        self.scene = scene
        self._travelled_m = self.host.travelled_m
        self._n_looked_back = len(self.host.speeds_mps)
        self.end = self._why_over()
        self.host.heed()
        self.observation = self._layout.observe(
            self.lidar.scan(scene),
            speed_mps=scene.speed_mps[0],
            limit_mps=self.host.limit_mps if self._world.observation.speed_limit else math.inf,
            lateral_m=self.adas.lateral_m,
        )
        return self.observation

    def _why_over(self) -> EndReason | None:
        if self.host.contact:
            return "collision"
        if self._travelled_m >= self._world.episode.course_m:
            return "course"
        if self.n_steps >= self._duration_steps:
            return "duration"
        if self._travelled_m >= self.stretch.drivable_m:
            return "end of road"
        speeds = self.host.speeds_mps
        crawls = speeds[-1] < CRAWL_MPS and len(speeds) >= STANDSTILL_STEPS
        return "standstill" if crawls and fmean(speeds[-STANDSTILL_STEPS:]) < CRAWL_MPS else None

    def action_masks(self) -> list[bool]:
        """Return for each meta-action whether a masked policy may choose it now; see `HighwayEnv.action_masks`."""
        self._is_told = True
        return list(self.mask)

    @property
    def mask(self) -> list[bool]:
        """For each meta-action whether the assistance layer would carry it out now; asking is not noted."""
        if self._mask is None:
            self._mask = self.adas.allowed(self.state, self.gaps)
        return self._mask

    @property
    def state(self) -> HostState:
        """Where it stands on its lane now."""
        if self._state is None:
            self._state = self.host.state()
        return self._state

    def surroundings(self) -> tuple[HostState, Gaps, Gaps, Gaps]:
        """Return its state and the true gaps in its own lane, to its left and to its right."""
        return self.state, self.gaps(0), self.gaps(1), self.gaps(-1)

    def gaps(self, side: int) -> Gaps:
        """Return the true gaps in its own lane (0) or the one to its left (+1) or right (-1) now."""
        if side not in self._gaps:
            self._gaps[side] = self.host.gaps(side)
        return self._gaps[side]

    def decide(self, action: MetaAction) -> None:
        """Take a decision for the steps until the next falls due."""
        self._at_decision = (self.n_steps, self.overtakes, self.overtaken, self.refused_decisions)
        carried_out = self.adas.decide(action, self.state, self.gaps)
        self.decided = action, carried_out
        if self._keeps_trajectory:
            self._observations.append(self.observation)
            self._decisions.append(action)
            self._carried_out.append(carried_out)
            self._allowed.append(self.mask if self._is_told else ALL_ALLOWED)
            self._decision_step.append(self.n_steps)
            x_m, y_m = self.scene.boxes[:2, 0].tolist()
            self._decision_place.append((self._travelled_m, x_m, -y_m if self.stretch.road.is_left_hand else y_m))
        self._mask, self._is_told = None, False
        self.wait(self._period_steps)

    def wait(self, steps: int) -> None:
        """Let it drive on as it does for so many steps, or to the end of its duration, before it decides."""
        self._left = min(steps, self._duration_steps - self.n_steps)

    def forget_gaps(self) -> None:
        """Look at the gaps again when they are next asked for: another vehicle has claimed a lane meanwhile."""
        self._gaps = {}

    def leave(self) -> None:
        """End its episode as it was last seen: it has left the road, or what it could drive of it."""
        self._end_unseen("left the road")

    def arrive(self) -> bool:
        """End its episode as it was last seen, and return whether it was on the last edge of its course by then."""
        self._end_unseen("end of road")
        place = self.stretch.road.place(self.stretch.start_m + self._travelled_m)
        return place is None or place[0] == len(self.stretch.road.edges) - 1

    def _end_unseen(self, why: EndReason) -> None:
        self._travelled_m += SECONDS_PER_STEP * sum(self.host.speeds_mps[self._n_looked_back :])
        self._mask = KEEP_ALONE
        self.end = why

    def command(self) -> Command:
        """Return what to do next, for no more steps than there are until the next decision."""
        self._was_changing = self.adas.changing_lane
        command = self.adas.command(self.state, self.gaps, steps=self._left)
        self.host.claim(command.cross or self.adas.aim)
        return command

    def note(self, steps: int) -> None:
        """Note that the last command was carried out, for so many steps."""
        self._left -= steps
        self.n_steps += steps
        self.adas.note(steps)
        if self._keeps_trajectory:
            self._lane_changing += [self._was_changing] * steps
            self._limits_mps += [self.state.limit_mps] * steps
        self._state = self._mask = None
        self._gaps = {}

    @property
    def is_due(self) -> bool:
        """Whether the next decision falls due: by the clock, at the end of a lane change, or at a contact."""
        ended_change = self._was_changing and not self.adas.changing_lane
        return self.is_spent or ended_change

    @property
    def is_spent(self) -> bool:
        """Whether it has driven all the steps of its decision, or has had a contact."""
        return self._left <= 0 or self.host.contact

    # Counts, rewards, and the trajectory.

    @property
    def is_driven_by_us(self) -> bool:
        """Whether decisions count; else SUMO's own driver drives."""
        return isinstance(self.adas, Adas)

    @property
    def is_changing_lane(self) -> bool:
        """Whether a lane change is under way."""
        return self.adas.changing_lane

    @property
    def refused_decisions(self) -> int:
        """How many lane changes it decided for in vain; see `docs/measures.md`."""
        return self.adas.refused_decisions

    def _last(self, steps: int) -> tuple[Floats, Floats, Any]:
        """Return speeds, limits and whether a lane change was under way, for each of the last steps."""
        first = self.n_steps - steps
        return (
            np.array(self.host.speeds_mps[first + 1 : self.n_steps + 1]),
            np.array(self._limits_mps[first:]),
            np.array(self._lane_changing[first:], dtype=np.bool_),
        )

    def earned(self) -> float:
        """Return the reward for what it has driven since its last decision."""
        n_steps, overtakes, overtaken, refused_decisions = self._at_decision
        return reward(
            *self._last(self.n_steps - n_steps),
            self._world.adas,
            overtakes=self.overtakes - overtakes,
            overtaken=self.overtaken - overtaken,
            refused_decisions=self.refused_decisions - refused_decisions,
            collisions=int(self.end == "collision"),
        )

    def info(self, seed: int) -> dict[str, Any]:
        """Return its `action_mask`, what was `carried_out`, and when it is over what its episode came to.

        See `HighwayEnv.step`.
        """
        info: dict[str, Any] = {"action_mask": np.array(self.mask, np.int8)}
        if self.decided is not None:
            info["carried_out"] = int(self.decided[1])
        if self.end is not None:
            info |= metrics.row(self.trajectory(seed), self._world.adas)
            info["is_success"] = self.end != "collision"
        return info

    def trajectory(self, seed: int) -> Trajectory:
        """Return its episode up to the last look; `seed` is the traffic's."""
        host, adas = self.host, self.adas
        return Trajectory(
            observations=np.array(self._observations),
            decisions=np.array(self._decisions, dtype=np.int64),
            carried_out=np.array(self._carried_out, dtype=np.int64),
            allowed=np.array(self._allowed, dtype=np.bool_),
            decision_step=np.array(self._decision_step, dtype=np.int64),
            decision_place=np.array(self._decision_place),
            speed_mps=np.array(host.speeds_mps),
            distance_m=self._travelled_m,
            limit_mps=np.array(self._limits_mps),
            lane_changing=np.array(self._lane_changing, dtype=np.bool_),
            overtakes=self.overtakes,
            overtaken=self.overtaken,
            lane_changes=adas.lane_changes_by_now(host.sumos_lane_changes),
            aborted_lane_changes=adas.aborted_lane_changes,
            refused_decisions=adas.refused_decisions,
            collisions=host.collisions,
            struck=host.struck,
            hard_brakings_behind=host.hard_brakings_behind,
            min_ttc_s=host.min_ttc_s,
            end_reason=self.end,
            seed=seed,
            network=self.stretch.road.name,
            host=host.name,
            depart_s=host.depart_s,
        )


@lru_cache(maxsize=32)
def _lidar(settings: LidarConfig, course: Road) -> Lidar:
    """Return the LIDAR of a course: one for all episodes, since it remembers which road edges are near where."""
    return Lidar(settings.n_rays, settings.max_range_m, course.boundaries if settings.road_edges else None)
