"""Films an episode: all vehicles after every step, the rays of the host, and how each decision was carried out."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from rail_sumo.film import Decision, Driven, Film, Ground, Holding, Mark, MarkKind, Stays, Vehicle
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.vehicle import hard_braking
from rail_sumo.highway.vehicle.adas import slowed_for
from rail_sumo.highway.vehicle.lane_ends import LEFT
from rail_sumo.records import SECONDS_PER_STEP, Floats, MetaAction, Trajectory

SEES_M = 250.0
"""Vehicles within this distance of the host, along either axis, are on the film; and whatever its rays may reach."""
SLACK_MPS = 0.05
"""Speeds that differ by less are taken for the same."""
TOO_CLOSE_S, TOO_CLOSE_M = 2.0, 5.0
"""SUMO brakes for the vehicle ahead, and not for who comes first at a junction, where it is no farther than this."""

HOLDINGS: tuple[Holding, ...] = get_args(Holding)
SIDEWAYS = (MetaAction.LEFT, MetaAction.RIGHT)
SPEEDS = (MetaAction.ACCELERATE, MetaAction.DECELERATE)


class Camera:
    """Films the present episode of an environment, from now on.

    Drive by `drive` instead of the environment's own; what is driven stays the same.

    Args:
        env: the environment, just after its `reset`.
        probabilities: returns how probable each meta-action is to the driver, from what it observes and which are open.
    """

    def __init__(self, env: HighwayEnv, probabilities: Callable[[Floats, list[bool]], Sequence[float]]) -> None:
        self._env = env
        self.network = env.world.network.file
        """The network that is driven on, which may vary from episode to episode."""
        self._agent = env.agent
        self._probabilities = probabilities
        self._sees_m = max(SEES_M, env.stretch.sees_m)
        self._vehicles: list[Vehicle] = []
        self._numbers: dict[str, int] = {}  # their places in that list, by id
        # For each frame: the vehicles' numbers, and their x, y, headings and speeds, shape (4, n).
        self._rows: list[tuple[Floats, Floats]] = []
        self._rays: list[Floats] = []
        self._set_mps: list[float] = []
        self._gap_m: list[float] = []
        self._holding: list[int] = []
        self._signals: dict[str, list[tuple[int, str]]] = {}  # by light: when it changed, and what it showed then
        self._marks: list[Mark] = []
        self._decisions: list[Decision] = []
        self._asked = MetaAction.KEEP
        self._changes = self._reverses = False
        self._aborted = 0
        self._contacts = (0, 0)
        self._start_s = env.scene.time_s - SECONDS_PER_STEP  # by which SUMO's outputs call what is there now
        env.watch(self._shoot)

    @property
    def _now(self) -> int:
        return len(self._rows) - 1

    def drive(self, action: int) -> Floats:
        """Take one decision and drive until the next falls due; returns the next observation."""
        agent, frame, is_open = self._agent, self._now, list(self._agent.mask)
        self._asked = MetaAction(action)
        probabilities = tuple(self._probabilities(agent.observation, is_open))
        counts = agent.overtakes, agent.overtaken, agent.refused_decisions
        limit_mps = agent.state.limit_mps
        before_mps = agent.adas.set_mps(limit_mps)
        observation, _ = self._env.drive(action)
        assert agent.decided is not None  # just now
        stays: Stays = self._stays(before_mps, limit_mps) if self._asked in SPEEDS else ""
        self._decisions.append(
            Decision(frame, *agent.decided, agent.adas.why, tuple(is_open), probabilities, stays=stays)
        )
        if agent.refused_decisions > counts[2]:
            self._marks.append(Mark(frame, "refused", agent.adas.why))
        passed: tuple[tuple[MarkKind, int], ...] = (
            ("overtake", agent.overtakes - counts[0]),
            ("overtaken", agent.overtaken - counts[1]),
        )
        for kind, number in passed:
            if number:
                self._marks.append(Mark(self._now, kind, str(number) if number > 1 else ""))
        return observation

    def _stays(self, before_mps: float, limit_mps: float) -> Stays:
        """Return where the set speed stayed, if the last decision left it where it was, by the limit at that time."""
        adas, set_mps = self._env.world.adas, self._agent.adas.set_mps(limit_mps)
        if set_mps != before_mps:
            return ""
        if set_mps >= adas.held_mps(math.inf, limit_mps):
            return "highest"
        return "lowest" if set_mps <= adas.held_mps(-math.inf, limit_mps) else "same"

    def _shoot(self, simulation: Simulation) -> None:
        agent = self._agent
        sign = -1.0 if agent.stretch.road.is_left_hand else 1.0  # a scene is told in the mirror there
        scene = simulation.scene(agent.host, sees_m=self._sees_m)
        numbers = [
            self._number(simulation, name, scene.length_m[k], scene.width_m[k]) for k, name in enumerate(scene.ids)
        ]
        mirrored = np.array([1.0, sign, sign, 1.0])[:, None]
        self._rows.append((np.array(numbers), scene.boxes[:4] * mirrored))
        rays_m = agent.lidar.scan(scene)[0]
        self._rays.append(rays_m if sign > 0 else np.roll(rays_m[::-1], 1))
        for light, shown in simulation.signals().items():
            changes = self._signals.setdefault(light, [])
            if not changes or changes[-1][1] != shown:
                changes.append((self._now, shown))
        self._set_mps.append(agent.adas.set_mps(agent.state.limit_mps))
        self._holding.append(HOLDINGS.index(self._holds()))
        self._gap_m.append(agent.host.gap_m)
        self._mark()

    def _number(self, simulation: Simulation, name: str, length_m: float, width_m: float) -> int:
        if name not in self._numbers:
            self._numbers[name] = len(self._vehicles)
            self._vehicles.append(Vehicle(name, simulation.class_of(name), float(length_m), float(width_m)))
        return self._numbers[name]

    def _holds(self) -> Holding:
        """Return what the host's speed has followed in the last step."""
        agent = self._agent
        host, state, set_mps = agent.host, agent.state, self._set_mps[-1]
        if not agent.is_driven_by_us:
            return "SUMO"
        steadily: Holding = "limit" if set_mps >= state.limit_mps else "set speed"
        ceiling_mps = host.abilities.ceiling_mps
        if host.speeds_mps[-1] > ceiling_mps - SLACK_MPS and set_mps > ceiling_mps:
            steadily = "top speed"
        if len(host.speeds_mps) < 2:
            return steadily
        adas = self._env.world.adas
        before_mps, now_mps = host.speeds_mps[-2:]
        gap_m = self._gap_m[-1]  # before that step
        commanded_mps, told_mps = host.told_mps
        waits: Holding = "signal" if host.junctions.waits_for_signal else "right of way"
        reachable_mps = min(told_mps, ceiling_mps, before_mps + adas.acceleration_mps2 * SECONDS_PER_STEP)
        if now_mps < reachable_mps - SLACK_MPS:
            return "emergency" if gap_m < TOO_CLOSE_S * before_mps + TOO_CLOSE_M else waits
        if told_mps < commanded_mps:
            if host.makes_room:
                return "vehicle across"
            if host.lets_in:
                return "vehicle joining"
            return waits if math.isnan(gap_m) else "vehicle ahead"
        meant_mps = max(set_mps, before_mps - adas.comfort_braking_mps2 * SECONDS_PER_STEP)
        if commanded_mps < meant_mps - SLACK_MPS:
            if agent.adas.falls_in:
                return "gap beside"
            why = slowed_for(state, adas, meant_mps)
            if why == "limit":
                return "limit ahead" if commanded_mps < state.limit_mps - SLACK_MPS else "limit"
            return waits if why == "stop" else why
        return steadily

    def _mark(self) -> None:
        agent, now = self._agent, self._now
        changes, reverses = agent.is_changing_lane, agent.adas.is_reversing
        if changes and not self._changes:
            is_own = self._asked in SIDEWAYS and not agent.adas.why  # else the layer leaves a lane that ends
            side = agent.adas.side
            text = "" if side is None else "to the left" if side == LEFT else "to the right"
            self._marks.append(Mark(now, "lane change" if is_own or side is None else "lane end", text))
        ended_as_it_began = agent.adas.aborted_lane_changes > self._aborted and not self._reverses
        if (reverses and not self._reverses) or ended_as_it_began:
            self._marks.append(Mark(now, "reversed"))
        self._changes, self._reverses, self._aborted = changes, reverses, agent.adas.aborted_lane_changes
        contacts = agent.host.collisions, agent.host.struck
        if contacts[0] > self._contacts[0]:
            self._marks.append(Mark(now, "collision"))
        if contacts[1] > self._contacts[1]:
            self._marks.append(Mark(now, "struck"))
        self._contacts = contacts

    @property
    def places(self) -> Floats:
        """Where vehicles have been filmed, shape (2, n): x and y, in the network's coordinates."""
        return np.concatenate([boxes[:2] for _, boxes in self._rows], axis=1)

    def film(self, name: str, trajectory: Trajectory, below: Ground, judged: Sequence[float] = ()) -> Film:
        """Return what has been filmed.

        Args:
            name: who drives.
            trajectory: the episode.
            below: the ground, whose signals are on the film.
            judged: a judge's score of each decision, if there is one.
        """
        numbers, boxes = zip(*self._rows, strict=True)
        x_m, y_m, heading_rad, speed_mps = np.concatenate(boxes, axis=1)
        return Film(
            name=name,
            start_s=self._start_s,
            step_s=SECONDS_PER_STEP,
            n_frames=len(self._rows),
            vehicles=tuple(self._vehicles),
            frame=np.repeat(np.arange(len(numbers), dtype=np.int32), [len(one) for one in numbers]),
            vehicle=np.concatenate(numbers).astype(np.int32),
            x_m=x_m,
            y_m=y_m,
            heading_rad=heading_rad,
            speed_mps=speed_mps,
            signals=tuple(self._shown_by(line.light, line.index) for line in below.stop_lines),
            driven=self._driven(trajectory, judged),
        )

    def _shown_by(self, light: str, index: int) -> tuple[tuple[int, str], ...]:
        """Return the frames in which a signal changed, and its letter from then on."""
        letters = [(frame, shown[index]) for frame, shown in self._signals[light]]
        return tuple(
            (frame, letter) for k, (frame, letter) in enumerate(letters) if k == 0 or letter != letters[k - 1][1]
        )

    def _driven(self, trajectory: Trajectory, judged: Sequence[float]) -> Driven:
        limit_mps = trajectory.limit_mps
        hard = [Mark(k, "hard braking") for k in np.flatnonzero(hard_braking.starts(trajectory.speed_mps)).tolist()]
        decisions = self._decisions if self._agent.is_driven_by_us else []
        if len(judged):
            decisions = [replace(one, judged=float(score)) for one, score in zip(decisions, judged, strict=True)]
        return Driven(
            vehicle=0,
            ray_m=np.array(self._rays),
            range_m=self._agent.lidar.max_range_m,
            set_mps=np.array(self._set_mps),
            limit_mps=np.concatenate((limit_mps[:1], limit_mps)),
            gap_m=np.array(self._gap_m),
            holding=np.array(self._holding, dtype=np.int8),
            decisions=tuple(decisions),
            marks=tuple(sorted([*self._marks, *hard], key=lambda mark: mark.frame)),
            end_reason=trajectory.end_reason or "",
        )
