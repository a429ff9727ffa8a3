"""The paper's experiments: every learner trained on several seeds, their Table 1, and Figures 3 and 4.

An experiment is a grid of cells. A cell is one training, or one driver that does not train, evaluated on the held-out
traffic of its seed. Trainings are run directories under `runs/`, so that an experiment which is interrupted goes on
with the iteration that it was at; what a finished cell came to is one file under `cells/`, which also tells the
configuration and the files that it follows from.
"""

import itertools
import json
import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rail_sumo import assets, drivers, plot, report, rollout, run, training
from rail_sumo.config import Config, dumps, validate
from rail_sumo.errors import InputError
from rail_sumo.files import check_folder, whole_file
from rail_sumo.records import EPISODE_COLUMNS, Floats
from rail_sumo.rollout import SILENT, Observer, WorkerCount
from rail_sumo.run_directory import RunDirectory
from rail_sumo.statistics import (
    interval,
    iqm,
    mean_difference,
    probability_of_improvement,
    ratio_of_iqms,
)

TRAJECTORIES = (1, 5, 10, 20, 40)
METRICS = ("speed_kmh", "overtakes", "lane_changes", "longitudinal_reward", "lateral_reward")

PAPER = {
    ("rail", 2): (70.38, 45.04, 15.01, 2719.38, -122.98),
    ("rail", 1): (65.00, 40.03, 13.05, 2495.57, -175.6),
    ("expert", 0): (68.83, 44.48, 14.04, 2642.11, -132.52),
}
"""Table 1 of the paper, by learner and layers, in the order of `METRICS`."""

ROWS = {
    ("rail", 2): "RAIL, two layers",
    ("rail", 1): "RAIL, one layer",
    ("rewarded", 2): "RAIL and the reward, two layers",
    ("expert", 0): "expert",
    ("bc", 2): "behaviour cloning",
    ("gail", 2): "GAIL",
    ("dagger", 2): "DAgger",
    ("rule", 0): "rule driver",
    ("sumo", 0): "SUMO's driver",
}
"""What is set side by side: who drives, and on how many layers; 0 for drivers that do not learn."""

TABLE1 = tuple(system for system in ROWS if system != ("expert", 0))
"""The rows beside the expert's."""

FIGURES = (("rail", 2), ("rail", 1), ("bc", 2), ("gail", 2))
"""The curves of Figures 3 and 4."""

QUICK = {"rail": 40, "rewarded": 40, "gail": 40, "bc": 0, "dagger": 5}
"""Iterations of an experiment that is to show its shape within minutes: a quarter."""

REWARD_WEIGHT = 1.0
"""Of the environment's reward beside the judge's, for RAIL that is paid both: no longer imitation alone."""

MADE_OF = b"rail_sumo"
"""The key of a cell's metadata that tells its configuration and the SHA-256 of the files it read."""

CELL_COLUMNS = {"learner": "string", "layers": "int64", "trajectories": "int64", "training_seed": "int64"} | {
    name: kind for name, kind in EPISODE_COLUMNS.items() if name != "policy"
}
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


@dataclass(frozen=True, order=True)
class Cell:
    """One training, or one driver that does not train, and its held-out episodes."""

    learner: str
    layers: int
    trajectories: int
    seed: int

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.learner}-{self.layers}-layer-{self.trajectories}-seed{self.seed}"

    @classmethod
    def parse(cls, name: str) -> "Cell | None":
        """Return the cell whose files are called so, if any is."""
        found = re.fullmatch(r"(\w+)-(\d)-layer-(\d+)-seed(\d+)", name)
        return cls(found[1], int(found[2]), int(found[3]), int(found[4])) if found else None


@dataclass(frozen=True)
class _Work:
    """A cell, the configuration it is trained and driven with, and the experiment's folder."""

    cell: Cell
    config: Config
    out: Path

    @property
    def run(self) -> Path:
        return self.out / "runs" / self.cell.name

    @property
    def is_finished(self) -> bool:
        """Whether its result is there, of this configuration and these files; a key it lacks had its default."""
        if not self._file.is_file():
            return False
        made_of = json.loads((pq.read_schema(self._file).metadata or {}).get(MADE_OF, b"{}"))
        if "config" not in made_of or made_of["inputs"] != self._inputs:
            return False
        return validate(tomllib.loads(made_of["config"])) == self.config

    def check(self) -> None:
        """Refuse, before anybody drives, what could not be gone on with."""
        if self.run.exists():
            RunDirectory(self.run).require_same(self.config, self.cell.seed, training.inputs_of(self.config))

    def save(self, episodes: pd.DataFrame) -> None:
        """Write the result."""
        about = {"training_seed" if name == "seed" else name: value for name, value in vars(self.cell).items()}
        table = pa.Table.from_pandas(report.typed(episodes.assign(**about), CELL_COLUMNS), preserve_index=False)
        made_of = json.dumps({"config": dumps(self.config), "inputs": self._inputs})
        with whole_file(self._file) as partial:
            pq.write_table(table.replace_schema_metadata({MADE_OF: made_of}), partial)

    def result(self) -> pd.DataFrame:
        """Read the result."""
        return report.typed(pd.read_parquet(self._file), CELL_COLUMNS)

    @property
    def _file(self) -> Path:
        return self.out / "cells" / f"{self.cell.name}.parquet"

    @property
    def _inputs(self) -> dict[str, str]:
        """The files that the result follows from."""
        inputs = training.inputs_of(self.config)
        if self.cell.learner == report.EXPERT:
            inputs["the shipped expert"] = assets.sha256(assets.expert(assets.EXPERT_POLICY))
        return inputs


