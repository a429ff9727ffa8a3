"""The paper's experiments: Table 1 and Figures 3 and 4, from many trainings in place of one."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rail_sumo.config import Config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.files import check_folder, whole_file, writing
from rail_sumo.pictures import plot
from rail_sumo.records import COMPARISON_COLUMNS, Floats
from rail_sumo.studies.experiment import CELL_COLUMNS, SYSTEMS, Experiment
from rail_sumo.tables import report
from rail_sumo.tables.statistics import probability_of_improvement

TRAJECTORIES = (1, 5, 10, 20, 40)
PAPER_METRICS = ("speed_kmh", "overtakes", "lane_changes", "longitudinal_reward", "lateral_reward")
TABLE_METRICS = (*PAPER_METRICS, "refused_decisions", "told_apart", *report.CONTACTS)

PAPER = {
    "rail-2": (70.38, 45.04, 15.01, 2719.38, -122.98),
    "rail-1": (65.00, 40.03, 13.05, 2495.57, -175.6),
    "expert": (68.83, 44.48, 14.04, 2642.11, -132.52),
}
"""Table 1 of the paper, by system, in the order of `PAPER_METRICS`."""
_USUAL = Config()
_PAPERS_WORLD = _USUAL.network, _USUAL.traffic, _USUAL.episode, _USUAL.varied

FIGURES = ("rail-2", "rail-1", "gail-2", "bc-2")
"""The curves of Figures 3 and 4, each in the mode it was trained in."""

TABLE_COLUMNS = {
    "system": "string",
    "mode": "string",
    "as_trained": "bool",
    "trainings": "int64",  # 0 of a driver that does not train
    "episodes": "int64",
    "metric": "string",
    "mean": "float64",
    "low": "float64",
    "high": "float64",
    **COMPARISON_COLUMNS,
    "above_expert": "float64",
    "paper": "float64",
    "paper_ratio": "float64",
}


def chosen(only: str) -> tuple[str, ...]:
    """Return the systems of a list with commas, in the table's order; all of them for an empty one.

    Raises:
        InputError: one of them is not known.
    """
    wanted = {name.strip() for name in only.split(",") if name.strip()}
    if only and not wanted:
        raise InputError(f"--only takes systems' names with commas between them; got '{only}'")
    for name in sorted(wanted - SYSTEMS.keys()):
        raise InputError(f"--only: system '{name}' not found{did_you_mean(name, SYSTEMS)}")
    return tuple(name for name in SYSTEMS if name in wanted or not wanted)


def table1(experiment: Experiment, systems: Sequence[str] = tuple(SYSTEMS)) -> pd.DataFrame:
    """Train and drive what Table 1 sets side by side, and write `cells`, `table1.csv` and `table1.md` into `out`.

    Args:
        experiment: its configuration, folder and size.
        systems: which of `SYSTEMS`; the expert is always among them.

    Returns:
        A row per system, mode and metric: `TABLE_COLUMNS`.

    Raises:
        InputError: as in `Experiment.drive`.
    """
    n_shown = experiment.config.train.trajectories
    grid = [(name, n_shown if SYSTEMS[name].trains else 0) for name in _with_the_expert(systems)]
    own = experiment.config
    as_the_paper = (own.network, own.traffic, own.episode, own.varied) == _PAPERS_WORLD
    notes = [*experiment.unusual(name for name, _ in grid), *experiment.notes]
    return _written(experiment.drive(grid), experiment.out, as_the_paper=as_the_paper, notes=notes)


def table1_of(
    cells: Path, out: Path, systems: Sequence[str] = tuple(SYSTEMS), *, trajectories: int = 40
) -> pd.DataFrame:
    """Make the table from cells that an experiment left behind, without driving anything.

    Args:
        cells: its `cells.parquet`.
        out: the folder that `table1.csv` and `table1.md` go into.
        systems: which of them; all that there are by default.
        trajectories: of learners, those that were shown so many.

    Raises:
        InputError: the file cannot be read or is another one, or the expert is not in it.
    """
    table = read_cells(cells)
    table = table[table["trajectories"].isin([0, trajectories]) & table["system"].isin(_with_the_expert(systems))]
    _require_some(table, cells, systems, f" shown {trajectories} trajectories")
    _make(out)
    return _written(table, out)


def read_cells(file: Path) -> pd.DataFrame:
    """Return the episodes that an experiment left behind, in the table's order.

    Raises:
        InputError: the file cannot be read or is another one, or the expert is not in it.
    """
    if not file.is_file():
        raise InputError(f"cells '{file}' not found; name the cells.parquet of an experiment")
    try:
        cells = report.typed(pd.read_parquet(file), CELL_COLUMNS)
    except (OSError, pa.ArrowException, ValueError, KeyError, TypeError) as error:
        raise InputError(f"'{file}' is not the cells.parquet of an experiment ({str(error).splitlines()[0]})") from None
    if report.EXPERT not in set(cells["system"]):
        raise InputError(f"'{file}' holds no episodes of the expert, which every ratio refers to")
    rank = {name: number for number, name in enumerate(SYSTEMS)}
    return cells.sort_values("system", key=lambda names: names.map(rank), kind="stable", ignore_index=True)


def _require_some(table: pd.DataFrame, file: Path, systems: Sequence[str], shown: str) -> None:
    if not len(table[table["system"].isin(systems)]):
        raise InputError(f"'{file}' holds no episodes of {', '.join(systems)}{shown}")


def _make(out: Path) -> None:
    check_folder(out, overwrite=True)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)


def _with_the_expert(systems: Sequence[str]) -> list[str]:
    return [name for name in SYSTEMS if name in systems or name == report.EXPERT]


def _written(cells: pd.DataFrame, out: Path, *, as_the_paper: bool = True, notes: Sequence[str] = ()) -> pd.DataFrame:
    """Write the table, with the paper's figures where it was driven as there."""
    table = compare(cells)
    if not as_the_paper:
        table[["paper", "paper_ratio"]] = np.nan
    with whole_file(out / "table1.csv") as partial:
        table.to_csv(partial, index=False)
    with whole_file(out / "table1.md") as partial:
        partial.write_text(_markdown(table, cells["episode"].nunique(), notes), encoding="utf-8")
    return table


