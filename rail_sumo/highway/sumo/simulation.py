"""The one libsumo process: Scene out, Command in. SUMO's facts are converted once, here and in `host`."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import ClassVar

import libsumo

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway import sumo_process
from rail_sumo.highway.names import CARS, HOST, OURS
from rail_sumo.highway.network import sumo_xml
from rail_sumo.highway.network.demand import Demand
from rail_sumo.highway.network.lanes import MAJOR
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.sumo import inserted, signals
from rail_sumo.highway.sumo.closings import Closings
from rail_sumo.highway.sumo.held import HeldVehicles
from rail_sumo.highway.sumo.inserted import Inserted
from rail_sumo.highway.sumo.options import options_of
from rail_sumo.highway.sumo.sight import Sight
from rail_sumo.highway.sumo_outputs import Outputs
from rail_sumo.highway.vehicle.abilities import HOST_TYPE
from rail_sumo.highway.vehicle.host import Host
from rail_sumo.records import SECONDS_PER_STEP, Command, Lane, Scene

# Ids that no demand of a user's has; the types' are those of the two files beside this one.
TRAFFIC_TYPE, LORRY_TYPE = f"{OURS}traffic_", f"{OURS}lorry_"
"""Followed by the car-following model's name."""
MADE_CLASS = "passenger"
"""SUMO's class of both."""
ACC_TYPE = f"{OURS}acc"
ROUTE = f"{OURS}route"
DECIDES_EVERY_S = 0.5
"""How often a vehicle of the made traffic decides: its types' `actionStepLength`."""
ORDER_ROOM_M = 30.0
"""Farther than any vehicle drives in that time."""
NOTHING = Demand()

LEAVE_ENDING_LANES = 513
"""Lane-change mode: away from a lane that does not lead on, otherwise as `held.RESPECT_OTHERS_GAPS`."""

WAIT_S, GAP_WAIT_S = 120.0, 30.0
"""How long to wait for the host to enter, and of that for a gap that lets it do so at its starting speed."""
NEAR_ENTRY_M = 100.0
"""The host enters as fast as the vehicles drive that are within this distance of its entry."""


