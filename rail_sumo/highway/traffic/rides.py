"""The driven vehicles of a simulation: they enter, drive step by step, and are SUMO's again afterwards."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rail_sumo.config import Config
from rail_sumo.errors import CourseError, InputError
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.stretch import Stretch
from rail_sumo.highway.sumo.inserted import Inserted
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic import entry
from rail_sumo.records import Floats, MetaAction

Decide = Callable[[Floats, Agent], int]
"""What decides for a vehicle: from what it observes, and the agent itself, the next `MetaAction`."""


class Ride:
    """An agent among others, and how far it has carried out its present command.

    Args:
        agent: the agent.
        decide: what decides for it; None where somebody else tells it to.
    """

    def __init__(self, agent: Agent, decide: Decide | None = None) -> None:
        self.agent = agent
        self._decides = decide
        self.decisions = 0
        """How many have been taken for it."""
        self._ordered = self._driven = 0  # steps of the present command

    @property
    def is_idle(self) -> bool:
        """Whether its last command has been carried out."""
        return self._driven == self._ordered

    @property
    def contacts(self) -> int:
        """How often its vehicle struck another or was struck."""
        return self.agent.host.collisions + self.agent.host.struck

    def is_over(self, simulation: Simulation) -> bool:
        """Look around if it is time to, and return whether it has driven as far as it can."""
        agent = self.agent
        if agent.host.is_lost:
            return True
        if self.is_idle and agent.is_due:
            agent.look(simulation.scene(agent.host))
        return agent.end is not None

    def decide(self) -> None:
        """Take a decision for it."""
        assert self._decides is not None
        self.agent.decide(MetaAction(self._decides(self.agent.observation, self.agent)))
        self.decisions += 1

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


def lay_anew(agent: Agent, simulation: Simulation, world: Config, *, until_arrival: bool = False) -> bool:
    """Lay an agent's course along the way that its vehicle has now, and return whether that could be done.

    Where a lane ahead has been closed too late for it to stop, it drives on as if it were open.

    Args:
        agent: the agent. It keeps its course while its vehicle is within a junction, and where the new one could not be
            driven.
        simulation: where it drives.
        world: how it drives.
        until_arrival: see `Rides`.
    """
    host = agent.host
    now = simulation.seen(host.name)
    if now is None:
        return False
    now, closed = replace(now, vclass=host.abilities.vclass), simulation.closed_to(host.abilities.vclass)
    lay = partial(entry.stretch_of, now, world, to_its_end=until_arrival)
    try:
        stretch = lay(closed=closed)
        heeds = not (closed and agent.is_driven_by_us) or host.can_stop_on(stretch.road)
        if not heeds:
            stretch = lay()
    except CourseError:
        simulation.note_way(host)
        return False
    host.abilities.heed_closings(heeds)
    if heeds:
        simulation.note_way(host)
    agent.follow(stretch)
    return True


def keep_to_way(agent: Agent, simulation: Simulation, world: Config, *, until_arrival: bool = False) -> None:
    """Have an agent follow another route that SUMO has given its vehicle, and heed lanes that were closed or opened.

    On a loop of ours it goes round as before. Arguments as in `lay_anew`.
    """
    if not simulation.way_has_changed(agent.host):
        return
    if agent.stretch.road.is_loop:
        simulation.note_way(agent.host)
    else:
        lay_anew(agent, simulation, world, until_arrival=until_arrival)


class Rides:
    """All driven vehicles of one simulation.

    Args:
        simulation: where they drive.
        world: how they sense and drive, and when their episodes end.
        keeps_trajectory: whether they keep what they did; see `Agent`.
        hands_off: leave them to SUMO's own driver; see `Agent`.
        until_arrival: whether they are driven until they arrive, wherever their routes lead.
    """

    def __init__(
        self,
        simulation: Simulation,
        world: Config,
        *,
        keeps_trajectory: bool,
        hands_off: bool | str = False,
        until_arrival: bool = False,
    ) -> None:
        self._simulation = simulation
        self._world = world
        self._keeps_trajectory = keeps_trajectory
        self._hands_off = hands_off
        self._until_arrival = until_arrival
        self.rides: dict[str, Ride] = {}
        """Those that are on the road, by their vehicles' ids."""

    def enter(self, car: Inserted, decide: Decide | None = None, *, stretch: Stretch | None = None) -> Ride:
        """Take over a vehicle that has just been inserted.

        Args:
            car: the vehicle.
            decide: what decides for it in `drive`.
            stretch: what it drives; otherwise its route.

        Raises:
            CourseError: its route could not be driven.
            InputError: what is to decide cannot be called.
        """
        if decide is not None and not callable(decide):
            raise InputError(
                f"what decides for a vehicle takes an observation and the vehicle, and returns a meta-action; got a "
                f"{type(decide).__name__}: of a driver give its `decide`"
            )
        stretch = stretch or entry.stretch_of(car, self._world, to_its_end=self._until_arrival)
        host = self._simulation.lay_course(
            stretch.road, self._world.adas, sees_m=stretch.sees_m, host=car.name, shares_type=True
        )
        self._simulation.take_over(car)
        agent = Agent(
            host,
            stretch,
            self._world,
            hands_off=self._hands_off,
            enters_as_traffic=self._world.adas.starts_by_the_limit,
            in_demand=self._simulation.in_demand,
            keeps_trajectory=self._keeps_trajectory,
        )
        self.rides[car.name] = Ride(agent, decide)
        return self.rides[car.name]

    def part(self, name: str) -> Ride:
        """Let SUMO's own driver drive a vehicle on."""
        ride = self.rides.pop(name)
        self._simulation.hand_back(ride.agent.host)
        return ride

    def drive(self) -> list[Ride]:
        """Take the decisions that are due, then drive one step; returns those who are not driven any more.

        Some have driven as far as they can, and SUMO drives them from this step on. Others have left the road in it.
        """
        over = []
        for name, ride in list(self.rides.items()):
            self.keep_to_way(ride)
            if ride.is_over(self._simulation) and not self._goes_on(ride):
                over.append(self.part(name))
            elif ride.is_idle:
                if ride.agent.is_due:
                    ride.decide()
                ride.command(self._simulation)
        return over + self.step()

    def keep_to_way(self, ride: Ride) -> None:
        """Have a vehicle keep to its way, if that has changed; see the function."""
        keep_to_way(ride.agent, self._simulation, self._world, until_arrival=self._until_arrival)

    def _goes_on(self, ride: Ride) -> bool:
        """Whether a vehicle at the end of its course can follow its route on, which comes over an edge again."""
        goes_on = self._until_arrival and ride.agent.end == "end of road"
        return goes_on and lay_anew(ride.agent, self._simulation, self._world, until_arrival=True)

    def step(self) -> list[Ride]:
        """Let everybody drive one step; returns those who have left the road in it."""
        left = [self.rides.pop(name) for name in self._simulation.step()]
        for ride in self.rides.values():
            ride.note()
        return left
