"""What a driven vehicle meets at the junctions ahead of it in SUMO, and what it heeds there."""

import math
from collections.abc import Callable, Sequence

import libsumo

from rail_sumo import config
from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.vehicle import acc, crossing
from rail_sumo.highway.vehicle.right_of_way import LINE_SHORT_M, NOT_GREEN, SIGHT_M, GiveWay, Place, Signal
from rail_sumo.highway.vehicle.whereabouts import to_junction_end_m, to_lane_end_m, way_of
from rail_sumo.records import SECONDS_PER_STEP, Scene

SUMO_SPEED_MODE = 31
"""SUMO's default speed mode."""
IGNORE_SIGNALS = 15
"""Speed mode: the same, but for signals."""
SLOW_MPS, LINE_NEAR_M = 5.0, 10.0
"""A vehicle that is slower, and nearer to a line, may have to stop there within a second."""
STUCK_MPS = 0.5
"""Whoever is slower within a junction is stuck there."""
STRAIGHT = "s"
"""SUMO's letter for the way straight on."""


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

    def follow(self, road: Road, *, sees_m: float) -> None:
        """Tell what is ahead along a course, so far away."""
        self._edges, self._sight_m = road.edge_of, road.sight_m
        self._sees_m = sees_m
        self.matter = self._has_signals or road.gives_way
        """Whether it may ever have to wait at one."""

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
        """Return how fast it may go on, for those who are across its path within a junction; inf if nobody is.

        Before a junction it heeds those who stand there across its way straight on, and stops at the line for them.

        Args:
            look_around: returns itself and the vehicles around it.
            speed_mps: how fast it is.
        """
        if libsumo.vehicle.getLaneID(self._name).startswith(":"):
            free_m = crossing.free_m(look_around().boxes)
            if free_m > to_junction_end_m(self._name):  # beside the road that it comes out on
                return math.inf
            allowed_mps = crossing.allowed_mps(free_m)
        else:
            allowed_mps = self._clear_ahead_mps(look_around, speed_mps)
        hardest_mps = speed_mps - self._adas.emergency_braking_mps2 * SECONDS_PER_STEP
        return max(allowed_mps, hardest_mps, 0.0)

    def _clear_ahead_mps(self, look_around: Callable[[], Scene], speed_mps: float) -> float:
        comfort_mps2, to_line_m = self._adas.comfort_braking_mps2, to_lane_end_m(self._name)
        if to_line_m > acc.braking_distance_m(speed_mps, comfort_mps2) + LINE_NEAR_M:
            return math.inf
        links = libsumo.vehicle.getNextLinks(self._name)
        if not links:
            return math.inf
        *_, via, _, direction, inside_m = links[0]
        if direction != STRAIGHT or not via or not self._is_crossed(via):
            return math.inf
        boxes = look_around().boxes
        is_told = boxes[3] < STUCK_MPS
        is_told[0] = True  # the host itself
        free_m = crossing.free_m(boxes[:, is_told])
        if not to_line_m < free_m < to_line_m + inside_m:
            return math.inf
        if acc.braking_distance_m(speed_mps, self._adas.emergency_braking_mps2) >= to_line_m:
            return crossing.allowed_mps(free_m)
        left_m = to_line_m - LINE_SHORT_M - speed_mps * SECONDS_PER_STEP
        return math.sqrt(2 * comfort_mps2 * max(left_m, 0.0))

    def _is_crossed(self, inside: str) -> bool:
        """Return whether anybody is on a lane that crosses one within a junction, or joins it."""
        if inside not in self._crossing:
            self._crossing[inside] = libsumo.lane.getInternalFoes(inside)
        return any(map(libsumo.lane.getLastStepOccupancy, self._crossing[inside]))

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
