"""The surrounding vehicles where the user brings none: a window that moves with the host."""

from collections.abc import Collection, Sequence
from itertools import count

import numpy as np

from rail_sumo import config
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.records import KMH

START_GAP_M, START_GAP_S = 30.0, 1.5
"""Room around a vehicle in its lane when the window is filled: the longer of these at the highest desired speed. SUMO
leaves out who is too close to drive so fast."""
CLEAR_OF_HOST_M = 40.0
"""While the host or another driven vehicle changes lanes, no vehicle this near it is told to, and none enters there."""
CLEAR_OF_ANOTHER_M = 20.0
"""Of two vehicles this near each other only one is told to move into a lane: drivers who move into it from either side
do not see each other in time."""

FASTEST_LORRY_MPS = 90.0 / KMH
"""To which speed limiters hold lorries in the European Union."""

PERIOD_S = 2.0
"""How often the window looks for vehicles that have left it."""


class MovingWindow:
    """Vehicles in a window around the host, each with its own desired speed, changing lanes at random.

    A vehicle that leaves the window is replaced at an edge of it: ahead when the new one is slower than the host,
    behind when it is faster. The first `traffic.driven` cars are `driven`; when one of them leaves, the car that enters
    next takes its place among them. What drives them is not decided here.

    Args:
        simulation: where they drive.
        road: the course they share with the host.
        traffic: how many, where, how fast.
        host_s_m: place on the course where the host starts, its front.
        host_lane: the lane it starts on.
        farthest_m: how far it drives at most.
        rng: every random choice of this traffic.
    """

    def __init__(
        self,
        simulation: Simulation,
        road: Road,
        traffic: config.Traffic,
        *,
        host_s_m: float,
        host_lane: int,
        farthest_m: float,
        rng: np.random.Generator,
    ) -> None:
        self._simulation = simulation
        self._road = road
        self._config = traffic
        self._host_start_m = host_s_m
        # In whole km/h, as it is signposted: networks round it in m/s.
        limit_kmh = round(min(road.highest_limit_mps, config.FASTEST_CAR_MPS) * KMH)
        desired_kmh = traffic.desired_kmh(limit_kmh)
        self._slowest_kmh, self._fastest_kmh = min(desired_kmh), max(desired_kmh)
        self._end_m = host_s_m + farthest_m + traffic.ahead_m
        self._rng = rng
        self._names = count()
        self.start_m: dict[str, float] = {}
        """Everybody's place on the course at insertion; an odometer adds the rest."""
        self._since_update_s = 0.0
        self.driven: set[str] = set()
        """The cars that are to be driven as the host is; for the newest of them SUMO may have found no room."""
        self._fill(host_lane)

    def _fill(self, host_lane: int) -> None:
        """Place vehicles all over the window at random, clear of one another and of the host."""
        taken: list[tuple[int, float]] = [(host_lane, 0.0)]
        room_m = max(START_GAP_M, START_GAP_S * self._fastest_kmh / KMH)
        for _ in range(self._config.vehicles):
            for _ in range(20):
                lane = self._draw_lane(self._host_start_m)
                ahead_m = self._rng.uniform(-self._config.behind_m, self._config.ahead_m)
                is_there = lane in self._lanes(self._host_start_m + ahead_m)
                if is_there and all(lane != other or abs(ahead_m - there) > room_m for other, there in taken):
                    self._insert(ahead_m, self._host_start_m, lane, self._draw_speed_mps())
                    taken.append((lane, ahead_m))
                    break

    def update(self, *, elapsed_s: float, changing_lane: Collection[str]) -> None:
        """Replace who left the window, then let each vehicle try a lane change once in the configured mean time.

        Args:
            elapsed_s: since the last update.
            changing_lane: the driven vehicles that change lanes now, the host among them.
        """
        self._since_update_s += elapsed_s
        if self._since_update_s < PERIOD_S:
            return
        tries = min(1.0, self._since_update_s / self._config.lane_change_every_s)
        self._since_update_s = 0.0
        odometers_m = self._simulation.odometers_m()
        host_m = self._host_start_m + odometers_m[self._simulation.host.name]
        ahead_m: dict[str, float] = {}
        for name, start_m in self.start_m.items():
            if name not in odometers_m:
                continue  # SUMO found no room for it
            ahead = start_m + odometers_m[name] - host_m
            if -self._config.behind_m < ahead < self._config.ahead_m:
                ahead_m[name] = ahead
            else:
                self._simulation.remove_vehicle(name)
        self.start_m = {name: self.start_m[name] for name in ahead_m}
        self.driven &= ahead_m.keys()
        there_m = {self._simulation.host.name: 0.0, **ahead_m}
        changing_m = [there_m[name] for name in changing_lane if name in there_m]
        self._order_lane_changes(ahead_m, tries, changing_m)
        for _ in range(self._config.vehicles - len(ahead_m)):
            self._replace(host_m, changing_m)

    def _replace(self, host_m: float, changing_m: Sequence[float]) -> None:
        """Bring in one vehicle just inside an edge of the window; without room there, the next update tries again."""
        desired_mps = self._draw_speed_mps()
        slower = desired_mps < self._simulation.host.speeds_mps[-1]
        ahead_m = self._config.ahead_m - 1.0 if slower else 1.0 - self._config.behind_m
        if _is_clear(ahead_m, changing_m):
            self._insert(ahead_m, host_m, self._draw_lane(host_m + ahead_m), desired_mps)

    def _insert(self, ahead_m: float, host_m: float, lane: int, desired_mps: float) -> None:
        place = self._road.place(host_m + ahead_m)
        if place is None:
            return  # beyond the end of the road
        index, front_m = place
        is_lorry = self._config.lorries > 0.0 and self._rng.random() < self._config.lorries
        name = f"{'lorry' if is_lorry else 'car'}{next(self._names)}"
        edges = self._road.laps(index, front_m + self._end_m - (host_m + ahead_m))
        self._simulation.add_vehicle(
            name,
            edges,
            lane=lane,
            front_m=front_m,
            desired_speed_mps=min(desired_mps, FASTEST_LORRY_MPS) if is_lorry else desired_mps,
            car_following=self._config.car_following,
            is_lorry=is_lorry,
        )
        self.start_m[name] = host_m + ahead_m
        if not is_lorry and len(self.driven) < self._config.driven:
            self.driven.add(name)

    def _order_lane_changes(self, ahead_m: dict[str, float], probability: float, changing_m: Sequence[float]) -> None:
        moves: list[tuple[int, float]] = []  # the lanes that vehicles move into, and how far ahead of the host
        for name, draw in zip(ahead_m, self._rng.random(len(ahead_m)).tolist(), strict=True):
            if draw >= probability or name in self.driven or not _is_clear(ahead_m[name], changing_m):
                continue
            lane = self._simulation.lane_beside(name, 1 if draw < 0.5 * probability else -1)
            beside_m = [place_m for other, place_m in moves if other == lane]
            if lane is not None and all(abs(ahead_m[name] - place_m) >= CLEAR_OF_ANOTHER_M for place_m in beside_m):
                self._simulation.order_lane_change(name, lane)
                moves.append((lane, ahead_m[name]))

    def _draw_speed_mps(self) -> float:
        return self._rng.uniform(self._slowest_kmh, self._fastest_kmh) / KMH

    def _draw_lane(self, s_m: float) -> int:
        lanes = self._lanes(s_m)
        return lanes[int(self._rng.integers(len(lanes)))]

    def _lanes(self, s_m: float) -> range:
        place = self._road.place(s_m)
        return self._road.edges[place[0] if place else 0].lanes


def _is_clear(ahead_m: float, changing_m: Sequence[float]) -> bool:
    """Whether a place is clear of those that change lanes; places are told from the host's on."""
    return all(abs(ahead_m - there_m) >= CLEAR_OF_HOST_M for there_m in changing_m)
