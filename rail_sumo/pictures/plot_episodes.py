"""Driven episodes as pictures: every one as a point, and where lanes were changed. Needs matplotlib."""

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from rail_sumo.pictures.plot import leave_room

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = {
    "speed_kmh": "speed, km/h",
    "overtakes": "overtakes",
    "lane_changes": "lane changes",
    "refused_decisions": "refused decisions",
    "hardest_braking_mps2": "hardest braking, m/s²",
    "min_ttc_s": "smallest time to collision, s",
}
"""What is drawn of every episode."""
FARTHEST_TTC_S = 60.0
"""Times to collision beyond this are drawn here: nobody was near."""
SIDES = {"left": "#0072b2", "right": "#d55e00"}
"""The colours of lane changes."""
STRIP_M = 50.0
"""What was driven within a straight strip as wide as this is not drawn on a map: it would be a line."""
WIDE = 0.35
"""Maps that are lower than this, of their width, lie under one another."""


def points(episodes: pd.DataFrame, policies: Sequence[str]) -> "Figure":
    """Draw every episode as a point, and the mean of each policy's as a line: a panel for each of `POINTS`.

    A policy with a point that is not drawn at its value has no line there: the mean of what is drawn is not its mean.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.2 + 0.28 * len(policies) * 2 + 2.0), layout="constrained")
    spread = np.random.default_rng(0)  # points that lie on one another are moved apart, the same way each time
    for axes, (metric, label) in zip(figure.subplots(2, 3, sharey=True).flat, POINTS.items(), strict=True):
        told = episodes[metric].to_numpy(np.float64, na_value=np.nan)
        drawn = np.minimum(told, FARTHEST_TTC_S) if metric == "min_ttc_s" else told
        for at, policy in enumerate(policies):
            is_own = (episodes["policy"] == policy).to_numpy() & ~np.isnan(told)
            values = drawn[is_own]
            axes.plot(
                values, at + spread.uniform(-0.2, 0.2, len(values)), "o", markersize=3, alpha=0.6, color="#0072b2"
            )
            if len(values) and (values == told[is_own]).all():
                axes.plot([values.mean()] * 2, [at - 0.35, at + 0.35], color="#d55e00", linewidth=2)
        leave_room(axes.set_xlim, drawn)
        axes.set_yticks(range(len(policies)), policies)
        axes.set_ylim(len(policies) - 0.5, -0.5)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3, axis="x")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def lane_changes(decisions: pd.DataFrame) -> "Figure":
    """Draw on how much of the way driven lane changes began, by kilometre and episode."""
    from matplotlib.figure import Figure

    policies = list(decisions["policy"].unique())
    begun = decisions[decisions["carried_out"].isin(SIDES)]
    figure = Figure(figsize=(9.0, 0.6 + 1.3 * len(policies)), layout="constrained")
    width_m = max(decisions["distance_m"].max() / 40, 1.0)
    edges = np.arange(41) * width_m
    for axes, policy in zip(
        figure.subplots(len(policies), sharex=True, sharey=True, squeeze=False).flat, policies, strict=True
    ):
        own = begun[begun["policy"] == policy]
        n_episodes = decisions.loc[decisions["policy"] == policy, "episode"].nunique()
        for (side, colour), sign in zip(SIDES.items(), (1, -1), strict=True):
            counts, _ = np.histogram(own.loc[own["carried_out"] == side, "distance_m"], edges)
            heights = sign * counts / n_episodes / (width_m / 1000)
            axes.bar(edges[:-1] / 1000, heights, width_m / 1000, align="edge", color=colour, label=side)
        axes.axhline(0.0, color="0.4", linewidth=0.8)
        axes.set_title(policy, loc="left", fontsize="medium")
        axes.set_ylabel("per km")
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[-1].set_xlabel("driven, km")
    return figure


def is_straight(decisions: pd.DataFrame) -> bool:
    """Return whether all was driven within a strip of `STRIP_M`, whichever way it points."""
    place_m = decisions[["x_m", "y_m"]].to_numpy()
    around_m = place_m - place_m.mean(axis=0)
    _, principal = np.linalg.eigh(around_m.T @ around_m)  # the narrowest direction first
    return bool(np.ptp(around_m @ principal[:, 0]) <= STRIP_M)


def lane_change_map(decisions: pd.DataFrame) -> "Figure":
    """Draw where on the network lane changes began, seen from above, a map for each policy."""
    from matplotlib.figure import Figure

    policies = list(decisions["policy"].unique())
    width_m, height_m = np.ptp(decisions[["x_m", "y_m"]].to_numpy(), axis=0)
    n_columns = 1 if height_m < WIDE * width_m else min(len(policies), 3)
    n_rows = math.ceil(len(policies) / n_columns)
    height = min(max(9.0 / n_columns * height_m / width_m, 1.0), 6.0) + 0.6  # of one map, in inches
    figure = Figure(figsize=(9.0, n_rows * height), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).flat
    for axes, policy in itertools.zip_longest(grid, policies):
        if policy is None:
            axes.set_axis_off()
            continue
        driven = decisions[decisions["policy"] == policy]
        axes.plot(driven["x_m"], driven["y_m"], ".", markersize=1, color="0.75", rasterized=True)
        for (side, colour), marker in zip(SIDES.items(), "^v", strict=True):
            own = driven[driven["carried_out"] == side]
            axes.plot(own["x_m"], own["y_m"], marker, markersize=4, alpha=0.6, color=colour, label=side)
        axes.set_aspect("equal")
        axes.set_title(policy, loc="left", fontsize="medium")
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    figure.supxlabel("x, m", fontsize="small")
    figure.supylabel("y, m", fontsize="small")
    return figure
