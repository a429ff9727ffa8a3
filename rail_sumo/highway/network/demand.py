"""What a user's demand says, read before anybody drives in it."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rail_sumo import assets, config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.highway.names import CARS, OURS
from rail_sumo.highway.network import demand_file, sumocfg
from rail_sumo.highway.network.demand_file import DemandFile

OF_MADE_TRAFFIC = (
    *("vehicles", "ahead_m", "behind_m", "speed_low_kmh", "speed_high_kmh", "lorries", "car_following"),
    "lane_change_every_s",
)
"""Keys of `[traffic]` that are of the window of traffic that is made around a host without a demand."""
UNREAD_OPTIONS = frozenset({"load-state", "device.fcd-replay.files"})
"""Options that name files with vehicles and types which are not read here."""


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
    def contents(self) -> list[DemandFile]:
        """What is in each of the files, which are read once."""
        return [demand_file.read(path) for path in self.files]

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
        return self.may_have_more or any(classes.get(kind, demand_file.DEFAULT_CLASS) in CARS for kind in kinds)

    @property
    def lanes_closed(self) -> set[str]:
        """Ids of lanes that it closes for a time."""
        return {lane for one in self.contents for lane in one.closed_lanes}

    @property
    def written(self) -> set[Path]:
        """The files that it may have SUMO write, as far as it names them: beside what names one, or in this folder."""
        named = ((path, name) for path in self.files for name in demand_file.read(path).outputs)
        return {folder / name for path, name in named for folder in (path.parent, Path.cwd())}


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
        reserved = demand_file.read(path).reserved
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
    for one in demand.contents:
        for kind, length_m in one.long_cars.items():
            yield (
                f"vehicle type '{kind}' is {length_m:g} m long and has no vClass: it counts, and may be driven, as a "
                f'car; if it is none, give it one, such as vClass="truck"'
            )
    for given in demand.routes:
        for path in _with_included(given):
            misplaced = demand_file.read(path).misplaced
            if misplaced:
                yield (
                    f"demand '{path}' has <{misplaced}>, which SUMO reads from additional files only; move it to a "
                    f"file of its own, and name that in traffic.additional"
                )
    for path in demand.files:
        late = demand_file.read(path).out_of_order
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
    if demand.has_traffic:
        known |= {demand_file.DEFAULT_TYPE}
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
    for name in demand_file.read(path).includes:
        included = path.parent / name
        if included.resolve() in {one.resolve() for one in (*including, path)}:
            raise InputError(f"'{path}' includes '{name}', which includes it in turn; take one of the two out")
        if not included.is_file():
            raise InputError(f"'{path}' includes '{name}', which does not exist; correct its <include>")
        yield from _with_included(included, (*including, path))
