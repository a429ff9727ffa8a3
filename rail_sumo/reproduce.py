"""The paper's experiments: Table 1 and Figures 3 and 4, from many trainings in place of one."""

import itertools
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pandas as pd

from rail_sumo import plot, report
from rail_sumo.experiment import Experiment
from rail_sumo.files import whole_file
from rail_sumo.records import Floats
from rail_sumo.statistics import interval, iqm, mean_difference, probability_of_improvement, ratio_of_iqms

TRAJECTORIES = (1, 5, 10, 20, 40)
PAPER_METRICS = ("speed_kmh", "overtakes", "lane_changes", "longitudinal_reward", "lateral_reward")

PAPER = {
    ("rail", 2): (70.38, 45.04, 15.01, 2719.38, -122.98),
    ("rail", 1): (65.00, 40.03, 13.05, 2495.57, -175.6),
    ("expert", 0): (68.83, 44.48, 14.04, 2642.11, -132.52),
}
"""Table 1 of the paper, by learner and layers, in the order of `PAPER_METRICS`."""

ROWS = {
    ("rail", 2): "RAIL, two layers",
    ("rail", 1): "RAIL, one layer",
    ("rewarded", 2): "RAIL and the reward, two layers",
    ("expert", 0): "expert",
    ("bc", 2): "behaviour cloning, two layers",
    ("bc", 1): "behaviour cloning, one layer",
    ("gail", 2): "GAIL",
    ("dagger", 2): "DAgger",
    ("rule", 0): "rule driver",
    ("sumo", 0): "SUMO's driver",
}
"""What is set side by side: who drives, and on how many layers; 0 for drivers that do not learn."""

TABLE1 = tuple(system for system in ROWS if system != ("expert", 0))
"""The rows beside the expert's."""

EXPERT_CELL = (report.EXPERT, 0, 0)
"""Whom all are set beside, as a part of an experiment's grid."""

FIGURES = (("rail", 2), ("rail", 1), ("bc", 2), ("gail", 2))
"""The curves of Figures 3 and 4."""

TABLE_COLUMNS = {
    "learner": "string",
    "layers": "int64",
    "metric": "string",
    "mean": "float64",
    "iqm": "float64",
    "low": "float64",
    "high": "float64",
    "ratio": "float64",
    "ratio_low": "float64",
    "ratio_high": "float64",
    "difference": "float64",
    "difference_low": "float64",
    "difference_high": "float64",
    "above_expert": "float64",
    "paper": "float64",
    "paper_ratio": "float64",
}


def table1(experiment: Experiment) -> pd.DataFrame:
    """Train and drive all that Table 1 sets side by side, and write `cells`, `table1.csv` and `table1.md` into `out`.

    Returns:
        A row per learner and metric: `TABLE_COLUMNS`.

    Raises:
        InputError: as in `Experiment.drive`.
    """
    train = experiment.config.train
    grid = [(learner, layers, train.trajectories if layers else 0) for learner, layers in TABLE1]
    table = compare(experiment.drive([*grid, EXPERT_CELL]))
    with whole_file(experiment.out / "table1.csv") as partial:
        table.to_csv(partial, index=False)
    with whole_file(experiment.out / "table1.md") as partial:
        partial.write_text(_markdown(table, experiment.seeds, train.evaluation_episodes), encoding="utf-8")
    return table


def compare(cells: pd.DataFrame) -> pd.DataFrame:
    """Return each learner's figures over its seeds and episodes, beside the expert's on the same traffic.

    `low` and `high` are the 95 % interval of the interquartile mean over seeds and episodes (of collisions and struck:
    Wilson's, of how often they happen), `ratio` is that mean over the expert's, `difference` the mean of learner minus
    expert, episode by episode on the same traffic, `above_expert` the probability that an episode of the learner has a
    greater value than one of the expert. Ratios and differences of contacts have no interval: a bootstrap of what never
    happened would be sure that it never will.
    """
    expert = cells[cells["learner"] == report.EXPERT]
    rows: list[dict[str, Any]] = []
    for (learner, layers), driven in cells.groupby(["learner", "layers"], sort=False):
        for metric in (*PAPER_METRICS, *report.CONTACTS):
            ours, theirs = scores(driven, metric), scores(expert, metric)
            low, high = report.metric_interval(metric, ours)
            ratio, ratio_low, ratio_high = _against(metric, ratio_of_iqms, ours, theirs)
            difference, difference_low, difference_high = _against(metric, mean_difference, ours, theirs)
            paper, paper_expert = _paper(learner, layers, metric), _paper(report.EXPERT, 0, metric)
            rows.append({
                "learner": learner,
                "layers": layers,
                "metric": metric,
                "mean": ours.mean(),
                "iqm": iqm(ours),
                "low": low,
                "high": high,
                "ratio": ratio,
                "ratio_low": ratio_low,
                "ratio_high": ratio_high,
                "difference": difference,
                "difference_low": difference_low,
                "difference_high": difference_high,
                "above_expert": probability_of_improvement(ours, theirs),
                "paper": paper,
                "paper_ratio": paper / paper_expert,
            })  # fmt: skip
    return report.typed(rows, TABLE_COLUMNS)


