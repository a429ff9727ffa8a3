"""The commands that train and record."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from rail_sumo import config_file
from rail_sumo.cli.apps import INTERRUPTED, app, expert
from rail_sumo.cli.options import (
    POLICY,
    SEED,
    ConfigFile,
    NetworkFile,
    Overrides,
    Overwrite,
    Routes,
    Seed,
    Workers,
    workers_of,
)
from rail_sumo.cli.progress import progress_bars, show
from rail_sumo.cli.world import choice_of
from rail_sumo.files import is_taken


@app.command(rich_help_panel="Learn")
def train(
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Run directory.", show_default="runs/CONFIG-seedS")] = None,
    workers: Workers = "",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help=SEED, show_default="0")] = None,
    events: Annotated[bool, typer.Option("--tensorboard", help="Also write event files.")] = False,
) -> None:
    """Learn a driver from demonstrations and compare it with its clone, if it has one, and the expert."""
    from rail_sumo import run
    from rail_sumo.run_directory import CONFIG, RunDirectory
    from rail_sumo.tensorboard import Events

    out = out or Path("runs", f"{config_path.stem if config_path else 'default'}-seed{seed or 0}")
    if resume:  # as it was started, where nothing else is said
        started = RunDirectory(out)
        config_path = config_path or out / CONFIG
        seed = started.seed if seed is None else seed
    chosen = config_file.load(config_path, choice_of(network, routes, overrides).overrides)
    n_workers = workers_of(workers)
    try:
        with progress_bars() as bars:
            observer = Events(bars, out) if events else bars
            tables = run.train(chosen, out, seed=seed or 0, workers=n_workers, resume=resume, observer=observer)
    except KeyboardInterrupt:
        hint = f"; go on with: rail-sumo train --out {shlex.quote(str(out))} --resume" if is_taken(out) else ""
        print(f"rail-sumo: interrupted{hint}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    show(tables, out)


@expert.command("train")
def train_expert(
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the expert.", show_default="runs/expert-seedS")] = None,
    seed: Seed = 0,
    workers: Workers = "",
) -> None:
    """Train an expert by PPO with invalid actions masked, evaluate it, and record its demonstrations."""
    from rail_sumo import expert

    out = out or Path("runs", f"expert-seed{seed}")
    n_workers = workers_of(workers)
    world = config_file.load(config_path, choice_of(network, routes, overrides).overrides)
    with progress_bars() as observer:
        tables = expert.train(world, out, seed=seed, workers=n_workers, observer=observer)
    show(tables, out)


@expert.command()
def record(
    out: Annotated[Path, typer.Option(metavar="FILE.parquet", help="Where the demonstrations go.")],
    config_path: ConfigFile = None,
    driver: Annotated[str, typer.Option(metavar="NAME", help=POLICY)] = "expert",
    episodes: Annotated[int, typer.Option(help="Episodes to record.")] = 40,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    seed: Seed = 0,
    workers: Workers = "",
    overwrite: Overwrite = False,
) -> None:
    """Record what a driver sees and carries out, for `train.demonstrations` to learn from.

    It sees with the senses that it was trained with, unless others are configured.
    """
    from rail_sumo import roster, run

    changes = choice_of(network, routes, overrides).overrides
    world = config_file.load(config_path, changes)
    roster.require_senses_heeded([driver], world, changes)
    n_workers = workers_of(workers)
    with progress_bars() as observer:
        demonstrations = run.demonstrate(
            driver,
            world,
            out,
            episodes=episodes,
            seed=seed,
            workers=n_workers,
            overwrite=overwrite,
            observer=observer,
        )
    print(f"{len(demonstrations.actions)} decisions from {episodes} episodes in {out}")
