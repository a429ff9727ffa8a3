"""The surrounding vehicles: a window that moves with the host, or the user's own demand."""

from itertools import count
from typing import Protocol

import numpy as np

from rail_sumo import config
from rail_sumo.highway.road import Road
from rail_sumo.highway.simulation import Simulation
from rail_sumo.records import KMH, Scene

START_GAP_M = 30.0
"""Room around a vehicle in its lane when it appears."""
CLEAR_OF_CHANGE_M = 40.0
"""Nobody this near the host begins a lane change while the host is changing lanes: two drivers who move into the same
lane from either side do not see each other until it is late."""


class Traffic(Protocol):
    """What an episode asks of its traffic."""

    def update(self, scene: Scene, *, elapsed_s: float, host_changing_lane: bool) -> None:
        """Look at the scene, let vehicles come and go, and have some of them change lanes."""


class Demand:
    """The user's own vehicles, from route files; SUMO drives them and nothing is added."""

    def update(self, scene: Scene, *, elapsed_s: float, host_changing_lane: bool) -> None:
        """Leave the traffic to itself."""


class MovingWindow:
    """Vehicles in a window around the host, each with its own desired speed, changing lanes at random.

    A vehicle that leaves the window is replaced at an edge of it: ahead when the new one is slower than the host,
    behind when it is faster.

    Args:
        simulation: where they drive.
        road: the course they share with the host.
        traffic: how many, where, how fast.
        host_s_m: place on the course where the host starts, its front.
        rng: every random choice of this traffic.
    """

    def __init__(
        self, simulation: Simulation, road: Road, traffic: config.Traffic, *, host_s_m: float, rng: np.random.Generator
    ) -> None:
        self._simulation = simulation
        self._road = road
        self._config = traffic
        self._host_start_m = host_s_m
        self._rng = rng
        self._names = count()
        self._start_m: dict[str, float] = {}  # place on the course at insertion; an odometer adds the rest

    def fill(self, host_lane: int) -> None:
        """Place vehicles all over the window at random, clear of one another and of the host."""
        taken: list[tuple[int, float]] = [(host_lane, 0.0)]
        for _ in range(self._config.vehicles):
            for _ in range(20):
                lane = self._draw_lane(self._host_start_m)
                ahead_m = self._rng.uniform(-self._config.behind_m, self._config.ahead_m)
                if all(lane != other or abs(ahead_m - there) > START_GAP_M for other, there in taken):
                    self._insert(ahead_m, self._host_start_m, lane, self._draw_speed_mps())
                    taken.append((lane, ahead_m))
                    break

    def update(self, scene: Scene, *, elapsed_s: float, host_changing_lane: bool) -> None:
        """Replace who left the window, then let each vehicle change lanes with the configured mean time between."""
        host_m = self._host_start_m + scene.travelled_m[0]
        ahead_m = np.array([self._start_m[name] for name in scene.ids[1:]]) + scene.travelled_m[1:] - host_m
        inside = (ahead_m < self._config.ahead_m) & (ahead_m > -self._config.behind_m)
        self._order_lane_changes(scene, inside, elapsed_s, host_changing_lane)
        missing = self._config.vehicles - int(inside.sum())
        if missing:
            for index in np.flatnonzero(~inside):
                name = scene.ids[1 + index]
                self._simulation.remove_vehicle(name)
                del self._start_m[name]
            for _ in range(missing):
                self._replace(scene, ahead_m[inside], scene.lane[1:][inside], host_m)

    def _replace(self, scene: Scene, ahead_m: np.ndarray, lanes: np.ndarray, host_m: float) -> None:
        """Bring in one vehicle at an edge of the window; leave it for later where there is no room."""
        desired = self._draw_speed_mps()
        slower = desired < scene.speed_mps[0]
        place = self._config.ahead_m - 1.0 if slower else -self._config.behind_m + 1.0
        lane = self._draw_lane(host_m + place)
        if not np.any((lanes == lane) & (np.abs(ahead_m - place) < START_GAP_M)):
            self._insert(place, host_m, lane, desired)

    def _insert(self, ahead_m: float, host_m: float, lane: int, desired_mps: float) -> None:
        place = self._road.place(host_m + ahead_m)
        if place is None:
            return  # beyond the end of the road
        index, front_m = place
        name = f"car{next(self._names)}"
        reach = self._config.ahead_m + self._config.behind_m
        edges = self._road.laps(index, front_m + reach + self._road.length_m)
        self._simulation.add_vehicle(name, edges, lane=lane, front_m=front_m, desired_speed_mps=desired_mps)
        self._start_m[name] = host_m + ahead_m

    def _order_lane_changes(self, scene: Scene, inside: np.ndarray, elapsed_s: float, host_changing_lane: bool) -> None:
        draws = self._rng.random((2, len(inside)))  # for everyone, so that one vehicle's fate does not move another's
        chosen = inside & (draws[0] < elapsed_s / self._config.lane_change_every_s)
        if host_changing_lane:
            east, north = scene.x_m[1:] - scene.x_m[0], scene.y_m[1:] - scene.y_m[0]
            chosen &= east * east + north * north > CLEAR_OF_CHANGE_M**2
        for index in np.flatnonzero(chosen):
            lane = int(scene.lane[1 + index]) + (1 if draws[1, index] < 0.5 else -1)
            self._simulation.order_lane_change(scene.ids[1 + index], lane)

    def _draw_speed_mps(self) -> float:
        return self._rng.uniform(self._config.speed_low_kmh, self._config.speed_high_kmh) / KMH

    def _draw_lane(self, s_m: float) -> int:
        place = self._road.place(s_m)
        edge = self._road.edges[place[0] if place else 0]
        return edge.first_lane + int(self._rng.integers(edge.n_lanes))