class Simulation:
    """SUMO on one network, with the vehicles that are driven, its `hosts`, once they have a course.

    libsumo holds one simulation a process, so a second one is refused while the first is open. Close it, or use it as
    a context manager.

    Args:
        net_file: the network.
        demand: the user's own traffic, additional files and options of SUMO's. What these have SUMO write is deleted
            at the end.
        begin_s: when to begin in the demand's time, in seconds.
        seed: SUMO's seed.
        outputs: further options of SUMO's, such as its own reports.
        limit_factor: what every speed limit is multiplied by.

    Raises:
        RuntimeError: a simulation is already running in this process.
        InputError: SUMO cannot load the network or the demand.
    """

    _latest_outputs: ClassVar[Outputs | None] = None
    _outputs: Outputs | None = None

    def __init__(
        self,
        net_file: Path,
        *,
        demand: Demand = NOTHING,
        begin_s: float = 0.0,
        seed: int,
        outputs: Sequence[str] = (),
        limit_factor: float = 1.0,
    ) -> None:
        self.in_demand = demand.has_traffic
        """Whether a demand drives, and no traffic need be made."""
        self._sight = Sight()
        self._held = HeldVehicles()
        self._taken_over: dict[str, Inserted] = {}
        self._routes: dict[tuple[str, ...], str] = {}
        # When hosts' courses were laid: their routes, and the number of closings; 0 of one that has heeded none yet.
        self._laid_for: dict[str, tuple[str, int]] = {}
        self.hosts: list[Host] = []
        """The vehicles that are driven; the first is `host`."""
        self.watch: Callable[[], None] | None = None
        """Called after every step, to look at what there is and change nothing."""
        options = options_of(net_file, demand, begin_s=begin_s, seed=seed)
        if demand.files:  # whatever they write is not kept, and must not overwrite what the user has
            self._outputs = Simulation._latest_outputs = Outputs(outputs, demand.written)
            options["output-prefix"] = self._outputs.prefix
        try:
            sumo_process.start(options, outputs)
        except BaseException as error:
            if self._outputs is not None:
                self._outputs.clear_away()
            if not isinstance(error, sumo_process.Refused):
                raise
            damaged = sumo_xml.first_damaged([net_file, *demand.additional, *demand.routes])
            which = f"'{damaged.name}'" if damaged else "the network or its demand"
            foreign = " Does the demand belong to this network?" if "not known" in str(error) else ""
            raise InputError(f"SUMO cannot load {which}: {error}{foreign}") from None
        self._is_open = True
        self._closings = Closings(demand.lanes_closed)
        if limit_factor != 1.0:
            for lane in libsumo.lane.getIDList():
                libsumo.lane.setMaxSpeed(lane, libsumo.lane.getMaxSpeed(lane) * limit_factor)

    def __enter__(self) -> "Simulation":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the simulation; harmless when it has ended."""
        if self._is_open:
            sumo_process.close()
            self._is_open = False
            if self._outputs is not None:
                self._outputs.close()

    @staticmethod
    def clear_away() -> None:
        """Remove what the latest simulation of this process has written and not ended, since it ends now."""
        if Simulation._latest_outputs is not None:
            Simulation._latest_outputs.clear_away()

    def lay_course(
        self, road: Road, adas: config.Adas, *, sees_m: float, host: str = HOST, shares_type: bool = False
    ) -> Host:
        """Tell where a host will drive: one more beside those that are driven already.

        Args:
            road: its course.
            adas: limits of its car-following (ACC and AEB).
            sees_m: how far from it, along either axis, a `Scene` shows vehicles.
            host: the id of its vehicle.
            shares_type: whether there will be several.
        """
        added = Host(road, adas, lambda: self.scene(added), host, self._claims, shares_type=shares_type)
        self._sight.give(host, reach_m=sees_m, is_left_hand=road.is_left_hand)
        self._edges = road.edge_of
        self.hosts.append(added)
        self.host = self.hosts[0]
        return added

    def _claims(self, name: str) -> Iterator[tuple[str, str]]:
        """Yield the driven vehicles but one that are about to move into a lane, each with that lane."""
        return ((host.name, host.aims_at) for host in self.hosts if host.aims_at and host.name != name)

    # Vehicles come and go.

    def add_vehicle(
        self,
        name: str,
        edges: Sequence[str],
        *,
        lane: int,
        front_m: float,
        desired_speed_mps: float,
        car_following: str,
        is_lorry: bool = False,
    ) -> None:
        """Insert a vehicle of the moving window on the next step, with its front at `front_m` on the first edge.

        It is left out where its lane is closed, and by SUMO where it would not be safe; look for it in the next scene.
        """
        if f"{edges[0]}_{lane}" in self.closed_to(MADE_CLASS):
            return
        self._add(name, (LORRY_TYPE if is_lorry else TRAFFIC_TYPE) + car_following, edges, lane, front_m, "desired")
        libsumo.vehicle.setSpeedFactor(name, 1.0)
        libsumo.vehicle.setMaxSpeed(name, desired_speed_mps)
        libsumo.vehicle.setLaneChangeMode(name, LEAVE_ENDING_LANES)

    def add_host(
        self,
        edges: Sequence[str],
        *,
        lane: int,
        front_m: float,
        speed_mps: float,
        fastest_mps: float = math.inf,
        as_traffic: bool = False,
    ) -> None:
        """Insert the host; it stands in the first scene after the next step unless there is no room for it.

        Where it may not drive as fast as `speed_mps`, it enters as fast as it may, and no faster than `fastest_mps`.
        With `as_traffic` it enters as fast as the vehicles drive that are there, if there are any.
        """
        ceiling_mps = min(libsumo.lane.getMaxSpeed(f"{edges[0]}_{lane}"), self.host.fastest_mps, fastest_mps)
        there_mps = self.traffic_mps(edges[0], lane, front_m) if as_traffic else None
        self._ceiling_mps = ceiling_mps if as_traffic else min(speed_mps, ceiling_mps)
        self._start = (edges, lane, front_m)
        self._enter(f"{min(speed_mps if there_mps is None else there_mps, ceiling_mps):.3f}")

    def departed(self) -> list[Inserted]:
        """Return the vehicles that have been inserted in the last step; not those that park."""
        return inserted.read(libsumo.simulation.getDepartedIDList())

    def seen(self, name: str) -> Inserted | None:
        """Return a vehicle as it is now; None if it is on no edge of the road."""
        on_road = name in libsumo.vehicle.getIDList()
        return next(iter(inserted.read([name])), None) if on_road else None

    def take_over(self, car: Inserted) -> None:
        """Make a vehicle that has just been inserted the last of the hosts: as large as it is, and on its route."""
        host = self.hosts[-1]
        libsumo.vehicle.setType(car.name, HOST_TYPE)
        host.become(car.own, speed_mps=car.speed_mps, fastest_mps=car.fastest_mps)
        host.take_over(car.speed_mps)
        self._begin(host)
        self._held.forget(car.name)
        self._taken_over[car.name] = car

    def hand_back(self, host: Host) -> None:
        """Let SUMO's own driver drive a vehicle again, as the one that it was."""
        car = self._taken_over[host.name]
        host.let_go(car.kind, speed_factor=car.speed_factor)
        self._forget(host)

    def give_acc(self, car: Inserted) -> None:
        """Have SUMO drive a vehicle that has just been inserted by its own model of adaptive cruise control."""
        libsumo.vehicle.setType(car.name, ACC_TYPE)
        for what, value in {**car.own, "MaxSpeed": car.fastest_mps, "SpeedFactor": car.speed_factor}.items():
            getattr(libsumo.vehicle, f"set{what}")(car.name, value)

    def _enter(self, speed: str) -> None:
        self._add(self.host.name, HOST_TYPE, *self._start, speed)
        self.host.take_over(self._ceiling_mps)

    def _add(self, name: str, kind: str, edges: Sequence[str], lane: int, front_m: float, speed: str) -> None:
        route = tuple(edges)
        if route not in self._routes:
            self._routes[route] = f"{ROUTE}{len(self._routes)}"
            libsumo.route.add(self._routes[route], list(route))
        libsumo.vehicle.add(
            name, self._routes[route], kind, departLane=str(lane), departPos=f"{front_m:.2f}", departSpeed=speed
        )

    def remove_vehicle(self, name: str) -> None:
        """Take a vehicle off the road; it may be one of the hosts, but not `host`."""
        libsumo.vehicle.remove(name)
        self._sight.forget(name)
        for driven in [host for host in self.hosts if host.name == name]:
            self._forget(driven)

    def lane_beside(self, name: str, side: int) -> int | None:
        """Return the lane to a vehicle's left (+1) or right (-1) that it could be ordered into.

        None if there is none, the vehicle is off the course, or it soon leaves its edge: SUMO crashes over an order
        that still holds on the next.
        """
        edge = self._edges.get(libsumo.vehicle.getRoadID(name))
        lane = libsumo.vehicle.getLaneIndex(name) + side
        if edge is None or lane not in edge.lanes:
            return None
        return lane if libsumo.vehicle.getLanePosition(name) < edge.length_m - ORDER_ROOM_M else None

    def order_lane_change(self, name: str, lane: int) -> None:
        """Tell a vehicle of the made traffic to change to a lane when it next decides; it does if the gap is safe."""
        libsumo.vehicle.changeLane(name, lane, DECIDES_EVERY_S)

    def on_road(self) -> set[str]:
        """Return the names of all vehicles that have been inserted and have not arrived."""
        return set(libsumo.vehicle.getIDList())

    def lanes(self) -> dict[str, Lane]:
        """Return every lane, junctions' insides too, by its id."""
        get = libsumo.lane
        allowed = {name: get.getAllowed(name) for name in get.getIDList()}  # nobody named: everybody
        return {
            name: Lane(
                get.getLength(name),
                get.getMaxSpeed(name),
                is_open=not classes or not CARS.isdisjoint(classes),
                has_priority={state for *_, state, _, _ in get.getLinks(name)} == {MAJOR},
            )
            for name, classes in allowed.items()
        }

    @property
    def n_on_road(self) -> int:
        """How many vehicles are on the road."""
        return libsumo.vehicle.getIDCount()

    def odometers_m(self) -> dict[str, float]:
        """Return the odometer of every vehicle on the road: metres driven since its insertion."""
        read = libsumo.vehicle.getDistance
        return {name: read(name) for name in libsumo.vehicle.getIDList()}

    def traffic_mps(self, edge: str, lane: int, front_m: float) -> float | None:
        """Return the mean speed of the vehicles within `NEAR_ENTRY_M` of a place on a lane; None if there are none."""
        vehicle = libsumo.vehicle
        near = [
            vehicle.getSpeed(name)
            for name in libsumo.lane.getLastStepVehicleIDs(f"{edge}_{lane}")
            if abs(vehicle.getLanePosition(name) - front_m) < NEAR_ENTRY_M
        ]
        return fmean(near) if near else None

    def wait_for_host(self) -> None:
        """Let the traffic drive until the host has entered.

        Where SUMO does not let it start so fast, as just before a red light, it enters as fast as it can: at once in a
        window, from which SUMO leaves it out; in the user's own demand after waiting `GAP_WAIT_S` for a larger gap.

        Raises:
            InputError: it has not entered within `WAIT_S`.
        """
        slower = False
        for number in range(round(WAIT_S / SECONDS_PER_STEP)):
            if number == round(GAP_WAIT_S / SECONDS_PER_STEP) and not slower:
                libsumo.vehicle.remove(self.host.name)
            if number and self.host.name not in libsumo.simulation.getPendingVehicles():
                slower = True
                self._enter("max")
                self.host.abilities.hold_below(self._ceiling_mps)
            with sumo_process.silenced():  # a host that cannot enter so fast enters more slowly
                libsumo.simulation.step()
            if self.host.name in libsumo.simulation.getDepartedIDList():
                break
        else:
            edges, lane, front_m = self._start
            raise InputError(
                f"the host could not enter within {WAIT_S:.0f} s, {front_m:.0f} m along lane {lane} of edge "
                f"'{edges[0]}'; use a lighter demand, or begin elsewhere by network.course"
            )
        if slower:
            self.host.abilities.hold_below(self.host.fastest_mps)
        self._begin(self.host)

    def _begin(self, host: Host) -> None:
        host.begin()
        self._laid_for[host.name] = libsumo.vehicle.getRouteID(host.name), 0

    # Its way changes.

    def way_has_changed(self, host: Host) -> bool:
        """Whether SUMO has given a host another route, or closed or opened lanes, since its course was laid."""
        return self._laid_for[host.name] != self._way_now(host)

    def note_way(self, host: Host) -> None:
        """Note that a host's course is laid for its present way, as far as it can be."""
        self._laid_for[host.name] = self._way_now(host)

    def _way_now(self, host: Host) -> tuple[str, int]:
        return libsumo.vehicle.getRouteID(host.name), self._closings.number

    def closed_to(self, vclass: str) -> frozenset[str]:
        """Return the lanes that are closed to a class of vehicles now, of those that the demand closes for a time."""
        return self._closings.to(vclass)

    # What is around the host.

    def scene(self, host: Host | None = None, *, sees_m: float | None = None) -> Scene:
        """Return a host and every vehicle within its reach, or that of `sees_m`, east or west, north or south.

        See `Sight.scene`.
        """
        return self._sight.scene((host or self.host).name, reach_m=sees_m)

    @staticmethod
    def class_of(name: str) -> str:
        """Return a vehicle's class, by SUMO's name for it."""
        vclass: str = libsumo.vehicle.getVehicleClass(name)
        return vclass

    @staticmethod
    def signals() -> dict[str, str]:
        """Return what every traffic light shows, a letter for each of its links."""
        show = libsumo.trafficlight.getRedYellowGreenState
        return {light: show(light) for light in libsumo.trafficlight.getIDList()}

    # Time goes on.

    def run(self, command: Command, step: Callable[[], None] | None = None) -> int:
        """Carry a command to `host` out and return the number of steps driven.

        They are fewer than asked where the host collides, its way changes, or it has to look again at a junction ahead;
        and where it arrives, the step that takes it off the road not counted.

        Args:
            command: what it is to do.
            step: drives one step, where others are driven too.
        """
        self.obey(self.host, command)
        step = step or self._step
        for driven in range(1, command.steps + 1):
            step()
            if self.has_arrived:
                return driven - 1
            if self.host.contact or self.host.junctions.must_look or self.way_has_changed(self.host):
                return driven
        return command.steps

    def obey(self, host: Host, command: Command) -> None:
        """Have a host carry a command out in the next step and those after it."""
        holds = self._held.are_held_by(host.name)
        if bool(command.lateral_m) != holds:
            self._held.release(host.name) if holds else self._hold(host)
        host.obey(command)

    def _step(self) -> None:
        """Let SUMO drive one step, and note the hosts' speeds, leaders and contacts."""
        self._move()
        if not self.has_arrived:
            self._note()

    @property
    def has_arrived(self) -> bool:
        """Whether a host of the demand has been taken off the road in the last step, as where its trip ends."""
        return self.in_demand and self.host.name in libsumo.simulation.getArrivedIDList()

    def step(self) -> list[str]:
        """Do the same where hosts may leave the road, and return which have."""
        self._move()
        self._sight.notice()
        gone = {*libsumo.simulation.getArrivedIDList(), *self.teleporting()}
        left = [host for host in self.hosts if host.name in gone]
        for host in left:
            self._forget(host)
        self._note()
        return [host.name for host in left]

    def _move(self) -> None:
        for host in self.hosts:
            host.drive()
        libsumo.simulation.step()

    def _note(self) -> None:
        self._closings.notice()
        for host in self.hosts:
            host.note()
        if self.watch is not None:
            self.watch()

    def teleporting(self) -> Sequence[str]:
        """Return who has been taken off the road in the last step, to be put on again elsewhere."""
        names: Sequence[str] = libsumo.simulation.getStartingTeleportIDList()
        return names

    def _forget(self, host: Host) -> None:
        self.hosts.remove(host)
        del self._taken_over[host.name], self._laid_for[host.name]
        self._sight.forget(host.name)
        self._held.release(host.name)

    def _hold(self, host: Host) -> None:
        """Keep everyone near from changing lanes while a host does; other hosts know of it by its claim."""
        driven = {one.name for one in self.hosts}
        self._held.hold((name for name in self.scene(host).ids[1:] if name not in driven), host.name)

    @property
    def now_s(self) -> float:
        """The demand's time."""
        return libsumo.simulation.getTime()

    def long_reds(self) -> dict[str, tuple[float, list[str]]]:
        """Return for which traffic lights somebody waits for very long, how long, and on which edges."""
        return signals.long_reds(self.lanes())

    @property
    def n_waiting(self) -> int:
        """How many vehicles are due to depart, and find no room yet."""
        return len(libsumo.simulation.getPendingVehicles())

    def routes_m(self) -> list[float]:
        """Return how long each of the routes is that anybody drives now."""
        routes = {tuple(libsumo.vehicle.getRoute(name)) for name in libsumo.vehicle.getIDList()}
        return [sum(libsumo.lane.getLength(f"{edge}_0") for edge in route) for route in routes]

    def edges_awaited(self) -> Iterator[str]:
        """Yield the edges of the routes of those who are due to depart, and find no room yet."""
        for name in libsumo.simulation.getPendingVehicles():
            yield from libsumo.vehicle.getRoute(name)

    @property
    def expects_vehicles(self) -> bool:
        """Whether anybody is on the road or yet to depart."""
        return libsumo.simulation.getMinExpectedNumber() > 0

    def run_until(self, time_s: float) -> None:
        """Let the traffic drive until a time, before the host is watched; not at all if it has passed."""
        if time_s > self.now_s:
            libsumo.simulation.step(time_s)

    def run_without_host(self, seconds: float) -> None:
        """Let the traffic drive, for one step at least, before the host is watched."""
        libsumo.simulation.step(libsumo.simulation.getTime() + max(seconds, SECONDS_PER_STEP))
