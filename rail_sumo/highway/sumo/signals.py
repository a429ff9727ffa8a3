"""Traffic lights that keep somebody waiting for very long, as a program may that was made by hand."""

import math
from collections.abc import Mapping
from itertools import groupby
from typing import Any

import libsumo

from rail_sumo.highway.vehicle.right_of_way import NOT_GREEN
from rail_sumo.records import Lane

LONG_S = 300.0
"""Whoever stands for so long is taken off the road by SUMO, unless a demand says otherwise."""
STATIC = 0
"""SUMO's number for programs that keep to their phases' durations."""


def long_reds(lanes: Mapping[str, Lane]) -> dict[str, tuple[float, list[str]]]:
    """Return by traffic light for how many seconds it keeps somebody waiting, and on which edges, where that is long.

    Args:
        lanes: all lanes; of those that are not open to cars nothing is told.
    """
    waits = {light: _waits_s(light, lanes) for light in libsumo.trafficlight.getIDList()}
    return {light: (max(by_edge.values()), sorted(by_edge)) for light, by_edge in waits.items() if by_edge}


def _waits_s(light: str, lanes: Mapping[str, Lane]) -> dict[str, float]:
    """Return by edge for how long a light keeps somebody waiting there, where that is long."""
    running, programs = libsumo.trafficlight.getProgram(light), libsumo.trafficlight.getAllProgramLogics(light)
    logic = next(one for one in programs if one.programID == running)
    found: dict[str, float] = {}
    for number, links in enumerate(libsumo.trafficlight.getControlledLinks(light)):
        seconds = _longest_red_s(logic, number)
        for lane, onto, _ in links:
            if seconds > LONG_S and lanes[lane].is_open and lanes[onto].is_open:
                edge = lane.rpartition("_")[0]
                found[edge] = max(found.get(edge, 0.0), seconds)
    return found


def _longest_red_s(logic: Any, link: int) -> float:
    """Return how long a link is red on end, inf for ever; of a program that answers to traffic the latter alone."""
    shown = [(phase.state[link] in NOT_GREEN, phase.duration) for phase in logic.phases if link < len(phase.state)]
    if not any(stops for stops, _ in shown):
        return 0.0
    if all(stops for stops, _ in shown):
        return math.inf
    if logic.type != STATIC:
        return 0.0
    runs = groupby(shown + shown, key=lambda one: one[0])  # it goes round
    return max(sum(seconds for _, seconds in run) for stops, run in runs if stops)
