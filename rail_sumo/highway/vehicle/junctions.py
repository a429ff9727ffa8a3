"""What a driven vehicle meets at the junctions ahead of it in SUMO, and what it heeds there."""

import math
from collections.abc import Callable, Sequence

import libsumo
import numpy as np

from rail_sumo import config
from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.vehicle import acc, crossing
from rail_sumo.highway.vehicle.right_of_way import LINE_SHORT_M, NOT_GREEN, SIGHT_M, GiveWay, Place, Signal
from rail_sumo.highway.vehicle.whereabouts import lanes_inside, to_lane_end_m, way_of
from rail_sumo.records import SECONDS_PER_STEP, Floats, Scene

SUMO_SPEED_MODE = 31
"""SUMO's default speed mode."""
IGNORE_SIGNALS = 15
"""Speed mode: the same, but for signals."""
SLOW_MPS, LINE_NEAR_M = 5.0, 10.0
"""A vehicle that is slower, and nearer to a line, may have to stop there within a second."""
TOUCH_M = 0.01
"""A line nearer than this counts as reached."""
STANDS_MPS, LINE_AT_M = 0.5, 1.0
"""A vehicle that is slower, and nearer to it, stands there."""
LONG_M = 6.0
"""A longer vehicle comes near to other lanes when it turns: SUMO has it as one straight box."""


