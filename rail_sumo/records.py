"""The records that cross the borders between modules, and the column names of every table."""

import math
import operator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SECONDS_PER_STEP = 0.1
"""SUMO's step, in seconds. Rewards are accounted per step of this length."""

KMH = 3.6
"""Kilometres per hour in one metre per second."""


class MetaAction(IntEnum):
    """What the supervisor can decide."""

    KEEP = 0
    ACCELERATE = 1
    DECELERATE = 2
    LEFT = 3
    RIGHT = 4

    @classmethod
    def of(cls, action: Any) -> "MetaAction":
        """Return the meta-action of a number, of whatever library's whole ones.

        Raises:
            ValueError: there is none.
        """
        try:
            return cls(operator.index(action))
        except (TypeError, ValueError):
            names = ", ".join(f"{one.value} {one.name.lower()}" for one in cls)
            raise ValueError(f"an action is one whole number ({names}); got {action!r}") from None


class Scene(NamedTuple):
    """All vehicles around the host now, the host first.

    SI units, road frame: x east, y north, headings in radians counter-clockwise from east, (x, y) the centre of
    each vehicle's box.
    """

    time_s: float
    ids: list[str]
    boxes: Floats
    """Shape (6, n_vehicles): x, y, heading, speed, length and width; column 0 is the host."""

    @property
    def x_m(self) -> Floats:
        """Shape (n_vehicles,), as all that follow."""
        return self.boxes[0]

    @property
    def y_m(self) -> Floats:
        """Of the centres."""
        return self.boxes[1]

    @property
    def heading_rad(self) -> Floats:
        """Of the boxes."""
        return self.boxes[2]

    @property
    def speed_mps(self) -> Floats:
        """Along the heading."""
        return self.boxes[3]

    @property
    def length_m(self) -> Floats:
        """Along the heading."""
        return self.boxes[4]

    @property
    def width_m(self) -> Floats:
        """Across it."""
        return self.boxes[5]


class HostState(NamedTuple):
    """Where the host stands on its lane: what lane keeping and the gap gate steer by."""

    speed_mps: float
    lane: int
    rightmost_lane: int
    leftmost_lane: int
    to_edge_end_m: float
    """Metres to the end of the edge, or of the junction's inside where that is as good as one; else 0 on a junction."""
    lane_width_m: float
    to_left_m: float
    """Metres from the centre of its lane to that of the lane to the left; 0 where there is none to change to."""
    to_right_m: float
    leads_on_m: tuple[float, ...]
    """For each lane, from the rightmost: how far beyond the edge's end it leads on along the course; inf to its end."""
    limit_mps: float = math.inf
    """The speed limit here."""
    limits_ahead: tuple[tuple[float, float], ...] = ()
    """Metres beyond the edge's end (before it, where negative), and the highest speed from there on."""
    stops_ahead: tuple[tuple[float, float], ...] = ()
    """Metres ahead of the host itself, and how slow it must be there, in m/s, however hard it brakes for that."""
    left_goes_on_m: float = 0.0
    """How far beyond the edge's end the host's lane may be left for the one to its left without a break."""
    right_goes_on_m: float = 0.0
    sumos_lane_changes: int = 0
    """How often SUMO has changed lanes by now, as the host's driver or while the host asked to be let in."""
    dead_ends: tuple[bool, ...] = ()
    """For each lane, from the rightmost: whether it leads nobody on where it ends; empty where none ends."""
    queued_m: tuple[float, ...] = ()
    """For each lane, from the rightmost: how long the queue ahead in it is; empty where none matters."""

    def ends_in_m(self, lane: int) -> float:
        """Return how far ahead of the host a lane stops leading on along the course."""
        return self.to_edge_end_m + self.leads_on_m[lane - self.rightmost_lane]

    def is_dead_end(self, lane: int) -> bool:
        """Return whether a lane leads nobody on where it ends."""
        return bool(self.dead_ends) and self.dead_ends[lane - self.rightmost_lane]


class Gaps(NamedTuple):
    """The gaps in a lane, bumper to bumper; a vehicle alongside makes one negative; inf if none."""

    ahead_m: float
    ahead_speed_mps: float
    behind_m: float
    behind_speed_mps: float


class Lane(NamedTuple):
    """A lane of SUMO's, or one of a junction's inside."""

    length_m: float
    limit_mps: float
    is_open: bool = True
    """Whether it is open to cars."""
    has_priority: bool = False
    """Whether nobody need wait at its end: it leads on, all ways have priority, and there is no signal."""


SUMO_DECIDES = -1.0
"""As a commanded speed: SUMO's own driver picks it."""


