"""What a user's demand says, read before anybody drives in it."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from rail_sumo import assets, config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.highway.names import CARS, OURS
from rail_sumo.highway.network import sumocfg
from rail_sumo.highway.network.sumo_xml import (
    UNKNOWN_ENCODING,
    UNREADABLE,
    elements,
    is_configuration,
    seconds,
    state_of,
)

TRAFFIC_ELEMENTS = ("vehicle", "flow", "trip")
"""Elements that put somebody on the road."""

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
OF_MADE_TRAFFIC = (
    *("vehicles", "ahead_m", "behind_m", "speed_low_kmh", "speed_high_kmh", "lorries", "car_following"),
    "lane_change_every_s",
)
"""Keys of `[traffic]` that are of the window of traffic that is made around a host without a demand."""
UNREAD_OPTIONS = frozenset({"load-state", "device.fcd-replay.files"})
"""Options that name files with vehicles and types which are not read here."""

OUTPUTS = ("file", "output", "dest")
"""Attributes that name a file to be written."""
DENSEST_FLOW_PER_S = 1000.0
"""No road takes as many vehicles; SUMO would make them all and never come to an end."""
OUTPUT_PARAMETER = ".file"
"""What the keys of parameters end with that do, as `device.ssm.file`."""


@dataclass(frozen=True)
class Demand:
    """The files of a user's demand, checked, and SUMO's options for it."""

    routes: tuple[Path, ...] = ()
    additional: tuple[Path, ...] = ()
    """SUMO's additional files beside them, in their order; they may put vehicles on the road too."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Further options of SUMO's, by name."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All that SUMO reads for it, included files too."""
        return tuple(path for given in (*self.routes, *self.additional) for path in _with_included(given))

    @property
    def contents(self) -> list["_Content"]:
        """What is in each of the files, which are read once."""
        return [_content(path, state_of(path)) for path in self.files]

    @property
    def has_traffic(self) -> bool:
        """Whether it puts anybody on the road; else traffic is made for the host."""
        return any(one.departures_s for one in self.contents)

    @property
    def may_have_more(self) -> bool:
        """Whether SUMO may make other vehicles for it than the files name."""
        return any(one.may_have_more for one in self.contents) or not UNREAD_OPTIONS.isdisjoint(self.options)

    @property
    def departs_s(self) -> tuple[float, float]:
        """When the first vehicle is to depart, and the last; inf of a flow without an end."""
        spans = [one.departures_s for one in self.contents]
        return min(first for first, _ in filter(None, spans)), max(last for _, last in filter(None, spans))

    @property
    def may_have_cars(self) -> bool:
        """Whether any vehicle may be a car, as far as the types tell; one of a distribution may be anything."""
        contents = self.contents
        classes = {kind: vclass for one in contents for kind, vclass in one.types.items()}
        kinds = {kind for one in contents for kind in one.kinds}
        return self.may_have_more or any(classes.get(kind, DEFAULT_CLASS) in CARS for kind in kinds)

    @property
    def folders_written(self) -> set[Path]:
        """The folders into which it may have SUMO write: beside what names a file there, and the current one."""
        named = ((path, name) for path in self.files for name in _content(path, state_of(path)).outputs)
        written = {(folder / name).parent for path, name in named for folder in (path.parent, Path.cwd())}
        return written | {path.parent for path in self.files} | ({Path.cwd()} if self.files else set())


@dataclass(frozen=True, slots=True)
class _Content:
    misplaced: str
    """An element that SUMO reads from additional files only, if there is one."""
    reserved: str
    """An id that is ours, if there is one."""
    departures_s: tuple[float, float] | None
    """The first and the last; None if it puts nobody on the road."""
    out_of_order: tuple[str, ...]
    """Ids of those that depart before one that stands before them."""
    includes: tuple[str, ...]
    """Files that are to be read in its place."""
    outputs: tuple[str, ...]
    """Names of files that it has SUMO write, and of some that it has SUMO read."""
    vehicles: frozenset[str]
    """Ids of vehicles and trips."""
    flows: Mapping[str, float]
    """How many vehicles a flow has at most, by its id, where they are not multiplied; inf where it does not tell."""
    types: Mapping[str, str]
    """Classes of vehicle types, by their ids; of distributions, as if they were of cars."""
    kinds: frozenset[str]
    """Ids of the types that vehicles are of."""
    may_have_more: bool
    """Whether SUMO may make vehicles for it with other ids than these, or more of them than it says."""


