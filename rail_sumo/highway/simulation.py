"""The one libsumo process: Scene out, Command in. SUMO's facts are converted once, here and in `host`."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import libsumo
import numpy as np

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway import placing, sumo_process
from rail_sumo.highway.host import HOST_TYPE, Host
from rail_sumo.highway.names import HOST, OURS
from rail_sumo.highway.network.demand import Demand
from rail_sumo.highway.network.road import Road
from rail_sumo.records import SECONDS_PER_STEP, Command, Scene

# Ids that no demand of a user's has; the types' are those of the two files below.
TRAFFIC_TYPE, LORRY_TYPE = f"{OURS}traffic_", f"{OURS}lorry_"
"""Followed by the car-following model's name."""
ROUTE = f"{OURS}route"
DECIDES_EVERY_S = 0.5
"""How often a vehicle of the made traffic decides: its types' `actionStepLength`."""
ORDER_ROOM_M = 30.0
"""Farther than any vehicle drives in that time."""
HOST_TYPES = Path(__file__).with_name("host.add.xml")
TRAFFIC_TYPES = Path(__file__).with_name("traffic.add.xml")
"""The types as SUMO has them by default, whatever a user's demand says of its default. The made traffic decides every
0.5 s, which halves what it costs, and brakes by 3 m/s², which calms it. Its types are kept away from a user's demand:
one type with an `actionStepLength` of its own, though nobody is of it, makes SUMO drive everybody differently."""

OUR_OPTIONS = {
    "step-length": SECONDS_PER_STEP,
    "collision.action": "warn",
    "collision.mingap-factor": 0,
    "collision.check-junctions": "true",
    "no-step-log": "true",
    "no-warnings": "true",
    "xml-validation": "never",
}
"""What SUMO is always told: contacts are counted and not removed, and nothing is said."""
MADE_TRAFFIC_OPTIONS = {"time-to-teleport": -1, "max-depart-delay": 0}
"""What it is told beside these of a window's traffic: a vehicle enters at once or not at all, and never teleports."""
NOTHING = Demand()

RESPECT_OTHERS_GAPS = 512
"""Lane-change mode: no change of its own accord; a commanded one waits for a gap that is safe to others."""
LEAVE_ENDING_LANES = 513
"""Lane-change mode: the same, but away from a lane that does not lead on."""

SEEDS = 2**31
"""SUMO takes seeds below this."""
WAIT_S, GAP_WAIT_S = 120.0, 30.0
"""How long to wait for the host to enter, and of that for a gap that lets it do so at its starting speed."""
NEAR_ENTRY_M = 100.0
"""The host enters as fast as the vehicles drive that are within this distance of its entry."""
CARS = frozenset({"passenger", "private", "taxi", "evehicle", "hov", "vip", "custom1", "custom2", "ignoring"})
"""SUMO's vehicle classes of what drives as a car does."""
STOREY_M = 3.0
"""Vehicles farther above or below drive on another road, as on a bridge."""


@dataclass(frozen=True, slots=True)
class Inserted:
    """A vehicle of the demand, where SUMO has inserted it."""

    name: str
    vclass: str
    """SUMO's class."""
    edges: tuple[str, ...]
    """Of its route."""
    lane: int
    front_m: float
    speed_mps: float
    length_m: float
    width_m: float

    @property
    def is_car(self) -> bool:
        """Whether it drives as a car does."""
        return self.vclass in CARS


