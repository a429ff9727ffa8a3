"""What a user's demand says, read before anybody drives in it."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway.network.sumo_xml import UNKNOWN_ENCODING, UNREADABLE, opened, seconds, state_of

TRAFFIC_ELEMENTS = ("vehicle", "flow", "trip")
"""Elements that put somebody on the road."""

ADDITIONAL = frozenset({
    "busStop", "trainStop", "containerStop", "chargingStation", "parkingArea", "rerouter", "variableSpeedSign",
    "calibrator", "vaporizer", "tlLogic", "inductionLoop", "e1Detector", "laneAreaDetector", "e2Detector",
    "entryExitDetector", "e3Detector", "instantInductionLoop", "routeProbe", "edgeData", "laneData", "poly", "poi",
    "timedEvent", "WAUT",
})  # fmt: skip
"""Elements that SUMO passes over in route files, and reads from additional files."""

OUTPUTS = ("file", "output", "dest")
"""Attributes that name a file to be written."""

OURS = "rail_sumo_"
"""What the ids of our own vehicles, types and routes begin with."""
HOST = f"{OURS}host"


@dataclass(frozen=True, slots=True)
class _Content:
    elements: frozenset[str]
    taken: tuple[str, ...]
    """Ids that are ours."""
    out_of_order: tuple[str, ...]
    """Ids of those that depart before one that stands before them."""
    includes: tuple[str, ...]
    """Files that are to be read in its place."""
    outputs: tuple[str, ...]
    """Names of files that it has SUMO write, and of some that it has SUMO read."""


def check(routes: Iterable[str], additional: Iterable[str] = ()) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the files of a demand, and SUMO's additional files beside it, after reading them.

    Args:
        routes: a shipped example's name or a path each; none for the moving window of traffic.
        additional: paths.

    Raises:
        InputError: no such file, not XML, one that has our ids or includes another, routes with elements that SUMO
            reads from additional files only, no vehicle, flow or trip in any of the routes, or some beside no routes.
    """
    demand, beside = tuple(map(assets.routes, routes)), tuple(map(assets.additional, additional))
    contents = {path: _content(path, state_of(path)) for path in (*demand, *beside)}
    for path, content in contents.items():
        if content.taken:
            raise InputError(
                f"'{path}' has the id '{content.taken[0]}'; ids that begin with {OURS} are rail-sumo's own: rename it"
            )
        if content.includes:
            raise InputError(
                f"'{path}' includes '{content.includes[0]}', which rail-sumo does not follow; name that file itself"
            )
    for path in demand:
        misplaced = sorted(contents[path].elements & ADDITIONAL)
        if misplaced:
            raise InputError(
                f"demand '{path}' has <{misplaced[0]}>, which SUMO reads from additional files only; move it to a file "
                f"of its own, and name that in traffic.additional"
            )
    for path in () if demand else beside:
        if contents[path].elements.intersection(TRAFFIC_ELEMENTS):
            raise InputError(
                f"'{path}' puts vehicles on the road, beside traffic that is made for the host; name it in "
                f"traffic.routes (--routes), not in traffic.additional"
            )
    if demand and not any(contents[path].elements.intersection(TRAFFIC_ELEMENTS) for path in demand):
        names = "', '".join(map(str, demand))
        raise InputError(f"demand '{names}' has no <vehicle>, <flow> or <trip>; rail-sumo needs traffic to drive in")
    return demand, beside


def folders_written(additional: Iterable[Path]) -> set[Path]:
    """Return the folders into which additional files have SUMO write."""
    written = ((path, name) for path in additional for name in _content(path, state_of(path)).outputs)
    return {(path.parent / name).parent for path, name in written}


def warnings(demand: Iterable[Path]) -> Iterator[str]:
    """Tell what SUMO would not do as it is written, and says nothing about."""
    for path in demand:
        late = _content(path, state_of(path)).out_of_order
        if late:
            more = f" and {len(late) - 1} more" if len(late) > 1 else ""
            yield (
                f"demand '{path}' is not in order of departure: '{late[0]}'{more} may enter late or never; sort it, by "
                f"SUMO's tools/route/sort_routes.py for example"
            )


@cache  # every episode asks
def _content(path: Path, state: tuple[int, int]) -> _Content:
    elements: set[str] = set()
    taken: list[str] = []
    out_of_order: list[str] = []
    includes: list[str] = []
    outputs: list[str] = []
    latest_s = 0.0
    try:
        with opened(path) as stream:
            for _, element in ElementTree.iterparse(stream):
                elements.add(element.tag)
                name = element.get("id", "")
                if name.startswith(OURS):
                    taken.append(name)
                if element.tag == "include":
                    includes.append(element.get("href", ""))
                outputs += filter(None, map(element.get, OUTPUTS))
                if element.tag in TRAFFIC_ELEMENTS:
                    departs_s = _departure_s(element, otherwise=latest_s)
                    if departs_s < latest_s:
                        out_of_order.append(name)
                    latest_s = max(latest_s, departs_s)
                element.clear()
    except (*UNREADABLE, *UNKNOWN_ENCODING) as error:
        raise InputError(f"'{path}' is not a complete XML file: {error}") from None
    return _Content(frozenset(elements), tuple(taken), tuple(out_of_order), tuple(includes), tuple(outputs))


def _departure_s(element: ElementTree.Element, *, otherwise: float) -> float:
    try:
        return seconds(element.get("depart") or element.get("begin") or "")
    except ValueError:  # as "triggered"
        return otherwise
