"""The commands of many trainings or runs: reproduce and sweep."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from rail_sumo import config_file
from rail_sumo.cli.apps import INTERRUPTED, app
from rail_sumo.cli.options import (
    ConfigFile,
    LocalWorkers,
    NetworkFile,
    Overrides,
    Routes,
    typed,
    workers_of,
)
from rail_sumo.cli.progress import progress_bars
from rail_sumo.cli.world import choice_of
from rail_sumo.errors import InputError


@app.command(rich_help_panel="Study")
def reproduce(
    what: Annotated[Literal["table1", "figures"], typer.Argument(help="Table 1, or Figures 3 and 4.")],
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    out: Annotated[Path, typer.Option(help="Folder for cells, table and figures.")] = Path("runs/reproduce"),
    only: Annotated[
        str, typer.Option(metavar="SYSTEM,...", help="Some rows or curves alone.", show_default="all")
    ] = "",
    seeds: Annotated[int | None, typer.Option(help="Trainings per cell.", show_default="10, with --quick 2")] = None,
    episodes: Annotated[int, typer.Option(help="Held-out episodes of each training.")] = 32,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer iterations, for a first look.")] = False,
    cells: Annotated[Path | None, typer.Option(metavar="FILE", help="Only from these cells; train nothing.")] = None,
    workers: LocalWorkers = "",
) -> None:
    """Repeat the paper's experiments; what is in the folder already is not done again."""
    from rail_sumo.studies import reproduce
    from rail_sumo.studies.experiment import Experiment

    chosen = config_file.load(config_path, choice_of(network, routes, overrides).overrides)
    if cells and (seeds is not None or quick or workers):
        raise InputError("--cells makes tables of what was driven before: leave out --seeds, --quick and --workers")
    n_seeds = (2 if quick else 10) if seeds is None else seeds
    n_workers = workers_of(workers)
    systems = reproduce.chosen(only)
    try:
        with progress_bars() as bars:
            experiment = Experiment(
                chosen, out, n_seeds, episodes, quick=quick, workers=n_workers, observer=bars, command=typed()
            )
            if what == "table1":
                if cells:
                    reproduce.table1_of(cells, out, systems, trajectories=chosen.train.trajectories)
                else:
                    reproduce.table1(experiment, systems)
            else:
                curves = systems if only else reproduce.FIGURES
                reproduce.figures_of(cells, out, curves) if cells else reproduce.figures(experiment, curves)
    except KeyboardInterrupt:
        print("rail-sumo: interrupted; the same command goes on", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    if what == "table1":
        print((out / "table1.md").read_text(encoding="utf-8"), end="")
    print(f"{what} in {out}")


@app.command(rich_help_panel="Study")
def sweep(
    what: Annotated[str, typer.Argument(metavar="share|SECTION.KEY", help="What is varied.")],
    values: Annotated[
        list[str], typer.Argument(metavar="VALUE...", help="Its values; shares are of the cars, 0 to 1.")
    ],
    driver: Annotated[
        list[str], typer.Option("--driver", metavar="POLICY", help="Who drives the share; repeatable. Also acc, sumo.")
    ],
    config_path: Annotated[Path | None, typer.Option("--config", metavar="FILE", help="A .toml.")] = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    share: Annotated[
        float | None, typer.Option(help="Of the cars, where a key is varied.", show_default="0.25")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Runs of each.")] = 10,
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="The period that counts.")] = 600.0,
    warm_up: Annotated[
        str, typer.Option("--warm-up", metavar="SECONDS|auto", help="What is driven before and does not count.")
    ] = "auto",
    out: Annotated[Path, typer.Option(help="Folder for runs, tables and figures.")] = Path("runs/sweep"),
    fcd: Annotated[bool, typer.Option("--fcd", help="Also SUMO's floating-car data of every run.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the differences from share 0 as JSON.")] = False,
    workers: LocalWorkers = "",
) -> None:
    """Tell what happens on a road as the share of driven cars grows; what is in the folder is not driven again."""
    from rail_sumo import roster
    from rail_sumo.studies import share_run, sweep_report
    from rail_sumo.studies import sweep as study

    n_workers = workers_of(workers)
    if n_workers == "ray":
        raise InputError("sweep drives on this machine and takes a number of --workers, not ray")
    is_share = what == sweep_report.SHARE
    if is_share and share is not None:
        raise InputError("shares are what is varied; leave out --share")
    if not is_share and "." not in what:
        raise InputError(f"varied is share, or a key of the configuration such as traffic.scale; got '{what}'")
    choice = choice_of(network, routes, overrides)
    world = config_file.load(config_path, choice.overrides)
    roster.require_heeded([name for name in driver if name != study.ACC], world, choice.overrides)
    swept = study.Sweep(
        world,
        tuple(driver),
        study.shares_of(values) if is_share else (0.25 if share is None else share,),
        out,
        key=what,
        settings=("",) if is_share else tuple(values),
        seeds=seeds,
        duration_s=duration,
        warm_up_s=_warm_up_s(warm_up),
        fcd=fcd,
        workers=n_workers,
        command=typed(),
        road=network or "",
        known=choice.notes,
    )
    try:
        with progress_bars() as bars:
            tables = replace(swept, observer=bars).drive()
    except KeyboardInterrupt as interrupt:
        some = interrupt.seeds if isinstance(interrupt, study.Interrupted) else 0
        told = f" (tables of {some} of {seeds} seeds are in {out})" if some else ""
        print(f"rail-sumo: interrupted; the same command goes on{told}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    if as_json:
        print(tables.differences.to_json(orient="records", indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else 120, emoji=False)
    console.print(sweep_report.shown(tables, width=console.width))
    written = "tables, figures and sweep.md" if (out / study.FIGURES).is_dir() else "tables and sweep.md"
    print(f"{written} in {out}")
    if fcd:
        print(f"floating-car data in {out / share_run.FCD}; watch one: rail-sumo replay FILE --network NETWORK")


def _warm_up_s(text: str) -> float | None:
    try:
        return None if text == "auto" else float(text)
    except ValueError:
        raise InputError(f"--warm-up takes seconds, or auto; got '{text}'") from None
