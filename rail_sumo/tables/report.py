"""Rows -> tables with intervals: CSV and Parquet with the same content, and a table for the terminal."""

import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from rail_sumo.files import AnyPath, whole_folder
from rail_sumo.records import DECISION_COLUMNS, EPISODE_COLUMNS, METRICS, SUMMARY_COLUMNS, UNDRIVEN, EndReason, Floats
from rail_sumo.tables import statistics

EXPERT = "expert"
"""The policy that ratios refer to unless another is named."""
FEW = 5
"""Of fewer episodes, trainings or seeds the intervals are right, but very wide."""

EPISODES, SUMMARY, DECISIONS = "episodes.parquet", "summary.parquet", "decisions.parquet"
WORLD, ORIGIN = "world.toml", "evaluation.json"
"""The files of an evaluation's folder: its tables, the configuration, and how it was made."""
FINISHED = "cells"
"""The folder of what is finished of a sweep or a study, which is there before its tables."""

CONTACTS = ("collisions", "struck")
"""Metrics that are 0 in nearly every episode."""

DECIMALS = 6
"""Tables are rounded to this: finer than any simulation means, and any CSV reader gives back the very same number."""


def episodes(rows: Iterable[dict[str, Any]]) -> pd.DataFrame:
    """Return the `episodes` table, a row per policy and episode, typed as `EPISODE_COLUMNS` says.

    Figures that are missing, of episodes that could not be driven, are empty.
    """
    rows = list(rows)
    columns = dict(EPISODE_COLUMNS)
    if any(row["end_reason"] in UNDRIVEN for row in rows):
        columns |= {name: "Int64" for name in METRICS if columns[name] == "int64"}
    return typed(rows, columns)


def decisions(parts: Iterable[tuple[str, int, dict[str, Any]]]) -> pd.DataFrame:
    """Return the `decisions` table, a row per decision of each policy and episode; see `metrics.decisions`."""
    tables = [pd.DataFrame({"policy": policy, "episode": episode, **part}) for policy, episode, part in parts]
    return typed(pd.concat(tables) if tables else [], DECISION_COLUMNS)


def summary(episodes: pd.DataFrame, reference: str = EXPERT) -> pd.DataFrame:
    """Return the `summary` table: a row per policy and metric, over that policy's episodes.

    `low` and `high` are the 95 % interval of `mean`. `ratio` is the policy's mean over the reference's, `difference`
    the mean of policy minus reference, both episode by episode on the same traffic, with intervals of their own (see
    `statistics`). Of `collisions` and `struck` the interval is Wilson's, of the share of episodes with one, and ratio
    and difference have none. Of one episode, which tells no interval, both ends are NaN; so are ratio and difference
    where the reference was not evaluated beside.

    Episodes in which the host never closed in on a vehicle have an infinite `min_ttc_s`; that metric is summarised
    over the others, `episodes` of them, and NaN if there are none. Its ratio and difference are over the episodes in
    which both policies have a finite value.

    Args:
        episodes: the `episodes` table.
        reference: the policy that ratios and differences refer to.
    """
    by_policy = {policy: driven.set_index("episode") for policy, driven in episodes.groupby("policy", sort=False)}
    rows = []
    for policy, driven in by_policy.items():
        beside = by_policy.get(reference, driven.iloc[:0]).reindex(driven.index)
        for metric in METRICS:
            scores, theirs = (table[metric].to_numpy(np.float64, na_value=np.nan)[None] for table in (driven, beside))
            told = {
                "policy": policy,
                "metric": metric,
                "episodes": int(np.isfinite(scores).sum()),
                "reference": reference,
            }
            rows.append(told | figures(metric, scores, theirs, trained=False))
    return typed(rows, SUMMARY_COLUMNS)


def reference_among(policies: Sequence[str]) -> str:
    """Return the policy that ratios refer to where none is named: an expert by name, else the last of several."""
    experts = [policy for policy in policies if policy in (EXPERT, "road-expert")]
    return (experts or [policies[-1] if len(policies) > 1 else EXPERT])[0]


