"""A world tried for a moment, and what may go wrong in it told, before anybody drives there for hours."""

import math
from collections.abc import Iterator

from rail_sumo.config import Config
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.stretch import Stretch


def check(world: Config) -> tuple[Road, list[str]]:
    """Return the course of a world and what may go wrong on it; of the traffic, at the first moment of an episode.

    Raises:
        InputError: it cannot be driven.
    """
    env = HighwayEnv(world)
    try:
        env.reset(seed=0)
        course = env.stretch.road
        return course, [
            *_shortness(env.stretch),
            *road.warnings(course),
            *demand.warnings(env.demand),
            *_solitude(env),
        ]
    finally:
        env.close()


def _shortness(stretch: Stretch) -> Iterator[str]:
    farthest_m = stretch.farthest_m - stretch.overrun_m
    if stretch.drivable_m < farthest_m:
        yield (
            f"the road ends {stretch.drivable_m:.0f} m after the host's start, and so will episodes of up to "
            f"{farthest_m:.0f} m; set episode.course_m to {math.floor(stretch.drivable_m)} or less"
        )


def _solitude(env: HighwayEnv) -> Iterator[str]:
    if env.demand.has_traffic and env.is_alone:
        yield (
            "when the host enters, no vehicle of the demand is on its course or on the way to it; lead network.course "
            "where they drive, or change traffic.begin_s"
        )