def figures(experiment: Experiment) -> pd.DataFrame:
    """Train and drive all that Figures 3 and 4 compare, and write `cells` and the five figures into `out`.

    Cells that Table 1 has too are taken over from there.

    Returns:
        The cells' episodes: `experiment.CELL_COLUMNS`.

    Raises:
        InputError: matplotlib is not installed; else as in `Experiment.drive`.
    """
    plot.require_matplotlib()
    grid = [(*system, trajectories) for system, trajectories in itertools.product(FIGURES, TRAJECTORIES)]
    cells = experiment.drive([*grid, EXPERT_CELL])
    expert = cells[cells["learner"] == report.EXPERT]
    for metric in PAPER_METRICS:
        reference = scores(expert, metric)
        curves = {
            ROWS[system]: np.array([
                _against(metric, ratio_of_iqms, scores(_of(cells, *system, n), metric), reference)
                for n in TRAJECTORIES
            ])
            for system in FIGURES
        }  # fmt: skip
        figure = plot.against_trajectories(TRAJECTORIES, curves, _LABELS[metric])
        for suffix in (".png", ".svg"):
            name = metric.removesuffix("_kmh").removesuffix("_reward")
            plot.save(figure, experiment.out / f"figure_{name}{suffix}", overwrite=True)
    return cells


def _of(cells: pd.DataFrame, learner: str, layers: int, trajectories: int) -> pd.DataFrame:
    same = (cells["learner"] == learner) & (cells["layers"] == layers) & (cells["trajectories"] == trajectories)
    return cells[same]


def scores(driven: pd.DataFrame, metric: str) -> Floats:
    """Return a metric as `statistics` takes it, shape (n_seeds, n_episodes)."""
    return driven.pivot(index="training_seed", columns="episode", values=metric).to_numpy(dtype=np.float64)


def _paper(learner: str, layers: int, metric: str) -> float:
    """Return the paper's mean; NaN where it tells none."""
    return dict(zip(PAPER_METRICS, PAPER.get((learner, layers), ()), strict=False)).get(metric, np.nan)


def _against(
    metric: str, compared: Callable[..., Floats], scores: Floats, reference: Floats
) -> tuple[float, float, float]:
    """Return how scores compare with the expert's, and the 95 % interval; NaN of contacts."""
    sure = (np.nan, np.nan) if metric in report.CONTACTS else interval(compared, scores, reference)
    return float(compared(scores, reference)), *sure


_LABELS = {
    "speed_kmh": "speed",
    "overtakes": "overtakes",
    "lane_changes": "lane changes",
    "longitudinal_reward": "longitudinal reward",
    "lateral_reward": "lateral reward",
}


def _markdown(table: pd.DataFrame, n_seeds: int, n_episodes: int) -> str:
    """Return means, ratios of interquartile means to the expert's with intervals, and the paper's beside them."""
    lines = [_line("", [*_LABELS.values(), "contacts"]), "| --- |" + " ---: |" * (len(PAPER_METRICS) + 1)]
    for (learner, layers), rows in table.groupby(["learner", "layers"], sort=False):
        system, figures = (learner, layers), rows.set_index("metric")
        by_metric = figures.loc[list(PAPER_METRICS)]
        contacts = round(figures.loc[list(report.CONTACTS), "mean"].sum() * n_seeds * n_episodes)
        lines.append(_line(ROWS[system], [*map("{:.1f}".format, by_metric["mean"]), str(contacts)]))
        ratios = [_ratio(*row) for row in by_metric[["ratio", "ratio_low", "ratio_high"]].to_numpy()]
        if learner != report.EXPERT:
            lines.append(_line("&emsp;of the expert's", [*ratios, ""]))
        if system in PAPER:
            lines.append(_line("&emsp;in the paper", [*map("{:.1f}".format, by_metric["paper"]), ""]))
        if system in PAPER and learner != report.EXPERT:
            shares = map("{:.3f}".format, by_metric["paper_ratio"])
            lines.append(_line("&emsp;in the paper, of the expert's", [*shares, ""]))
    lines += [
        "",
        f"Means of {n_seeds} x {n_episodes} episodes (training seeds x held-out traffic); below them, ratios of "
        f"interquartile means to the expert's on the same traffic, with 95 % intervals. Contacts: how often the host "
        f"hit or was hit, in all episodes. The paper's are means of 16 episodes of one training.",
    ]
    return "\n".join(lines) + "\n"


def _line(head: str, cells: Iterable[str]) -> str:
    return f"| {head} | " + " | ".join(cells) + " |"


def _ratio(ratio: float, low: float, high: float) -> str:
    return f"{ratio:.3f}" + (f" ({low:.3f} to {high:.3f})" if np.isfinite([low, high]).all() else "")
