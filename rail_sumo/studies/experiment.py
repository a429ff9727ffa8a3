"""An experiment: several learners and drivers, each on several seeds, brought to its end however often interrupted.

It is a grid of cells. A cell is one training, or one driver that does not train, evaluated on the held-out traffic of
its seed. Trainings are run directories under `runs/`, so that an experiment which is interrupted goes on with the
iteration that it was at; what a finished cell came to is one file under `cells/`, which also tells the configuration
and the files that it follows from.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rail_sumo import drivers, learners, origin, rollout, roster, run, training
from rail_sumo.config import Config
from rail_sumo.config_file import dumps, validate
from rail_sumo.errors import InputError
from rail_sumo.files import check_folder
from rail_sumo.highway import metrics
from rail_sumo.policy import ARGMAX, SAMPLED
from rail_sumo.records import EPISODE_COLUMNS, Trajectory
from rail_sumo.rollout import EVALUATION, SILENT, Observer, Task, Who, WorkerCount, traffic_seed
from rail_sumo.run_directory import RunDirectory
from rail_sumo.studies import cells
from rail_sumo.tables import report
from rail_sumo.tables.audit import told_apart

QUICK = 4
"""An experiment that is to show its shape within minutes has so many times fewer iterations."""

CELL_COLUMNS = {
    "system": "string",
    "mode": "string",  # "" of a driver that does not train
    "as_trained": "bool",  # whether that is the mode it was trained in
    "trajectories": "int64",
    "training_seed": "int64",
    **{name: kind for name, kind in EPISODE_COLUMNS.items() if name not in ("policy", "host", "depart_s")},
    "told_apart": "float64",  # by a fresh classifier, see `audit`
}

Sections = Mapping[str, dict[str, Any]]


@dataclass(frozen=True)
class System:
    """A learner with its settings, or a driver that does not train: what one row of a table is about."""

    label: str
    sections: Sections = field(default_factory=dict)
    """What its configuration says otherwise than the experiment's, by section; nothing for a driver."""

    @property
    def trains(self) -> bool:
        """Whether it learns; else its name is a driver's."""
        return bool(self.sections)


def _learner(label: str, learner: str, layers: int, **sections: dict[str, Any]) -> System:
    policy = {"layers": layers} | sections.pop("policy", {})
    unpaid = {"rail": {"reward_weight": 0.0}}
    return System(label, {"train": {"learner": learner}, "policy": policy} | unpaid | sections)


UNMASKED = {"policy": {"masked": False}}

SYSTEMS = {
    "rail-2": _learner("RAIL, two layers", "rail", 2),
    "rail-1": _learner("RAIL, one layer", "rail", 1),
    "bc-2": _learner("behaviour cloning, two layers", "bc", 2),
    "bc-1": _learner("behaviour cloning, one layer", "bc", 1),
    "gail-2": _learner("GAIL, two layers", "gail", 2),
    "dagger-2": _learner("DAgger, two layers", "dagger", 2),
    "rewarded-2": _learner("RAIL and the reward, two layers", "rail", 2, rail={"reward_weight": 3.0}),
    "rail-2-unmasked": _learner("RAIL, two layers, unmasked", "rail", 2, **UNMASKED),
    "bc-2-unmasked": _learner("behaviour cloning, two layers, unmasked", "bc", 2, **UNMASKED),
    "gail-2-unmasked": _learner("GAIL, two layers, unmasked", "gail", 2, **UNMASKED),
    "rule": System("rule driver"),
    "sumo": System("SUMO's driver"),
    "expert": System("expert"),
}
"""Whatever is set side by side, by the name that `--only` and the files of an experiment know it by."""


@dataclass(frozen=True, order=True)
class Cell:
    """One training, or one driver that does not train, and its held-out episodes."""

    system: str
    """Of `SYSTEMS`."""
    trajectories: int
    """How many it was shown; 0 of a driver that does not train."""
    seed: int

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.system}-{self.trajectories}-seed{self.seed}"

    @classmethod
    def parse(cls, name: str) -> "Cell | None":
        """Return the cell whose files are called so, if any is."""
        found = re.fullmatch(r"([\w-]+)-(\d+)-seed(\d+)", name)
        return cls(found[1], int(found[2]), int(found[3])) if found and found[1] in SYSTEMS else None


