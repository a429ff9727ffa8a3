"""Where others may come first on the host's way, and where it must be how slow for that."""

from typing import NamedTuple

YELLOW = frozenset("yY")
"""SUMO's letters for it, minor and major."""
NOT_GREEN = YELLOW | frozenset("ru")
"""Yellow, red, and red with yellow."""

STOP_SHORT_M = 2.5
"""How far before a stop line the host stops. SUMO's own distance is 1 m, and it brakes for that harder at the end."""
SIGHT_M = 4.5
"""How far before a way that has no priority drivers see who comes: SUMO's default."""
CAUTIOUS_MPS = 6.36
"""As fast as SUMO's cars are there: they stop within that distance at 4.5 m/s², their default braking."""
CRAWL_MPS = 0.4
"""As slow as that to the line, where SUMO stops whoever must wait."""


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
    def stop_m(self) -> float:
        """How far ahead the host stands while it waits."""
        return self.ahead_m - STOP_SHORT_M

    def stops(self, speed_mps: float, *, braking_mps2: float) -> bool:
        """Return whether the host stops: at red, and at yellow if it would not get there in time; while it can."""
        if self.is_green or speed_mps**2 / (2 * braking_mps2) > self.ahead_m:
            return False
        return not self.is_yellow or speed_mps * self.left_s < self.ahead_m


class GiveWay(NamedTuple):
    """A way without priority through a junction: at a sign, among equals, or where a signal permits to go."""

    ahead_m: float
    """How far ahead it begins."""
    is_open: bool
    """Whether SUMO would let the host through now: nobody comes who is in the way."""

    @property
    def limit(self) -> tuple[float, float]:
        """How far ahead the host must be how slow: to see who comes, or, where somebody does, to wait for them."""
        if self.is_open:
            return self.ahead_m - SIGHT_M, CAUTIOUS_MPS
        return self.ahead_m - STOP_SHORT_M, CRAWL_MPS