class Simulation:
    """SUMO on one network, with one host vehicle, its `host`, once it has a course.

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
        self._sizes: dict[str, tuple[float, float]] = {}
        self._routes: dict[tuple[str, ...], str] = {}
        self._held: dict[str, int] = {}  # vehicles kept from changing lanes, and their own lane-change modes
        self._prefix = f"{OURS}{os.getpid()}_"
        self._written = demand.folders_written
        self._outputs = outputs
        types = (HOST_TYPES,) if demand.has_traffic else (HOST_TYPES, TRAFFIC_TYPES)
        options = {
            "net-file": net_file,
            "additional-files": ",".join(map(str, (*types, *demand.additional))),
            "begin": begin_s,
            **({} if demand.has_traffic else MADE_TRAFFIC_OPTIONS),
            **demand.options,
            **OUR_OPTIONS,
            "seed": seed % SEEDS,
        }
        if demand.routes:
            options["route-files"] = ",".join(map(str, demand.routes))
        if demand.files:  # whatever they write is not kept, and must not overwrite what the user has
            options["output-prefix"] = self._prefix
        try:
            sumo_process.start(options, outputs)
        except sumo_process.Refused as error:
            raise InputError(f"SUMO cannot load the network or its demand: {error}") from None
        self._is_open = True
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
            for asked in map(Path, filter(None, self._outputs)):
                written = asked.with_name(f"{self._prefix}{asked.name}")
                if written.exists():
                    written.replace(asked)
            for folder in self._written:
                for report in folder.glob(f"{self._prefix}*"):
                    report.unlink(missing_ok=True)

    def lay_course(self, road: Road, adas: config.Adas, *, sees_m: float, host: str = HOST) -> None:
        """Tell where the host will drive.

        Args:
            road: its course.
            adas: limits of its car-following (ACC and AEB).
            sees_m: how far from it, along either axis, a `Scene` shows vehicles.
            host: the id of its vehicle.
        """
        self.host = Host(road, adas, self.scene, host)
        self._edges = road.edge_of
        self._is_left_hand = road.is_left_hand
        self._context_m = sees_m

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

        SUMO leaves it out where it would not be safe; look for it in the next scene.
        """
        self._add(name, (LORRY_TYPE if is_lorry else TRAFFIC_TYPE) + car_following, edges, lane, front_m, "desired")
        libsumo.vehicle.setSpeedFactor(name, 1.0)
        libsumo.vehicle.setMaxSpeed(name, desired_speed_mps)
        libsumo.vehicle.setLaneChangeMode(name, LEAVE_ENDING_LANES)

    def add_host(
        self, edges: Sequence[str], *, lane: int, front_m: float, speed_mps: float, as_traffic: bool = False
    ) -> None:
        """Insert the host; it stands in the first scene after the next step unless there is no room for it.

        Where it may not drive as fast as `speed_mps`, it enters as fast as it may. With `as_traffic` it enters as fast
        as the vehicles drive that are there, if there are any.
        """
        ceiling_mps = min(libsumo.lane.getMaxSpeed(f"{edges[0]}_{lane}"), self.host.fastest_mps)
        there_mps = self.traffic_mps(edges[0], lane, front_m) if as_traffic else None
        self._ceiling_mps = ceiling_mps if as_traffic else min(speed_mps, ceiling_mps)
        self._start = (edges, lane, front_m)
        self._enter(f"{min(speed_mps if there_mps is None else there_mps, ceiling_mps):.3f}")

    def departed(self) -> list["Inserted"]:
        """Return the demand's vehicles that have been inserted in the last step, at the beginning of their route."""
        get = libsumo.vehicle
        return [
            Inserted(
                name,
                get.getVehicleClass(name),
                tuple(get.getRoute(name)),
                lane=get.getLaneIndex(name),
                front_m=get.getLanePosition(name),
                speed_mps=get.getSpeed(name),
                length_m=get.getLength(name),
                width_m=get.getWidth(name),
            )
            for name in libsumo.simulation.getDepartedIDList()
            if get.getRoadID(name) == get.getRoute(name)[0]
        ]

    def take_over(self, car: "Inserted") -> None:
        """Make a vehicle of the demand that has just been inserted the host: as large as it is, and on its route."""
        types = libsumo.vehicletype
        types.setVehicleClass(HOST_TYPE, car.vclass)  # or lanes for its class alone would be closed to it
        types.setLength(HOST_TYPE, car.length_m)
        types.setWidth(HOST_TYPE, car.width_m)
        libsumo.vehicle.setType(car.name, HOST_TYPE)
        types.setMaxSpeed(HOST_TYPE, max(self.host.fastest_mps, car.speed_mps))  # or SUMO would brake it hard
        self.host.take_over(car.speed_mps)
        self.host.begin()

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
        """Take a vehicle off the road."""
        libsumo.vehicle.remove(name)
        self._sizes.pop(name, None)

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
                self.host.hold_below(self._ceiling_mps)
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
            self.host.hold_below(self.host.fastest_mps)
        self.host.begin()

    # What is around the host.

    def scene(self) -> Scene:
        """Return the host and every vehicle within the context's reach, east or west, north or south.

        Vehicles on a bridge above or below are left out. On a road that is driven on the left it is told in the mirror;
        see `Road.is_left_hand`.
        """
        # Getters, not a context subscription: a standing one costs half a step more on every step, and one made for a
        # single look costs more than all the getters together.
        position, angle, speed = libsumo.vehicle.getPosition3D, libsumo.vehicle.getAngle, libsumo.vehicle.getSpeed
        sizes, reach = self._sizes, self._context_m
        host_x, host_y, host_z = position(self.host.name)
        names, rows = (
            [self.host.name],
            [
                host_x,
                host_y,
                angle(self.host.name),
                speed(self.host.name),
                *(sizes.get(self.host.name) or self._size(self.host.name)),
            ],
        )
        for name in libsumo.vehicle.getIDList():
            x, y, z = position(name)
            if -reach < x - host_x < reach and -reach < y - host_y < reach and name != self.host.name:
                if abs(z - host_z) >= STOREY_M:
                    continue
                names.append(name)
                rows += (x, y, angle(name), speed(name), *(sizes.get(name) or self._size(name)))
        vehicles = np.fromiter(rows, np.float64).reshape(len(names), -1)
        if self._is_left_hand:  # told in the mirror
            vehicles[:, 1] *= -1.0
            vehicles[:, 2] = 180.0 - vehicles[:, 2]
        return Scene(libsumo.simulation.getTime(), names, placing.boxes(vehicles))

    def _size(self, name: str) -> tuple[float, float]:
        self._sizes[name] = (libsumo.vehicle.getLength(name), libsumo.vehicle.getWidth(name))
        return self._sizes[name]

    # Time goes on.

    def run(self, command: Command) -> int:
        """Carry a command out and return the number of steps driven.

        They are fewer than asked where the host collides, or has to look again at a junction ahead.
        """
        if bool(command.lateral_m) != bool(self._held):
            self._release() if self._held else self._hold()
        self.host.obey(command)
        for driven in range(1, command.steps + 1):
            self._step()
            if self.host.contact or self.host.must_look:
                return driven
        return command.steps

    def _step(self) -> None:
        """Let SUMO drive one step, and note the host's speed, leader and contacts."""
        self.host.drive()
        libsumo.simulation.step()
        self.host.note()

    def _hold(self) -> None:
        """Keep everyone near from changing lanes while the host does.

        SUMO knows the host in one lane only. Its own drivers would move in beside the part of it that still stands in
        the lane it has crossed out of.
        """
        for name in self.scene().ids[1:]:
            self._held[name] = libsumo.vehicle.getLaneChangeMode(name)
            libsumo.vehicle.setLaneChangeMode(name, RESPECT_OTHERS_GAPS)

    def _release(self) -> None:
        for name in sorted(self._held.keys() & self.on_road()):
            libsumo.vehicle.setLaneChangeMode(name, self._held[name])
        self._held = {}

    @property
    def now_s(self) -> float:
        """The demand's time."""
        return libsumo.simulation.getTime()

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


def floating_car_data(file: Path, *, reach_m: float) -> tuple[str, ...]:
    """Return the options that have SUMO write, on every step, where the host is and who is within reach of it.

    Parquet, CSV or XML, by the file's suffix. `HOST` in them stands for whatever the host's id is.
    """
    columns = "x,y,angle,type,speed,acceleration,lane,pos,odometer"
    return (
        *("--fcd-output", str(file), "--fcd-output.attributes", columns),
        *("--device.fcd.explicit", HOST, "--device.fcd.radius", str(reach_m)),
    )
