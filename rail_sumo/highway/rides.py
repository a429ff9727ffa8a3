"""The driven vehicles of a simulation: they enter, drive step by step, and are the demand's again afterwards."""

from rail_sumo.config import Config
from rail_sumo.highway import entry
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.simulation import Inserted, Simulation
from rail_sumo.highway.stretch import Stretch


class Ride:
    """An agent among others, and how far it has carried out its present command."""

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self._ordered = self._driven = 0  # steps of the present command

    @property
    def is_idle(self) -> bool:
        """Whether its last command has been carried out."""
        return self._driven == self._ordered

    def command(self, simulation: Simulation) -> None:
        """Give its next command."""
        command = self.agent.command()
        simulation.obey(self.agent.host, command)
        self._ordered, self._driven = command.steps, 0

    def note(self) -> None:
        """Note that a step has been driven."""
        self._driven += 1
        host = self.agent.host
        if not host.is_lost and (self.is_idle or host.contact or host.junctions.must_look):
            self._note_all()

    def leave(self) -> None:
        """End its episode where it is: it has left the road, or can no longer be driven."""
        if self._driven:
            self._note_all()
        self.agent.leave()

    def _note_all(self) -> None:
        self.agent.note(self._driven)
        self._ordered = self._driven = 0


class Rides:
    """All driven vehicles of one simulation.

    Args:
        simulation: where they drive.
        world: how they sense and drive, and when their episodes end.
        keeps_trajectory: whether they keep what they did; see `Agent`.
    """

    def __init__(self, simulation: Simulation, world: Config, *, keeps_trajectory: bool) -> None:
        self._simulation = simulation
        self._world = world
        self._keeps_trajectory = keeps_trajectory
        self.rides: dict[str, Ride] = {}
        """Those that are on the road, by their vehicles' ids."""

    def enter(self, car: Inserted, stretch: Stretch | None = None) -> Ride:
        """Take over a vehicle that has just been inserted, along its route or a stretch of it.

        Raises:
            CourseError: its route cannot be driven.
        """
        stretch = stretch or entry.stretch_of(car, self._world)
        host = self._simulation.lay_course(
            stretch.road, self._world.adas, sees_m=stretch.sees_m, host=car.name, shares_type=True
        )
        self._simulation.take_over(car)
        agent = Agent(
            host,
            stretch,
            self._world,
            enters_as_traffic=self._world.adas.starts_by_the_limit,
            keeps_trajectory=self._keeps_trajectory,
        )
        self.rides[car.name] = Ride(agent)
        return self.rides[car.name]

    def part(self, name: str) -> Ride:
        """Let SUMO's own driver drive a vehicle on."""
        ride = self.rides.pop(name)
        self._simulation.hand_back(ride.agent.host)
        return ride

    def step(self) -> list[Ride]:
        """Let everybody drive one step; returns those who have left the road in it."""
        left = [self.rides.pop(name) for name in self._simulation.step()]
        for ride in self.rides.values():
            ride.note()
        return left
