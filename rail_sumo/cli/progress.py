"""What a terminal shows of work that goes on, and of tables."""

import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TaskID, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from rail_sumo.run import Tables

# What a bar tells of the part just done, where that is known. With all of it the bar fits into 80 columns.
_FIGURES = (
    "reward {mean_return:+.2f}",
    "judge {judge_expert_mean:.2f}/{judge_learner_mean:.2f}",
    "{speed_kmh:.1f} km/h",
    "{lane_changes:.1f} changes",
)


LINE_EVERY_S = 60.0
"""Where nobody watches a terminal, a line tells so often how far work is."""

_PACE_OVER_S = 600.0
"""How far back a bar looks to tell how long the rest will take; a run or an iteration may take a minute."""


class _Bars:
    """A `run.Observer` that draws a bar for each piece of work; where there is no terminal, a line now and then."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task = TaskID(0)
        self._done_before = 0
        self._begun_at = self._told_at = time.monotonic()
        self._told_of: TaskID | None = None
        self.notes: list[str] = []
        """What it was told to note."""

    def start(self, work: str, total: int, done: int = 0) -> None:
        self._task = self._progress.add_task(work, total=total, completed=done, figures="")
        self._begun_at, self._done_before = time.monotonic(), done

    def advance(self, figures: Mapping[str, float]) -> None:
        told = []
        for form in _FIGURES:
            with suppress(KeyError):
                told.append(form.format_map(figures))
        self._progress.update(self._task, advance=1, figures=" ".join(told))
        task = self._progress.tasks[self._task]
        is_due = time.monotonic() - self._told_at >= LINE_EVERY_S
        is_last = task.finished and self._told_of == self._task
        if self._progress.disable and (is_due or is_last):
            self._told_at, self._told_of = time.monotonic(), self._task
            left = [] if task.finished else [f"about {self._minutes_left(task)} min left"]
            done = f"{task.description}: {task.completed:.0f} of {task.total:.0f} done"
            self._print(", ".join([done, *left, *told]))

    def _minutes_left(self, task: Task) -> int:
        """At the pace since the work began: workers finish in pairs, so that the last ones' pace tells little."""
        pace_s = (time.monotonic() - self._begun_at) / (task.completed - self._done_before)
        return math.ceil(pace_s * (task.remaining or 0.0) / 60.0)

    def note(self, text: str) -> None:
        self.notes.append(text)
        self._print(text)

    def _print(self, text: str) -> None:
        self._progress.console.print(f"rail-sumo: {text}", soft_wrap=True, markup=False, highlight=False)


@contextmanager
def progress_bars() -> Iterator[_Bars]:
    """Give an observer of work, see `run.Observer`, which shows it until it is over."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=8),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
    )
    console = Console(stderr=True, emoji=False)
    hides = not console.is_terminal
    with Progress(*columns, console=console, disable=hides, speed_estimate_period=_PACE_OVER_S) as progress:
        yield _Bars(progress)


def show(tables: "Tables", out: Path | None) -> None:
    """Print an evaluation's table, which episodes were cut short, whether all drove alike, and where all of it is."""
    from rail_sumo.tables import report

    console = Console(width=None if sys.stdout.isatty() else 100, emoji=False)  # sumo:truck is a driver's name
    console.print(report.table(tables.summary, width=console.width))
    for line in (*report.cut_short(tables.episodes), *report.alike(tables.episodes)):
        console.print(escape(line), soft_wrap=True, highlight=False)
    if out:
        console.print(f"tables in {escape(str(out))}", soft_wrap=True)
