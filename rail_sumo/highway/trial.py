"""A world tried for a moment, and what may go wrong in it told, before anybody drives there for hours."""

import math
from collections.abc import Iterator

from rail_sumo.config import Config
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.network.road import Road


def check(world: Config) -> tuple[Road, list[str]]:
    """Return the course of a world and what may go wrong on it; of the traffic, at the first moment of an episode.

    Raises:
        InputError: it cannot be driven.
    """
    course, env = road.load(world.network.file, world.network.course), HighwayEnv(world)
    try:
        env.reset(seed=0)
        return course, [
            *_shortness(world, env),
            *road.warnings(course),
            *demand.warnings(env.demand),
            *_solitude(env),
        ]
    finally:
        env.close()


def _shortness(world: Config, env: HighwayEnv) -> Iterator[str]:
    farthest_m = min(world.episode.course_m, world.episode.duration_s * env.fastest_mps)
    if env.drivable_m < farthest_m:
        yield (
            f"the road ends {env.drivable_m:.0f} m after the host's start, and so will episodes of up to "
            f"{farthest_m:.0f} m; set episode.course_m to {math.floor(env.drivable_m)} or less"
        )


def _solitude(env: HighwayEnv) -> Iterator[str]:
    if env.demand.has_traffic and env.is_alone:
        yield (
            "when the host enters, no vehicle of the demand is on its course or on the way to it; lead network.course "
            "where they drive, or change traffic.begin_s"
        )