@dataclass(frozen=True)
class Experiment:
    """What all its cells have in common."""

    config: Config
    """Of every training; what its system says otherwise, and the number of trajectories, are the cell's."""
    out: Path
    """Its folder, which may hold some of it already, of the same configuration."""
    seeds: int
    """Trainings of each learner, with seeds from 0."""
    episodes: int = 32
    """Held-out episodes of each training and mode, and of each driver on every seed's traffic."""
    quick: bool = False
    """For a first look: a quarter of the iterations, unless `train.iterations` says how many."""
    workers: WorkerCount = 1
    """How many cells at once, each in a process of its own."""
    observer: Observer = SILENT
    """Receives progress, cell by cell."""
    command: str = ""
    """What was typed; it is kept beside the tables."""

    @property
    def notes(self) -> tuple[str, ...]:
        """That the demonstrations are, or may be, of another driver than the expert that all is compared with."""
        return tuple(training.other_expert(self.config, "ratios and 'told apart' are to"))

    def unusual(self, systems: Iterable[str]) -> list[str]:
        """Tell what of a training of these systems is not as it usually is: its iterations, and keys of its own."""
        told: dict[tuple[int, int], list[str]] = {}
        for name in dict.fromkeys(systems):
            if not SYSTEMS[name].trains:
                continue
            world = _world(Cell(name, 1, 0), self.config, self.quick)
            iterations = world.train.n_iterations, learners.learner_of(world).iterations
            if len(set(iterations)) > 1:
                told.setdefault(iterations, []).append(SYSTEMS[name].label)
        quick = " (--quick)" if self.quick and self.config.train.iterations == "default" else ""
        lines = [
            f"Trained for {own} iterations in place of {usual}{quick}: {'; '.join(labels)}."
            for (own, usual), labels in told.items()
        ]
        others = [f"{key} = {value}" for key, value in self.config.of_its_own().items() if key != "train.iterations"]
        return [*lines, f"Other than the defaults: {'; '.join(others)}."] if others else lines

    def drive(self, grid: Iterable[tuple[str, int]]) -> pd.DataFrame:
        """Bring a cell for every seed and every (system, trajectories) to its end; write `cells` into `out`.

        Returns:
            Their episodes, in the grid's order: `CELL_COLUMNS`.

        Raises:
            InputError: as in `run.train`; the expert does not drive in this world; `out` holds trainings of another
                configuration or of more iterations; seeds or episodes below 1; workers on a cluster.
        """
        if self.seeds < 1:
            raise InputError(f"--seeds must be at least 1; got {self.seeds}")
        if self.workers == "ray":
            raise InputError("reproduce keeps its cells on this machine and takes a number of --workers, not ray")
        check_folder(self.out, overwrite=True)
        run.require_drivable(self.config, self.episodes)
        training.require_loss(self.config)
        drivers.require_same_senses(drivers.load_expert(self.config), self.config, "the expert of every ratio")
        systems = list(grid)
        work = [self._work(Cell(*system, seed)) for seed in range(self.seeds) for system in systems]
        shown_most = max(work, key=lambda one: one.cell.trajectories).config
        shown = training.demonstrations_of(shown_most)  # are there so many?
        for one in work:
            one.check()
        notes = [*training.doubts(shown_most, shown), *self.notes]
        for note in notes:
            self.observer.note(note)
        self.observer.start("cells", len(work))
        driven = []
        with rollout.workers(self.workers) as pool:
            for episodes in pool.map(_finish, work):
                driven.append(episodes)
                self.observer.advance({})
        report.write(self.out, cells=_typed(self._all_finished()), overwrite=True)
        files = training.inputs_of(self.config) | training.expert_input(self.config)
        notes += self.unusual(system for system, _ in systems)
        origin.describe(self.out, self.config, self.command, notes=notes, trains=True, files=files)
        return _typed(driven)

    def _work(self, cell: Cell) -> "_Work":
        config = self.config.changed(train={"evaluation_episodes": self.episodes})
        return _Work(cell, _world(cell, config, self.quick), self.out)

    def _all_finished(self) -> list[pd.DataFrame]:
        """Return what every finished cell of this configuration came to, in the order of `CELL_COLUMNS`."""
        names = [file.stem for file in (self.out / report.FINISHED).glob("[!.]*.parquet")]
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
        made_of = json.loads(cells.made_of(self._file) or "{}")
        if "config" not in made_of or made_of["inputs"] != self._inputs:
            return False
        return validate(tomllib.loads(made_of["config"])) == self.config

    def check(self) -> None:
        """Refuse, before anybody drives, what could not be gone on with."""
        if self.run.exists():
            RunDirectory(self.run).require_same(self.config, self.cell.seed, training.inputs_of(self.config))

    def save(self, episodes: pd.DataFrame) -> None:
        """Write the result."""
        about = {"system": self.cell.system, "trajectories": self.cell.trajectories, "training_seed": self.cell.seed}
        made_of = json.dumps({"config": dumps(self.config), "inputs": self._inputs})
        cells.write(self._file, report.typed(episodes.assign(**about), CELL_COLUMNS), made_of)

    def result(self) -> pd.DataFrame:
        """Read the result."""
        return report.typed(pd.read_parquet(self._file), CELL_COLUMNS)

    @property
    def _file(self) -> Path:
        return self.out / report.FINISHED / f"{self.cell.name}.parquet"

    @property
    def _inputs(self) -> dict[str, str]:
        """The files that the result follows from."""
        return training.inputs_of(self.config) | training.expert_input(self.config)