class Command(NamedTuple):
    """What the host's actuators do for the next `steps` SUMO steps."""

    speed_mps: float
    """The set speed, which adaptive cruise control and emergency braking lower; negative: SUMO's driver picks it."""
    lateral_m: float = 0.0
    """Offset from the centre of the lane the host is on (after `cross`), leftwards positive."""
    cross: int = 0
    """+1 to become a vehicle of the lane to the left on the next step, -1 of the one to the right."""
    steps: int = 1
    asks: int = 0
    """+1 to ask those in the lane to the left to let it in, as by its indicator, -1 those to the right."""
    must_leave: int | None = None
    """+1 where its lane must be left to the left, however far ahead, -1 to the right, 0 where none leads on farther;
    None: SUMO knows."""


EndReason = Literal[
    "course", "duration", "collision", "end of road", "standstill", "left the road", "not begun", "SUMO stopped"
]
UNDRIVEN: tuple[EndReason, ...] = ("not begun", "SUMO stopped")
"""Why an episode has no figures."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One episode as it was driven: decisions for the learners, steps and counts for the metrics."""

    observations: Floats
    """(n_decisions, n_features): what the supervisor saw."""
    decisions: NDArray[np.int64]
    """(n_decisions,): the `MetaAction` it asked for."""
    carried_out: NDArray[np.int64]
    """(n_decisions,): the `MetaAction` carried out; KEEP for a lane change refused or under way already."""
    allowed: NDArray[np.bool_]
    """(n_decisions, 5): which meta-actions the supervisor was told it may choose; all of them where nobody asked."""
    decision_step: NDArray[np.int64]
    """(n_decisions,): after how many SUMO steps each was taken."""
    decision_place: Floats
    """(n_decisions, 3): where the host was then: metres driven, and x and y of its centre on the network."""
    speed_mps: Floats
    """(n_steps + 1,): the host's speed at the start and after every SUMO step."""
    distance_m: float
    """How far the host has driven, by SUMO's odometer."""
    limit_mps: Floats
    """(n_steps,): the speed limit where the host was when that step was commanded."""
    lane_changing: NDArray[np.bool_]
    """(n_steps,): whether a lane change was under way in that step."""
    overtakes: int
    overtaken: int
    lane_changes: int
    aborted_lane_changes: int
    refused_decisions: int
    collisions: int
    struck: int
    hard_brakings_behind: int
    """How often a vehicle braked hard behind the host within 5 s of the host's moving in front of it."""
    min_ttc_s: float
    """Smallest time to collision with the vehicle ahead; inf if the host never closed in on one."""
    end_reason: EndReason | None
    """None while it is under way."""
    seed: int
    """Seed of the episode's traffic."""
    network: str
    host: str
    """SUMO's id of its vehicle."""
    depart_s: float
    """When that entered the road, by SUMO's clock."""


EPISODE_COLUMNS: dict[str, str] = {
    "policy": "string",
    "episode": "int64",
    "seed": "int64",
    "network": "string",
    "host": "string",
    "depart_s": "float64",
    "duration_s": "float64",
    "distance_m": "float64",
    "speed_kmh": "float64",
    "overtakes": "int64",
    "overtaken": "int64",
    "lane_changes": "int64",
    "aborted_lane_changes": "int64",
    "longitudinal_reward": "float64",
    "lateral_reward": "float64",
    "collisions": "int64",
    "struck": "int64",
    "refused_decisions": "int64",
    "min_ttc_s": "float64",
    "hardest_braking_mps2": "float64",
    "hard_brakings": "int64",
    "hard_brakings_behind": "int64",
    "end_reason": "string",
}
"""Columns of the `episodes` table, in order, with their pandas types."""

COMPARISON_COLUMNS: dict[str, str] = {
    "ratio": "float64",
    "ratio_low": "float64",
    "ratio_high": "float64",
    "difference": "float64",
    "difference_low": "float64",
    "difference_high": "float64",
}
"""How a mean compares with the reference's, in the `summary` table and in Table 1; see `report.figures`."""

SUMMARY_COLUMNS: dict[str, str] = {
    "policy": "string",
    "metric": "string",
    "episodes": "int64",
    "mean": "float64",
    "low": "float64",
    "high": "float64",
    "reference": "string",
    **COMPARISON_COLUMNS,
}
"""Columns of the `summary` table, in order; see `report.summary`."""

DECISION_COLUMNS: dict[str, str] = {
    "policy": "string",
    "episode": "int64",
    "time_s": "float64",
    "distance_m": "float64",
    "x_m": "float64",
    "y_m": "float64",
    "speed_kmh": "float64",
    "asked": "string",
    "carried_out": "string",
}
"""Columns of the `decisions` table, in order, with their pandas types: a row per decision."""

METRICS: tuple[str, ...] = tuple(
    name for name, kind in EPISODE_COLUMNS.items() if kind != "string" and name not in ("episode", "seed", "depart_s")
)
"""The numeric columns of `episodes` that `summary` summarises."""
