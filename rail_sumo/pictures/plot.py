"""Learning curves, and what more demonstrations bring, as pictures. Needs matplotlib, the extra `plots`."""

import io
import itertools
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from rail_sumo.errors import InputError
from rail_sumo.files import check_file, whole_file
from rail_sumo.records import Floats
from rail_sumo.run_directory import PROGRESS, PROGRESS_COLUMNS, RunDirectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Against = Literal["steps", "time"]

SMOOTHED_OVER = 5
"""Iterations in the running mean that is drawn: one iteration's rollouts leave much to chance."""

_ACROSS: dict[Against, tuple[str, float, str]] = {
    "steps": ("environment_steps", 1e-6, "environment steps, millions"),
    "time": ("seconds", 1 / 60, "training, minutes"),
}
_PANELS = {
    "speed, km/h": {"speed_kmh": "-"},
    "overtakes a rollout": {"overtakes": "-"},
    "lane changes a rollout": {"lane_changes": "-"},
}
_VERDICTS = {
    "judge's verdict on expert (solid) and learner (dashed)": {"judge_expert_mean": "-", "judge_learner_mean": "--"}
}
_RETURN = {"what is learned from: reward a rollout": {"mean_return": "-"}}
"""The last panel, where there is a judge and where there is none."""
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_STYLES = ("-", "--", "-.", ":")
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe & Ito's


def learning_curves(runs: Sequence[Path], against: Against = "steps") -> "Figure":
    """Draw how training went, over the rollouts that it went by, in training traffic: those of perturbed policies for
    a random search, of one that draws its actions for GAIL.

    Runs in one folder whose names differ in a number at their end alone (`mine-seed0`, `mine-seed1`), of one
    configuration and with a seed of its own each, and perhaps demonstrations, are one curve: their mean, with the 95 %
    confidence band of the mean (Student's t) and each run as a thin line. Others have a curve each, see `apart`. Runs
    without an iteration, such as clones, are left out.

    Args:
        runs: run directories.
        against: environment steps, or time at work.

    Raises:
        InputError: matplotlib is not installed; no run directory, a damaged one, or none with an iteration.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    drawable = {run: progress for run in runs if len(progress := _progress(run))}
    if not drawable:
        raise InputError(f"{', '.join(map(str, runs))}: no iteration to draw, as of a clone, which has none")
    groups = {at: [drawable[run] for run in of_group] for at, of_group in _grouped(drawable).items()}
    looks = [_look(number) for number in range(len(groups))]
    column, unit, label = _ACROSS[against]
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    is_judged = any(progress["judge_expert_mean"].notna().any() for progress in drawable.values())
    panels = _PANELS | (_VERDICTS if is_judged else _RETURN)
    for axes, (title, lines) in zip(figure.subplots(2, 2, sharex=True).flat, panels.items(), strict=True):
        for progress, look in zip(groups.values(), looks, strict=True):
            for drawn, style in lines.items():
                _draw(axes, progress, column, unit, drawn, {**look, "linestyle": style})
        axes.set_title(title, loc="left", fontsize="medium")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in figure.axes[2:]:
        axes.set_xlabel(label)
        axes.locator_params(axis="x", nbins=5)  # labels of a short run are long, such as 0.0012
    several = any(len(runs) > 1 for runs in groups.values())
    told = f"Rollouts in training traffic; running means over {SMOOTHED_OVER} iterations"
    figure.supxlabel(f"{told}; bands: 95 % of the mean over runs" if several else told, fontsize="small", color="0.4")
    handles = [figure.axes[0].plot([], [], **look)[0] for look in looks]
    counts = [f"{at.name} ({len(runs)} runs)" if len(runs) > 1 else at.name for at, runs in groups.items()]
    figure.legend(handles, counts, loc="outside upper center", ncols=min(len(counts), 3), frameon=False)
    return figure


def against_trajectories(trajectories: Sequence[int], curves: Mapping[str, Floats], what: str) -> "Figure":
    """Draw ratios to the expert against the number of demonstrated trajectories, as the paper's Figures 3 and 4 do.

    Args:
        trajectories: how many were demonstrated, shape (n,).
        curves: by name, the ratio and the ends of its 95 % interval, shape (n, 3).
        what: the figure that is compared.

    Raises:
        InputError: matplotlib is not installed.
    """
    places = np.arange(len(trajectories))
    placed = {name: np.column_stack([places, curve]) for name, curve in curves.items()}
    figure = with_bands(placed, "demonstrated trajectories", f"{what}, of the expert's", columns=2)
    (axes,) = figure.axes
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, 1.0), max(top, 1.0))
    axes.axhline(1.0, color="0.4", linewidth=0.8, zorder=0)
    beside = axes.get_yaxis_transform()  # no curve comes there
    axes.text(1.01, 1.0, "expert", transform=beside, verticalalignment="center", color="0.4", fontsize="small")
    axes.set_xticks(places, [str(n) for n in trajectories])
    return figure


def with_bands(curves: Mapping[str, Floats], across: str, what: str, *, columns: int = 3) -> "Figure":
    """Draw means with their 95 % intervals.

    Args:
        curves: by name; rows of where, the mean, and the ends of its interval, NaN if it has none, shape (n, 4).
        across: what runs from left to right.
        what: what is measured.
        columns: of the legend.

    Raises:
        InputError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for at, (name, curve) in enumerate(curves.items()):
        where, mean, low, high = curve.T
        colour, style, marker = (looks[at % len(looks)] for looks in (_COLOURS, _STYLES, _MARKERS))
        axes.plot(where, mean, style, marker=marker, color=colour, label=name)
        axes.fill_between(where, low, high, color=colour, alpha=0.15, linewidth=0.0)
        alone = _alone(mean)
        axes.vlines(where[alone], low[alone], high[alone], color=colour, linewidth=1.0)
    drawn = np.concatenate([curve[:, 1:] for curve in curves.values()])
    leave_room(axes.set_ylim, drawn)
    if not (drawn[:, 0] < 0.0).any():  # of what cannot be negative the interval of few may be
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.0))
    axes.set_xlabel(across)
    axes.set_ylabel(textwrap.fill(what, 40))  # or it is cut off at the picture's edge
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=columns, frameon=False)
    return figure


