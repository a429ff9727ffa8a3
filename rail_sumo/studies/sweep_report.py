"""What a sweep came to, as people read it: tables, a page and pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from rich.table import Table

from rail_sumo.pictures import plot
from rail_sumo.records import Floats
from rail_sumo.tables import report, traffic
from rail_sumo.tables.shares import AS_THEY_ARE, HEADINGS, MEASURED, TOLD, told_rows, told_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARE = "share"
"""What is swept over, unless it is a key of the configuration."""


class Tables(NamedTuple):
    """What a sweep came to."""

    traffic: pd.DataFrame
    """A row per driver, setting, share, seed and kind of vehicles: `TRAFFIC_COLUMNS`."""
    summary: pd.DataFrame
    """Means over seeds: `SUMMARY_COLUMNS`."""
    differences: pd.DataFrame
    """From share 0: `DIFFERENCE_COLUMNS`."""
    edges: pd.DataFrame
    """Sums for each edge and type of vehicles: `EDGE_COLUMNS`."""
    key: str
    """What was swept over."""
    duration_s: float
    """The period that counted."""
    warm_up_s: float
    """How long the traffic drove before that."""
    notes: tuple[str, ...] = ()
    """What makes the figures depend on the period."""

    @property
    def drivers(self) -> list[str]:
        """Who drove a share of the cars, in the order in which they were named."""
        return [driver for driver in self.traffic["driver"].unique() if driver != AS_THEY_ARE]

    @property
    def n_seeds(self) -> int:
        """How many runs there are of each."""
        return self.traffic["seed"].nunique()


def draw(tables: Tables, folder: Path) -> None:
    """Draw every measure of all vehicles into a folder, as PNG and SVG.

    It needs matplotlib.
    """
    across, along = ("share", "share of the cars") if tables.key == SHARE else ("setting", tables.key)
    of_all, of_seeds = (one[one["vehicles"] == traffic.ALL] for one in (tables.summary, tables.traffic))
    who = (*tables.drivers, *([AS_THEY_ARE] if tables.key != SHARE or not tables.drivers else ()))
    for measure in MEASURED:
        curves, points = {}, []
        for driver in who:
            told = _along_a_curve(tables.key, of_all[of_all["measure"] == measure], driver)
            label = "as they are" if driver == AS_THEY_ARE else driver
            curves[label] = told[[across, "mean", "low", "high"]].astype("float64").sort_values(across).to_numpy()
            points.append(_along_a_curve(tables.key, of_seeds, driver)[[across, measure]].astype("float64").to_numpy())
        figure = plot.with_bands(curves, along, HEADINGS[measure])
        if tables.n_seeds > 1:
            _mark(figure.axes[0], points)
        if tables.key == SHARE:
            figure.axes[0].xaxis.set_major_formatter("{x:.0%}")  # as the tables tell shares
        for suffix in (".png", ".svg"):
            plot.save(figure, folder / f"{measure}{suffix}", overwrite=True)


def _along_a_curve(key: str, rows: pd.DataFrame, driver: str) -> pd.DataFrame:
    """Return the rows that a driver's curve goes along: from share 0 on, where the share is varied."""
    zero = rows[(rows["driver"] == AS_THEY_ARE) & (rows["share"] == 0.0)]
    own = rows[(rows["driver"] == driver) & (rows["share"] > 0.0)]
    if key == SHARE:
        return pd.concat([zero, own])
    return zero if driver == AS_THEY_ARE else own


def _mark(axes: "Axes", points: Sequence[Floats]) -> None:
    """Draw every run as a small point in its curve's colour, since a mean hides the one that broke down.

    Args:
        axes: with a line for each curve.
        points: of each curve; rows of where and what, NaN if there is none, shape (n, 2).
    """
    for line, of_curve in zip(axes.get_lines(), points, strict=True):
        axes.plot(*of_curve.T, ".", markersize=4, alpha=0.5, color=line.get_color(), clip_on=False)
        heights = of_curve[np.isfinite(of_curve[:, 1]), 1]
        if len(heights):
            bottom, top = axes.get_ylim()
            axes.set_ylim(min(bottom, heights.min()), max(top, heights.max()))


def markdown(tables: Tables, road: str, *, command: str = "") -> str:
    """Return the study as a page: what was driven, the means of all vehicles, and how they differ from share 0.

    Args:
        tables: what it came to.
        road: what the page calls the road.
        command: what was typed.
    """
    setting = [] if tables.key == SHARE else [tables.key]
    headings = ["driver", *setting, "share", *(told.heading for told in TOLD.values())]
    rows = [
        [row.driver, *([row.setting] if setting else []), row.share, *(cell.on_one_line for cell in row.cells.values())]
        for row in told_rows(tables.traffic, tables.differences)
    ]
    lines = [
        f"# {road}: {', '.join(tables.drivers) or 'as they are'}",
        "",
        _caption(tables, "in brackets"),
        "",
        *((f"    {command}", "") if command else ()),
        *(line for note in tables.notes for line in (f"Note: {note}.", "")),
        f"| {' | '.join(headings)} |",
        "| --- |" + " ---: |" * (len(headings) - 1),
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def shown(tables: Tables, *, width: int) -> Table:
    """Return the same for a terminal of so many columns, without what does not fit."""
    key, rows = "" if tables.key == SHARE else tables.key, told_rows(tables.traffic, tables.differences)
    return told_table(key, rows, _caption(tables, "below them"), width=width)


def _caption(tables: Tables, where: str) -> str:
    n_seeds = tables.n_seeds
    seeds = f"{n_seeds} seeds" if n_seeds > 1 else "one seed: no interval"
    undriven = tables.traffic.loc[tables.traffic["vehicles"] == traffic.DRIVEN, "undriven"].max()
    left = (
        f" Up to {undriven} cars of a run's share are left to SUMO, on routes that a host cannot drive."
        if undriven
        else ""
    )
    few = f" Fewer than {report.FEW} seeds: intervals are very wide." if 1 < n_seeds < report.FEW else ""
    return (
        f"{seeds}; {tables.duration_s:g} s each, after {tables.warm_up_s:g} s that do not count. Means of all "
        f"vehicles; {where} the difference from share 0 on the same traffic, ± half its 95 % interval.{few}{left}"
    )
