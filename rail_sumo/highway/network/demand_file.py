"""One file of a user's demand, and what it says: who departs when, of which types, under which ids."""

import math
import re
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from rail_sumo.errors import InputError
from rail_sumo.highway.names import CARS, OURS
from rail_sumo.highway.network.sumo_xml import elements, is_configuration, seconds, state_of

TRAFFIC_ELEMENTS = ("vehicle", "flow", "trip")
"""Elements that put somebody on the road."""

NETWORK = "net"
"""The root of a network, which has elements of an additional file's too."""
TYPES = ("vType", "vTypeDistribution")
"""Elements that say what vehicles are like."""
DEFAULT_TYPE, DEFAULT_CLASS = "DEFAULT_VEHTYPE", "passenger"
"""The type of a vehicle that names none, and the class of a type that names none."""

ADDITIONAL = frozenset({
    "busStop", "trainStop", "containerStop", "chargingStation", "parkingArea", "rerouter", "variableSpeedSign",
    "calibrator", "vaporizer", "tlLogic", "inductionLoop", "e1Detector", "laneAreaDetector", "e2Detector",
    "entryExitDetector", "e3Detector", "instantInductionLoop", "routeProbe", "edgeData", "laneData", "poly", "poi",
    "timedEvent", "WAUT",
})  # fmt: skip
"""Elements that SUMO passes over in route files, and reads from additional files."""

KNOWN = ADDITIONAL | frozenset({
    *TRAFFIC_ELEMENTS, *TYPES, "routes", "additional", "route", "routeDistribution", "person",
    "personFlow", "container", "containerFlow", "include", "taz", "interval", "type",
})  # fmt: skip
"""Elements of which a file of SUMO's has some."""

UNNAMED = frozenset({"calibrator", "person", "personFlow"})
"""Elements for which SUMO may make vehicles, with ids of its own."""
OUTPUTS = ("file", "output", "dest")
"""Attributes that name a file to be written."""
LONGEST_CAR_M = 8.0
"""What is longer is no car, though its type names no class and SUMO takes it for one."""
DENSEST_FLOW_PER_S = 1000.0
"""No road takes as many vehicles; SUMO would make them all and never come to an end."""
NORMAL = re.compile(r"normc?\(\s*([^,]+),([^,)]+)")
"""A speed factor that is drawn: its mean and its deviation."""
CARS_DEVIATION = "0.1"
"""SUMO's deviation of the speed factors of cars, where their type gives none."""
OUTPUT_PARAMETER = ".file"
"""What the keys of parameters end with that do, as `device.ssm.file`."""


@dataclass(slots=True)
class DemandFile:
    """What a file says."""

    misplaced: str = ""
    """An element that SUMO reads from additional files only, if there is one."""
    reserved: str = ""
    """An id that is ours, if there is one."""
    out_of_order: list[str] = field(default_factory=list)
    """Ids of those that depart before one that stands before them."""
    includes: list[str] = field(default_factory=list)
    """Files that are to be read in its place."""
    outputs: list[str] = field(default_factory=list)
    """Names of files that it has SUMO write, and of some that it has SUMO read."""
    vehicles: set[str] = field(default_factory=set)
    """Ids of vehicles and trips."""
    flows: dict[str, float] = field(default_factory=dict)
    """How many vehicles a flow has at most, by its id, where they are not multiplied; inf where it does not tell."""
    types: dict[str, str] = field(default_factory=dict)
    """Classes of vehicle types, by their ids; of distributions, as if they were of cars."""
    long_cars: dict[str, float] = field(default_factory=dict)
    """Lengths of types without a class that are longer than a car, by their ids."""
    following: dict[str, dict[str, float]] = field(default_factory=dict)
    """What types of cars tell of how they follow, `tau` and `accel`, by their ids."""
    wishes: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Mean and deviation of the speed factors of types of cars, by their ids, where they tell of them."""
    kinds: set[str] = field(default_factory=set)
    """Ids of the types that vehicles are of."""
    closed_lanes: set[str] = field(default_factory=set)
    """Ids of lanes that rerouters close for a time."""
    may_have_more: bool = False
    """Whether SUMO may make vehicles for it with other ids than these, or more of them than it says."""
    too_dense: str = ""
    """The id of a flow that has more vehicles than any road takes, if there is one."""
    is_known: bool = False
    """Whether there is any element of those that files of SUMO's have."""
    _first_s: float = math.inf
    _latest_s: float = 0.0  # when the vehicle before departs, ...
    _last_s: float = -math.inf  # ... or the last of a flow

    @property
    def departures_s(self) -> tuple[float, float] | None:
        """The first and the last; None if it puts nobody on the road."""
        return (self._first_s, self._last_s) if self._first_s <= self._last_s else None

    def note(self, element: ElementTree.Element) -> None:
        """Note what one more of its elements says."""
        tag, name = element.tag, element.get("id", "")
        self.is_known = self.is_known or tag in KNOWN
        if name.startswith(OURS):
            self.reserved = self.reserved or name
        if tag in ADDITIONAL:
            self.misplaced = self.misplaced or tag
        if tag in UNNAMED:
            self.may_have_more = True
        if tag in TYPES:
            self.types[name] = element.get("vClass", DEFAULT_CLASS)
            self.may_have_more = self.may_have_more or "scale" in element.attrib
            with suppress(ValueError):
                length_m = float(element.get("length", "0"))
                if "vClass" not in element.attrib and length_m > LONGEST_CAR_M:
                    self.long_cars[name] = length_m
            if self.types[name] in CARS:
                self.following[name] = _numbers(element, "tau", "accel")
                with suppress(ValueError):
                    self.wishes[name] = _wish(element)
        if tag == "closingLaneReroute":
            self.closed_lanes.add(name)
        if tag == "include":
            self.includes.append(element.get("href", ""))
        self.outputs += filter(None, map(element.get, OUTPUTS))
        if tag == "param" and element.get("key", "").endswith(OUTPUT_PARAMETER):
            self.outputs.append(element.get("value", ""))
        if tag in TRAFFIC_ELEMENTS:
            self._note_traffic(element, name)

    def _note_traffic(self, element: ElementTree.Element, name: str) -> None:
        """Note a vehicle, a trip or a flow."""
        self.kinds.add(element.get("type", DEFAULT_TYPE))
        departs_s, ends_s = _departures_s(element, otherwise=self._latest_s)
        if element.tag == "flow":
            rate_per_s = _rate_per_s(element, ends_s - departs_s)
            if rate_per_s > DENSEST_FLOW_PER_S:
                self.too_dense = self.too_dense or name
            self.flows[name] = _at_most(element, rate_per_s, ends_s - departs_s)
        else:
            self.vehicles.add(name)
        if departs_s < self._latest_s:
            self.out_of_order.append(name)
        self._latest_s = max(self._latest_s, departs_s)
        self._first_s, self._last_s = min(self._first_s, departs_s), max(self._last_s, ends_s)


