"""The pictures of the measures, as SVG. Where a measure has code of its own, that code says what is drawn."""

import html
import io
import re
from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

from rail_sumo.config import Adas
from rail_sumo.highway.vehicle import acc, hard_braking
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.records import KMH, SECONDS_PER_STEP

INK, FAINT = "#7a858d", "#b3bcc2"  # readable on white and on black
HOST, OTHER = "#d55e00", "#0072b2"  # Okabe & Ito's vermilion and blue


def svg(name: str, caption: str) -> str:
    """Return the picture of this name, as an element of a page.

    Args:
        name: one of `PICTURES`.
        caption: what it shows, for those who cannot see it.

    Raises:
        KeyError: there is no such picture.
    """
    settings = {"svg.fonttype": "none", "svg.hashsalt": name, "font.family": "sans-serif", "font.size": 11}
    colours = dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK)
    with mpl.rc_context(settings | colours):
        figure = PICTURES[name]()
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, bbox_inches="tight", metadata={"Date": None})
    drawn = text.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r'(id=|href=|url\()(["\']?)(#?)', rf"\g<1>\g<2>\g<3>{name}-", drawn)  # ids are the page's
    label = html.escape(caption, quote=True)
    return drawn.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


def _overtakes() -> Figure:
    figure = Figure(figsize=(7.0, 1.9))
    axes = _plain(figure)
    for column, (title, at) in enumerate((("fully ahead", 6.5), ("alongside: neither", 1.5), ("fully behind", -6.5))):
        left = 22.0 * column
        axes.add_patch(Rectangle((left - 9.5, -2.0), 19.0, 7.6, color=FAINT, alpha=0.25, linewidth=0))
        axes.plot([left - 9.5, left + 9.5], [1.8, 1.8], color=FAINT, linestyle=(0, (4, 3)), linewidth=1.2)
        _car(axes, left, 0.0, HOST, "host")
        _car(axes, left + at, 3.6, INK)
        axes.text(left, 6.6, title, horizontalalignment="center")
        if column:
            axes.annotate("", (left - 9.9, 1.8), (left - 12.1, 1.8), arrowprops={"arrowstyle": "->", "color": INK})
    axes.set(xlim=(-10.0, 54.0), ylim=(-2.2, 8.2), aspect="equal")
    return figure


def _ttc() -> Figure:
    figure = Figure(figsize=(6.0, 1.5))
    axes = _plain(figure)
    axes.add_patch(Rectangle((-3.0, -1.8), 40.0, 3.6, color=FAINT, alpha=0.25, linewidth=0))
    _car(axes, 2.5, 0.0, HOST)
    _car(axes, 27.5, 0.0, OTHER)
    axes.annotate("", (25.0, -2.9), (5.0, -2.9), arrowprops={"arrowstyle": "<->", "color": INK})
    axes.text(15.0, -4.6, "s", horizontalalignment="center", style="italic")
    for begins, length, label, colour in ((5.2, 7.0, "v", HOST), (30.2, 4.0, "w", OTHER)):
        axes.annotate(
            "", (begins + length, 0.0), (begins, 0.0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.0}
        )
        axes.text(begins + length / 2, 0.7, label, color=colour, horizontalalignment="center", style="italic")
    axes.set(xlim=(-3.5, 37.5), ylim=(-5.2, 2.6), aspect="equal")
    return figure


