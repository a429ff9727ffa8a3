"""An experiment: several learners and drivers, each on several seeds, brought to its end however often interrupted.

It is a grid of cells. A cell is one training, or one driver that does not train, evaluated on the held-out traffic of
its seed. Trainings are run directories under `runs/`, so that an experiment which is interrupted goes on with the
iteration that it was at; what a finished cell came to is one file under `cells/`, which also tells the configuration
and the files that it follows from.
"""

import json
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rail_sumo import drivers, report, rollout, run, training
from rail_sumo.config import ITERATIONS, Config, Learner, dumps, validate
from rail_sumo.errors import InputError
from rail_sumo.files import check_folder, whole_file
from rail_sumo.records import EPISODE_COLUMNS
from rail_sumo.rollout import SILENT, Observer, Who, WorkerCount
from rail_sumo.run_directory import RunDirectory

LEARNERS = ("rail", "rewarded", "gail", "bc", "dagger")
"""Who is trained; `rewarded` is RAIL that the environment pays too."""

QUICK = 4
"""An experiment that is to show its shape within minutes has so many times fewer iterations."""

REWARD_WEIGHT = 3.0
"""Of the environment's reward beside the judge's, for RAIL that is paid both; `rail.reward_weight` tells another."""

MADE_OF = b"rail_sumo"
"""The key of a cell's metadata that tells its configuration and the SHA-256 of the files it read."""

CELL_COLUMNS = {"learner": "string", "layers": "int64", "trajectories": "int64", "training_seed": "int64"} | {
    name: kind for name, kind in EPISODE_COLUMNS.items() if name != "policy"
}


@dataclass(frozen=True, order=True)
class Cell:
    """One training, or one driver that does not train, and its held-out episodes."""

    learner: str
    """Of `LEARNERS`, or a driver's name."""
    layers: int
    """0 of a driver that does not train."""
    trajectories: int
    """How many it was shown; 0 of a driver that does not train."""
    seed: int

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.learner}-{self.layers}-layer-{self.trajectories}-seed{self.seed}"

    @classmethod
    def parse(cls, name: str) -> "Cell | None":
        """Return the cell whose files are called so, if any is."""
        found = re.fullmatch(r"(\w+)-(\d)-layer-(\d+)-seed(\d+)", name)
        if not found:
            return None
        cell = cls(found[1], int(found[2]), int(found[3]), int(found[4]))
        layers = (1, 2) if cell.learner in LEARNERS else (0,) if cell.learner in drivers.NAMES else ()
        return cell if cell.layers in layers else None


@dataclass(frozen=True)
class Experiment:
    """What all its cells have in common."""

    config: Config
    """Of every training; learner, layers and number of trajectories are the cell's."""
    out: Path
    """Its folder, which may hold some of it already, of the same configuration."""
    seeds: int
    """Trainings of each learner, with seeds from 0."""
    quick: bool = False
    """For a first look: a quarter of the iterations, unless `train.iterations` says how many."""
    workers: WorkerCount = 1
    """How many cells at once, each in a process of its own."""
    observer: Observer = SILENT
    """Is told of every cell."""

    def drive(self, grid: Iterable[tuple[str, int, int]]) -> pd.DataFrame:
        """Bring a cell for every seed and every (learner, layers, trajectories) to its end; write `cells` into `out`.

        Returns:
            Their episodes, in the grid's order: `CELL_COLUMNS`.

        Raises:
            InputError: as in `run.train`; the expert does not drive in this world; `out` holds trainings of another
                configuration or of more iterations; seeds below 1; workers on a cluster.
        """
        if self.seeds < 1:
            raise InputError(f"--seeds must be at least 1; got {self.seeds}")
        if self.workers == "ray":
            raise InputError("reproduce keeps its cells on this machine and takes a number of --workers, not ray")
        check_folder(self.out, overwrite=True)
        run.require_drivable(self.config, self.config.train.evaluation_episodes)
        drivers.load_expert(self.config)  # everybody is set beside it
        systems = list(grid)
        work = [self._work(Cell(*system, seed)) for seed in range(self.seeds) for system in systems]
        training.demonstrations_of(max(work, key=lambda one: one.cell.trajectories).config)  # are there so many?
        for one in work:
            one.check()
        self.observer.start("cells", len(work))
        driven = []
        with rollout.workers(self.workers) as pool:
            for episodes in pool.map(_finish, work):
                driven.append(episodes)
                self.observer.advance({})
        report.write(self.out, cells=_typed(self._all_finished()), overwrite=True)
        return _typed(driven)

    def _work(self, cell: Cell) -> "_Work":
        return _Work(cell, _world(cell, self.config, self.quick), self.out)

    def _all_finished(self) -> list[pd.DataFrame]:
        """Return what every finished cell of this configuration came to, in the order of `CELL_COLUMNS`."""
        names = [file.stem for file in (self.out / "cells").glob("[!.]*.parquet")]
        work = [self._work(cell) for cell in sorted(cell for cell in map(Cell.parse, names) if cell)]
        return [one.result() for one in work if one.is_finished]


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
        try:
            metadata = pq.read_schema(self._file).metadata or {}
        except (OSError, pa.ArrowException):  # not there, or damaged
            return False
        made_of = json.loads(metadata.get(MADE_OF, b"{}"))
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
            inputs |= training.expert_input(self.config)
        return inputs


def _world(cell: Cell, config: Config, quick: bool) -> Config:
    """Return the configuration that a cell is trained and driven with."""
    if not cell.layers:
        return config.resolved()
    learner: Learner = "rail" if cell.learner == "rewarded" else cast(Learner, cell.learner)
    default = config.train.iterations == "default"
    iterations = ITERATIONS[learner] // QUICK if quick and default else config.train.iterations
    changed = {
        "learner": learner,
        "trajectories": cell.trajectories,
        "iterations": "default" if cell.learner == "bc" else iterations,
    }
    weight = (config.rail.reward_weight or REWARD_WEIGHT) if cell.learner == "rewarded" else 0.0
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
            driver: Who = learned.policy(world)
        else:
            driver = run.find_driver(cell.learner, world)
        n_episodes = world.train.evaluation_episodes
        episodes, _ = run.evaluate({cell.learner: driver}, world, episodes=n_episodes, seed=cell.seed)
        work.save(episodes)
    return work.result()


def _typed(cells: list[pd.DataFrame]) -> pd.DataFrame:
    return report.typed(pd.concat(cells, ignore_index=True), CELL_COLUMNS)