def figures(metric: str, scores: Floats, reference: Floats, *, trained: bool) -> dict[str, float]:
    """Return a metric's mean, its ratio to the reference's and the difference, each with its interval.

    Args:
        metric: one of `METRICS`.
        scores: shape (n_seeds, n_episodes); what is not finite is left out.
        reference: the reference's on the same traffic, of the same shape; NaN where it did not drive.
        trained: whether each seed is a training of its own; see `statistics.units`.
    """
    ours, theirs = (statistics.units(one, trained=trained) for one in (scores, reference))
    both = np.isfinite(ours) & np.isfinite(theirs)
    mean = statistics.mean(ours[np.isfinite(ours)])
    ratio, difference = statistics.ratio(ours[both], theirs[both]), statistics.difference(ours[both], theirs[both])
    if metric in CONTACTS:
        mean = statistics.share(scores[np.isfinite(scores)])
        ratio, difference = (one._replace(low=np.nan, high=np.nan) for one in (ratio, difference))
    return {
        "mean": mean.value, "low": mean.low, "high": mean.high,
        "ratio": ratio.value, "ratio_low": ratio.low, "ratio_high": ratio.high,
        "difference": difference.value, "difference_low": difference.low, "difference_high": difference.high,
    }  # fmt: skip


def write(folder: AnyPath, *, overwrite: bool = False, **tables: pd.DataFrame) -> None:
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


# What the terminal shows, with intervals and ratios: heading -> metric and decimals. Then means alone.
_COMPARED = {
    "speed\nkm/h": ("speed_kmh", 1),
    "overtakes": ("overtakes", 1),
    "lane\nchanges": ("lane_changes", 1),
}
_TOLD = {
    "refused": ("refused_decisions", 1),
    "over-\ntaken": ("overtaken", 1),
    "hard\nbrakings": ("hard_brakings", 2),
}
ALIKE = 0.01
"""Speeds that differ by less than this share are told to be the same."""
FEWEST_ALIKE = 3
"""Where not all policies are alike, so many are told to be: two may well have learned the same."""
WIDE = 100
"""How many columns the whole table takes, if its figures are not too long."""
NAME_WIDTH = 14
"""Names of policies that are longer are folded."""