def read(path: Path) -> DemandFile:
    """Return what a file says; one that has not changed since is not read again.

    Raises:
        InputError: it is no whole XML, none of SUMO's demand, or has a flow that no road takes.
    """
    return _read(path, state_of(path))


@cache  # every episode asks
def _read(path: Path, state: tuple[int, int]) -> DemandFile:
    said, root = DemandFile(), ""
    for element in elements(path):
        said.note(element)
        root = element.tag  # which ends last
    if root == NETWORK or not said.is_known:
        instead = "give it to --network" if root == NETWORK or is_configuration(path) else "give a .rou.xml or .add.xml"
        raise InputError(f"'{path}' holds <{root}>, which is no traffic of SUMO's; {instead}")
    if said.too_dense:
        raise InputError(
            f"'{path}': flow '{said.too_dense}' has over {DENSEST_FLOW_PER_S:.0f} vehicles a second; correct its "
            f"number, its period or its time"
        )
    return said


def _numbers(element: ElementTree.Element, *names: str) -> dict[str, float]:
    """Return those of these attributes that are numbers."""
    numbers = {}
    for name in names:
        with suppress(ValueError):
            numbers[name] = float(element.get(name, ""))
    return numbers


def _wish(kind: ElementTree.Element) -> tuple[float, float]:
    """Return mean and deviation of a type's speed factors, which it may give as a distribution.

    Raises:
        ValueError: it gives what is neither.
    """
    distribution, factor = NORMAL.match(kind.get("speedFactor", "")), kind.get("speedFactor", "1")
    mean, deviation = distribution.groups() if distribution else (factor, CARS_DEVIATION)
    return float(mean), float(kind.get("speedDev", deviation))


def _rate_per_s(flow: ElementTree.Element, lasts_s: float) -> float:
    """Return how many vehicles a flow has in a second, as far as its attributes tell."""
    rates = []
    with suppress(ValueError, ZeroDivisionError):
        rates.append(float(flow.get("vehsPerHour", flow.get("perHour", "0"))) / 3600.0)
    with suppress(ValueError, ZeroDivisionError):
        rates.append(1.0 / abs(float(flow.get("period", "inf"))))
    with suppress(ValueError, ZeroDivisionError):
        rates.append(float(flow.get("number", "0")) / max(lasts_s, 1.0))
    return max(rates, default=0.0)


def _at_most(flow: ElementTree.Element, rate_per_s: float, lasts_s: float) -> float:
    """Return how many vehicles a flow has at most, as far as its attributes tell; inf where chance decides."""
    with suppress(ValueError):
        return float(flow.get("number", ""))
    if not rate_per_s or lasts_s == math.inf:
        return math.inf
    return max(1.0, math.ceil(rate_per_s * lasts_s))  # the first departs at once, the last before its end


def _departures_s(element: ElementTree.Element, *, otherwise: float) -> tuple[float, float]:
    """Return when a vehicle departs, twice, or when a flow's first and last do."""
    try:
        first_s = seconds(element.get("depart") or element.get("begin") or ("0" if element.tag == "flow" else ""))
    except ValueError:  # as "triggered"
        first_s = otherwise
    if element.tag != "flow":
        return first_s, first_s
    try:
        return first_s, max(first_s, seconds(element.get("end", "")))
    except ValueError:  # it has no end, or none that is a time
        return first_s, math.inf
