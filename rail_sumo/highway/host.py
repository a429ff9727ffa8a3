"""The host on SUMO: what its sensors and its ADAS layer can know, how it obeys, and what is recorded."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import libsumo

from rail_sumo import config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.highway import acc, crossing, neighbours
from rail_sumo.highway.acc import Leader
from rail_sumo.highway.hard_braking import hard_brakings
from rail_sumo.highway.names import HOST, OURS
from rail_sumo.highway.neighbours import Neighbours, to_lane_end_m
from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.right_of_way import NOT_GREEN, SIGHT_M, GiveWay, Place, Signal
from rail_sumo.records import SECONDS_PER_STEP, SUMO_DECIDES, Command, Gaps, HostState, Scene

HOST_TYPE = HOST
"""The id of its vehicle type."""

COMMANDED_ONLY = 256
"""Lane-change mode of the host: no change of its own accord; the ADAS layer is the gate, SUMO only avoids overlap."""
ASKS, ASSERTIVE, NOT_ASSERTIVE = 257, "laneChangeModel.lcAssertive", "1e-9"
"""The same, but it means to leave a lane that does not lead on; and how little it then insists on it."""
UNSURE_MPS = 0.5
"""By how much speeds change within a step, at most."""
SUMO_CHANGES_LANES = 1621
"""SUMO's default lane-change mode."""

SUMO_TYPE_PREFIX = "DEFAULT_"
"""What the ids of SUMO's own vehicle types begin with."""
UNLIMITED = 10.0
"""Speed factor with which SUMO does not hold the host to the road's limits."""

SUMO_SPEED_MODE = 31
"""SUMO's default speed mode."""
IGNORE_SIGNALS = 15
"""Speed mode: the same, but for signals."""

AEB_TIME_GAP_S = 0.5
"""What emergency braking keeps to the vehicle ahead: less than adaptive cruise control does, which it is not to
disturb. SUMO keeps clear of contacts as long as this is no shorter than a step."""
GENTLE_MPS2, SLOW_MPS, LINE_NEAR_M = 3.0, 5.0, 10.0
"""How hard SUMO may brake the host for who comes first, when it is that slow and that near to the line."""
EXPECTED_BRAKING_MPS2 = 4.5
"""The braking that other vehicles expect of the host."""
WATCH_STEPS = 50
"""How long the vehicle behind is watched after the host has moved in front of it: 5 s."""
EDGES_PER_STEP = 10
"""Onto no more edges than these, junctions' insides included, does a vehicle come within a step."""
SLACK_M = 100.0
"""Junctions are heeded from this much farther away than the host needs to stop comfortably from its highest speed."""


@dataclass(slots=True)
class _Watched:
    """A vehicle that the host has moved in front of."""

    name: str
    speeds_mps: list[float]
    until: int
    """How many speeds of its own the host will have noted when the watch ends."""


