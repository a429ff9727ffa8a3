"""A traffic signal on the host's way, and whether the host stops at it."""

from typing import NamedTuple

YELLOW = frozenset("yY")
"""SUMO's letters for it, minor and major."""
NOT_GREEN = YELLOW | frozenset("ru")
"""Yellow, red, and red with yellow."""


class Signal(NamedTuple):
    """The next signal on the host's way, as the host meets it."""

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

    def stops(self, speed_mps: float, *, braking_mps2: float) -> bool:
        """Return whether the host stops: at red, and at yellow if it would not get there in time; while it can."""
        if self.is_green or speed_mps**2 / (2 * braking_mps2) > self.ahead_m:
            return False
        return not self.is_yellow or speed_mps * self.left_s < self.ahead_m