def table1(
    config: Config,
    out: Path,
    *,
    seeds: int,
    quick: bool = False,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
) -> pd.DataFrame:
    """Train and drive all that Table 1 sets side by side, and write `cells`, `table1.csv` and `table1.md` into `out`.

    Args:
        config: of every training; learner, layers and number of trajectories are the cell's.
        out: may hold some of it already, of the same configuration.
        seeds: trainings of each learner, with seeds from 0.
        quick: for a first look: a quarter of the iterations, unless `train.iterations` says how many.
        workers: how many cells at once, each in a process of its own.
        observer: is told of every cell.

    Returns:
        A row per learner and metric: `TABLE_COLUMNS`.

    Raises:
        InputError: as in `run.train`; the expert does not drive in this world; `out` holds trainings of another
            configuration or of more iterations.
    """
    grid = [(learner, layers, config.train.trajectories if layers else 0) for learner, layers in TABLE1]
    cells = _drive(config, out, [*grid, (report.EXPERT, 0, 0)], seeds, quick, workers, observer)
    table = compare(cells)
    with whole_file(out / "table1.csv") as partial:
        table.to_csv(partial, index=False)
    with whole_file(out / "table1.md") as partial:
        partial.write_text(_markdown(table, seeds, config.train.evaluation_episodes), encoding="utf-8")
    return table


def compare(cells: pd.DataFrame) -> pd.DataFrame:
    """Return each learner's figures over its seeds and episodes, beside the expert's on the same traffic.

    `low` and `high` are the 95 % interval of the interquartile mean over seeds and episodes (of collisions and struck:
    Wilson's, of how often they happen), `ratio` is that mean over the expert's, `difference` the mean of learner minus
    expert, episode by episode on the same traffic, `above_expert` the probability that an episode of the learner has a
    greater value than one of the expert.
    """
    expert = cells[cells["learner"] == report.EXPERT]
    rows: list[dict[str, Any]] = []
    for (learner, layers), driven in cells.groupby(["learner", "layers"], sort=False):
        for metric in (*METRICS, *report.CONTACTS):
            scores, reference = _scores(driven, metric), _scores(expert, metric)
            low, high = report.metric_interval(metric, scores)
            ratio, ratio_low, ratio_high = _against(driven, expert, metric)
            difference_low, difference_high = interval(mean_difference, scores, reference)
            paper, paper_expert = _paper(learner, layers, metric), _paper(report.EXPERT, 0, metric)
            rows.append({
                "learner": learner,
                "layers": layers,
                "metric": metric,
                "mean": scores.mean(),
                "iqm": iqm(scores),
                "low": low,
                "high": high,
                "ratio": ratio,
                "ratio_low": ratio_low,
                "ratio_high": ratio_high,
                "difference": mean_difference(scores, reference),
                "difference_low": difference_low,
                "difference_high": difference_high,
                "above_expert": probability_of_improvement(scores, reference),
                "paper": paper,
                "paper_ratio": paper / paper_expert,
            })  # fmt: skip
    return report.typed(rows, TABLE_COLUMNS)


def figures(
    config: Config,
    out: Path,
    *,
    seeds: int,
    quick: bool = False,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
) -> pd.DataFrame:
    """Train and drive all that Figures 3 and 4 compare, and write `cells` and the five figures into `out`.

    The arguments and errors are those of `table1`, whose cells it takes over where they are in `out` already.

    Returns:
        The cells' episodes: `CELL_COLUMNS`.
    """
    plot.require_matplotlib()
    grid = [(*system, trajectories) for system, trajectories in itertools.product(FIGURES, TRAJECTORIES)]
    cells = _drive(config, out, [*grid, (report.EXPERT, 0, 0)], seeds, quick, workers, observer)
    expert = cells[cells["learner"] == report.EXPERT]
    for metric in METRICS:
        curves = {
            ROWS[system]: np.array([_against(_of(cells, *system, n), expert, metric) for n in TRAJECTORIES])
            for system in FIGURES
        }
        figure = plot.against_trajectories(TRAJECTORIES, curves, _LABELS[metric])
        for suffix in (".png", ".svg"):
            name = metric.removesuffix("_kmh").removesuffix("_reward")
            plot.save(figure, out / f"figure_{name}{suffix}", overwrite=True)
    return cells


