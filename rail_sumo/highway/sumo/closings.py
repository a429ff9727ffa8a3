"""Lanes that a demand closes for a time: which are closed now, and to which classes of vehicles."""

from collections.abc import Iterable, Sequence

import libsumo


class Closings:
    """Notices when lanes are closed and opened.

    Args:
        lanes: the ids of those that the demand may close; others than the network's are left out.
    """

    def __init__(self, lanes: Iterable[str]) -> None:
        self._lanes = sorted(set(lanes).intersection(libsumo.lane.getIDList()))
        self._disallowed: list[Sequence[str]] = []  # the classes, on each of them
        self.number = 0
        """How often that has changed."""
        self.notice()

    def notice(self) -> None:
        """Look, after every step."""
        if self._lanes:
            disallowed = [libsumo.lane.getDisallowed(lane) for lane in self._lanes]
            self.number += disallowed != self._disallowed
            self._disallowed = disallowed

    def to(self, vclass: str) -> frozenset[str]:
        """Return the lanes that are closed to a class of vehicles now."""
        lanes = zip(self._lanes, self._disallowed, strict=True)
        return frozenset(lane for lane, disallowed in lanes if vclass in disallowed)
