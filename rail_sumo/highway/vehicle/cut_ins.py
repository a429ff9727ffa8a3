"""Whether vehicles brake hard because a driven one has moved in front of them, as SUMO has it."""

from contextlib import suppress
from dataclasses import dataclass

import libsumo

from rail_sumo.highway.vehicle.hard_braking import hard_brakings

WATCH_STEPS = 50
"""How long the vehicle behind is watched after another has moved in front of it: 5 s."""


@dataclass(slots=True)
class _Watched:
    """A vehicle that another has moved in front of."""

    name: str
    speeds_mps: list[float]
    until: int
    """The step in which the watch ends."""


class CutIns:
    """Counts the hard brakings of vehicles that one vehicle has moved in front of. The caller counts the steps."""

    def __init__(self) -> None:
        self._watched: list[_Watched] = []
        self._until = 0  # of the last of them

    def watch(self, name: str, step: int) -> None:
        """Watch the vehicle that is moved in front of now; one that is watched already, for longer."""
        self._until = step + WATCH_STEPS
        for watched in self._watched:
            if watched.name == name and watched.until >= step:
                watched.until = self._until
                return
        self._watched.append(_Watched(name, [libsumo.vehicle.getSpeed(name)], self._until))

    def note(self, step: int) -> None:
        """Record the speeds of those who are watched and still on the road."""
        if step > self._until:
            return
        for watched in self._watched:
            if watched.until >= step:
                with suppress(libsumo.TraCIException):  # it has left
                    speed_mps = libsumo.vehicle.getSpeed(watched.name)
                    if speed_mps != libsumo.INVALID_DOUBLE_VALUE:  # as of one that is being teleported
                        watched.speeds_mps.append(speed_mps)

    @property
    def hard_brakings(self) -> int:
        """How often they braked hard while they were watched."""
        return sum(hard_brakings(one.speeds_mps) for one in self._watched)