def read(traffic: config.Traffic) -> Demand:
    """Return the demand that the configuration names, after reading its files.

    Raises:
        InputError: no such file, not XML, one that has our ids or includes itself, an option that is ours to set, or
            vehicles of the made traffic are to be driven where there is none.
    """
    routes, additional = tuple(map(assets.routes, traffic.routes)), tuple(map(assets.additional, traffic.additional))
    options = dict(_options(traffic.options))
    if traffic.scale != 1.0:
        if "scale" in options:
            raise InputError("the demand is scaled twice, by traffic.scale and by an option; leave one of them out")
        options["scale"] = f"{traffic.scale:g}"
    demand = Demand(routes, additional, options)
    for path in demand.files:
        reserved = _content(path, state_of(path)).reserved
        if reserved:
            raise InputError(
                f"'{path}' has the id '{reserved}'; ids that begin with {OURS} are rail-sumo's own: rename it"
            )
    if traffic.driven and demand.has_traffic:
        raise InputError(
            f"traffic.driven is {traffic.driven}, and such vehicles are of the made traffic, not of a demand; leave it "
            "out, and drive a share of the demand's cars by: rail-sumo sweep share"
        )
    return demand


def warnings(demand: Demand, traffic: config.Traffic) -> Iterator[str]:
    """Tell what SUMO would not do as it is written, and says nothing about, and which of our keys do nothing."""
    yield from _without_effect(demand, traffic)
    if demand.routes and not demand.has_traffic:
        names = "', '".join(map(str, demand.routes))
        yield f"'{names}' has no <vehicle>, <flow> or <trip>: traffic is made for the host"
    if demand.has_traffic and not demand.may_have_cars:
        yield "the demand has no cars: the host takes the place of another motor vehicle, and is as long and as wide"
    for given in demand.routes:
        for path in _with_included(given):
            misplaced = _content(path, state_of(path)).misplaced
            if misplaced:
                yield (
                    f"demand '{path}' has <{misplaced}>, which SUMO reads from additional files only; move it to a "
                    f"file of its own, and name that in traffic.additional"
                )
    for path in demand.files:
        late = _content(path, state_of(path)).out_of_order
        if late:
            more = f" and {len(late) - 1} more" if len(late) > 1 else ""
            yield (
                f"demand '{path}' is not in order of departure: '{late[0]}'{more} may enter late or never; sort it, by "
                f"SUMO's tools/route/sort_routes.py for example"
            )


def _without_effect(demand: Demand, traffic: config.Traffic) -> Iterator[str]:
    """Tell which keys of ours were changed and have no effect on this demand."""
    usual = config.Traffic()
    idle = [name for name in OF_MADE_TRAFFIC if getattr(traffic, name) != getattr(usual, name)]
    if demand.has_traffic and idle:
        yield f"{', '.join(f'traffic.{name}' for name in idle)}: of made traffic, without effect on a demand"


def require_vehicle(demand: Demand, name: str) -> None:
    """Raise InputError if the demand certainly has no vehicle with this id.

    What may have it: a vehicle or trip of that name, a flow that has so many, as `flow.3`, or a vehicle that an option
    multiplies. Of a demand for which SUMO may make vehicles with ids of its own, nothing is certain.
    """
    if demand.may_have_more:
        return
    contents = demand.contents
    vehicles = frozenset[str]().union(*(one.vehicles for one in contents))
    flows = {flow: _multiplied(most, demand) for one in contents for flow, most in one.flows.items()}
    whose, _, number = name.rpartition(".")
    is_number = number.isdecimal() and number == str(int(number))
    if name in vehicles or (is_number and (whose in vehicles or int(number) < flows.get(whose, 0.0))):
        return
    if is_number and whose in flows:
        last = flows[whose] - 1
        has = f"ends with '{whose}.{last:.0f}'; name one up to that" if last >= 0 else "has no vehicles; name another"
        raise InputError(f"traffic.host names '{name}', and the flow '{whose}' {has}")
    available = vehicles | {f"{flow}.0" for flow in flows}
    also = ("added", "replaces")
    raise InputError(
        f"the demand has no vehicle '{name}', which traffic.host names{did_you_mean(name, available, also=also)}"
    )


def _multiplied(number: float, demand: Demand) -> float:
    """Return how many vehicles there are at most of so many, as SUMO scales a demand."""
    try:
        return math.ceil(number * float(demand.options.get("scale", "1"))) if number < math.inf else math.inf
    except ValueError:
        return math.inf


def require_type(demand: Demand, kind: str) -> None:
    """Raise InputError if the demand certainly has no vehicle type of this id, as which `sumo:TYPE` is to drive."""
    if not UNREAD_OPTIONS.isdisjoint(demand.options):
        return
    known = frozenset[str]().union(*(one.types for one in demand.contents))
    if not known:
        raise InputError(
            f"driver 'sumo:{kind}' is a vehicle of your demand's, which names no types; name its files with --routes"
        )
    if kind not in known:
        raise InputError(f"vehicle type '{kind}' of driver 'sumo:{kind}' not found{did_you_mean(kind, known)}")


def _options(given: Iterable[str]) -> Iterator[tuple[str, str]]:
    for text in given:
        option, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"traffic.options takes SUMO's options as name=value, for example scale=2; got '{text}'")
        if sumocfg.is_ours(option):
            raise InputError(f"SUMO's option '{option}' is rail-sumo's to set; leave it out of traffic.options")
        yield option, value


