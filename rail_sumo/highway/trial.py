"""A world tried for a moment: what the host would drive, and what may go wrong, before anybody drives for hours."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from rail_sumo.config import FASTEST_CAR_MPS, Config
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.network.edge import Edge
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.traffic import entry
from rail_sumo.records import KMH, SECONDS_PER_STEP, MetaAction

NO_LIMIT_MPS = 300.0
"""What is above is no limit."""
MANY_WAITING = 10
"""From so many waiting vehicles on, a check warns of them."""
WATCHED_DECISIONS = 60
"""For how many decisions the traffic is watched: a minute, unless `episode.decision_period_s` says otherwise."""


@dataclass(frozen=True)
class Findings:
    """What a first look at a world tells, at the first moment of its first episode."""

    road: Road
    """The course."""
    host: str
    """The id of the demand's vehicle that the host is; empty if it is a vehicle of ours."""
    enters_s: float
    """When it enters, in SUMO's time."""
    n_signals: int
    """How many traffic lights are on its way."""
    flows_vehph: Mapping[str, float]
    """Vehicles per hour on every edge of the course in the host's first seconds; empty of made traffic."""
    watched_s: float
    """For how many seconds they were watched: a minute, unless the host had driven its course before."""
    warnings: tuple[str, ...]
    """What may go wrong."""

    @property
    def ending_lanes(self) -> dict[str, list[int]]:
        """The lanes that do not lead on along the course, by their edge; the host leaves them in time."""
        ending = {
            edge.id: [k for k, m in zip(edge.lanes, edge.leads_on_m, strict=True) if not m] for edge in self.road.edges
        }
        return {edge: lanes for edge, lanes in ending.items() if lanes}

    @property
    def limits_kmh(self) -> tuple[int, int]:
        """The lowest and the highest speed limit of the course, junctions included; without any, what a car can do."""
        of_edges = [_limit_mps(edge) for edge in self.road.edges]
        ahead = [mps for edge in self.road.edges for lane in edge.limits_ahead for _, mps in lane]
        return round(min(of_edges + ahead) * KMH), round(max(of_edges) * KMH)

    @property
    def as_json(self) -> dict[str, Any]:
        """All of it in plain types."""
        return {
            "network": self.road.name,
            "length_m": round(self.road.length_m, 2),
            "is_loop": self.road.is_loop,
            "is_left_hand": self.road.is_left_hand,
            "signals": self.n_signals,
            "host": self.host or None,
            "host_enters_s": round(self.enters_s, 1),
            "flows_watched_s": round(self.watched_s, 1),
            "edges": [
                {
                    "id": edge.id,
                    "length_m": round(edge.length_m, 2),
                    "lanes": edge.n_lanes,
                    "limit_kmh": round(_limit_mps(edge) * KMH, 1),
                    "ending_lanes": self.ending_lanes.get(edge.id, []),
                    "flow_vehph": round(self.flows_vehph[edge.id]) if self.flows_vehph else None,
                }
                for edge in self.road.edges
            ],
            "warnings": list(self.warnings),
        }


def check(world: Config, *, seed: int = 0) -> Findings:
    """Begin an episode, and tell what it would drive.

    Args:
        world: where.
        seed: of the traffic.

    Raises:
        InputError: it cannot be driven. Warnings about the demand follow, since they may say why.
    """
    env = HighwayEnv(world, companions=lambda vehicle: lambda observation, agent: MetaAction.KEEP)
    try:
        _begin(env, seed)
        warnings = [
            *_shortness(env),
            *road.warnings(env.stretch.road),
            *demand.warnings(env.demand, world.traffic),
            *_long_reds(env),
            *_short_routes(env),
            *_backlog(env),
            *_slowness(env),
            *_haste(env),
            *_solitude(env),
        ]
        host, enters_s, n_signals = env.host_name, env.agent.host.depart_s, env.n_signals_ahead
        flows_vehph = _flows_vehph(env) if env.demand.has_traffic else {}
        return Findings(
            env.stretch.road,
            host=host if env.is_one_of_the_demand else "",
            enters_s=enters_s,
            n_signals=n_signals,
            flows_vehph=flows_vehph,
            watched_s=env.agent.n_steps * SECONDS_PER_STEP,
            warnings=tuple(warnings),
        )
    finally:
        env.close()


