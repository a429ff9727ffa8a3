"""A training's figures as TensorBoard event files. Needs the extra `tensorboard`."""

import csv
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rail_sumo.errors import InputError
from rail_sumo.files import writing
from rail_sumo.rollout import Observer
from rail_sumo.run_directory import PROGRESS

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

FOLDER = "tensorboard"
"""In the run directory, holds the event files."""


class Events:
    """An observer that writes every iteration's figures down before it passes them on.

    Args:
        observer: is told all the same.
        run: the run directory, which need not exist before the first iteration is done.

    Raises:
        InputError: TensorBoard is not installed.
    """

    def __init__(self, observer: Observer, run: Path) -> None:
        if find_spec("tensorboard") is None:
            raise InputError("event files need TensorBoard; install it with: pip install 'rail-sumo[tensorboard]'")
        self._observer = observer
        self._run = run
        self._writer: SummaryWriter | None = None

    def start(self, work: str, total: int, done: int = 0) -> None:
        """Pass it on."""
        self._observer.start(work, total, done)

    def advance(self, figures: Mapping[str, float]) -> None:
        """Write an iteration's figures, over the environment steps driven so far.

        Raises:
            InputError: they cannot be written.
        """
        if "iteration" in figures:
            with writing(self._run / FOLDER):
                self._write(figures)
        self._observer.advance(figures)

    def note(self, text: str) -> None:
        """Pass it on."""
        self._observer.note(text)

    def _write(self, figures: Mapping[str, float]) -> None:
        from torch.utils.tensorboard import SummaryWriter

        if self._writer is None:  # whatever was written before an interruption, all of it is written anew
            self._writer = SummaryWriter(str(self._run / FOLDER), purge_step=0)
            for row in self._earlier(figures["iteration"]):
                self._add(self._writer, row)
        self._add(self._writer, figures)
        self._writer.flush()

    def _earlier(self, iteration: float) -> list[dict[str, float]]:
        """Return what `progress.csv` has of the iterations before this one."""
        with (self._run / PROGRESS).open(encoding="utf-8") as file:
            rows = [{name: float(text) for name, text in row.items() if text} for row in csv.DictReader(file)]
        return [row for row in rows if row["iteration"] < iteration]

    @staticmethod
    def _add(writer: "SummaryWriter", figures: Mapping[str, float]) -> None:
        for name, figure in figures.items():
            if name not in ("environment_steps", "seconds"):
                writer.add_scalar(name, figure, int(figures["environment_steps"]))