def compare(cells: pd.DataFrame) -> pd.DataFrame:
    """Return each system's figures over its seeds and episodes, beside the expert's on the same traffic.

    `low` and `high` are the 95 % interval of the mean (of collisions and struck: Wilson's, of how often they happen),
    `ratio` is that mean over the expert's, `difference` the mean of system minus expert, each with its interval; see
    `statistics`. `above_expert` is the probability that an episode of the system has a greater value than one of the
    expert.
    """
    expert = cells[cells["system"] == report.EXPERT]
    cells = cells[cells["training_seed"].isin(expert["training_seed"])]
    rows: list[dict[str, Any]] = []
    for (system, mode), driven in cells.groupby(["system", "mode"], sort=False):
        beside = expert[expert["training_seed"].isin(driven["training_seed"])]
        trains = SYSTEMS[system].trains
        for metric in TABLE_METRICS:
            # Episodes of a seed are told apart by the same classifiers: they are not independent.
            by_seed = trains or metric == "told_apart"
            ours, theirs = scores(driven, metric), scores(beside, metric)
            paper, paper_expert = _paper(system, metric), _paper(report.EXPERT, metric)
            told = {"system": system, "mode": mode, "as_trained": driven["as_trained"].all(), "metric": metric}
            rows.append(
                {**told, "trainings": len(ours) if trains else 0, "episodes": int(np.isfinite(ours).sum())}
                | report.figures(metric, ours, theirs, trained=by_seed)
                | {"above_expert": probability_of_improvement(ours, theirs)}
                | {"paper": paper, "paper_ratio": paper / paper_expert}
            )
    return report.typed(rows, TABLE_COLUMNS)


def figures(experiment: Experiment, systems: Sequence[str] = FIGURES) -> pd.DataFrame:
    """Train and drive what Figures 3 and 4 compare, and write `cells` and the figures into `out`.

    Cells that Table 1 has too are taken over from there.

    Args:
        experiment: its configuration, folder and size.
        systems: a curve for each that learns.

    Returns:
        The cells' episodes: `experiment.CELL_COLUMNS`.

    Raises:
        InputError: matplotlib is not installed; else as in `Experiment.drive`.
    """
    plot.require_matplotlib()
    systems = _learners(systems)
    grid = [(name, trajectories) for name in systems for trajectories in TRAJECTORIES]
    cells = experiment.drive([*grid, (report.EXPERT, 0)])
    _draw(cells, systems, experiment.out)
    return cells


def figures_of(cells: Path, out: Path, systems: Sequence[str] = FIGURES) -> None:
    """Draw the figures of cells that an experiment left behind, into the folder `out`, without driving anything.

    Raises:
        InputError: the file cannot be read or is another one, or matplotlib is not installed.
    """
    plot.require_matplotlib()
    systems = _learners(systems)
    table = read_cells(cells)
    _require_some(table, cells, systems, "")
    _make(out)
    _draw(table, systems, out)


def _learners(systems: Sequence[str]) -> list[str]:
    learners = [name for name in systems if SYSTEMS[name].trains]
    if not learners:
        raise InputError(f"--only {','.join(systems)}: the figures are of learners, and none of these learns")
    return learners


def _draw(cells: pd.DataFrame, systems: Sequence[str], out: Path) -> None:
    """Write the figures, as PNG and SVG."""
    cells = cells[cells["as_trained"] & cells["system"].isin([*systems, report.EXPERT])]
    by_shown = {n: compare(cells[cells["trajectories"].isin([0, n])]) for n in TRAJECTORIES}
    for metric in PAPER_METRICS:
        rows = pd.concat([table[table["metric"] == metric].assign(shown=n) for n, table in by_shown.items()])
        curves = {
            SYSTEMS[system].label: of_system.set_index("shown")[["ratio", "ratio_low", "ratio_high"]]
            .reindex(TRAJECTORIES)
            .to_numpy()
            for system in systems
            if len(of_system := rows[rows["system"] == system])
        }
        figure = plot.against_trajectories(TRAJECTORIES, curves, _LABELS[metric])
        for suffix in (".png", ".svg"):
            name = metric.removesuffix("_kmh").removesuffix("_reward")
            plot.save(figure, out / f"figure_{name}{suffix}", overwrite=True)