def _alone(values: Floats) -> NDArray[np.bool_]:
    """Return which values have no neighbour, so that neither a line nor a band is drawn to them; NaN is none."""
    there = np.pad(np.isfinite(values), 1)
    return there[1:-1] & ~there[:-2] & ~there[2:]


def leave_room(set_limits: Callable[[float, float], object], drawn: Floats) -> None:
    """Let an axis reach from 1 below to 1 above a value that is the only one drawn; NaN is not.

    By itself matplotlib shows hundredths, as if there were something to tell apart.
    """
    values = np.unique(drawn[~np.isnan(drawn)])
    if len(values) == 1:
        set_limits(values[0] - 1.0, values[0] + 1.0)


def require_matplotlib() -> None:
    """Raise InputError if there is nothing to plot with."""
    if find_spec("matplotlib") is None:
        raise InputError("plotting needs matplotlib; install it with: pip install 'rail-sumo[plots]'")


def group_of(run: Path) -> Path:
    """Return the run's path without the number at its end."""
    return run.with_name(re.sub(r"(?<=.)[-_]?(seed)?\d+$", "", run.name))


def apart(runs: Iterable[Path]) -> Iterator[str]:
    """Tell which runs have a curve each though their names differ by a number alone, and why."""
    for at, of_group in _named_alike(run for run in runs if len(_progress(run))).items():
        if why := _differ(of_group):
            yield f"the runs '{at.name}' have a curve each: {why}"


def _grouped(runs: Iterable[Path]) -> dict[Path, list[Path]]:
    """Return the runs that become one curve: by their names, if they are one training with several seeds."""
    curves: dict[Path, list[Path]] = {}
    for at, of_group in _named_alike(runs).items():
        curves |= {run: [run] for run in of_group} if _differ(of_group) else {at: of_group}
    return curves


def _named_alike(runs: Iterable[Path]) -> dict[Path, list[Path]]:
    groups: dict[Path, list[Path]] = {}
    for path, run in {run.resolve(): run for run in runs}.items():
        groups.setdefault(group_of(path), []).append(run)
    return groups


def _differ(runs: Iterable[Path]) -> str:
    """Return by what two of these runs are more than one training with another seed; "" if none are."""
    pairs = itertools.combinations(map(RunDirectory, runs), 2)
    return next((why for one, other in pairs if (why := one.differs_from(other))), "")


def save(figure: "Figure", out: Path, *, overwrite: bool = False) -> None:
    """Write the picture, as PNG, SVG or PDF by the file's suffix, whole or not at all.

    Raises:
        InputError: the file exists and is not to be overwritten, its suffix is none of these, or it cannot be written.
    """
    if out.suffix not in (".png", ".svg", ".pdf"):
        raise InputError(f"a picture's name must end in .png, .svg or .pdf; got '{out}'")
    check_file(out, overwrite=overwrite)
    with whole_file(out) as partial:
        partial.write_bytes(picture(figure, out.suffix[1:]))


def picture(figure: "Figure", kind: str) -> bytes:
    """Return the picture as a file of this kind (png, svg or pdf), the same bytes for the same figure."""
    from matplotlib import rc_context

    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    drawn = io.BytesIO()
    with rc_context({"svg.hashsalt": "rail-sumo"}):  # else an element's id is drawn by chance
        figure.savefig(drawn, format=kind, dpi=150, metadata=undated.get(kind))
    return drawn.getvalue()


def _progress(run: Path) -> pd.DataFrame:
    RunDirectory(run)  # or there is nothing to draw
    try:
        progress = pd.read_csv(run / PROGRESS)[list(PROGRESS_COLUMNS)]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"'{run / PROGRESS}' is missing or damaged: {error}") from None
    return progress


def _look(number: int) -> dict[str, Any]:
    """Return how a curve is drawn: by its colour, and where colours come round again by marks too."""
    marks = (None, *_MARKERS)
    return {
        "color": _COLOURS[number % len(_COLOURS)],
        "marker": marks[number // len(_COLOURS) % len(marks)],
        "markevery": 0.1,  # of the picture's diagonal
        "markersize": 4.0,
    }


def _draw(
    axes: "Axes", progress: list[pd.DataFrame], across: str, unit: float, drawn: str, look: Mapping[str, Any]
) -> None:
    smooth = [run[drawn].rolling(SMOOTHED_OVER, min_periods=1).mean() for run in progress]
    if len(progress) == 1:
        axes.plot(progress[0][across] * unit, smooth[0], **look)
        return
    thin = {**look, "marker": None}
    for run, values in zip(progress, smooth, strict=True):
        axes.plot(run[across] * unit, values, **thin, alpha=0.25, linewidth=0.7)
    n_shared = min(map(len, progress))  # as far as all of them have come
    mean_across = np.mean([run[across][:n_shared] for run in progress], axis=0) * unit
    values = np.array([run[:n_shared] for run in smooth])
    mean, half = values.mean(axis=0), stats.t.ppf(0.975, len(values) - 1) * stats.sem(values, axis=0)
    axes.plot(mean_across, mean, **look)
    axes.fill_between(mean_across, mean - half, mean + half, color=look["color"], alpha=0.2, linewidth=0.0)