class Name:
    """A policy's name in a column, folded after a '/' or a space, or before a ':', where there is one.

    What tells two runs apart, as in `runs/rail-seed0` or `runs/rail:sampled`, then stands together.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def lines(self, width: int) -> Iterator[str]:
        """Yield the name in pieces of at most so many letters."""
        rest = self._name
        while len(rest) > width:
            end = max(rest.rfind("/", 0, width) + 1, rest.rfind(" ", 0, width) + 1, rest.rfind(":", 1, width + 1))
            end = end if end > 0 else width
            yield rest[:end]
            rest = rest[end:]
        yield rest

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """As rich asks for it: a line each."""
        yield from map(Text, self.lines(options.max_width))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """As rich asks for it: how narrow and how wide it may be."""
        return Measurement(min(NAME_WIDTH, len(self._name)), len(self._name))


def table(summary: pd.DataFrame, *, width: int = WIDE) -> Table:
    """Return the table for the terminal, a row per policy: means ± half the 95 % interval; dimmed below, ratios.

    Of a ratio the interval is shown, which need not lie evenly around it; itself where there are no intervals. An
    interval without 1 in it never looks as if it ended there; see `ratio_decimals`.

    The last column counts the contacts, in which the host hit anything or was hit; either ends an episode. The rest is
    in the files.

    Args:
        summary: the `summary` table.
        width: of the terminal; where the table does not fit, the last columns before the contacts are left out, then
            the intervals.
    """
    fewer = [(dict(list(_TOLD.items())[:n]), True) for n in range(len(_TOLD), -1, -1)]
    for told, has_intervals in (*fewer, ({}, False)):
        shown = _table(summary, told, has_intervals=has_intervals)
        if width_of(shown, summary["policy"]) <= width:
            break
    return shown


def ratio_decimals(low: float, high: float, least: int) -> int:
    """Return how many decimals the ends of a ratio's interval are shown with.

    That is `least`, or the fewest more at which an interval without 1 in it does not look as if it ended there. NaN is
    no interval.
    """
    if low <= 1.0 <= high:
        return least
    enough = (n for n in range(least, DECIMALS) if f"{1:.{n}f}" not in (f"{low:.{n}f}", f"{high:.{n}f}"))
    return next(enough, DECIMALS)


def width_of(shown: Table, names: Iterable[str]) -> int:
    """Return how many columns a table takes whose first column has these names, folded as far as they may be."""
    wide = Console(width=1000, file=io.StringIO())
    with wide.capture() as text:
        wide.print(shown)
    taken = max(len(line.rstrip()) for line in text.get().splitlines())
    longest = max(map(len, names))
    return taken - max(0, longest - NAME_WIDTH)


def _table(summary: pd.DataFrame, told: dict[str, tuple[str, int]], *, has_intervals: bool) -> Table:
    policies, reference = summary["policy"].unique(), summary["reference"].iloc[0]
    by_metric = summary.set_index(["policy", "metric"])
    n = by_metric["episodes"].max()
    compared = reference in policies and len(policies) > 1
    km = f"{summary.loc[summary['metric'] == 'distance_m', 'mean'].mean() / 1000:.1f} km"
    episodes = f"means over {n} episodes of {km}{' ± 95 % interval' * has_intervals}"
    if n == 1:
        episodes = f"one episode of {km}: no interval"
    elif n < FEW:
        episodes += f" (fewer than {FEW} tell little)"
    ratios = "95 % intervals of ratios" if has_intervals and n > 1 else "ratios"
    below = f"; below, {ratios} to {escape(reference)}" if compared else ""
    shown = Table(box=SIMPLE_HEAD, caption=episodes + below)
    shown.add_column("policy", min_width=NAME_WIDTH)
    for heading in (*_COMPARED, *told, "contacts"):
        shown.add_column(heading, justify="right", no_wrap=True)
    for policy in policies:
        cells = []
        for metric, decimals in _COMPARED.values():
            row = by_metric.loc[(policy, metric)]
            cell = f"{row['mean']:.{decimals}f}"
            if has_intervals and np.isfinite(row["high"]):
                cell += f" ± {(row['high'] - row['low']) / 2:.{decimals}f}"
            if compared and policy != reference and np.isfinite(row["ratio"]):
                ratio = f"{row['ratio']:.2f}"
                if has_intervals and n > 1:  # where the reference's mean may be 0 a ratio has none
                    low, high = row["ratio_low"], row["ratio_high"]
                    places = ratio_decimals(low, high, 2)
                    ratio = f"{low:z.{places}f}\N{EN DASH}{high:z.{places}f}" if np.isfinite(high) else "no interval"
                cell += f"\n[dim]{ratio}[/]"
            cells.append(cell)
        cells += [f"{by_metric.loc[(policy, metric), 'mean']:.{decimals}f}" for metric, decimals in told.values()]
        contacts = sum(by_metric.loc[(policy, metric), "mean"] for metric in CONTACTS) * n
        shown.add_row(Name(policy), *cells, f"{contacts:.0f}")
    return shown


_CUT_SHORT: dict[EndReason, str] = {
    "standstill": "ended at a standstill",
    "left the road": "ended off the road",
    "not begun": "could not begin (left out of the means)",
    "SUMO stopped": "ended because SUMO stopped (left out of the means)",
}
"""Ends that are not the ordinary ones, but collisions: these the table counts as contacts."""


def cut_short(episodes: pd.DataFrame) -> list[str]:
    """Return a line for each policy with episodes that were cut short: how many, and why.

    Such as "rule: 2 of 16 episodes ended at a standstill". Episodes that ended in a contact are not among them: the
    table for the terminal has them in a column of their own.

    Args:
        episodes: the `episodes` table.
    """
    lines = []
    for policy, driven in episodes.groupby("policy", sort=False):
        counts = driven["end_reason"].value_counts()
        told = [f"{counts[end]} of {len(driven)} episodes {what}" for end, what in _CUT_SHORT.items() if end in counts]
        if told:
            lines.append(f"{policy}: {'; '.join(told)}")
    return lines


def alike(episodes: pd.DataFrame) -> list[str]:
    """Return a line that says so where all policies, or three, were in each episode as fast as each other, to `ALIKE`.

    Args:
        episodes: the `episodes` table.
    """
    speeds = episodes.pivot(index="episode", columns="policy", values="speed_kmh").astype("float64").dropna()
    if len(speeds.columns) < 2 or speeds.empty:
        return []
    policies = [name for name in episodes["policy"].unique() if name in speeds]
    groups = ([other for other in policies if _are_close(speeds[[name, other]])] for name in policies)
    most = max((group for group in groups if _are_close(speeds[group])), key=len, default=[])
    if len(most) < min(len(policies), FEWEST_ALIKE):
        return []
    who = "all of them" if len(most) == len(policies) else ", ".join(f"'{name}'" for name in most)
    return [
        f"in each episode {who} are as fast as each other, to within {100 * ALIKE:g} %: one may have learned from "
        "another, or the road or the host's own vehicle leave no choice, see rail-sumo network check"
    ]


def _are_close(speeds: pd.DataFrame) -> bool:
    return bool((speeds.max(axis=1) <= speeds.min(axis=1) * (1 + ALIKE)).all())


def typed(rows: Iterable[dict[str, Any]] | pd.DataFrame, columns: dict[str, str]) -> pd.DataFrame:
    """Return a table with these columns of these types, its numbers rounded to `DECIMALS`."""
    table = pd.DataFrame(rows, columns=list(columns)).astype(columns).round(DECIMALS)
    return table.replace(-0.0, 0.0)