def _world(cell: Cell, config: Config, quick: bool) -> Config:
    """Return the configuration that a cell is trained and driven with."""
    system = SYSTEMS[cell.system]
    if not system.trains:
        return training.resolved(config)
    world = config.changed(**system.sections).changed(train={"trajectories": cell.trajectories})
    learner = learners.learner_of(world)
    if not learner.iterations:
        return training.resolved(world.changed(train={"iterations": "default"}))
    if quick and config.train.iterations == "default":
        world = world.changed(train={"iterations": learner.iterations // QUICK})
    return training.resolved(world)


def _finish(work: _Work) -> pd.DataFrame:
    """Bring a cell to its end, wherever it stands, and return its episodes; runs in a process of its own."""
    if not work.is_finished:
        work.save(_driven(work))
    return work.result()


def _driven(work: _Work) -> pd.DataFrame:
    """Train the cell's system if it trains, and drive it, in either mode, on its seed's held-out traffic."""
    cell, world = work.cell, work.config
    n = world.train.evaluation_episodes
    who: dict[str, Who] = {"": cell.system}
    if SYSTEMS[cell.system].trains:
        learned = training.learn(world, work.run, seed=cell.seed, resume=work.run.exists()).policy()
        who = {mode: learned.acting(mode) for mode in (ARGMAX, SAMPLED)}
    expert = _episodes(report.EXPERT, world, cell.seed, range(n))
    parts = []
    for mode, driver in who.items():
        driven = expert if cell.system == report.EXPERT else _episodes(driver, world, cell.seed, range(n))
        # The expert is compared with its own drives on other traffic: the measure's negative control.
        beside = _episodes(report.EXPERT, world, cell.seed, range(n, 2 * n)) if driven is expert else expert
        rows = [{"episode": number, **metrics.row(one, world.adas)} for number, one in enumerate(driven)]
        parts.append(
            pd.DataFrame(rows).assign(
                mode=mode,
                as_trained=mode in ("", world.policy.mode),
                told_apart=told_apart(driven, beside) if cell.system != "sumo" else np.nan,  # which takes no decisions
            )
        )
    return pd.concat(parts, ignore_index=True)


def _episodes(driver: Who, world: Config, seed: int, numbers: range) -> list[Trajectory]:
    if isinstance(driver, str):
        driver = roster.find_driver(driver, world)
    return [rollout.drive(Task(driver, world, traffic_seed(seed, EVALUATION, number))) for number in numbers]


def _typed(cells: list[pd.DataFrame]) -> pd.DataFrame:
    return report.typed(pd.concat(cells, ignore_index=True), CELL_COLUMNS)
