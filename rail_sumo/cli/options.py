"""Options that several commands have, and what else they share."""

import os
import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from rail_sumo.errors import InputError

ConfigFile = Annotated[Path | None, typer.Argument(metavar="CONFIG", help="A .toml. Without one, all defaults.")]
WorldFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="A .toml of the world.", show_default="the first run's, or none"),
]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Change one key; repeatable.")
]
NETWORK = "A .net.xml, a .sumocfg with its demand, or a shipped network's name."
NetworkFile = Annotated[str | None, typer.Option(metavar="FILE", help=NETWORK)]
Routes = Annotated[list[str] | None, typer.Option(metavar="FILE", help="Your own demand; repeatable.")]
POLICY = (
    "A run, an expert's folder, or expert, rail, road-expert, road-rail, rule, sumo, sumo:TYPE, keep or random; "
    "module:attribute of your own. "
    "What was learned acts as it was trained, or as RUN:argmax or RUN:sampled."
)
SEED = "Everything random follows from it."
Seed = Annotated[int, typer.Option(min=0, help=SEED)]
_WORKERS, _CORES = "Processes that drive.", "as many as cores"
Workers = Annotated[str, typer.Option(metavar="N|ray", help=_WORKERS, show_default=_CORES)]
LocalWorkers = Annotated[str, typer.Option(metavar="N", help=_WORKERS, show_default=_CORES)]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]


def tell(what: str) -> None:
    """Print what is worth knowing, and stops nothing."""
    print(f"rail-sumo: {what}", file=sys.stderr)


def typed() -> str:
    """Return the command as it was typed, to be kept beside what it writes."""
    return shlex.join(["rail-sumo", *sys.argv[1:]])


def require_page(out: Path, what: str) -> None:
    """Raise InputError if a file is not to be a page."""
    if out.suffix != ".html":
        raise InputError(f"{what} is a page, FILE.html; got '{out}'")


def workers_of(text: str) -> int | Literal["ray"]:
    """Return how many processes drive, as `--workers` says.

    Raises:
        InputError: it is neither a number from 1 up nor ray.
    """
    if text == "ray":
        return "ray"
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"--workers takes a number of processes from 1 up, or ray; got '{text}'")
    return int(text)
