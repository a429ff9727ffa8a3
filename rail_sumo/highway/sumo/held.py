"""Vehicles that are kept from changing lanes while driven ones near them do."""

from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

import libsumo

RESPECT_OTHERS_GAPS = 512
"""Lane-change mode: no change of its own accord; a commanded one waits for a gap that is safe to others."""


class _Held(NamedTuple):
    mode: int
    """Its own lane-change mode."""
    by: set[str]
    """The hosts beside which it is."""


class HeldVehicles:
    """Who is kept from changing lanes, and by which hosts.

    SUMO knows a vehicle in one lane only. Its own drivers would move in beside the part of a host that still stands in
    the lane it has crossed out of.
    """

    def __init__(self) -> None:
        self._held: dict[str, _Held] = {}

    def are_held_by(self, host: str) -> bool:
        """Return whether a host keeps anybody."""
        return any(host in held.by for held in self._held.values())

    def hold(self, names: Iterable[str], host: str) -> None:
        """Keep some vehicles from changing lanes until a host releases them."""
        for name in names:
            if name not in self._held:
                self._held[name] = _Held(libsumo.vehicle.getLaneChangeMode(name), set())
                libsumo.vehicle.setLaneChangeMode(name, RESPECT_OTHERS_GAPS)
            self._held[name].by.add(host)

    def release(self, host: str) -> None:
        """Let those go that a host has kept, unless another still does."""
        for name, held in sorted(self._held.items()):
            held.by.discard(host)
            if not held.by:
                del self._held[name]
                with suppress(libsumo.TraCIException):  # it has left
                    libsumo.vehicle.setLaneChangeMode(name, held.mode)

    def forget(self, name: str) -> None:
        """Leave a vehicle out, which is to be driven itself."""
        self._held.pop(name, None)
