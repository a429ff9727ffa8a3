"""The host on SUMO: what its sensors and its ADAS layer can know, how it obeys, and what is recorded."""

import math
from collections.abc import Callable, Iterable, Mapping

import libsumo

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway.names import HOST
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.vehicle import acc, neighbours
from rail_sumo.highway.vehicle.abilities import EXPECTED_BRAKING_MPS2, UNLIMITED, Abilities
from rail_sumo.highway.vehicle.ahead import Ahead
from rail_sumo.highway.vehicle.cut_ins import CutIns
from rail_sumo.highway.vehicle.junctions import SUMO_SPEED_MODE, Junctions
from rail_sumo.highway.vehicle.letting_in import COMMANDED_ONLY, LettingIn
from rail_sumo.highway.vehicle.neighbours import Neighbours
from rail_sumo.highway.vehicle.queues import Queues
from rail_sumo.highway.vehicle.sumos_changes import SumosChanges
from rail_sumo.highway.vehicle.whereabouts import to_lane_end_m, way_of
from rail_sumo.highway.vehicle.zipper import Zipper
from rail_sumo.records import SECONDS_PER_STEP, SUMO_DECIDES, Command, Gaps, HostState, Scene

SUMO_CHANGES_LANES = 1621
"""SUMO's default lane-change mode."""
SLACK_M = 100.0
"""Junctions are heeded from this much farther away than the host needs to stop comfortably from its highest speed."""


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
        self._look_around = look_around
        self._claims = claims
        self._adas = adas
        self._neighbours = Neighbours(name, standstill_gap_m=adas.standstill_gap_m)
        self._letting_in = LettingIn(name, self._neighbours, adas)
        self._zipper = Zipper(name, adas)
        self.junctions = Junctions(name, adas)
        """What it meets at those ahead."""
        self._ahead = Ahead(name, standstill_gap_m=adas.standstill_gap_m)
        self._sumos_changes = SumosChanges(name)
        self._queues = Queues(name)
        self._know(road)
        self.abilities = Abilities(name, adas, fastest_mps=self.fastest_mps, shares_type=shares_type)
        """What SUMO lets it do."""
        self._before_m = 0.0
        self._lateral_m = 0.0
        self._is_changing_lane = False
        self.lets_in = False
        """Whether it drives more slowly for somebody in a lane beside, or in one that joins its own."""
        self.makes_room = False
        """Whether it drives more slowly for somebody who crosses its way at a junction."""
        self.aims_at = ""
        """The lane that it is about to move into; empty if none."""
        self._sumo_drives = False
        self._set_mps = self._told_mps = 0.0  # the set speed, and the speed that SUMO was told
        self.depart_s = math.nan
        """When it entered the road, by SUMO's clock."""
        self.speeds_mps: list[float] = []
        self.collisions = 0
        self.struck = 0
        self.contact = False
        """Whether the host has struck or been struck."""
        self.min_ttc_s = math.inf
        self._cut_ins = CutIns()

    def _know(self, road: Road) -> None:
        """Take what follows from a course."""
        self.fastest_mps = self._adas.highest_mps(road.highest_limit_mps)
        """The highest set speed on its course."""
        self._edges = road.edge_of
        self._joints = road.joints
        self._sumos_changes.follow(road.next_lanes)
        self._queues.follow(road.next_lanes)
        self._zipper.follow(road)
        self._sight_m = acc.sight_m(self.fastest_mps, self._adas)
        self._neighbours.follow(road, sight_m=self._sight_m)
        to_stop_m = acc.braking_distance_m(self.fastest_mps, self._adas.comfort_braking_mps2)
        self.junctions.follow(road, sees_m=to_stop_m + SLACK_M)

    # It enters.

    def take_over(self, speed_mps: float) -> None:
        """Put the host under ADAS control as soon as it is inserted, holding `speed_mps` at first."""
        libsumo.vehicle.setSpeedFactor(self.name, UNLIMITED)  # the ADAS layer brakes for limits, in time
        libsumo.vehicle.setLaneChangeMode(self.name, COMMANDED_ONLY)
        libsumo.vehicle.setSpeed(self.name, speed_mps)
        self._set_mps = self._told_mps = speed_mps

    def become(self, own: Mapping[str, str | float], *, speed_mps: float, fastest_mps: float) -> None:
        """Be the vehicle that has these properties of its own, by what SUMO's setters call them, and drives so fast.

        It never drives faster than that vehicle can.
        """
        self._before_m = libsumo.vehicle.getDistance(self.name)  # where it is not driven for the first time
        self.abilities.become(own, speed_mps=speed_mps, fastest_mps=fastest_mps)

    def begin(self) -> None:
        """Note when and at which speed the host has entered, and who is ahead."""
        self.depart_s = libsumo.vehicle.getDeparture(self.name)
        self.speeds_mps.append(libsumo.vehicle.getSpeed(self.name))
        self._ahead.look(self._sight_m)

    def follow(self, road: Road) -> None:
        """Drive along another course from where it is."""
        libsumo.vehicle.updateBestLanes(self.name)  # SUMO itself does not, when a lane is opened
        self._know(road)
        if not self.junctions.matter:
            self.abilities.be_gentle(False)
        self.abilities.follow(fastest_mps=self.fastest_mps, speed_mps=self.speeds_mps[-1])

    def can_stop_on(self, road: Road) -> bool:
        """Return whether it can stop in its lane before that no longer leads on along a course.

        No harder than others expect it to: they would run into it.
        """
        edge_id, _, lane = libsumo.vehicle.getLaneID(self.name).rpartition("_")
        ends_in_m = road.edge_of[edge_id].ends_in_m(libsumo.vehicle.getLanePosition(self.name))
        to_stop_m = acc.braking_distance_m(self.speeds_mps[-1], EXPECTED_BRAKING_MPS2)
        return to_stop_m <= ends_in_m.get(int(lane), math.inf)

    def let_go(self, kind: str, *, speed_factor: float) -> None:
        """Be a vehicle of SUMO's again, of a type of the demand's and as fast as it was meant to be.

        If it is faster, it stays so: SUMO would brake it hard, and it leaves the road soon.
        """
        self._ask(0)
        self._letting_in.tell(None)
        self.abilities.heed_closings(True)
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
        """
        self._sumo_drives = True
        self._sumos_changes.begin()
        self.abilities.hand_over(kind)
        libsumo.vehicle.setLaneChangeMode(self.name, SUMO_CHANGES_LANES)

    # What it can know.

    def state(self) -> HostState:
        """Return the host's place on its edge, or on the junction's inside where lanes go on side by side.

        Elsewhere on a junction, or off the course's lanes, no lane is beside it.

        `limit_mps` is the present limit of the host's lane; `limits_ahead` come from the network and right of way.
        """
        vehicle, speed_mps = libsumo.vehicle, self.speeds_mps[-1]
        lane_id = vehicle.getLaneID(self.name)
        if not lane_id:
            raise InputError(f"vehicle '{self.name}' parks beside the road, and can be driven no further as the host")
        edge_id, _, index = lane_id.rpartition("_")
        edge, lane = self._edges.get(edge_id) or self._joints.get(edge_id), int(index)
        limit_mps = libsumo.lane.getMaxSpeed(lane_id)
        within_junction, stops = self.junctions.places(speed_mps)
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
            dead_ends=edge.dead_ends,
            limit_mps=limit_mps,
            left_goes_on_m=edge.left_goes_on_m[here],
            right_goes_on_m=edge.right_goes_on_m[here],
            limits_ahead=edge.limits_ahead[here],
            stops_ahead=stops,
            sumos_lane_changes=self.sumos_lane_changes,
            queued_m=() if self._sumo_drives else self._queues.queued_m(edge),
        )

    @property
    def is_lost(self) -> bool:
        """Whether it can no longer be driven: it parks, or has been given another way than its course."""
        lane_id = libsumo.vehicle.getLaneID(self.name)
        return not lane_id or not (lane_id.startswith(":") or lane_id.rpartition("_")[0] in self._edges)

    @property
    def travelled_m(self) -> float:
        """Its odometer: metres driven since its insertion, or since it has been taken over."""
        return libsumo.vehicle.getDistance(self.name) - self._before_m

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
        ahead, to_it_m = self.junctions.next_edge(), to_lane_end_m(self.name)
        if ahead is None:
            return ()
        lane = self.junctions.next_lane()
        here = lane - ahead.first_lane if lane in ahead.lanes else 0
        beyond = ((to_it_m + ahead.length_m + metres, limit) for metres, limit in ahead.limits_ahead[here])
        return (to_it_m, ahead.limit_mps), *beyond

    @property
    def n_signals_ahead(self) -> int:
        """How many traffic lights are on its way."""
        return len(libsumo.vehicle.getNextTLS(self.name))

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
        return self._ahead.gap_m

    @property
    def told_mps(self) -> tuple[float, float]:
        """The speed that it was commanded, and what SUMO was told: less where it follows the vehicle ahead."""
        return self._set_mps, self._told_mps

    # What it does, and what is recorded.

    def obey(self, command: Command) -> None:
        """Carry a command out in the next step and those after it."""
        vehicle = libsumo.vehicle
        if self.junctions.matter:
            self.junctions.heed_signals(self.speeds_mps[-1])
            now_mps = self.speeds_mps[-1]
            self.abilities.be_gentle(
                self.junctions.is_slow_at_line(now_mps), stands=self.junctions.stands_at_line(now_mps)
            )
        self._set_mps = command.speed_mps
        self._letting_in.tell(command.must_leave)
        self._ask(command.asks)
        if command.cross:
            vehicle.changeLane(self.name, vehicle.getLaneIndex(self.name) + command.cross, 0.0)
            followers = vehicle.getNeighbors(self.name, neighbours.modes(command.cross)[1])
            if followers:
                self._cut_ins.watch(min(followers, key=lambda follower: follower[1])[0], len(self.speeds_mps))
        self._is_changing_lane = bool(command.lateral_m or command.cross)
        if self._is_changing_lane or not self.junctions.matter:
            self._move_to(command.lateral_m)

    def _move_to(self, lateral_m: float) -> None:
        """Be so far to the left of the middle of its lane."""
        if lateral_m != self._lateral_m:
            libsumo.vehicle.setLateralLanePosition(self.name, lateral_m)
            self._lateral_m = lateral_m

    def _move_towards(self, lateral_m: float) -> None:
        """Move sideways in one step, as far as it may."""
        stride_m = self._adas.lateral_speed_mps * SECONDS_PER_STEP
        self._move_to(min(max(lateral_m, self._lateral_m - stride_m), self._lateral_m + stride_m))

    def _ask(self, side: int) -> None:
        """Have others in the lane on a side let it in; 0: no longer."""
        if self._letting_in.ask(side, self.speeds_mps[-1]):
            self._sumos_changes.begin()

    def heed(self) -> None:
        """Notice queues, and who must come into its lane; let those in until it looks again."""
        self._queues.look_again()
        self._letting_in.heed()

    def drive(self) -> None:
        """Tell SUMO the speed for the next step: the set speed, or what adaptive cruise control makes of it."""
        speed_mps, now_mps, leader = self._set_mps, self.speeds_mps[-1], self._ahead.leader
        self.abilities.keep_to_limit(now_mps)
        if not self._sumo_drives:
            beside_mps = min(self._letting_in.allowed_mps(now_mps), self._zipper.allowed_mps(now_mps))
            ahead_mps = math.inf if leader is None else acc.following_mps(now_mps, leader, self._adas)
            self.lets_in, self.makes_room = beside_mps < min(speed_mps, ahead_mps), False
            speed_mps = min(speed_mps, beside_mps, ahead_mps)
            if self.junctions.matter:
                clear_mps = self.junctions.clear_mps(self._look_around, now_mps)
                self.makes_room, speed_mps = clear_mps < speed_mps, min(clear_mps, speed_mps)
                if not self._is_changing_lane:
                    self._move_towards(self.junctions.aside_m)
            self.abilities.brace(now_mps, speed_mps, leader)
        if speed_mps != self._told_mps:
            libsumo.vehicle.setSpeed(self.name, speed_mps)
            self._told_mps = speed_mps

    def note(self) -> None:
        """Record the host's speed, its leader and its contacts after a step."""
        speed_mps = libsumo.vehicle.getSpeed(self.name)
        self.speeds_mps.append(speed_mps)
        leader = self._ahead.look(self._sight_m)
        if leader is not None:
            closing_mps = speed_mps - leader.speed_mps
            if closing_mps * self.min_ttc_s > leader.gap_m > 0.0:
                self.min_ttc_s = leader.gap_m / closing_mps
        if libsumo.simulation.getCollidingVehiclesNumber():
            self._note_contacts()
        if self._sumo_drives or self._letting_in.asks:
            self._note_change()
        self._cut_ins.note(len(self.speeds_mps))

    def _note_change(self) -> None:
        if self._sumos_changes.note():
            follower = libsumo.vehicle.getFollower(self.name)
            if follower and follower[0]:
                self._cut_ins.watch(follower[0], len(self.speeds_mps))

    def _note_contacts(self) -> None:
        for collision in libsumo.simulation.getCollisions():  # contacts among the others are not counted
            self.collisions += collision.collider == self.name
            self.struck += collision.victim == self.name
        self.contact = bool(self.collisions or self.struck)

    @property
    def sumos_lane_changes(self) -> int:
        """How often SUMO has changed lanes, as its driver or while it asked to be let in."""
        return self._sumos_changes.count

    @property
    def hard_brakings_behind(self) -> int:
        """How often vehicles braked hard within 5 s of the host's moving in front of them."""
        return self._cut_ins.hard_brakings
