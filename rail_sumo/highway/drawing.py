"""The road from above, around the host: what it senses, who is near, how fast they are. Needs matplotlib.

One drawing, for the frames of the environment and for the picture in the documentation.
"""

import itertools
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rail_sumo.errors import InputError
from rail_sumo.highway.network.markings import Markings
from rail_sumo.records import KMH, Floats, Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.text import Text
    from matplotlib.typing import ColorType

ASPHALT, MARKING, BORDER, INK, GROUND = "#dfe4e8", "#ffffff", "#78858d", "#263238", "#f6f8f4"
HOST = ON_VEHICLE = "#d55e00"  # vermilion: stands out from viridis to any eye
ON_BORDER = "#9aa7b0"
SPEEDS = "viridis"
DPI = 100.0
BAND_M = 3.6
"""How high the strips of text above and below the road are."""
NEAR_END_M = 0.05
"""A ray ends on a vehicle if its end is this near to the vehicle's outline."""


class View(NamedTuple):
    """What is to be seen, in metres; the host drives to the right."""

    behind_m: float
    ahead_m: float
    """From the host's centre, as behind it."""
    right_m: float
    left_m: float
    """From the middle of its course."""

    @property
    def width_m(self) -> float:
        """Along the road."""
        return self.behind_m + self.ahead_m

    @property
    def height_m(self) -> float:
        """Across it, with the strips of text."""
        return self.right_m + self.left_m + 2 * BAND_M


@dataclass(frozen=True)
class Moment:
    """The scene at a decision, the scan made of it, and the road."""

    scene: Scene
    distance_m: Floats
    """(n_rays,): how far each ray of the LIDAR reaches; see `Lidar`."""
    markings: Markings
    boundaries: Floats
    """(n_segments, 4): the outer borders of the host's course; see `Road.boundaries`."""
    is_left_hand: bool = False
    """Whether scene and markings are told in the mirror; see `Road.is_left_hand`. They are shown as they are."""

    def seen_from_host(self, points: Floats) -> Floats:
        """Return points of the road frame, shape (..., 2), as metres ahead of the host and to its left."""
        cos, sin = np.cos(self.scene.heading_rad[0]), np.sin(self.scene.heading_rad[0])
        ahead = np.array([[cos, -sin], [sin, cos]])
        turned: Floats = (points - [self.scene.x_m[0], self.scene.y_m[0]]) @ ahead
        return turned * [1.0, -1.0] if self.is_left_hand else turned

    @cached_property
    def centres_m(self) -> Floats:
        """Of the vehicles, shape (n_vehicles, 2), from the host."""
        return self.seen_from_host(np.column_stack([self.scene.x_m, self.scene.y_m]))

    @cached_property
    def headings_rad(self) -> Floats:
        """Of the vehicles, shape (n_vehicles,), to the host's."""
        turned: Floats = self.scene.heading_rad - self.scene.heading_rad[0]
        return -turned if self.is_left_hand else turned

    @cached_property
    def ends_m(self) -> Floats:
        """Where the rays end, shape (n_rays, 2), from the host."""
        angles = 2 * np.pi * np.arange(len(self.distance_m)) / len(self.distance_m)
        side = -1.0 if self.is_left_hand else 1.0
        return self.distance_m[:, None] * np.column_stack([np.cos(angles), side * np.sin(angles)])

    @cached_property
    def _hits(self) -> NDArray[np.bool_]:
        """(n_rays, n_vehicles - 1): whether a ray ends on a vehicle other than the host."""
        scene, turn = self.scene, self.headings_rad[1:]
        east, north = (self.ends_m[:, None] - self.centres_m[1:]).transpose(2, 0, 1)
        along, across = east * np.cos(turn) + north * np.sin(turn), north * np.cos(turn) - east * np.sin(turn)
        beyond = np.maximum(abs(along) - 0.5 * scene.length_m[1:], abs(across) - 0.5 * scene.width_m[1:])
        return np.asarray(beyond < NEAR_END_M)

    @cached_property
    def middle_m(self) -> float:
        """How far to the left of the host the middle of its course is, where it is now; 0 where the course is open."""
        (x1, y1), (x2, y2) = self.seen_from_host(self.boundaries.reshape(-1, 2, 2)).transpose(1, 2, 0)
        beside = (x1 <= 0.0) != (x2 <= 0.0)
        left = (y1 - x1 * (y2 - y1) / np.where(beside, x2 - x1, 1.0))[beside]
        if not (left > 0.0).any() or not (left < 0.0).any():
            return 0.0
        return 0.5 * float(left[left > 0.0].min() + left[left < 0.0].max())

    @property
    def on_vehicle(self) -> NDArray[np.bool_]:
        """(n_rays,): whether the ray ends on a vehicle."""
        return np.asarray(self._hits.any(axis=1))

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n_vehicles,): whether a ray ends on it; the host counts as seen."""
        return np.concatenate([[True], self._hits.any(axis=0)])


def require_matplotlib() -> None:
    """Raise InputError if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise InputError("pictures of the road need matplotlib; install it with: pip install 'rail-sumo[render]'")


