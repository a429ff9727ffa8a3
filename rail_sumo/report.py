"""Rows -> tables with intervals: CSV and Parquet with the same content, and a table for the terminal."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from rail_sumo.files import whole_folder
from rail_sumo.records import EPISODE_COLUMNS, METRICS, SUMMARY_COLUMNS, Floats
from rail_sumo.statistics import interval, iqm, share_interval

EXPERT = "expert"
"""The policy that ratios refer to."""

CONTACTS = ("collisions", "struck")
"""Metrics that are 0 in nearly every episode."""

DECIMALS = 6
"""Tables are rounded to this: finer than any simulation means, and any CSV reader gives back the very same number."""


def episodes(rows: Iterable[dict[str, Any]]) -> pd.DataFrame:
    """Return the `episodes` table, a row per policy and episode, typed as `EPISODE_COLUMNS` says."""
    return typed(rows, EPISODE_COLUMNS)


def summary(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return the `summary` table: a row per policy and metric, over that policy's episodes.

    `iqm` is the interquartile mean (the mean of the middle half of the episodes), `low` and `high` its 95 %
    percentile-bootstrap interval over episodes (see `statistics`). Of `collisions` and `struck` they are Wilson's
    interval of the share of episodes with one. `ratio_to_expert` is the ratio of the means, every policy driving on the
    same traffic. It is NaN where the expert was not evaluated beside or its mean is 0.

    Episodes in which the host never closed in on a vehicle have an infinite `min_ttc_s`; that metric is summarised
    over the others, and NaN if there are none.
    """
    expert = episodes[episodes["policy"] == EXPERT]
    rows = []
    for policy, driven in episodes.groupby("policy", sort=False):
        for metric in METRICS:
            values, reference = _finite(driven[metric]), _finite(expert[metric])
            low, high = metric_interval(metric, values[None]) if len(values) else (np.nan, np.nan)
            rows.append(
                {
                    "policy": policy,
                    "metric": metric,
                    "mean": _mean(values),
                    "iqm": float(iqm(values[None])) if len(values) else np.nan,
                    "low": low,
                    "high": high,
                    "ratio_to_expert": _mean(values) / (_mean(reference) or np.nan),
                }
            )
    return typed(rows, SUMMARY_COLUMNS)


def metric_interval(metric: str, scores: Floats) -> tuple[float, float]:
    """Return a metric's 95 % interval: of a contact's share of the episodes, else of the interquartile mean.

    Args:
        metric: one of `METRICS`.
        scores: shape (n_seeds, n_episodes), not empty.
    """
    return share_interval(scores) if metric in CONTACTS else interval(iqm, scores)


def write(folder: Path, *, overwrite: bool = False, **tables: pd.DataFrame) -> None:
    """Write tables into the folder, each under its name as CSV and as Parquet with the same content.

    A new folder appears whole or not at all. With `overwrite` it may exist: tables of the same names are replaced,
    other files left alone.

    Raises:
        InputError: the folder exists, cannot be written to, or the disk is full.
    """
    with whole_folder(folder, overwrite=overwrite) as partial:
        save(partial, **tables)


def save(folder: Path, **tables: pd.DataFrame) -> None:
    """Write tables into a folder that is not whole yet, each under its name as CSV and as Parquet."""
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
        table.to_parquet(folder / f"{name}.parquet", index=False)


# What the terminal shows: heading -> metric and format. The rest is in the files.
_SHOWN = {
    "speed\nkm/h": ("speed_kmh", ".1f"),
    "overtakes": ("overtakes", ".1f"),
    "lane\nchanges": ("lane_changes", ".1f"),
    "lateral\nreward": ("lateral_reward", ".1f"),
    "collisions": ("collisions", ".2f"),
    "struck": ("struck", ".2f"),
}


def table(summary: pd.DataFrame) -> Table:
    """Return the means for the terminal, a row per policy; below each mean, dimmed, its ratio to the expert's."""
    policies = summary["policy"].unique()
    ratios = "; below them, ratios to the expert" if EXPERT in policies and len(policies) > 1 else ""
    shown = Table("policy", box=SIMPLE_HEAD, caption=f"means over the episodes{ratios}")
    shown.columns[0].overflow = "fold"
    for heading in _SHOWN:
        shown.add_column(heading, justify="right")
    by_metric = summary.set_index(["policy", "metric"])
    for policy in policies:
        cells = []
        for metric, form in _SHOWN.values():
            mean, ratio = by_metric.loc[(policy, metric), ["mean", "ratio_to_expert"]]
            compared = policy != EXPERT and not np.isnan(ratio)
            cells.append(f"{mean:{form}}" + (f"\n[dim]{ratio:.2f}[/]" if compared else ""))
        shown.add_row(escape(policy), *cells)
    return shown


def typed(rows: Iterable[dict[str, Any]] | pd.DataFrame, columns: dict[str, str]) -> pd.DataFrame:
    """Return a table with these columns of these types, its numbers rounded to `DECIMALS`."""
    table = pd.DataFrame(rows, columns=list(columns)).astype(columns).round(DECIMALS)
    return table.replace(-0.0, 0.0)


def _finite(values: pd.Series) -> Floats:
    array = values.to_numpy(dtype=np.float64)
    return array[np.isfinite(array)]


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else np.nan