def _with_included(path: Path, including: tuple[Path, ...] = ()) -> Iterator[Path]:
    """Yield a file and those that it includes, in the order in which SUMO reads them.

    Raises:
        InputError: one is not there, or includes itself.
    """
    yield path
    for name in _content(path, state_of(path)).includes:
        included = path.parent / name
        if included.resolve() in {one.resolve() for one in (*including, path)}:
            raise InputError(f"'{path}' includes '{name}', which includes it in turn; take one of the two out")
        if not included.is_file():
            raise InputError(f"'{path}' includes '{name}', which does not exist; correct its <include>")
        yield from _with_included(included, (*including, path))


@cache  # every episode asks
def _content(path: Path, state: tuple[int, int]) -> _Content:
    misplaced = reserved = too_dense = root = ""
    is_known = may_have_more = False
    vehicles: set[str] = set()
    flows: dict[str, float] = {}
    types: dict[str, str] = {}
    kinds: set[str] = set()
    out_of_order: list[str] = []
    includes: list[str] = []
    outputs: list[str] = []
    first_s, latest_s, last_s = math.inf, 0.0, -math.inf
    try:
        for element in elements(path):
            name, root = element.get("id", ""), element.tag
            is_known = is_known or root in KNOWN
            if name.startswith(OURS):
                reserved = reserved or name
            if element.tag in ADDITIONAL:
                misplaced = misplaced or element.tag
            may_have_more = may_have_more or element.tag in UNNAMED
            if element.tag in TYPES:
                types[name] = element.get("vClass", DEFAULT_CLASS)
                may_have_more = may_have_more or "scale" in element.attrib
            if element.tag == "include":
                includes.append(element.get("href", ""))
            outputs += filter(None, map(element.get, OUTPUTS))
            if element.tag == "param" and element.get("key", "").endswith(OUTPUT_PARAMETER):
                outputs.append(element.get("value", ""))
            if element.tag == "flow" and _rate_per_s(element) > DENSEST_FLOW_PER_S:
                too_dense = too_dense or name
            if element.tag in TRAFFIC_ELEMENTS:
                kinds.add(element.get("type", DEFAULT_TYPE))
                if element.tag == "flow":
                    flows[name] = _at_most(element)
                else:
                    vehicles.add(name)
                departs_s, ends_s = _departures_s(element, otherwise=latest_s)
                if departs_s < latest_s:
                    out_of_order.append(name)
                latest_s = max(latest_s, departs_s)
                first_s, last_s = min(first_s, departs_s), max(last_s, ends_s)
    except InputError:
        raise
    except (*UNREADABLE, *UNKNOWN_ENCODING) as error:
        raise InputError(f"'{path}' is not a complete XML file: {error}") from None
    if not is_known:
        instead = "give it to --network" if is_configuration(path) else "give a .rou.xml or an .add.xml"
        raise InputError(f"'{path}' holds <{root}>, which is no traffic of SUMO's; {instead}")
    if too_dense:
        raise InputError(
            f"'{path}': flow '{too_dense}' has over {DENSEST_FLOW_PER_S:.0f} vehicles a second; correct its number, "
            f"its period or its time"
        )
    span_s = (first_s, last_s) if first_s <= last_s else None
    return _Content(
        misplaced=misplaced,
        reserved=reserved,
        departures_s=span_s,
        out_of_order=tuple(out_of_order),
        includes=tuple(includes),
        outputs=tuple(outputs),
        vehicles=frozenset(vehicles),
        flows=flows,
        types=types,
        kinds=frozenset(kinds),
        may_have_more=may_have_more,
    )


def _rate_per_s(flow: ElementTree.Element) -> float:
    """Return how many vehicles a flow has in a second, as far as its attributes tell."""
    first_s, last_s = _departures_s(flow, otherwise=0.0)
    rates = []
    with suppress(ValueError, ZeroDivisionError):
        rates.append(float(flow.get("vehsPerHour", flow.get("perHour", "0"))) / 3600.0)
    with suppress(ValueError, ZeroDivisionError):
        rates.append(1.0 / abs(float(flow.get("period", "inf"))))
    with suppress(ValueError, ZeroDivisionError):
        rates.append(float(flow.get("number", "0")) / max(last_s - first_s, 1.0))
    return max(rates, default=0.0)


def _at_most(flow: ElementTree.Element) -> float:
    """Return how many vehicles a flow has at most, as far as its attributes tell; inf where chance decides."""
    with suppress(ValueError):
        return float(flow.get("number", ""))
    first_s, last_s = _departures_s(flow, otherwise=0.0)
    rate_per_s = _rate_per_s(flow)
    if not rate_per_s or last_s == math.inf:
        return math.inf
    return max(1.0, math.ceil(rate_per_s * (last_s - first_s)))  # the first departs at once, the last before its end


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
