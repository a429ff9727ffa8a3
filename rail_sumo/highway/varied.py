"""Varied worlds: an episode's seed draws the network, the limits and the traffic that it drives in."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from rail_sumo import assets
from rail_sumo.config import FASTEST_CAR_MPS, Config, Range
from rail_sumo.highway.network import road, sumocfg
from rail_sumo.highway.network.sumo_xml import is_configuration, state_of
from rail_sumo.records import KMH

STREAM = 3
"""Tells these draws from others with the same seed."""
SCALE = "scale"
"""SUMO's option for how many times the vehicles that a demand names depart."""
WINDOW: dict[str, Any] = {"routes": (), "additional": (), "options": ()}
"""The keys of `traffic` that leave it to a moving window."""


def draw(config: Config, seed: int) -> Config:
    """Return the world of one episode, in which nothing varies; the configuration itself if nothing does.

    Raises:
        InputError: a network that is named, or its demand, cannot be read.
    """
    varied = config.varied
    if not varied.networks:
        return config
    where, whose, limit, vehicles, slowest, fastest, lorries, scale = (
        np.random.default_rng([seed, STREAM]).random(8).tolist()
    )
    file, demand = _keys_of(varied.networks[int(where * len(varied.networks))])
    limit_factor = _between(varied.limit_factor, limit)
    if demand and whose < varied.own_demand:
        factor = config.traffic.scale * _between(varied.demand_scale, scale)
        options = _scaled(demand.get("options", ()), factor)
        return _fixed(config, file, limit_factor, demand | {"options": options, "scale": 1.0})
    course = road.load(file, limit_factor=limit_factor)
    limit_kmh = min(course.highest_limit_mps, FASTEST_CAR_MPS) * KMH
    n_lanes = fmean(edge.n_lanes for edge in course.edges)
    lowest = _between(varied.slowest, slowest)
    traffic = {
        "vehicles": round(_between(varied.vehicles_per_lane, vehicles) * n_lanes),
        "speed_low_kmh": lowest * limit_kmh,
        "speed_high_kmh": max(lowest, _between(varied.fastest, fastest)) * limit_kmh,
        "lorries": _between(varied.lorries, lorries),
        **WINDOW,
    }
    return _fixed(config, file, limit_factor, traffic)


def _scaled(options: Sequence[str], factor: float) -> tuple[str, ...]:
    """Return a demand's options, with so many times the vehicles."""
    given = dict(option.split("=", 1) for option in options)
    return tuple(f"{name}={value}" for name, value in (given | {SCALE: float(given.get(SCALE, 1)) * factor}).items())


def one_of_each(config: Config) -> Iterator[Config]:
    """Yield a world on each of the networks that are named, in its own demand and in a moving window.

    Raises:
        InputError: as in `draw`.
    """
    if not config.varied.networks:
        yield config
    for named in config.varied.networks:
        file, demand = _keys_of(named)
        yield _fixed(config, file, 1.0, WINDOW)
        if demand:
            yield _fixed(config, file, 1.0, demand)


def files_of(named: str) -> tuple[Path, ...]:
    """Return the files that one of `varied.networks` stands for."""
    file, demand = _keys_of(named)
    kinds = {"routes": assets.routes, "additional": assets.additional}
    return assets.network(file), *(find(name) for kind, find in kinds.items() for name in demand.get(kind, ()))


def _fixed(config: Config, file: str, limit_factor: float, traffic: dict[str, Any]) -> Config:
    return config.changed(
        network={"file": file, "course": (), "limit_factor": limit_factor}, varied={"networks": ()}, traffic=traffic
    )


def _between(ends: Range, share: float) -> float:
    return ends[0] + share * (ends[1] - ends[0])


def _keys_of(named: str) -> tuple[str, dict[str, Any]]:
    """Return a network's file, and the keys of `traffic` that its own demand sets: none if it has none."""
    path = Path(named)
    if is_configuration(path):
        return _of_configuration(path, state_of(path))
    return named, {"routes": (named,)} if named in assets.routes_names() else {}


@lru_cache(maxsize=32)
def _of_configuration(path: Path, state: tuple[int, int]) -> tuple[str, dict[str, Any]]:
    keys, _ = sumocfg.read(path)
    prefix = "traffic."
    traffic = {
        key.removeprefix(prefix): tuple(value) if isinstance(value, list) else value
        for key, value in keys.items()
        if key.startswith(prefix)
    }
    return keys["network.file"], traffic