def scores(driven: pd.DataFrame, metric: str) -> Floats:
    """Return a metric as `statistics.units` takes it, shape (n_seeds, n_episodes)."""
    return driven.pivot(index="training_seed", columns="episode", values=metric).to_numpy(dtype=np.float64)


def _paper(system: str, metric: str) -> float:
    """Return the paper's mean; NaN where it tells none."""
    return dict(zip(PAPER_METRICS, PAPER.get(system, ()), strict=False)).get(metric, np.nan)


_LABELS = {
    "speed_kmh": "speed",
    "overtakes": "overtakes",
    "lane_changes": "lane changes",
    "longitudinal_reward": "longitudinal reward",
    "lateral_reward": "lateral reward",
}


def _markdown(table: pd.DataFrame, n_episodes: int, more: Sequence[str]) -> str:
    """Return means, ratios of means to the expert's with intervals, and the paper's beside them."""
    headings = [*_LABELS.values(), "refused decisions", "told apart", "contacts"]
    lines = [_line("", headings), "| --- |" + " ---: |" * len(headings)]
    for (system, mode), rows in table.groupby(["system", "mode"], sort=False):
        figures, trains = rows.set_index("metric"), SYSTEMS[system].trains
        by_metric = figures.loc[list(PAPER_METRICS)]
        means = [*by_metric["mean"].map("{:.1f}".format), f"{figures.loc['refused_decisions', 'mean']:.1f}"]
        contacts = round((figures["mean"] * figures["episodes"])[list(report.CONTACTS)].sum())
        apart = with_interval(*figures.loc["told_apart", ["mean", "low", "high"]])
        trained = "" if rows["as_trained"].all() or not trains else ", not as trained"
        lines.append(
            _line(SYSTEMS[system].label + (f" ({mode}{trained})" if mode else ""), [*means, apart, str(contacts)])
        )
        ratios = [ratio_with_interval(*row) for row in by_metric[["ratio", "ratio_low", "ratio_high"]].to_numpy()]
        if system != report.EXPERT:
            lines.append(_line("&emsp;of the expert's", [*ratios, "", "", ""]))
        if by_metric["paper"].notna().any() and rows["as_trained"].all():
            lines.append(_line("&emsp;in the paper", [*by_metric["paper"].map("{:.1f}".format), "", "", ""]))
            if system != report.EXPERT:
                shares = by_metric["paper_ratio"].map("{:.3f}".format)
                lines.append(_line("&emsp;in the paper, of the expert's", [*shares, "", "", ""]))
    return "\n".join([*lines, "", *_notes(table, n_episodes), *(line for note in more for line in ("", note))]) + "\n"


_NOTE = (
    "Trainings of each learner: {trainings}; held-out episodes of each in either mode, and of each driver on every "
    "training's traffic: {n_episodes}. Means; below them, ratios of means to the expert's on the same traffic, with "
    "95 % intervals: over trainings, and over episodes of drivers that do not train. Told apart: how well a fresh "
    "classifier tells the decisions from the expert's, 0.5 being not at all; the expert's own is from its decisions "
    "on other traffic. Contacts: in how many of the episodes the host hit anything or was hit."
)


def _notes(table: pd.DataFrame, n_episodes: int) -> list[str]:
    seeds = table.loc[table["trainings"] > 0, "trainings"]
    fewest, most = (seeds.min(), seeds.max()) if len(seeds) else (0, 0)
    trainings = f"{fewest}" if fewest == most else f"{fewest} to {most}"
    papers = " The paper's are means of 16 episodes." if table["paper"].notna().any() else ""
    notes = [_NOTE.format(trainings=trainings, n_episodes=n_episodes) + papers]
    if 0 < fewest < report.FEW:
        wide = "the intervals are right but very wide, and of told apart may reach below 0 or above 1, as no figure can"
        notes += ["", f"**Fewer than {report.FEW} trainings**: {wide}."]
    return notes


def _line(head: str, cells: Iterable[str]) -> str:
    return f"| {head} | " + " | ".join(cells) + " |"


def with_interval(value: float, low: float, high: float, decimals: int = 3) -> str:
    """Return a figure as tables show it, with its interval if that has a width; nothing for what is not known."""
    if not np.isfinite(value):
        return ""
    interval = f" ({low:z.{decimals}f} to {high:z.{decimals}f})" if low < high else ""
    return f"{value:z.{decimals}f}{interval}"


def ratio_with_interval(value: float, low: float, high: float) -> str:
    """Return a ratio as tables show it; an interval without 1 in it does not look as if it ended there."""
    return with_interval(value, low, high, report.ratio_decimals(low, high, 3))
