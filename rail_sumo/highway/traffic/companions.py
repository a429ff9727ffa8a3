"""Vehicles of the made traffic that are driven too, beside the host."""

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from rail_sumo.config import FASTEST_CAR_MPS, Config
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.sumo import inserted
from rail_sumo.highway.sumo.inserted import Inserted
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic.moving_window import MovingWindow
from rail_sumo.highway.traffic.rides import Decide, Rides


class Companions:
    """The driven vehicles of a window: each an agent, from its entry until the window takes it off the road.

    Each decides every `episode.decision_period_s` from its own entry, and whenever a lane change ends. It
    enters at the desired speed that the window drew for it; from then on its decisions set its speed. Near the end of
    the road, after a contact or a standstill of five minutes, SUMO's own driver drives it on.

    Args:
        simulation: where they drive, with the host and the window's vehicles on the road.
        window: the traffic that they are of.
        stretch: what the host drives; they follow the same course.
        world: how they sense and drive.
        driver: returns what decides for a vehicle, by its id.
        hands_off: leave them to SUMO's own driver, as the host; see `HighwayEnv`.
    """

    def __init__(
        self,
        simulation: Simulation,
        window: MovingWindow,
        stretch: Stretch,
        world: Config,
        driver: Callable[[str], Decide],
        *,
        hands_off: bool | str = False,
    ) -> None:
        self._simulation = simulation
        self._window = window
        self._stretch = stretch
        self._driver = driver
        self._rides = Rides(simulation, world.practice(math.inf), keeps_trajectory=False, hands_off=hands_off)
        self._contacts_before = 0  # of those that are driven no longer
        self._enter(inserted.read(sorted(window.driven & simulation.on_road())))

    def step(self) -> None:
        """Take the decisions that are due, then drive one step: the host and everybody else."""
        for ride in self._rides.drive():
            self._contacts_before += ride.contacts
        self._enter(car for car in self._simulation.departed() if car.name in self._window.driven)

    def update(self, *, elapsed_s: float, changing_lane: Collection[str]) -> None:
        """Do as `MovingWindow.update` does; the companions that change lanes count too."""
        mine = [name for name, ride in self._rides.rides.items() if ride.agent.is_changing_lane]
        self._window.update(elapsed_s=elapsed_s, changing_lane=[*changing_lane, *mine])
        for name in self._rides.rides.keys() - self._window.driven:
            self._contacts_before += self._rides.rides.pop(name).contacts

    def _enter(self, cars: Iterable[Inserted]) -> None:
        for car in cars:
            # As a car of the window it is of a type of its own, which has its desired speed.
            common = replace(car, kind=car.kind.partition("@")[0], fastest_mps=FASTEST_CAR_MPS)
            stretch = replace(self._stretch, start_m=self._window.start_m[car.name])
            self._rides.enter(common, self._driver(car.name), stretch=stretch)

    @property
    def names(self) -> list[str]:
        """Who is driven now, by their ids in SUMO."""
        return list(self._rides.rides)

    @property
    def contacts(self) -> int:
        """How often they have struck another vehicle or were struck."""
        return self._contacts_before + sum(ride.contacts for ride in self._rides.rides.values())
