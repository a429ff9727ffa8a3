"""Where others may come first on the host's way, and where it must be how slow for that."""

import math
from typing import NamedTuple

YELLOW = frozenset("yY")
"""SUMO's letters for it, minor and major."""
NOT_GREEN = YELLOW | frozenset("ru")
"""Yellow, red, and red with yellow."""

SIGNAL_SHORT_M = 2.5
"""How far before a signal's stop line the host stands. SUMO's own distance is 1 m, and it brakes for that harder."""
YELLOW_MPS2 = 3.0
"""Whoever can stop at yellow by such braking, does: 10 feet/s², by which traffic engineers time it (ITE)."""
LINE_SHORT_M = 0.3
"""How far before any other line the host stands. SUMO stops vehicles that must wait 0.1 m before it, ..."""
CREEP_MPS = 0.2
"""... and a vehicle that stands farther back may wait for ever, so the host creeps on at this speed."""
SIGHT_M = 4.5
"""How far before a way without priority drivers see who comes, unless the network says otherwise."""

Place = tuple[float, float]
"""Metres ahead of the host, and how slow it must be there, in m/s."""


class Signal(NamedTuple):
    """A traffic signal, as the host meets it."""

    ahead_m: float
    """How far ahead its stop line is."""
    state: str
    """SUMO's letter for what it shows."""
    left_s: float
    """How long it will show that."""

    @property
    def is_green(self) -> bool:
        """Whether it asks nobody to stop."""
        return self.state not in NOT_GREEN

    @property
    def is_yellow(self) -> bool:
        """Whether it is about to turn red."""
        return self.state in YELLOW

    @property
    def stop(self) -> Place:
        """Where the host stands while it waits."""
        return self.ahead_m - SIGNAL_SHORT_M, 0.0

    def stops(self, speed_mps: float, *, braking_mps2: float) -> bool:
        """Return whether the host stops: at red, and at yellow if that is easy or it were too late; while it can."""
        if self.is_green or speed_mps**2 / (2 * braking_mps2) > self.ahead_m:
            return False
        stands_in_m, _ = self.stop
        is_easy = speed_mps**2 / (2 * YELLOW_MPS2) <= stands_in_m
        return not self.is_yellow or is_easy or speed_mps * self.left_s < self.ahead_m


class GiveWay(NamedTuple):
    """A way without priority through a junction: at a sign, among equals, or where a signal permits to go."""

    ahead_m: float
    """How far ahead it begins."""
    is_open: bool
    """Whether SUMO would let the host through if it arrived now."""
    sight_m: float = SIGHT_M
    """How far before it the host sees who comes."""
    is_within: bool = False
    """Whether it is a second place to wait, within the junction. While that is open SUMO has nobody slow down."""

    def sight(self, *, braking_mps2: float) -> Place:
        """Return where the host sees who comes, and from how fast it can stop then by such braking."""
        return self.ahead_m - self.sight_m, math.sqrt(2 * braking_mps2 * max(self.sight_m - LINE_SHORT_M, 0.0))

    @property
    def stop(self) -> Place:
        """Where the host waits."""
        return self.ahead_m - LINE_SHORT_M, CREEP_MPS

    def stops(self, speed_mps: float, *, braking_mps2: float) -> bool:
        """Return whether the host stops: if it may not go, and while it can."""
        return not self.is_open and speed_mps**2 / (2 * braking_mps2) <= self.ahead_m