class Host:
    """The vehicle that is driven, in the simulation that is open.

    Args:
        road: its course.
        adas: limits of its car-following (ACC and AEB).
        look_around: returns who is around it.
        name: the id of its vehicle.
        claims: returns the other driven vehicles that are about to move into a lane, each with that lane.
        shares_type: whether others are of its vehicle type too.
    """

    def __init__(
        self,
        road: Road,
        adas: config.Adas,
        look_around: Callable[[], Scene],
        name: str = HOST,
        claims: Callable[[str], Iterable[tuple[str, str]]] = lambda name: (),
        *,
        shares_type: bool = False,
    ) -> None:
        self.name = name
        self._shares_type = shares_type
        self._look_around = look_around
        self._claims = claims
        self._adas = adas
        self.fastest_mps = adas.highest_mps(road.highest_limit_mps)
        self._edges = road.edge_of
        self._joints = road.joints
        self._next_lanes = road.next_lanes
        self._has_signals = bool(libsumo.trafficlight.getIDList())
        self._meets_others = self._has_signals or road.gives_way
        self._junction_sight_m = road.sight_m
        self._standstill_gap_m = adas.standstill_gap_m
        self._sight_m = acc.sight_m(self.fastest_mps, adas)
        self._neighbours = Neighbours(name, road, sight_m=self._sight_m, standstill_gap_m=adas.standstill_gap_m)
        self._heeds_m = acc.braking_distance_m(self.fastest_mps, adas.comfort_braking_mps2) + SLACK_M
        self._drives_on = False  # past the next signal, though it is not green
        self._shown: list[str | bool] = []  # when the host last looked
        self._is_unsure = False
        self._lateral_m = 0.0
        self._asks = self._is_gentle = False
        self._assertive = ""  # as it was before it asked
        self.aims_at = ""
        """The lane that it is about to move into; empty if none."""
        self._sumo_drives = False
        self._set_mps = self._told_mps = 0.0  # the set speed, and the speed that SUMO was told
        self._leader: Leader | None = None
        self._leader_name = ""
        self._leader_speeds_mps: deque[float] = deque(maxlen=round(0.5 / SECONDS_PER_STEP) + 1)
        self.speeds_mps: list[float] = []
        self.collisions = 0
        self.struck = 0
        self.contact = False
        """Whether the host has struck or been struck."""
        self.min_ttc_s = math.inf
        self._behind: list[_Watched] = []
        self._watched_until = 0  # as in `_Watched`, of the last of them
        self._lane_id = ""  # that the host was on while SUMO's own driver might change it
        self.sumos_lane_changes = 0
        """How often SUMO has changed lanes, as its driver or while it asked to be let in."""
        self._equip()

    def _equip(self) -> None:
        """Give it emergency braking: car-following that brakes safely and never harder than it may.

        Krauss without imperfection, a deceleration as hard as emergency braking, and others told to expect
        `EXPECTED_BRAKING_MPS2`. SUMO never exceeds `decel` under setSpeed in the default speed mode, and this model
        needs no more to stay clear of a leader that brakes as hard. Adaptive cruise control (`acc`) brakes long before.
        """
        types, adas = libsumo.vehicletype, self._adas
        types.setAccel(HOST_TYPE, adas.acceleration_mps2)
        types.setDecel(HOST_TYPE, adas.emergency_braking_mps2)
        types.setEmergencyDecel(HOST_TYPE, adas.emergency_braking_mps2)
        types.setApparentDecel(HOST_TYPE, min(EXPECTED_BRAKING_MPS2, adas.emergency_braking_mps2))
        types.setImperfection(HOST_TYPE, 0.0)
        types.setMaxSpeed(HOST_TYPE, self.fastest_mps)
        types.setTau(HOST_TYPE, AEB_TIME_GAP_S)
        types.setMinGap(HOST_TYPE, adas.standstill_gap_m)

    # It enters.

    def take_over(self, speed_mps: float) -> None:
        """Put the host under ADAS control as soon as it is inserted, holding `speed_mps` at first."""
        libsumo.vehicle.setSpeedFactor(self.name, UNLIMITED)  # the ADAS layer brakes for limits, in time
        libsumo.vehicle.setLaneChangeMode(self.name, COMMANDED_ONLY)
        libsumo.vehicle.setSpeed(self.name, speed_mps)
        self._set_mps = self._told_mps = speed_mps

    def become(self, own: Mapping[str, str | float], *, speed_mps: float) -> None:
        """Be the vehicle that has these properties of its own, by what SUMO's setters call them, and drives so fast."""
        for what, value in own.items():
            self._set(what, value)
        self._set("MaxSpeed", max(self.fastest_mps, speed_mps))  # or SUMO would brake it hard

    def _set(self, what: str, value: str | float) -> None:
        """Set a property of its vehicle type; if others are of it too, of the vehicle, to which SUMO gives its own."""
        if self._shares_type:
            getattr(libsumo.vehicle, f"set{what}")(self.name, value)
        else:
            getattr(libsumo.vehicletype, f"set{what}")(HOST_TYPE, value)

    def hold_below(self, speed_mps: float) -> None:
        """Let the host drive no faster than this, whatever is commanded."""
        self._set("MaxSpeed", speed_mps)

    def begin(self) -> None:
        """Note the speed at which the host has entered, and who is ahead."""
        self.speeds_mps.append(libsumo.vehicle.getSpeed(self.name))
        self._leader = self._look_ahead()

    def let_go(self, kind: str, *, speed_factor: float) -> None:
        """Be a vehicle of SUMO's again, of a type of the demand's and as fast as it was meant to be.

        If it is faster, it stays so: SUMO would brake it hard, and it leaves the road soon.
        """
        self._ask(0)
        vehicle, speed_mps = libsumo.vehicle, libsumo.vehicle.getSpeed(self.name)
        vehicle.setType(self.name, kind)
        faster = speed_mps / self.limit_mps if vehicle.getLaneID(self.name) else 0.0  # unless it parks
        vehicle.setSpeedFactor(self.name, max(speed_factor, faster))
        if speed_mps > vehicle.getMaxSpeed(self.name):
            vehicle.setMaxSpeed(self.name, speed_mps)
        vehicle.setSpeed(self.name, SUMO_DECIDES)
        vehicle.setSpeedMode(self.name, SUMO_SPEED_MODE)
        vehicle.setLaneChangeMode(self.name, SUMO_CHANGES_LANES)
        vehicle.setLateralLanePosition(self.name, 0.0)

    def hand_over(self, kind: str | None = None) -> None:
        """Let SUMO's own driver drive: no adaptive cruise control, lane changes of its own accord.

        Its speed is left to it by a command with a negative speed.

        Args:
            kind: the vehicle type whose car-following, lane changes, size and mean speed factor it has from now on.

        Raises:
            InputError: there is no such type.
        """
        vehicle, types = libsumo.vehicle, libsumo.vehicletype
        self._sumo_drives = True
        self._lane_id = vehicle.getLaneID(self.name)
        if kind is None:
            vehicle.setTau(self.name, self._adas.time_gap_s)  # as a vehicle of SUMO's, it has no other time gap
        else:
            known = [name for name in types.getIDList() if not name.startswith((OURS, SUMO_TYPE_PREFIX))]
            if not known:
                raise InputError(f"driver 'sumo:{kind}' is a vehicle of your demand's; name its files with --routes")
            if kind not in known:
                raise InputError(f"vehicle type '{kind}' of driver 'sumo:{kind}' not found{did_you_mean(kind, known)}")
            vehicle.setType(self.name, kind)
            kind = vehicle.getTypeID(self.name)  # the one drawn from a distribution
            vehicle.setSpeedFactor(self.name, types.getSpeedFactor(kind))
            vehicle.setMaxSpeed(self.name, types.getMaxSpeed(kind))
            vehicle.setSpeedMode(self.name, SUMO_SPEED_MODE)
        vehicle.setLaneChangeMode(self.name, SUMO_CHANGES_LANES)

    # What it can know.

    def state(self) -> HostState:
        """Return the host's place on its edge, or on the junction's inside where lanes go on side by side.

        Elsewhere on a junction, or off the course's lanes, no lane is beside it.

        `limit_mps` is the present limit of the host's lane; `limits_ahead` come from the network and right of way.
        """
        vehicle, speed_mps = libsumo.vehicle, self.speeds_mps[-1]
        lane_id = vehicle.getLaneID(self.name)
        edge_id, _, index = lane_id.rpartition("_")
        edge, lane = self._edges.get(edge_id) or self._joints.get(edge_id), int(index)
        limit_mps = libsumo.lane.getMaxSpeed(lane_id)
        within_junction, stops = self._places(speed_mps)
        if edge is None or lane not in (lanes := edge.lanes):  # on a junction, or strayed
            return HostState(
                speed_mps=speed_mps,
                lane=lane,
                rightmost_lane=lane,
                leftmost_lane=lane,
                to_edge_end_m=0.0,
                lane_width_m=0.0,
                to_left_m=0.0,
                to_right_m=0.0,
                leads_on_m=(math.inf,),
                limit_mps=limit_mps,
                limits_ahead=(*self._limits_beyond_this_lane(), *within_junction),
                stops_ahead=stops,
                sumos_lane_changes=self.sumos_lane_changes,
            )
        here, to_edge_end_m = lane - lanes[0], to_lane_end_m(self.name)
        return HostState(
            speed_mps=speed_mps,
            lane=lane,
            rightmost_lane=lanes[0],
            leftmost_lane=lanes[-1],
            to_edge_end_m=to_edge_end_m,
            lane_width_m=edge.lane_widths_m[here],
            to_left_m=edge.to_left_m[here],
            to_right_m=edge.to_right_m[here],
            leads_on_m=edge.leads_on_m,
            limit_mps=limit_mps,
            left_goes_on_m=edge.left_goes_on_m[here],
            right_goes_on_m=edge.right_goes_on_m[here],
            limits_ahead=edge.limits_ahead,
            stops_ahead=stops,
            sumos_lane_changes=self.sumos_lane_changes,
        )

    @property
    def is_lost(self) -> bool:
        """Whether it can no longer be driven: it parks, or has been given another way than its course."""
        lane_id = libsumo.vehicle.getLaneID(self.name)
        return not lane_id or not (lane_id.startswith(":") or lane_id.rpartition("_")[0] in self._edges)

    @property
    def travelled_m(self) -> float:
        """Its odometer: metres driven since its insertion."""
        return libsumo.vehicle.getDistance(self.name)

    def is_on_course(self, name: str) -> bool:
        """Return whether a vehicle on the road drives along its course, or has just come from it."""
        return way_of(name)[0] in self._edges

    def heads_for_course(self, name: str) -> bool:
        """Return whether a vehicle's way leads along its course, from where it is on."""
        return not self._edges.keys().isdisjoint(way_of(name))

    def flows_vehph(self) -> dict[str, float]:
        """Return the flow on every edge of its course at this moment, in vehicles per hour.

        Source: Edie (1963), over an edge's length and no time: the sum of its vehicles' speeds by its length.
        """
        speed_mps, number = libsumo.edge.getLastStepMeanSpeed, libsumo.edge.getLastStepVehicleNumber
        return {
            name: number(name) and 3600 * number(name) * speed_mps(name) / edge.length_m
            for name, edge in self._edges.items()
        }

    @property
    def limit_mps(self) -> float:
        """The speed limit of its lane."""
        return libsumo.lane.getMaxSpeed(libsumo.vehicle.getLaneID(self.name))

    def _limits_beyond_this_lane(self) -> tuple[tuple[float, float], ...]:
        """Return the limits of the edge that comes next, and beyond it, with the metres from here to each."""
        ahead, to_it_m = self._next_edge(), to_lane_end_m(self.name)
        if ahead is None:
            return ()
        beyond = ((to_it_m + ahead.length_m + metres, limit) for metres, limit in ahead.limits_ahead)
        return (to_it_m, ahead.limit_mps), *beyond

    def _next_edge(self) -> Edge | None:
        """Return the edge of the course after the one that it is on, or was on before the junction."""
        way = way_of(self.name)
        return self._edges.get(way[1]) if len(way) > 1 else None

    @property
    def n_signals_ahead(self) -> int:
        """How many traffic lights are on its way."""
        return len(libsumo.vehicle.getNextTLS(self.name))

    def _signals(self) -> list[Signal]:
        """Return the signals that the host may have to brake for by now, the nearest first."""
        if not self._has_signals:
            return []
        now, next_switch = libsumo.simulation.getTime(), libsumo.trafficlight.getNextSwitch
        ahead = libsumo.vehicle.getNextTLS(self.name)
        return [Signal(m, state, next_switch(name) - now) for name, _, m, state in ahead if m < self._heeds_m]

    def _give_ways(self) -> list[GiveWay]:
        """Return the ways without priority that the host may have to brake for by now, the nearest first."""
        if not self._meets_others:
            return []
        ahead_m, lane_id = to_lane_end_m(self.name), libsumo.vehicle.getLaneID(self.name)
        found, entered = [], ""
        if lane_id.startswith(":"):
            for _, _, is_open, _, via, *_ in libsumo.lane.getLinks(lane_id):
                if via:  # within the junction the host may have to wait once more, as when it turns left
                    found.append(GiveWay(ahead_m, is_open, self._junction_sight_m.get(via, SIGHT_M), is_within=True))
            if edge_after := self._next_edge():  # SUMO's list begins beyond it
                ahead_m += edge_after.length_m
        for lane, has_priority, is_open, _, via, state, _, inside_m in libsumo.vehicle.getNextLinks(self.name):
            if ahead_m > self._heeds_m:
                break
            edge = libsumo.lane.getEdgeID(lane)
            if edge == entered:  # listed once more, for another lane
                continue
            if not has_priority and state not in NOT_GREEN:
                found.append(GiveWay(ahead_m, is_open, self._junction_sight_m.get(via, SIGHT_M)))
            ahead_m += inside_m + libsumo.lane.getLength(lane)
            entered = edge
        return found

    def _places(self, speed_mps: float) -> tuple[tuple[Place, ...], tuple[Place, ...]]:
        """Return where right of way asks the host to be slow: limits that may be met late, and places that may not.

        Before a way without priority SUMO has it slow where it sees others from, and brakes for that as late as it can.
        """
        if not self._meets_others:
            return (), ()
        adas, give_ways = self._adas, self._give_ways()
        limits: list[Place] = []
        stops: list[Place] = []
        for way in give_ways:
            (limits if way.is_within else stops).append(way.sight(braking_mps2=adas.comfort_braking_mps2))
        meets: list[Signal | GiveWay] = [*self._signals(), *give_ways]
        stops += [one.stop for one in meets if one.stops(speed_mps, braking_mps2=adas.emergency_braking_mps2)]
        return tuple(limits), tuple(stops)

    def gaps(self, side: int) -> Gaps:
        """Return the gaps in the host's own lane (0) or the one to its left (+1) or right (-1)."""
        return self._neighbours.gaps(side, self._claims(self.name) if side else ())

    def claim(self, side: int) -> None:
        """Tell other driven vehicles which lane it is about to move into: to its left (+1), its right (-1), or none."""
        edge, _, lane = libsumo.vehicle.getLaneID(self.name).rpartition("_") if side else ("", "", "")
        self.aims_at = f"{edge}_{int(lane) + side}" if side else ""

    @property
    def gap_m(self) -> float:
        """Bumper to bumper to the vehicle ahead; NaN where none is in sight."""
        return math.nan if self._leader is None else self._leader.gap_m

    @property
    def told_mps(self) -> tuple[float, float]:
        """The speed that it was commanded, and what SUMO was told: less where it follows the vehicle ahead."""
        return self._set_mps, self._told_mps

    @property
    def waits_for_signal(self) -> bool:
        """Whether a signal that it may have to brake for is not green."""
        return any(not signal.is_green for signal in self._signals())

    # What it does, and what is recorded.

    def obey(self, command: Command) -> None:
        """Carry a command out in the next step and those after it."""
        vehicle = libsumo.vehicle
        if self._meets_others:
            self._heed_signals()
            self._heed_lines()
        self._set_mps = command.speed_mps
        if command.asks or self._asks:
            self._ask(command.asks)
        if command.cross:
            vehicle.changeLane(self.name, vehicle.getLaneIndex(self.name) + command.cross, 0.0)
            followers = vehicle.getNeighbors(self.name, neighbours.modes(command.cross)[1])
            if followers:
                self._watch(min(followers, key=lambda follower: follower[1])[0])
        if command.lateral_m != self._lateral_m:
            vehicle.setLateralLanePosition(self.name, command.lateral_m)
            self._lateral_m = command.lateral_m

    def _ask(self, side: int) -> None:
        """Have SUMO's drivers in the lane on a side let the host in, as they do each other; 0: no longer.

        SUMO's lane changer makes drivers give way to a vehicle that wants to change lanes by itself. So the host is set
        to want to, and never does: its gaps would have to be longer than any. Only where SUMO takes a gap of no length,
        between a slower vehicle behind and a faster one ahead, it would change at once; there the host does not ask.
        Where others come to drive so in the very same step SUMO takes that gap, and the host is in the next lane.
        """
        asks = side != 0 and self._needs_room(side)
        if asks == self._asks:
            return
        vehicle = libsumo.vehicle
        try:
            if asks:
                self._assertive = vehicle.getParameter(self.name, ASSERTIVE)
            vehicle.setParameter(self.name, ASSERTIVE, NOT_ASSERTIVE if asks else self._assertive)
        except libsumo.TraCIException:  # its lane-change model, a demand's default, knows no such thing
            return
        vehicle.setLaneChangeMode(self.name, ASKS if asks else COMMANDED_ONLY)
        self._asks, self._lane_id = asks, vehicle.getLaneID(self.name)

    def _needs_room(self, side: int) -> bool:
        """Whether SUMO's drivers would keep a gap between the host and its neighbours in the lane on a side."""
        vehicle, mps = libsumo.vehicle, self.speeds_mps[-1]
        ahead, behind = (vehicle.getNeighbors(self.name, mode) for mode in neighbours.modes(side))
        pairs = [(self.name, mps, name, vehicle.getSpeed(name)) for name, _ in ahead]
        pairs += [(name, vehicle.getSpeed(name), self.name, mps) for name, _ in behind]
        return any(
            vehicle.getSecureGap(rear, max(rear_mps - UNSURE_MPS, 0.0), front_mps + UNSURE_MPS, vehicle.getDecel(front))
            for rear, rear_mps, front, front_mps in pairs
        )

    def _heed_signals(self) -> None:
        """Have SUMO drive past a signal for which it is too late to stop, and note what all of them show."""
        signals, hardest, speed_mps = self._signals(), self._adas.emergency_braking_mps2, self.speeds_mps[-1]
        drives_on = any(not one.is_green and not one.stops(speed_mps, braking_mps2=hardest) for one in signals[:1])
        if drives_on != self._drives_on:
            libsumo.vehicle.setSpeedMode(self.name, IGNORE_SIGNALS if drives_on else SUMO_SPEED_MODE)
            self._drives_on = drives_on
        self._shown = self._shows(signals)
        self._is_unsure = drives_on or any(signal.is_yellow for signal in signals)

    def _heed_lines(self) -> None:
        """Have SUMO brake gently where the host may have to wait for others.

        SUMO finds that out a second after it has called the way open, and stops then as late and as hard as it may.
        """
        is_slow = self.speeds_mps[-1] < SLOW_MPS
        is_gentle = is_slow and any(way.ahead_m < LINE_NEAR_M for way in self._give_ways())
        if is_gentle != self._is_gentle:
            hardest = self._adas.emergency_braking_mps2
            self._set("Decel", min(GENTLE_MPS2, hardest) if is_gentle else hardest)
            self._is_gentle = is_gentle

    @property
    def must_look(self) -> bool:
        """Whether the host must look at a junction ahead again before the present command ends.

        True while a signal is yellow, while the host passes one that is not green, and when a signal or right of way
        has changed.
        """
        return self._meets_others and (self._is_unsure or self._shows(self._signals()) != self._shown)

    def _shows(self, signals: Sequence[Signal]) -> list[str | bool]:
        """Return what signals on the host's way show, and which ways without priority are open."""
        return [*(signal.state for signal in signals), *(give_way.is_open for give_way in self._give_ways())]

    def drive(self) -> None:
        """Tell SUMO the speed for the next step: the set speed, or what adaptive cruise control makes of it."""
        speed_mps, leader = self._set_mps, self._leader
        if leader is not None and not self._sumo_drives:
            speed_mps = min(speed_mps, acc.following_mps(self.speeds_mps[-1], leader, self._adas))
        if self._meets_others and not self._sumo_drives and libsumo.vehicle.getLaneID(self.name).startswith(":"):
            speed_mps = min(speed_mps, self._clear_of_crossing_mps())
        if speed_mps != self._told_mps:
            libsumo.vehicle.setSpeed(self.name, speed_mps)
            self._told_mps = speed_mps

    def _clear_of_crossing_mps(self) -> float:
        """Return how fast the host may go on within a junction, for those who are stuck across its path."""
        free_m = crossing.free_m(self._look_around().boxes)
        if free_m > _to_junction_end_m(self.name):  # beside the road that the host comes out on
            return math.inf
        hardest_mps = self.speeds_mps[-1] - self._adas.emergency_braking_mps2 * SECONDS_PER_STEP
        return max(crossing.allowed_mps(free_m), hardest_mps, 0.0)

    def note(self) -> None:
        """Record the host's speed, its leader and its contacts after a step."""
        speed_mps = libsumo.vehicle.getSpeed(self.name)
        self.speeds_mps.append(speed_mps)
        leader = self._leader = self._look_ahead()
        if leader is not None:
            closing_mps = speed_mps - leader[1]
            if closing_mps * self.min_ttc_s > leader[0] > 0.0:
                self.min_ttc_s = leader[0] / closing_mps
        if libsumo.simulation.getCollidingVehiclesNumber():
            self._note_contacts()
        if self._sumo_drives or self._asks:
            self._note_lane()
        if len(self.speeds_mps) <= self._watched_until:
            self._note_behind()

    def _look_ahead(self) -> Leader | None:
        """Return who is ahead, with how that vehicle has sped up or braked over the last half second."""
        vehicle = libsumo.vehicle
        ahead = vehicle.getLeader(self.name, self._sight_m)
        if not ahead or not ahead[0]:
            self._leader_name = ""
            return None
        name, gap_m = ahead
        speed_mps, speeds_mps = vehicle.getSpeed(name), self._leader_speeds_mps
        if name != self._leader_name:
            self._leader_name = name
            speeds_mps.clear()
            speeds_mps.append(speed_mps)
            return Leader(gap_m + self._standstill_gap_m, speed_mps)
        speeds_mps.append(speed_mps)
        seconds = (len(speeds_mps) - 1) * SECONDS_PER_STEP
        return Leader(gap_m + self._standstill_gap_m, speed_mps, (speed_mps - speeds_mps[0]) / seconds)

    def _note_contacts(self) -> None:
        for collision in libsumo.simulation.getCollisions():  # contacts among the others are not counted
            self.collisions += collision.collider == self.name
            self.struck += collision.victim == self.name
        self.contact = bool(self.collisions or self.struck)

    def _watch(self, name: str) -> None:
        """Watch the vehicle that the host moves in front of now; one that is watched already, for longer."""
        self._watched_until = len(self.speeds_mps) + WATCH_STEPS
        for watched in self._behind:
            if watched.name == name and watched.until >= len(self.speeds_mps):
                watched.until = self._watched_until
                return
        self._behind.append(_Watched(name, [libsumo.vehicle.getSpeed(name)], self._watched_until))

    def _note_behind(self) -> None:
        """Record the speeds of the watched vehicles that are still on the road."""
        for watched in self._behind:
            if watched.until >= len(self.speeds_mps):
                with suppress(libsumo.TraCIException):  # it has left
                    speed_mps = libsumo.vehicle.getSpeed(watched.name)
                    if speed_mps != libsumo.INVALID_DOUBLE_VALUE:  # as of one that is being teleported
                        watched.speeds_mps.append(speed_mps)

    def _note_lane(self) -> None:
        """Notice when SUMO has changed lanes for the host, as its own driver or while the host asks to be let in."""
        lane_id = libsumo.vehicle.getLaneID(self.name)
        if lane_id != self._lane_id and self._is_beside(lane_id):
            self.sumos_lane_changes += 1
            follower = libsumo.vehicle.getFollower(self.name)
            if follower and follower[0]:
                self._watch(follower[0])
        self._lane_id = lane_id

    def _is_beside(self, lane_id: str) -> bool:
        """Whether a lane is beside the one that SUMO's own driver was on, or beside those that this one leads to."""
        edge_id, reached = lane_id.rpartition("_")[0], {self._lane_id}
        for _ in range(EDGES_PER_STEP):
            on_edge = {one for one in reached if one.rpartition("_")[0] == edge_id}
            if on_edge:
                return lane_id not in on_edge
            reached = {ahead for one in reached for ahead in self._next_lanes.get(one, ())}
        return False

    @property
    def hard_brakings_behind(self) -> int:
        """How often vehicles braked hard within `WATCH_STEPS` of the host's moving in front of them."""
        return sum(hard_brakings(one.speeds_mps) for one in self._behind)


def _to_junction_end_m(name: str) -> float:
    """Return how far a vehicle that is within a junction has to the end of it."""
    lane_id, metres = libsumo.vehicle.getLaneID(name), to_lane_end_m(name)
    while via := next((link[4] for link in libsumo.lane.getLinks(lane_id)), ""):
        lane_id, metres = via, metres + libsumo.lane.getLength(via)
    return metres


def way_of(name: str) -> Sequence[str]:
    """Return the edges of a vehicle's route from the one on that it is on, or was on before the junction."""
    return libsumo.vehicle.getRoute(name)[libsumo.vehicle.getRouteIndex(name) :]