def _drive(
    config: Config,
    out: Path,
    grid: Sequence[tuple[str, int, int]],
    seeds: int,
    quick: bool,
    workers: WorkerCount,
    observer: Observer,
) -> pd.DataFrame:
    """Bring every cell to its end and return their episodes, in the grid's order."""
    if seeds < 1:
        raise InputError(f"--seeds must be at least 1; got {seeds}")
    if workers == "ray":
        raise InputError("reproduce keeps its cells on this machine and takes a number of --workers, not ray")
    check_folder(out, overwrite=True)
    run.require_drivable(config, config.train.evaluation_episodes)
    drivers.load_expert(config)  # everybody is set beside it
    cells = [Cell(*what, seed) for seed in range(seeds) for what in grid]
    work = [_Work(cell, _world(cell, config, quick), out) for cell in cells]
    training.demonstrations_of(max(work, key=lambda one: one.cell.trajectories).config)  # are there so many?
    for one in work:
        one.check()
    observer.start("cells", len(cells))
    driven = []
    with rollout.workers(workers) as pool:
        for episodes in pool.map(_finish, work):
            driven.append(episodes)
            observer.advance({})
    finished = [one.result() for one in _all_finished(config, out, quick)]  # the other experiment's too
    report.write(out, cells=report.typed(pd.concat(finished, ignore_index=True), CELL_COLUMNS), overwrite=True)
    return report.typed(pd.concat(driven, ignore_index=True), CELL_COLUMNS)


def _world(cell: Cell, config: Config, quick: bool) -> Config:
    """Return the configuration that a cell is trained and driven with."""
    if not cell.layers:
        return config.resolved()
    default = config.train.iterations == "default"
    iterations = QUICK[cell.learner] if quick and default else config.train.iterations
    changed = {
        "learner": "rail" if cell.learner == "rewarded" else cell.learner,
        "trajectories": cell.trajectories,
        "iterations": "default" if cell.learner == "bc" else iterations,
    }
    weight = REWARD_WEIGHT if cell.learner == "rewarded" else config.rail.reward_weight
    return config.model_copy(
        update={
            "policy": config.policy.model_copy(update={"layers": cell.layers}),
            "rail": config.rail.model_copy(update={"reward_weight": weight}),
            "train": config.train.model_copy(update=changed),
        }
    ).resolved()


def _finish(work: _Work) -> pd.DataFrame:
    """Bring a cell to its end, wherever it stands, and return its episodes; runs in a process of its own."""
    cell, world = work.cell, work.config
    if not work.is_finished:
        if cell.layers:
            learned = training.learn(world, work.run, seed=cell.seed, resume=work.run.exists())
            driver: run.Driver = learned.policy(world)
        else:
            driver = run.find_driver(cell.learner, world)
        n_episodes = world.train.evaluation_episodes
        episodes, _ = run.evaluate({cell.learner: driver}, world, episodes=n_episodes, seed=cell.seed)
        work.save(episodes)
    return work.result()


def _all_finished(config: Config, out: Path, quick: bool) -> list[_Work]:
    """Return the finished cells of this configuration, in the order of `CELL_COLUMNS`."""
    names = [file.stem for file in (out / "cells").glob("[!.]*.parquet")]
    cells = sorted(cell for cell in map(Cell.parse, names) if cell and (cell.learner, cell.layers) in ROWS)
    work = [_Work(cell, _world(cell, config, quick), out) for cell in cells]
    return [one for one in work if one.is_finished]


def _of(cells: pd.DataFrame, learner: str, layers: int, trajectories: int) -> pd.DataFrame:
    same = (cells["learner"] == learner) & (cells["layers"] == layers) & (cells["trajectories"] == trajectories)
    return cells[same]


def _scores(driven: pd.DataFrame, metric: str) -> Floats:
    """Return a metric as `statistics` takes it, shape (n_seeds, n_episodes)."""
    return driven.pivot(index="training_seed", columns="episode", values=metric).to_numpy(dtype=np.float64)


def _paper(learner: str, layers: int, metric: str) -> float:
    """Return the paper's mean; NaN where it tells none."""
    return dict(zip(METRICS, PAPER.get((learner, layers), ()), strict=False)).get(metric, np.nan)


def _against(driven: pd.DataFrame, expert: pd.DataFrame, metric: str) -> tuple[float, float, float]:
    """Return the ratio of interquartile means to the expert's, and its 95 % interval."""
    scores, reference = _scores(driven, metric), _scores(expert, metric)
    return float(ratio_of_iqms(scores, reference)), *interval(ratio_of_iqms, scores, reference)


_LABELS = {
    "speed_kmh": "speed",
    "overtakes": "overtakes",
    "lane_changes": "lane changes",
    "longitudinal_reward": "longitudinal reward",
    "lateral_reward": "lateral reward",
}


def _markdown(table: pd.DataFrame, n_seeds: int, n_episodes: int) -> str:
    """Return means, ratios of interquartile means to the expert's with intervals, and the paper's beside them."""
    lines = [_line("", [*_LABELS.values(), "contacts"]), "| --- |" + " ---: |" * (len(METRICS) + 1)]
    for (learner, layers), rows in table.groupby(["learner", "layers"], sort=False):
        system, figures = (learner, layers), rows.set_index("metric")
        by_metric = figures.loc[list(METRICS)]
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
