"""Which vehicle of a user's demand the host takes the place of, and when."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from rail_sumo.config import Config
from rail_sumo.errors import CourseError, InputError
from rail_sumo.highway.names import CARS, MOTOR_VEHICLES
from rail_sumo.highway.network import road
from rail_sumo.highway.network.demand import Demand
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.sumo.inserted import Inserted
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.records import SECONDS_PER_STEP

WAIT_S = 600.0
"""How long to wait for a car that the host can replace."""
CHOOSY_S, CHOOSY_SHARE = 60.0, 0.1
"""After so long without one that has enough to drive, any car will do; or after this share of the span within which the
host is to enter, if that is less."""
WAIT_FOR_NAMED_S = 7200.0
"""How long to wait for a vehicle that is named, from the beginning."""


class Nobody(InputError):
    """No car departs that the host could replace."""


class Search(NamedTuple):
    """When to look for a car that the host can replace, in the demand's time."""

    from_s: float
    until_s: float
    choosy_s: float
    """How long after `from_s` it must have `traffic.shortest_route_m` to drive."""


def take_over(simulation: Simulation, config: Config, demand: Demand, search: Search) -> Stretch:
    """Let the demand drive until a car departs that the host can replace, and make it the host.

    It is the first that `search` allows, or the vehicle that `traffic.host` names. Of a demand without cars it is
    another motor vehicle.

    Returns:
        The stretch along that car's route, from where it departs.

    Raises:
        Nobody: no car departs that the host could replace.
        InputError: the one that is named has a route that it could not drive, or the network cannot be read.
    """
    road.require_readable(config.network.file, config.network.course)
    kinds = kinds_of(demand)
    refused: list[str] = []
    simulation.run_until(search.from_s - SECONDS_PER_STEP)
    for steps in itertools.count(1):
        simulation.run_without_host(SECONDS_PER_STEP)
        is_choosy = steps * SECONDS_PER_STEP < search.choosy_s
        for car, stretch in replaceable(simulation.departed(), config, kinds, refused, is_choosy=is_choosy):
            simulation.lay_course(stretch.road, config.adas, sees_m=stretch.sees_m, host=car.name)
            simulation.take_over(car)
            return stretch
        if simulation.now_s > search.until_s or not simulation.expects_vehicles:
            break
    raise Nobody(nobody(config, demand, refused, simulation.now_s))


def searches(config: Config, demand: Demand, rng: np.random.Generator) -> Iterator[Search]:
    """Yield when to look for a car that the host can replace; where one finds nobody, there may be another.

    From a moment on that is drawn evenly from `traffic.entry_within_s` after the warm-up. Where the demand ends while a
    car is waited for: any from that moment on, then any from the warm-up on.
    """
    traffic = config.traffic
    first_s, last_s = demand.departs_s
    if not is_drawn(config):
        until_s = min(last_s + WAIT_S, traffic.begin_s + WAIT_FOR_NAMED_S)
        yield Search(traffic.begin_s, until_s, CHOOSY_S)
        return
    earliest_s = max(min(traffic.begin_s + traffic.warm_up_s, last_s), first_s, traffic.begin_s)
    latest_s = max(min(last_s, earliest_s + traffic.entry_within_s), earliest_s)
    from_s = rng.uniform(earliest_s, latest_s)
    yield Search(from_s, from_s + WAIT_S, min(CHOOSY_S, CHOOSY_SHARE * (latest_s - earliest_s)))
    if last_s < from_s + WAIT_S:
        for again_s in (from_s, earliest_s):
            yield Search(again_s, again_s + WAIT_S, 0.0)


def is_drawn(config: Config) -> bool:
    """Return whether the car that the host replaces is drawn, and not named."""
    return config.traffic.host == "replaces"


def kinds_of(demand: Demand) -> frozenset[str]:
    """Return SUMO's classes of what the host can replace: cars, or what else has a motor where there are none."""
    return CARS if demand.may_have_cars else MOTOR_VEHICLES


def replaceable(
    cars: Iterable[Inserted], config: Config, kinds: frozenset[str], refused: list[str], *, is_choosy: bool
) -> Iterator[tuple[Inserted, Stretch]]:
    """Yield those of the vehicles that have just departed that the host can replace, and what it would drive.

    Args:
        cars: the vehicles.
        config: the world; see `traffic.host` and `traffic.shortest_route_m`.
        kinds: SUMO's classes of those that may be drawn.
        refused: why others of these classes could not be driven is added here.
        is_choosy: whether a car that is drawn must have `traffic.shortest_route_m` to drive.

    Raises:
        CourseError: the one that is named has a route that the host could not drive.
        InputError: the network cannot be read.
    """
    traffic, drawn = config.traffic, is_drawn(config)
    for car in cars:
        if car.vclass not in kinds if drawn else car.name != traffic.host:
            continue
        try:
            require_along_course(car, config)
            stretch = stretch_of(car, config)
        except CourseError as error:  # too short, not on lanes that the host may use, or not at the speeds it may
            if not drawn:
                raise
            refused.append(f"'{car.name}': {error}")
            continue
        if not (drawn and is_choosy) or stretch.drivable_m >= traffic.shortest_route_m:
            yield car, stretch


def require_along_course(car: Inserted, config: Config) -> None:
    """Raise CourseError if a vehicle's route does not lead along `network.course`."""
    ahead = iter(_until_repeated(car.edges))
    if not all(edge in ahead for edge in config.network.course):  # in this order, with others in between
        raise CourseError(
            f"vehicle '{car.name}' does not drive over the edges of network.course in their order; name others"
        )


def stretch_of(
    car: Inserted, config: Config, *, to_its_end: bool = False, closed: frozenset[str] = frozenset()
) -> Stretch:
    """Return the stretch along a vehicle's route, as far as it comes over no edge again.

    Args:
        car: the vehicle.
        config: the world.
        to_its_end: whether a route that comes over none again is driven until the vehicle arrives.
        closed: the ids of lanes that it may not enter now.

    Raises:
        CourseError: it could not be driven.
        InputError: the network cannot be read.
    """
    edges = _until_repeated(car.edges)
    course = road.load(
        config.network.file, edges, vclass=car.vclass, limit_factor=config.network.limit_factor, closed=closed
    )
    return Stretch.along(course, config, car.front_m, to_its_end=to_its_end and len(edges) == len(car.edges))


def _until_repeated(edges: tuple[str, ...]) -> tuple[str, ...]:
    return edges[: next((k for k, edge in enumerate(edges) if edge in edges[:k]), len(edges))]


def nobody(config: Config, demand: Demand, refused: Sequence[str], now_s: float) -> str:
    """Return why there is no host: nothing has departed by now that it could replace; see `replaceable`."""
    first_s, last_s = demand.departs_s
    until = "on" if math.isinf(last_s) else f"to {last_s:.0f} s"
    asked, kind = config.traffic.host, "car" if demand.may_have_cars else "vehicle"
    if refused:
        return f"none of the {len(refused)} {kind}s that departed by {now_s:.0f} s can be the host; {refused[-1]}"
    by_now = (
        f"no {kind} that the host could replace departed"
        if asked == "replaces"
        else f"vehicle '{asked}', which traffic.host names, has not departed"
    )
    along = " along network.course" if config.network.course else ""
    return (
        f"{by_now}{along} by {now_s:.0f} s; the demand's vehicles depart from {first_s:.0f} s {until}: change "
        f"traffic.begin_s, or set traffic.host to 'added' or to a {kind}'s id"
    )
