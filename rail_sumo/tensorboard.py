"""A training's figures as TensorBoard event files. Needs the extra `tensorboard`."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rail_sumo.errors import InputError
from rail_sumo.rollout import Observer

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
        self._folder = run / FOLDER
        self._writer: SummaryWriter | None = None

    def start(self, work: str, total: int, done: int = 0) -> None:
        """Pass it on."""
        self._observer.start(work, total, done)

    def advance(self, figures: Mapping[str, float]) -> None:
        """Write an iteration's figures, over the environment steps driven so far."""
        if "iteration" in figures:
            self._write(figures)
        self._observer.advance(figures)

    def _write(self, figures: Mapping[str, float]) -> None:
        from torch.utils.tensorboard import SummaryWriter

        steps = int(figures["environment_steps"])
        if self._writer is None:  # what an interrupted training wrote from here on is overruled
            self._writer = SummaryWriter(str(self._folder), purge_step=steps)
        for name, figure in figures.items():
            if name not in ("environment_steps", "seconds"):
                self._writer.add_scalar(name, figure, steps)
        self._writer.flush()
