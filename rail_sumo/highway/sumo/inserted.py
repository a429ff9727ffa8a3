"""A vehicle as SUMO has inserted it, and the properties that it keeps under any driver."""

from collections.abc import Iterable
from dataclasses import dataclass

import libsumo

from rail_sumo.highway.names import CARS
from rail_sumo.highway.vehicle.whereabouts import way_of


@dataclass(frozen=True, slots=True)
class Inserted:
    """A vehicle as it is when SUMO has inserted it."""

    name: str
    vclass: str
    """SUMO's class."""
    edges: tuple[str, ...]
    """Of its route, from where it has been inserted on."""
    lane: int
    front_m: float
    speed_mps: float
    length_m: float
    width_m: float
    kind: str
    """The id of its type."""
    speed_factor: float
    fastest_mps: float
    emission_class: str

    @property
    def own(self) -> dict[str, str | float]:
        """The properties that it keeps when a host or ACC takes it over, by the names of SUMO's setters."""
        return {
            "VehicleClass": self.vclass,  # or lanes for its class alone would be closed to it
            "Length": self.length_m,
            "Width": self.width_m,
            "EmissionClass": self.emission_class,
        }

    @property
    def is_car(self) -> bool:
        """Whether it drives as a car does."""
        return self.vclass in CARS


def read(names: Iterable[str]) -> list[Inserted]:
    """Return some of the vehicles that are on the road, as they are now; not those that park."""
    get = libsumo.vehicle
    return [
        Inserted(
            name,
            get.getVehicleClass(name),
            tuple(way_of(name)),
            lane=get.getLaneIndex(name),
            front_m=get.getLanePosition(name),
            speed_mps=get.getSpeed(name),
            length_m=get.getLength(name),
            width_m=get.getWidth(name),
            kind=get.getTypeID(name),
            speed_factor=get.getSpeedFactor(name),
            fastest_mps=get.getMaxSpeed(name),
            emission_class=get.getEmissionClass(name),
        )
        for name in names
        if get.getRoadID(name) == way_of(name)[0]
    ]