class Junctions:
    """Tells what is ahead of one vehicle, and has SUMO drive it accordingly.

    Args:
        name: its id.
        adas: its limits.
    """

    def __init__(self, name: str, adas: config.Adas) -> None:
        self._name = name
        self._adas = adas
        self._has_signals = bool(libsumo.trafficlight.getIDList())
        self._drives_on = False  # past the next signal, though it is not green
        self._shown: list[str | bool] = []  # when it last looked
        self._is_unsure = False
        self._crossing: dict[str, Sequence[str]] = {}  # lanes within junctions that others cross
        self._shapes: dict[str, Floats] = {}
        self.aside_m = 0.0
        """How far to the left of the middle of its lane it had better drive, to pass somebody within a junction."""

    def follow(self, road: Road, *, sees_m: float) -> None:
        """Tell what is ahead along a course, so far away."""
        self._edges, self._sight_m = road.edge_of, road.sight_m
        self._is_left_hand, self._sees_m = road.is_left_hand, sees_m
        self.matter = self._has_signals or road.meets_others
        """Whether it may ever have to wait at one, or somebody may stand in its way there."""

    def places(self, speed_mps: float) -> tuple[tuple[Place, ...], tuple[Place, ...]]:
        """Return where right of way asks it to be slow: limits that may be met late, and places that may not.

        Before a way without priority SUMO has it slow where it sees others from, and brakes for that as late as it can.
        """
        if not self.matter:
            return (), ()
        adas, give_ways = self._adas, self._give_ways()
        limits: list[Place] = []
        stops: list[Place] = []
        for way in give_ways:
            (limits if way.is_within else stops).append(way.sight(braking_mps2=adas.comfort_braking_mps2))
        meets: list[Signal | GiveWay] = [*self._signals(), *give_ways]
        stops += [one.stop for one in meets if one.stops(speed_mps, braking_mps2=adas.emergency_braking_mps2)]
        return tuple(limits), tuple(stops)

    def next_edge(self) -> Edge | None:
        """Return the edge of the course after the one that it is on, or was on before the junction."""
        way = way_of(self._name)
        return self._edges.get(way[1]) if len(way) > 1 else None

    def next_lane(self) -> int:
        """Return the index of the lane that the one that it is on leads to beyond the junction; -1 if none."""
        links = libsumo.lane.getLinks(libsumo.vehicle.getLaneID(self._name))
        return int(links[0][0].rpartition("_")[2]) if links else -1

    def heed_signals(self, speed_mps: float) -> None:
        """Have SUMO drive past a signal for which it is too late to stop, and note what all of them show."""
        signals, hardest = self._signals(), self._adas.emergency_braking_mps2
        drives_on = any(not one.is_green and not one.stops(speed_mps, braking_mps2=hardest) for one in signals[:1])
        if drives_on != self._drives_on:
            libsumo.vehicle.setSpeedMode(self._name, IGNORE_SIGNALS if drives_on else SUMO_SPEED_MODE)
            self._drives_on = drives_on
        self._shown = self._shows(signals)
        self._is_unsure = drives_on or any(signal.is_yellow for signal in signals)

    def is_slow_at_line(self, speed_mps: float) -> bool:
        """Return whether it is about to reach, slowly, a line where it may have to wait for others."""
        return speed_mps < SLOW_MPS and any(way.ahead_m < LINE_NEAR_M for way in self._give_ways())

    def stands_at_line(self, speed_mps: float) -> bool:
        """Return whether it is the first that waits there."""
        return speed_mps < STANDS_MPS and any(way.ahead_m < LINE_AT_M for way in self._give_ways())

    @property
    def waits_for_signal(self) -> bool:
        """Whether a signal that it may have to brake for is not green."""
        return any(not signal.is_green for signal in self._signals())

    @property
    def must_look(self) -> bool:
        """Whether it must look at a junction ahead again before the present command ends.

        True while a signal is yellow, while it passes one that is not green, and when a signal or right of way has
        changed.
        """
        return self.matter and (self._is_unsure or self._shows(self._signals()) != self._shown)

    def clear_mps(self, look_around: Callable[[], Scene], speed_mps: float) -> float:
        """Return how fast it may go on, for those who are across its way through a junction; inf if nobody is.

        Before a junction it heeds those who stand there across its way, and stops at the line for them. Where it is
        slow already it also waits there until a lorry has turned.
        Whom it can pass within its lane it passes; see `aside_m`.

        Args:
            look_around: returns itself and the vehicles around it.
            speed_mps: how fast it is.
        """
        lane_id = libsumo.vehicle.getLaneID(self._name)
        if lane_id.startswith(":"):
            allowed_mps = self._clear_inside_mps(look_around().boxes, lanes_inside(lane_id))
        else:
            if self.aside_m and libsumo.vehicle.getLanePosition(self._name) > libsumo.vehicle.getLength(self._name):
                self.aside_m = 0.0  # all of it has left the junction
            allowed_mps = self._clear_ahead_mps(look_around, speed_mps)
        hardest_mps = speed_mps - self._adas.emergency_braking_mps2 * SECONDS_PER_STEP
        return max(allowed_mps, hardest_mps, 0.0)

    def _clear_inside_mps(self, boxes: Floats, lanes: Sequence[str]) -> float:
        way, host, others = self._way(lanes), boxes[:, 0], boxes[:, 1:]
        width_m, lane_m = host[5], libsumo.lane.getWidth(lanes[0])
        self.aside_m = crossing.aside_m(host, others, way, lane_m=lane_m, now_m=self.aside_m)
        free_m = crossing.free_m(others, way, width_m=width_m, aside_m=self.aside_m)
        allowed_mps = math.inf if math.isinf(free_m) else crossing.allowed_mps(free_m)
        if self.aside_m:
            least_m = width_m + 2 * crossing.LEAST_BESIDE_M
            nearest_m = crossing.free_m(crossing.stopped(others), way, width_m=least_m)
            allowed_mps = min(allowed_mps, crossing.passing_mps(nearest_m, self._adas.comfort_braking_mps2))
        return allowed_mps

    def _clear_ahead_mps(self, look_around: Callable[[], Scene], speed_mps: float) -> float:
        comfort_mps2, to_line_m = self._adas.comfort_braking_mps2, to_lane_end_m(self._name)
        if to_line_m > acc.braking_distance_m(speed_mps, comfort_mps2) + LINE_NEAR_M:
            return math.inf
        links = libsumo.vehicle.getNextLinks(self._name)
        if not links:
            return math.inf
        *_, via, state, _, _ = links[0]
        waits = state in NOT_GREEN and not self._drives_on  # for the signal
        if not via or waits or not self._is_crossed(via):
            return math.inf
        if speed_mps < SLOW_MPS and self._is_swept(via):
            return self._stopping_mps(speed_mps, to_line_m)
        host, others = np.split(look_around().boxes, [1], axis=1)
        standing = others[:, others[3] < crossing.STANDS_MPS]
        way = self._way([libsumo.vehicle.getLaneID(self._name), *lanes_inside(via)])
        free_m = crossing.free_m(standing, way, width_m=host[5, 0])
        if not to_line_m < free_m < math.inf:
            return math.inf
        if crossing.aside_m(host[:, 0], standing, way, lane_m=libsumo.lane.getWidth(via), now_m=0.0):
            return crossing.passing_mps(free_m, comfort_mps2)
        if acc.braking_distance_m(speed_mps, self._adas.emergency_braking_mps2) >= to_line_m:
            return crossing.allowed_mps(free_m)
        return self._stopping_mps(speed_mps, to_line_m)

    def _stopping_mps(self, speed_mps: float, to_line_m: float) -> float:
        """Return the speed at the end of the next step with which it stops at the line."""
        comfort_mps2, left_m = self._adas.comfort_braking_mps2, to_line_m - LINE_SHORT_M
        if left_m <= TOUCH_M:
            return 0.0
        braking_mps2 = max(speed_mps**2 / (2 * left_m), comfort_mps2)  # as hard as it takes: it may see them late
        comfortable_mps = math.sqrt(2 * comfort_mps2 * max(left_m - speed_mps * SECONDS_PER_STEP, 0.0))
        return max(comfortable_mps, speed_mps - braking_mps2 * SECONDS_PER_STEP)

    def _way(self, lanes: Sequence[str]) -> Floats:
        """Return the points that the middle of its front comes by along lanes, the first of which it is on."""
        shapes = [self._shape(lane) for lane in lanes]
        part = libsumo.vehicle.getLanePosition(self._name) / libsumo.lane.getLength(lanes[0])
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(shapes[0], axis=0).T)))
        here_m = part * along[-1]
        here = [np.interp(here_m, along, shapes[0][:, axis]) for axis in (0, 1)]
        return np.vstack([here, shapes[0][along > here_m], *shapes[1:]])

    def _shape(self, lane: str) -> Floats:
        """Return the points of a lane's middle, shape (k, 2), as a `Scene` has them."""
        if lane not in self._shapes:
            mirror = (1.0, -1.0) if self._is_left_hand else (1.0, 1.0)
            self._shapes[lane] = np.array(libsumo.lane.getShape(lane))[:, :2] * mirror
        return self._shapes[lane]

    def _is_crossed(self, inside: str) -> bool:
        """Return whether anybody is on a lane that crosses one within a junction, or joins it."""
        return any(map(libsumo.lane.getLastStepOccupancy, self._across(inside)))

    def _is_swept(self, inside: str) -> bool:
        """Return whether a long vehicle drives on such a lane."""
        vehicle = libsumo.vehicle
        names = (name for lane in self._across(inside) for name in libsumo.lane.getLastStepVehicleIDs(lane))
        return any(vehicle.getLength(name) > LONG_M and vehicle.getSpeed(name) > STANDS_MPS for name in names)

    def _across(self, inside: str) -> Sequence[str]:
        """Return the lanes that cross one within a junction, or join it."""
        if inside not in self._crossing:
            self._crossing[inside] = libsumo.lane.getInternalFoes(inside)
        return self._crossing[inside]

    def _signals(self) -> list[Signal]:
        """Return the signals that it may have to brake for by now, the nearest first."""
        if not self._has_signals:
            return []
        now, next_switch = libsumo.simulation.getTime(), libsumo.trafficlight.getNextSwitch
        ahead = libsumo.vehicle.getNextTLS(self._name)
        return [Signal(m, state, next_switch(name) - now) for name, _, m, state in ahead if m < self._sees_m]

    def _give_ways(self) -> list[GiveWay]:
        """Return the ways without priority that it may have to brake for by now, the nearest first."""
        if not self.matter:
            return []
        ahead_m, lane_id = to_lane_end_m(self._name), libsumo.vehicle.getLaneID(self._name)
        found, entered = [], ""
        if lane_id.startswith(":"):
            for _, _, is_open, _, via, *_ in libsumo.lane.getLinks(lane_id):
                if via:  # within the junction it may have to wait once more, as when it turns left
                    found.append(GiveWay(ahead_m, is_open, self._sight_m.get(via, SIGHT_M), is_within=True))
            if edge_after := self.next_edge():  # SUMO's list begins beyond it
                ahead_m += edge_after.length_m
        for lane, has_priority, is_open, _, via, state, _, inside_m in libsumo.vehicle.getNextLinks(self._name):
            if ahead_m > self._sees_m:
                break
            edge = libsumo.lane.getEdgeID(lane)
            if edge == entered:  # listed once more, for another lane
                continue
            if not has_priority and state not in NOT_GREEN:
                found.append(GiveWay(ahead_m, is_open, self._sight_m.get(via, SIGHT_M)))
            ahead_m += inside_m + libsumo.lane.getLength(lane)
            entered = edge
        return found

    def _shows(self, signals: Sequence[Signal]) -> list[str | bool]:
        """Return what signals on its way show, and which ways without priority are open."""
        return [*(signal.state for signal in signals), *(give_way.is_open for give_way in self._give_ways())]
