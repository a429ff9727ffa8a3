"""Where a vehicle is on its way, as SUMO has it."""

import bisect
from collections.abc import Sequence

import libsumo


def way_of(name: str) -> Sequence[str]:
    """Return the edges of a vehicle's route from the one on that it is on, or was on before the junction."""
    return libsumo.vehicle.getRoute(name)[libsumo.vehicle.getRouteIndex(name) :]


def ahead_on(lane_id: str, beyond_m: float) -> Sequence[str]:
    """Return the vehicles on a lane whose fronts are beyond a place, the nearest first."""
    names = libsumo.lane.getLastStepVehicleIDs(lane_id)  # the rearmost first
    return names[bisect.bisect_right(names, beyond_m, key=libsumo.vehicle.getLanePosition) :]


def to_lane_end_m(name: str) -> float:
    """Return how far a vehicle's front has to the end of its lane."""
    return libsumo.lane.getLength(libsumo.vehicle.getLaneID(name)) - libsumo.vehicle.getLanePosition(name)


def lanes_inside(lane_id: str) -> list[str]:
    """Return a lane within a junction and those that follow it there."""
    lanes = [lane_id]
    while via := next((link[4] for link in libsumo.lane.getLinks(lanes[-1])), ""):
        lanes.append(via)
    return lanes