class Picture:
    """A sheet of fixed size that one moment after the other is drawn on.

    Args:
        width_px: how wide it is; its height follows from the view.
        view: what is to be seen.
        speeds_kmh: the lowest and the highest speed that are told apart by colour.
        text_px: the size of its text.

    Raises:
        InputError: matplotlib is not installed.
    """

    def __init__(self, width_px: int, view: View, speeds_kmh: tuple[float, float], *, text_px: float = 11.0) -> None:
        require_matplotlib()
        from matplotlib import colormaps
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._view, self._speeds_kmh = view, speeds_kmh
        self._colours = colormaps[SPEEDS]
        self._point = text_px / 8.0 * 72.0 / DPI  # lines and text grow together
        width, height = width_px / DPI, width_px / DPI * view.height_m / view.width_m
        self._canvas = FigureCanvasAgg(Figure(figsize=(width, height), dpi=DPI, facecolor=GROUND))
        self._road, self._strips = (self._canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0), zorder=z) for z in (0, 1))
        for axes in (self._road, self._strips):
            axes.set(xlim=(-view.behind_m, view.ahead_m), autoscale_on=False)
            axes.axis("off")
        self._draw_strips()

    def draw(self, moment: Moment, title: str, note: str = "") -> None:
        """Draw a moment in place of the last, with the road across the middle.

        Args:
            moment: what is drawn.
            title: is written above the road, at the left.
            note: is written at the right.
        """
        view, road = self._view, self._road
        for artist in [*road.collections, *road.texts, *road.lines]:
            artist.remove()
        low_m, high_m = -view.right_m - BAND_M, view.left_m + BAND_M
        road.set_ylim(low_m + moment.middle_m, high_m + moment.middle_m)
        self._draw_road(moment)
        self._draw_rays(moment)
        self._draw_vehicles(moment)
        self._title.set_text(title)
        self._note.set_text(note)

    def pixels(self) -> NDArray[np.uint8]:
        """Return what is drawn, shape (height, width, 3)."""
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()

    def save(self, path: Path) -> None:
        """Write it as a picture, in the format of the file's suffix."""
        self._canvas.figure.savefig(path, dpi=DPI, metadata={"Software": None})

    def _draw_road(self, moment: Moment) -> None:
        from matplotlib.collections import LineCollection, PolyCollection

        markings = moment.markings
        lines = (moment.boundaries.reshape(-1, 2, 2), markings.borders, markings.dashes)
        edges, borders, dashes = (self._near(moment, pieces) for pieces in lines)
        crossed = [moment.seen_from_host(corners) for corners in markings.junctions if self._is_near(moment, corners)]
        # An edge of their own colour closes the seams between the pieces.
        surface: dict[str, Any] = {"facecolors": ASPHALT, "edgecolors": ASPHALT, "linewidths": 0.6, "zorder": 1}
        self._add(PolyCollection([*self._near(moment, markings.asphalt), *crossed], **surface))
        width = 1.6 * self._point
        self._add(LineCollection(list(dashes), colors=MARKING, linewidths=width, zorder=2))
        self._add(LineCollection([*borders, *edges], colors=BORDER, linewidths=width, zorder=2))

    def _add(self, collection: "Collection") -> None:
        self._road.add_collection(collection, autolim=False)

    def _is_near(self, moment: Moment, corners: Floats) -> bool:
        reach_m = self._view.width_m
        middle, half = 0.5 * (corners.max(axis=0) + corners.min(axis=0)), 0.5 * np.ptp(corners, axis=0)
        return bool((abs(middle - [moment.scene.x_m[0], moment.scene.y_m[0]]) < half + reach_m).all())

    def _near(self, moment: Moment, pieces: Floats) -> Floats:
        """Return those pieces that may be in view, from the host."""
        half, host = 0.5 * np.ptp(pieces, axis=1), [moment.scene.x_m[0], moment.scene.y_m[0]]
        beyond = abs(0.5 * (pieces.max(axis=1) + pieces.min(axis=1)) - host) - half
        return moment.seen_from_host(pieces[(beyond < self._view.width_m).all(axis=1)])

    def _draw_rays(self, moment: Moment) -> None:
        from matplotlib.collections import LineCollection

        for on_vehicle, colour, width, size in ((False, ON_BORDER, 0.9, 3.0), (True, ON_VEHICLE, 1.4, 4.4)):
            ends = moment.ends_m[moment.on_vehicle == on_vehicle]
            rays = [((0.0, 0.0), end) for end in ends]
            width, size = width * self._point, size * self._point
            self._add(LineCollection(rays, colors=colour, linewidths=width, zorder=3 + on_vehicle))
            dots: dict[str, Any] = {"mec": "white", "mew": 0.7 * self._point, "zorder": 7}
            self._road.plot(*ends.T, ls="", marker="o", ms=size, color=colour, **dots)

    def _draw_vehicles(self, moment: Moment) -> None:
        """Draw every vehicle to scale with its speed in km/h, filled where the LIDAR hits it."""
        from matplotlib.collections import PolyCollection

        scene, view = moment.scene, self._view
        ahead, left = moment.centres_m.T
        room_m = 0.5 * scene.length_m
        across = abs(left - moment.middle_m - 0.5 * (view.left_m - view.right_m)) < 0.5 * view.height_m + room_m
        in_view = across & (ahead > -view.behind_m - room_m) & (ahead < view.ahead_m + room_m)
        rows, seen = np.flatnonzero(in_view), moment.seen
        colours = [HOST if row == 0 else self.colour_of(KMH * scene.speed_mps[row]) for row in rows]
        outlines = [
            outline(moment.centres_m[row], moment.headings_rad[row], scene.length_m[row], scene.width_m[row])
            for row in rows
        ]
        for filled in (False, True):
            chosen = [k for k, row in enumerate(rows) if seen[row] == filled]
            drawn = PolyCollection([outlines[k] for k in chosen], **self._style(filled, [colours[k] for k in chosen]))
            drawn.set_zorder(5 + filled)
            self._add(drawn)
        for row, colour in zip(rows, colours, strict=True):
            if not 4.0 - view.behind_m < ahead[row] < view.ahead_m - 4.0:
                continue
            ink = "white" if seen[row] and luminance(colour) < 0.5 else INK
            speed, weight = f"{KMH * scene.speed_mps[row]:.0f}", "bold" if row == 0 else "normal"
            self._write(self._road, ahead[row], left[row], speed, ha="center", color=ink, fontweight=weight)

    def _style(self, filled: bool, colours: "list[ColorType]") -> dict[str, Any]:
        if filled:
            return {"facecolors": colours, "edgecolors": INK, "linewidths": 0.9 * self._point}
        dashes = (0, (2.2, 1.2))
        return {"facecolors": "white", "edgecolors": colours, "linewidths": 1.5 * self._point, "linestyles": [dashes]}

    def colour_of(self, speed_kmh: float) -> "ColorType":
        """Return a vehicle's colour."""
        low, high = self._speeds_kmh
        colour: ColorType = self._colours((speed_kmh - low) / (high - low))
        return colour

    def _write(self, axes: "Axes", x: float, y: float, text: str, **style: Any) -> "Text":
        given: dict[str, Any] = {"va": "center_baseline", "color": INK, "fontsize": 8.0 * self._point, "zorder": 9}
        return axes.text(x, y, text, **given | style)

    def _draw_strips(self) -> None:
        """Draw the strip above the road, for text, and the one below it, which says what the marks mean."""
        from matplotlib.collections import LineCollection, PolyCollection

        view, axes = self._view, self._strips
        axes.set_ylim(0.0, view.height_m)
        above, below = view.height_m - 0.5 * BAND_M, 0.5 * BAND_M
        start, end, unit = -view.behind_m, view.ahead_m, view.width_m / 110.0
        for low, high in ((0.0, BAND_M), (view.height_m - BAND_M, view.height_m)):
            strip = [[[start, low], [end, low], [end, high], [start, high]]]
            axes.add_collection(PolyCollection(strip, facecolors="white", edgecolors="white"))
        self._title = self._write(axes, start + 2.2 * unit, above, "", fontweight="bold")
        self._note = self._write(axes, end - 2.2 * unit, above, "", ha="right")
        for at, colour, filled in ((3.5, HOST, True), (65.5, INK, False)):
            box = outline(np.array([start + at * unit, below]), 0.0, 2.6 * unit, 1.3 * unit)
            axes.add_collection(PolyCollection([box], **self._style(filled, [colour])))
        for at, colour, width, size in ((12.0, ON_VEHICLE, 1.4, 4.4), (32.0, ON_BORDER, 0.9, 3.0)):
            left, right = start + at * unit, start + (at + 2.5) * unit
            axes.add_collection(
                LineCollection([((left, below), (right, below))], colors=colour, linewidths=width * self._point)
            )
            axes.plot(right, below, "o", ms=size * self._point, color=colour)
        for at, text in (
            (5.6, "host"),
            (15.5, "ray on a vehicle"),
            (35.5, "ray on the road's edge, or on nothing"),
            (67.5, "vehicle no ray hits"),
        ):
            self._write(axes, start + at * unit, below, text)
        low_kmh, high_kmh = self._speeds_kmh
        shades = np.linspace(low_kmh, high_kmh, 65)
        edges = np.linspace(end - 21.0 * unit, end - 10.0 * unit, 66)
        ramp = [
            [[a, below - 0.6 * unit], [b, below - 0.6 * unit], [b, below + 0.6 * unit], [a, below + 0.6 * unit]]
            for a, b in itertools.pairwise(edges)
        ]
        axes.add_collection(PolyCollection(ramp, facecolors=[self.colour_of(kmh) for kmh in shades], linewidths=0.0))
        self._write(axes, edges[0] - 0.7 * unit, below, f"{low_kmh:.0f}", ha="right")
        self._write(axes, edges[-1] + 0.7 * unit, below, f"{high_kmh:.0f} km/h")


def outline(centre_m: Floats, heading_rad: float, length_m: float, width_m: float) -> Floats:
    """Return a vehicle's outline with rounded corners, shape (n_points, 2)."""
    radius = min(0.45, 0.3 * width_m)
    turn = np.linspace(0.0, 0.5 * np.pi, 4)
    corners = [
        np.column_stack([x + radius * np.cos(turn + start), y + radius * np.sin(turn + start)])
        for x, y, start in (
            (0.5 * length_m - radius, 0.5 * width_m - radius, 0.0),
            (radius - 0.5 * length_m, 0.5 * width_m - radius, 0.5 * np.pi),
            (radius - 0.5 * length_m, radius - 0.5 * width_m, np.pi),
            (0.5 * length_m - radius, radius - 0.5 * width_m, 1.5 * np.pi),
        )
    ]
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    around: Floats = np.concatenate(corners) @ np.array([[cos, sin], [-sin, cos]])
    return around + centre_m


def luminance(colour: "ColorType") -> float:
    """Return how bright a colour looks, 0..1 (ITU-R BT.709)."""
    from matplotlib.colors import to_rgb

    return float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)))