def _begin(env: HighwayEnv, seed: int) -> None:
    try:
        env.reset(seed=seed)
    except InputError as error:
        told = demand.warnings(env.demand, env.world.traffic)
        raise InputError("; also, ".join([str(error), *told])) from None


def _flows_vehph(env: HighwayEnv) -> dict[str, float]:
    """Drive on, and return the mean flow on every edge of the course."""
    seen = [env.flows_vehph]
    while not env.is_over and len(seen) <= WATCHED_DECISIONS:
        env.drive(MetaAction.KEEP)
        if not env.is_over:
            seen.append(env.flows_vehph)
    return {edge: fmean(flows[edge] for flows in seen if edge in flows) for edge in seen[0]}  # it may be rerouted


def _shortness(env: HighwayEnv) -> Iterator[str]:
    """Tell where a road of ours to choose ends before an episode does; a vehicle's own route is as long as it is."""
    stretch: Stretch = env.stretch
    farthest_m = stretch.farthest_m - stretch.overrun_m
    if stretch.drivable_m < farthest_m and not env.is_one_of_the_demand:
        yield (
            f"the road ends {stretch.drivable_m:.0f} m after the host's start, and so will episodes of up to "
            f"{farthest_m:.0f} m; set episode.course_m to {math.floor(stretch.drivable_m)} or less"
        )


def _short_routes(env: HighwayEnv) -> Iterator[str]:
    """Tell where cars are never the host since their routes are short, while others are."""
    shortest_m = env.world.traffic.shortest_route_m
    routes_m = env.routes_m() if entry.is_drawn(env.world) and env.demand.has_traffic else []
    n_short = sum(length_m < shortest_m for length_m in routes_m)
    if 0 < n_short < len(routes_m):
        yield (
            f"no car on {n_short} of the {len(routes_m)} routes that are driven when the host enters is ever the host: "
            f"they are shorter than {shortest_m:g} m (traffic.shortest_route_m), unless others depart too seldom"
        )


def _limit_mps(edge: Edge) -> float:
    return edge.limit_mps if edge.limit_mps < NO_LIMIT_MPS else FASTEST_CAR_MPS


def _haste(env: HighwayEnv) -> Iterator[str]:
    """Tell of limits that no car keeps to, as where a network has been written in km/h."""
    highest_mps = max(map(_limit_mps, env.stretch.road.edges))
    if highest_mps > FASTEST_CAR_MPS:
        yield (
            f"the limit is up to {highest_mps * KMH:.0f} km/h ({highest_mps:g} m/s): networks tell speeds in m/s; the "
            f"host takes what is above {FASTEST_CAR_MPS * KMH:.0f} km/h as that"
        )


def _long_reds(env: HighwayEnv) -> Iterator[str]:
    """Tell which traffic lights keep somebody waiting for so long that a demand may never get through."""
    for light, (seconds, edges) in env.long_reds().items():
        shows = "never shows green" if math.isinf(seconds) else f"shows red for {seconds:.0f} s on end"
        yield f"traffic light '{light}' {shows} to somebody on {', '.join(edges)}: vehicles may stand there"


def _backlog(env: HighwayEnv) -> Iterator[str]:
    """Tell where more vehicles of the demand are to depart than find room."""
    if env.demand.has_traffic and env.n_waiting >= MANY_WAITING:
        yield (
            f"when the host enters, {env.n_waiting} vehicles of the demand wait for room to enter: it is more than the "
            f"road, or its traffic lights, let through, and what is measured depends on how many have entered"
        )


def _slowness(env: HighwayEnv) -> Iterator[str]:
    """Tell where the host's own vehicle cannot drive as fast as the road allows: all drivers may then drive alike."""
    top_mps, limit_mps = env.agent.host.abilities.ceiling_mps, env.agent.host.fastest_mps
    if top_mps < limit_mps - 0.1:
        yield (
            f"the host's own vehicle is no faster than {top_mps * KMH:.0f} km/h (its maxSpeed), and the course allows "
            f"{limit_mps * KMH:.0f} km/h; where only the vehicle limits the speed, all drivers drive alike"
        )


def _solitude(env: HighwayEnv) -> Iterator[str]:
    if env.demand.has_traffic and env.is_alone:
        yield (
            "when the host enters, no vehicle of the demand is on its course or on the way to it; lead network.course "
            "where they drive, or change traffic.begin_s"
        )
