"""Many driven vehicles in one simulation: a share of the demand's cars."""

import hashlib
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from rail_sumo import assets
from rail_sumo.config import Config
from rail_sumo.errors import CourseError, InputError
from rail_sumo.highway import sumo_process
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.network.demand import Demand
from rail_sumo.highway.sumo.inserted import Inserted
from rail_sumo.highway.sumo.options import options_of
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic import entry
from rail_sumo.highway.traffic.rides import Decide, Ride, Rides
from rail_sumo.records import SECONDS_PER_STEP, Lane

Instead = Literal["nothing", "acc"]
"""What a vehicle of the share gets in place of a driver: nothing, or SUMO's own adaptive cruise control."""

_HASH_BYTES = 8


def is_driven(vehicle: str, share: float, seed: int) -> bool:
    """Return whether a vehicle is among a share of all: those at 25 % are among those at 50 %.

    It is if the hash of the seed and its id, as a fraction of all hashes, is below the share.
    """
    digest = hashlib.blake2b(f"{seed}:{vehicle}".encode(), digest_size=_HASH_BYTES).digest()
    return int.from_bytes(digest, "big") < share * 2 ** (8 * _HASH_BYTES)


def demand_of(world: Config) -> Demand:
    """Return the demand that a share may be of.

    Raises:
        InputError: there is none, or worlds are to vary.
    """
    if world.varied.networks:
        raise InputError("a share is of the cars of one demand; leave out varied.networks")
    own = demand.read(world.traffic)
    if not own.has_traffic:
        files = ", ".join((*world.traffic.routes, *world.traffic.additional))
        none = f"no vehicle is in {files}" if files else "there is none; name its files with --routes, or a .sumocfg"
        raise InputError(f"a share is of the cars of a demand, and {none}")
    return own


def sumo_command(world: Config, seed: int) -> str:
    """Return the command that has SUMO drive a demand as a fleet without driven cars does, to be run without us.

    `network.limit_factor` is not in it.
    """
    net_file, begin_s = assets.network(world.network.file), world.traffic.begin_s
    options = options_of(net_file, demand_of(world), begin_s=begin_s, seed=seed)
    return shlex.join(["sumo", *(word for name, value in options.items() for word in (f"--{name}", str(value)))])


@dataclass
class Fleet:
    """A demand of which a share of the cars is driven, from its beginning on.

    Vehicles keep their departure, route, class and size. What a driven one does is what a single host would do: it
    decides every `episode.decision_period_s` from its own entry, and whenever a lane change ends, until it
    arrives. After a contact SUMO drives it on as before.

    Args:
        world: network, demand, and how vehicles sense and drive.
        share: of the cars, 0 to 1.
        seed: of the traffic, and of which cars are driven.
        driver: returns what decides for a vehicle, by its id; or what it gets instead.
        outputs: further options of SUMO's, such as those of its own reports.
    """

    world: Config
    share: float
    seed: int
    driver: Callable[[str], Decide] | Instead
    outputs: Sequence[str] = ()

    def __post_init__(self) -> None:
        self.driven: set[str] = set()
        """The ids of those that were of the share and could be driven."""
        self.undriven: dict[str, str] = {}
        """Those of the share that SUMO drove all the way, and why."""
        self.contacts = 0
        """How often a driven vehicle struck another or was struck."""
        self.struck_another = 0
        """How often a driven vehicle was the one that struck."""
        self.decisions = 0
        """How many its drivers have taken."""
        self.inserted: dict[str, Inserted] = {}
        """Everybody who has been put on the road, by id."""
        self.edges: set[str] = set()
        """Those that the routes lead over of everybody who was due by the end, though there were no room to enter."""
        self.lanes: dict[str, Lane] = {}
        """By their id, whatever the class that they are open to."""
        self.kinds_of_cars: set[str] = set()
        """The vehicle types of the cars among them. SUMO is not asked for others: it would draw from distributions."""
        self.teleported: list[tuple[float, str]] = []
        """Who was taken off the road to be put on again elsewhere, and when."""
        self._world = self.world.practice(math.inf)

    @sumo_process.as_input_errors
    def drive(self, until_s: float) -> list[int]:
        """Let the demand drive until a time; returns how many vehicles were on the road, a second apart.

        Raises:
            InputError: there is no demand, worlds are to vary, or SUMO gives up.
        """
        own = demand_of(self.world)
        road.require_readable(self.world.network.file)
        begin_s = self.world.traffic.begin_s
        on_road = []
        with Simulation(
            assets.network(self.world.network.file),
            demand=own,
            begin_s=begin_s,
            seed=self.seed,
            outputs=self.outputs,
            limit_factor=self.world.network.limit_factor,
        ) as simulation:
            self.lanes = simulation.lanes()
            everybody = Rides(simulation, self._world, keeps_trajectory=False, until_arrival=True)
            for number in range(round((until_s - begin_s) / SECONDS_PER_STEP)):
                self._step(simulation, everybody)
                if number % round(1.0 / SECONDS_PER_STEP) == 0:
                    on_road.append(simulation.n_on_road)
            for ride in everybody.rides.values():
                self._count(ride)
            self.edges.update(simulation.edges_awaited())
        return on_road

    def _step(self, simulation: Simulation, everybody: Rides) -> None:
        for gone in everybody.drive():
            self._count(gone)
        self.teleported += [(simulation.now_s, name) for name in simulation.teleporting()]
        for car in simulation.departed():
            self.inserted[car.name] = car
            self.edges.update(car.edges)
            if car.is_car:
                self.kinds_of_cars.add(car.kind)
            if self.is_of_the_share(car.name, car.kind):
                self._enter(simulation, everybody, car)

    def is_of_the_share(self, vehicle: str, kind: str, share: float | None = None) -> bool:
        """Return whether a vehicle, by its id and its type's, is among the cars of a share; by default the fleet's."""
        return kind in self.kinds_of_cars and is_driven(vehicle, self.share if share is None else share, self.seed)

    def _enter(self, simulation: Simulation, everybody: Rides, car: Inserted) -> None:
        if self.driver == "nothing":
            self.driven.add(car.name)
            return
        if self.driver == "acc":
            simulation.give_acc(car)
            self.driven.add(car.name)
            return
        try:
            entry.require_along_course(car, self._world)
            everybody.enter(car, self.driver(car.name))
        except CourseError as error:  # too short, or not on lanes that a host may use
            self.undriven[car.name] = str(error)
            return
        self.driven.add(car.name)

    def _count(self, ride: Ride) -> None:
        self.contacts += ride.contacts
        self.struck_another += ride.agent.host.collisions
        self.decisions += ride.decisions
