"""A drive as it can be watched: who was where in every frame, what the driver saw and decided, and the road below.

Coordinates are the network's: metres, x east, y north; headings in radians counter-clockwise from east; (x, y) is the
centre of a vehicle's box.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rail_sumo.records import Floats, MetaAction

Holding = Literal[
    "set speed",
    "limit",
    "limit ahead",
    "top speed",
    "vehicle ahead",
    "emergency",
    "signal",
    "right of way",
    "lane end",
    "gap beside",
    "vehicle joining",
    "vehicle across",
    "SUMO",
]
"""What the host's speed followed: what the driver has set, or what the assistance layer made of it."""

Why = Literal["", "no lane", "line", "gap", "room", "lane ends", "just left", "no gain", "under way"]
"""Why a lane change was not carried out; empty where it was, or where none was asked for."""

Stays = Literal["", "lowest", "highest", "same"]
"""Where the set speed stays in spite of a decision to accelerate or decelerate; empty where it changes."""

MarkKind = Literal[
    "lane change", "refused", "reversed", "hard braking", "overtake", "overtaken", "lane end", "collision", "struck"
]


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane, or one of a junction's inside."""

    id: str
    points: Floats
    """(n, 2): its centre line."""
    width_m: float
    is_open: bool
    """Whether it is open to cars."""
    is_inside: bool
    """Whether it is of a junction's inside."""
    left_line: Literal["none", "dashed", "solid"]
    """What is painted between it and the next lane of its edge from the kerb on, "none" where there is none; "solid"
    where nobody may change over."""

    @property
    def edge(self) -> str:
        """The id of its edge."""
        return self.id.rpartition("_")[0]


@dataclass(frozen=True, slots=True)
class StopLine:
    """Where a lane ends at a traffic light; one that leads on in several directions has a part of the line for each."""

    lane: str
    """The lane's id."""
    ends: tuple[float, float, float, float]
    """x and y of its right end, and of its left."""
    light: str = ""
    """The traffic light's id."""
    index: int = 0
    """Which of the light's links it belongs to."""


@dataclass(frozen=True)
class Ground:
    """What lies still: a network, or the part of it that is near what is watched."""

    lanes: tuple[Lane, ...]
    junctions: tuple[Floats, ...]
    """(n, 2) each: the corners of a junction's area."""
    stop_lines: tuple[StopLine, ...]
    name: str
    """The network's."""
    is_left_hand: bool = False
    """Whether it is driven on the left: then the next lane from the kerb on is to the right."""


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Somebody on the road."""

    id: str
    vclass: str
    """SUMO's vehicle class, such as "passenger" or "truck"."""
    length_m: float
    width_m: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What the driver decided, and what was made of it."""

    frame: int
    """The frame that it was taken in."""
    asked: MetaAction
    carried_out: MetaAction
    why: Why
    open: tuple[bool, ...]
    """For each meta-action, whether the assistance layer would have carried it out."""
    probabilities: tuple[float, ...] = ()
    """Of each meta-action, where the driver has them."""
    judged: float | None = None
    """The judge's score of it, 0 to 1; None without a judge."""
    stays: Stays = ""
    """Whether it left the set speed where it was, at an end of its range or elsewhere, so that it had no effect."""


@dataclass(frozen=True, slots=True)
class Mark:
    """Something to jump to."""

    frame: int
    kind: MarkKind
    text: str = ""


@dataclass(frozen=True)
class Driven:
    """What the driver of the host saw and did. Arrays have one row per frame."""

    vehicle: int
    """Which of the film's vehicles is the host."""
    ray_m: Floats
    """(n_frames, n_rays): how far each ray reached. Ray k points 2 pi k / n_rays counter-clockwise from the heading."""
    range_m: float
    """The rays' range: one that reached so far hit nothing."""
    set_mps: Floats
    """(n_frames,): the set speed; NaN where SUMO's own driver has none."""
    limit_mps: Floats
    """(n_frames,): the speed limit where it was."""
    gap_m: Floats
    """(n_frames,): bumper to bumper to the vehicle ahead; NaN where there is none in sight."""
    holding: NDArray[np.int8]
    """(n_frames,): indices into the members of `Holding`."""
    decisions: tuple[Decision, ...]
    marks: tuple[Mark, ...]
    end_reason: str = ""
    """Why its episode ended after the last frame, by `records.EndReason`."""


@dataclass(frozen=True)
class Film:
    """One drive, or a stretch of any simulation. `frame` and what follows has one row per vehicle and frame."""

    name: str
    """Who drives, or what file it is of."""
    start_s: float
    """The simulation's time in frame 0."""
    step_s: float
    """Between two frames."""
    n_frames: int
    vehicles: tuple[Vehicle, ...]
    frame: NDArray[np.int32]
    """(n_rows,), not descending."""
    vehicle: NDArray[np.int32]
    """(n_rows,): an index into `vehicles`."""
    x_m: Floats
    y_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    signals: tuple[tuple[tuple[int, str], ...], ...] = ()
    """For each of the ground's stop lines: the frames in which its signal changed, and SUMO's letter from then on."""
    driven: Driven | None = None
    """None where nobody is driven by us."""
    left_out: str = ""
    """A sentence, where vehicles or frames are left out; else empty."""