def _braking() -> Figure:
    time_s = np.arange(0.0, 14.0, SECONDS_PER_STEP)
    braking = (
        4.6 * np.exp(-(((time_s - 3.0) / 0.8) ** 2))
        + 4.2 * np.exp(-(((time_s - 5.2) / 0.8) ** 2))
        + 2.4 * np.exp(-(((time_s - 8.2) / 0.7) ** 2))
        + 4.4 * np.exp(-(((time_s - 11.2) / 0.8) ** 2))
    )
    speed = 40.0 - np.concatenate([[0.0], np.cumsum(braking * SECONDS_PER_STEP)])
    steps = hard_braking.AVERAGED_STEPS
    averaged = (speed[:-steps] - speed[steps:]) / (steps * SECONDS_PER_STEP)
    begins = np.flatnonzero(hard_braking.starts(speed))
    assert len(begins) == hard_braking.hard_brakings(speed) == 2
    at_s = np.arange(len(averaged)) * SECONDS_PER_STEP
    figure = Figure(figsize=(6.4, 2.7))
    axes = figure.subplots()
    axes.plot(at_s, averaged, color=HOST, linewidth=2.0)
    for level, label in ((hard_braking.HARD_MPS2, "hard above"), (hard_braking.EASED_MPS2, "over below")):
        axes.axhline(level, color=INK, linewidth=0.9, linestyle="--")
        axes.text(at_s[-1] + 0.2, level, f"{label}\n{level} m/s²", verticalalignment="center", fontsize=9)
    axes.plot(at_s[begins], averaged[begins], "o", color=INK, markersize=7)
    for number, row in enumerate(begins, start=1):
        axes.text(at_s[row] - 0.25, averaged[row] + 0.1, str(number), horizontalalignment="right")
    axes.set(xlabel="time, s", ylabel="deceleration, m/s²", ylim=(0.0, 5.4), xlim=(0.0, at_s[-1]))
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _edie() -> Figure:
    figure = Figure(figsize=(6.0, 2.7))
    axes = figure.subplots()
    time_s = np.linspace(-20.0, 80.0, 400)
    for start_s, speed, stops_at_s in ((-15, 20, None), (0, 22, None), (8, 20, 25), (22, 19, 36), (38, 23, None)):
        moving = np.clip(time_s - start_s, 0.0, None)
        if stops_at_s is not None:
            held = np.clip(time_s - stops_at_s, 0.0, 9.0)
            moving = moving - held
        place = speed * moving
        shown = (time_s >= start_s) & (place <= 1000.0)
        inside = shown & (time_s >= 0.0) & (time_s <= 60.0)
        axes.plot(time_s[shown], place[shown], color=FAINT, linewidth=1.2)
        axes.plot(time_s[inside], place[inside], color=OTHER, linewidth=2.0)
    axes.add_patch(Rectangle((0.0, 0.0), 60.0, 1000.0, fill=False, edgecolor=INK, linewidth=1.4))
    axes.set(xlim=(-18.0, 76.0), ylim=(-60.0, 1120.0), xticks=[0.0, 60.0], yticks=[0.0, 1000.0])
    axes.set_xticklabels(["begins", "ends"])
    axes.set_yticklabels(["0", "L"])
    axes.set(xlabel="the period T", ylabel="place on the road")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _following() -> Figure:
    figure = Figure(figsize=(6.0, 2.9))
    axes = figure.subplots()
    gaps_m = np.linspace(2.0, 250.0, 500)
    for leader_mps, colour in ((0.0, HOST), (20.0, OTHER)):
        allowed = [acc.allowed_mps(Leader(gap_m, leader_mps), Adas()) for gap_m in gaps_m]
        axes.plot(gaps_m, np.array(allowed) * KMH, color=colour, linewidth=2.0)
        label = "leader stands" if leader_mps == 0.0 else f"leader at {leader_mps * KMH:.0f} km/h"
        axes.text(gaps_m[-1] + 3.0, allowed[-1] * KMH, label, color=colour, verticalalignment="center")
    axes.set(xlabel="gap from bumper to bumper, m", ylabel="speed allowed, km/h", xlim=(0.0, 250.0), ylim=(0.0, 145.0))
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _plain(figure: Figure) -> Axes:
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    return axes


def _car(axes: Axes, x_m: float, y_m: float, colour: str, label: str = "") -> None:
    """Draw a car of 5 m that drives to the right, by its centre."""
    shape = FancyBboxPatch(
        (x_m - 2.1, y_m - 0.5), 4.2, 1.0, boxstyle="round,pad=0.4,rounding_size=0.5", color=colour, linewidth=0
    )
    axes.add_patch(shape)
    if label:
        axes.text(x_m, y_m - 0.08, label, color="white", size=8.5, ha="center", va="center")


PICTURES: dict[str, Callable[[], Figure]] = {
    "overtakes": _overtakes,
    "ttc": _ttc,
    "braking": _braking,
    "edie": _edie,
    "following": _following,
}
