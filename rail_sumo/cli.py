"""The command line: parses, calls, prints."""

# Rollout workers import this module again, and `--help` is to be quick: what is slow to import (torch, pandas, SUMO)
# is imported by the command that needs it.
import json
import math
import os
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from rail_sumo import assets, config_file, files
from rail_sumo.errors import InputError
from rail_sumo.highway.network.sumo_xml import is_configuration

if TYPE_CHECKING:
    from rail_sumo.highway.network.road import Road
    from rail_sumo.run import Tables

app = typer.Typer(
    help="Learn a highway driver from demonstrations, and drive it in SUMO on your own roads.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
expert = typer.Typer(help="Train the expert; record demonstrations of any driver.", no_args_is_help=True)
network = typer.Typer(help="Look at networks before driving on them.", no_args_is_help=True)
app.add_typer(expert, name="expert")
app.add_typer(network, name="network")

ConfigFile = Annotated[Path | None, typer.Argument(metavar="CONFIG", help="A .toml. Without one, all defaults.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Change one key; repeatable.")
]
_NETWORK = "A .net.xml, a .sumocfg with its demand, or a shipped network's name."
NetworkFile = Annotated[str | None, typer.Option(metavar="FILE", help=_NETWORK)]
Routes = Annotated[list[str] | None, typer.Option(metavar="FILE", help="Your own demand; repeatable.")]
FCD, REPLAYS = "fcd", "replays"
"""The folders of the floating-car data, and of pages to watch, beside the tables."""
_POLICY = "A run, an expert's folder, or expert, rail, road-expert, road-rail, rule, sumo, sumo:TYPE, keep or random."
_SEED = "Everything random follows from it."
Seed = Annotated[int, typer.Option(min=0, help=_SEED)]
_WORKERS, _CORES = "Processes that drive.", "as many as cores"
Workers = Annotated[str, typer.Option(metavar="N|ray", help=_WORKERS, show_default=_CORES)]
LocalWorkers = Annotated[str, typer.Option(metavar="N", help=_WORKERS, show_default=_CORES)]
Mode = Annotated[
    Literal["default", "argmax", "sampled"], typer.Option(help="How learned policies act; by default as trained.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]


def main() -> None:
    """Run the command line. A user's mistake is one line on stderr and exit code 2."""
    try:
        app()
    except InputError as error:
        print(f"rail-sumo: {error}", file=sys.stderr)
        sys.exit(2)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rail-sumo {assets.own_version()} with SUMO {version('libsumo')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the versions and exit.")
    ] = False,
) -> None: ...


@app.command()
def train(
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Run directory.", show_default="runs/CONFIG-seedS")] = None,
    workers: Workers = "",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help=_SEED, show_default="0")] = None,
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
    chosen = config_file.load(config_path, overrides_of(network, routes, overrides))
    n_workers = _workers(workers)
    try:
        with _bars() as bars:
            observer = Events(bars, out) if events else bars
            tables = run.train(chosen, out, seed=seed or 0, workers=n_workers, resume=resume, observer=observer)
    except KeyboardInterrupt:
        hint = f"; go on with: rail-sumo train --out {shlex.quote(str(out))} --resume" if out.exists() else ""
        print(f"rail-sumo: interrupted{hint}", file=sys.stderr)
        raise typer.Exit(130) from None
    _show(tables, out)


@app.command("eval")
def evaluate(
    policies: Annotated[list[str], typer.Argument(metavar="POLICY...", help=_POLICY)],
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    episodes: Annotated[int, typer.Option(help="Episodes per policy, on the same traffic for all.")] = 16,
    seed: Seed = 0,
    workers: Workers = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the tables, as CSV and Parquet.")] = None,
    overwrite: Overwrite = False,
    fcd: Annotated[bool, typer.Option("--fcd", help="Also SUMO's floating-car data of every episode.")] = False,
    replays: Annotated[
        int, typer.Option("--replay", min=0, metavar="N", help="Also the N most telling episodes, as pages to watch.")
    ] = 0,
    reference: Annotated[
        str | None, typer.Option(metavar="POLICY", help="The policy that ratios refer to.", show_default="expert")
    ] = None,
    mode: Mode = "default",
) -> None:
    """Drive policies through the same held-out traffic and compare them.

    The world is that of the first run directory among the policies, or the default, changed by the options.
    """
    from rail_sumo import replay, run

    if out:
        files.check_folder(out, overwrite=overwrite, instead=", or replace its tables with --overwrite")
        for folder, option, is_asked in ((FCD, "--fcd", fcd), (REPLAYS, "--replay", replays)):
            if (out / folder).exists() and not is_asked:
                raise InputError(
                    f"'{out / folder}' is of other drives than these; replace it by {option}, or choose another --out"
                )
    elif fcd or replays:
        raise InputError(f"{'--fcd' if fcd else '--replay'} writes into the folder of --out; name one")
    if reference and reference not in policies:
        raise InputError(f"--reference {reference} is not among the policies: {', '.join(policies)}; name it there too")
    n_workers = _workers(workers)
    world = run.world(policies, overrides_of(network, routes, overrides))
    who = {policy: run.find_driver(policy, world, mode) for policy in policies}

    def keep(tables: "Tables", whole: Path, n_replays: int) -> None:
        tables.save(whole)
        run.describe(whole, world, shlex.join(["rail-sumo", *sys.argv[1:]]), seed=seed)
        if n_replays:
            replay.write_most_telling(tables.episodes, who, world, whole / REPLAYS, seed=seed, number=n_replays)

    try:
        with _bars() as bars:
            drive = partial(
                run.evaluate,
                who,
                world,
                episodes=episodes,
                seed=seed,
                workers=n_workers,
                observer=bars,
                reference=reference or "expert",
            )
            if out is None:
                tables = drive()
            elif fcd:
                with files.whole_folder(out, overwrite=overwrite) as whole:
                    tables = drive(fcd=whole / FCD)
                    keep(tables, whole, replays)
            else:
                tables = drive()
                with files.whole_folder(out, overwrite=overwrite) as whole:
                    keep(tables, whole, replays)
    except run.Interrupted as stop:
        if out:
            with files.whole_folder(out, overwrite=overwrite) as whole:
                keep(stop.tables, whole, 0)
        _show(stop.tables, out)
        print(f"rail-sumo: interrupted after {len(stop.tables.episodes)} of {stop.episodes} episodes", file=sys.stderr)
        raise typer.Exit(130) from None
    _show(tables, out)


@app.command()
def replay(
    what: Annotated[
        list[str],
        typer.Argument(metavar="POLICY...|FCD", help="One policy, two side by side, or floating-car data of SUMO's."),
    ],
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    seed: Seed = 0,
    episode: Annotated[int, typer.Option(min=0, help="Its number in an evaluation with this seed.")] = 0,
    mode: Mode = "default",
    begin: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FCD: what is earlier is left out.")] = None,
    end: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FCD: what is later is left out.")] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page.")] = Path("replay.html"),
    overwrite: Overwrite = False,
) -> None:
    """Watch an episode of an evaluation, or any SUMO run, in a browser: one file, which needs nothing else."""
    from rail_sumo import replay, run

    if out.suffix != ".html":
        raise InputError(f"a replay is a page, FILE.html; got '{out}'")
    if len(what) == 1 and Path(what[0]).is_file():
        if network is None:
            raise InputError("floating-car data do not hold the road; name their network by --network")
        if routes or overrides:
            raise InputError("floating-car data are shown as they are; leave out --routes and --set")
        replay.write_fcd(
            Path(what[0]),
            network,
            out,
            begin_s=-math.inf if begin is None else begin,
            end_s=math.inf if end is None else end,
            overwrite=overwrite,
        )
    else:
        if begin is not None or end is not None:
            raise InputError("--begin and --end cut floating-car data; of an episode all is shown")
        world = run.world(what, overrides_of(network, routes, overrides))
        who = {policy: run.find_driver(policy, world, mode) for policy in what}
        replay.write(who, world, out, seed=seed, episode=episode, overwrite=overwrite)
    print(f"replay in {out}; open it in a browser")


@app.command()
def report(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER...", help="What train, eval, sweep or reproduce has written.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page.")] = Path("report.html"),
    overwrite: Overwrite = False,
) -> None:
    """Put all that is known of runs, evaluations, sweeps or studies on one page, with pictures; one file."""
    from rail_sumo.pictures import report_page

    if out.suffix != ".html":
        raise InputError(f"a report is a page, FILE.html; got '{out}'")
    report_page.write(folders, out, overwrite=overwrite)
    print(f"report in {out}; open it in a browser")


@app.command()
def plot(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories, finished or under way.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The picture: .png, .svg or .pdf.")] = Path("curves.png"),
    against: Annotated[Literal["steps", "time"], typer.Option(help="What runs from left to right.")] = "steps",
    overwrite: Overwrite = False,
) -> None:
    """Draw how training went; runs that differ by the number at the end of their names become one curve with a band."""
    from rail_sumo.pictures import plot

    plot.save(plot.learning_curves(runs, against), out, overwrite=overwrite)
    print(f"learning curves in {out}")


@app.command()
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

    chosen = config_file.load(config_path, overrides_of(network, routes, overrides))
    if cells and (seeds is not None or quick or workers):
        raise InputError("--cells makes tables of what was driven before: leave out --seeds, --quick and --workers")
    n_seeds = (2 if quick else 10) if seeds is None else seeds
    n_workers = _workers(workers)
    systems = reproduce.chosen(only)
    try:
        with _bars() as bars:
            experiment = Experiment(chosen, out, n_seeds, episodes, quick=quick, workers=n_workers, observer=bars)
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
        raise typer.Exit(130) from None
    if what == "table1":
        print((out / "table1.md").read_text(encoding="utf-8"), end="")
    print(f"{what} in {out}")


@app.command()
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
    as_json: Annotated[bool, typer.Option("--json", help="Print the differences from share 0 as JSON.")] = False,
    workers: LocalWorkers = "",
) -> None:
    """Tell what happens on a road as the share of driven cars grows; what is in the folder is not driven again."""
    from rail_sumo.studies import sweep as study

    n_workers = _workers(workers)
    if n_workers == "ray":
        raise InputError("sweep drives on this machine and takes a number of --workers, not ray")
    is_share = what == study.SHARE
    if is_share and share is not None:
        raise InputError("shares are what is varied; leave out --share")
    if not is_share and "." not in what:
        raise InputError(f"varied is share, or a key of the configuration such as traffic.scale; got '{what}'")
    swept = study.Sweep(
        config_file.load(config_path, overrides_of(network, routes, overrides)),
        tuple(driver),
        study.shares_of(values) if is_share else (0.25 if share is None else share,),
        out,
        key=what,
        settings=("",) if is_share else tuple(values),
        seeds=seeds,
        duration_s=duration,
        warm_up_s=_warm_up_s(warm_up),
        workers=n_workers,
    )
    try:
        with _bars() as bars:
            tables = replace(swept, observer=bars).drive()
    except KeyboardInterrupt:
        print("rail-sumo: interrupted; the same command goes on", file=sys.stderr)
        raise typer.Exit(130) from None
    if as_json:
        print(tables.differences.to_json(orient="records", indent=2))
        return
    Console(width=None if sys.stdout.isatty() else 120).print(study.shown(swept, tables))
    print(f"tables, figures and sweep.md in {out}")


def _warm_up_s(text: str) -> float | None:
    try:
        return None if text == "auto" else float(text)
    except ValueError:
        raise InputError(f"--warm-up takes seconds, or auto; got '{text}'") from None


@app.command("config")
def show_config(
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
) -> None:
    """Print every key with what it means and its value, as TOML; a file to start from."""
    from rail_sumo import training

    chosen = config_file.load(config_path, overrides_of(network, routes, overrides))
    training.learner_of(chosen)  # or there is none of that name
    print(config_file.explained(chosen), end="")


@app.command("doctor")
def examine() -> None:
    """Tell versions and what is missing, drive for a moment, and say what to do about what is amiss."""
    from rail_sumo import doctor

    is_ill = False
    for found in doctor.examine():
        print(f"{found.what:32} {found.state}{f'  -> {found.advice}' if found.advice else ''}")
        is_ill |= bool(found.advice) and found.is_needed
    if is_ill:
        raise typer.Exit(1)


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
    n_workers = _workers(workers)
    world = config_file.load(config_path, overrides_of(network, routes, overrides))
    with _bars() as observer:
        tables = expert.train(world, out, seed=seed, workers=n_workers, observer=observer)
    _show(tables, out)


@expert.command()
def record(
    out: Annotated[Path, typer.Option(metavar="FILE.parquet", help="Where the demonstrations go.")],
    config_path: ConfigFile = None,
    driver: Annotated[str, typer.Option(metavar="NAME", help=_POLICY)] = "expert",
    episodes: Annotated[int, typer.Option(help="Episodes to record.")] = 40,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    seed: Seed = 0,
    workers: Workers = "",
    overwrite: Overwrite = False,
) -> None:
    """Record what a driver sees and carries out, for `train.demonstrations` to learn from."""
    from rail_sumo import run

    world = config_file.load(config_path, overrides_of(network, routes, overrides))
    n_workers = _workers(workers)
    with _bars() as observer:
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


@network.command()
def check(
    file: Annotated[str, typer.Argument(help=_NETWORK)],
    routes: Routes = None,
    overrides: Overrides = None,
    as_json: Annotated[bool, typer.Option("--json", help="All edges and findings, as JSON.")] = False,
) -> None:
    """Tell where on a network rail-sumo would drive, and what may go wrong there."""
    from rail_sumo.highway import trial

    found = trial.check(config_file.load(None, overrides_of(file, routes, overrides)))
    if as_json:
        print(json.dumps(found.as_json, indent=2))
        return
    print(_describe(found.road))
    print(f"edges: {_shortened([edge.id for edge in found.road.edges])}")
    low, high = found.limits_kmh
    print(f"limit: {low} km/h" if low == high else f"limits: {low} to {high} km/h")
    if found.n_signals:
        print(f"traffic lights: {found.n_signals}")
    if found.ending_lanes:
        print(f"lanes end on: {_shortened(list(found.ending_lanes))}; the host leaves them in time")
    if found.host:
        print(f"host of the first episode: '{found.host}' of the demand, from {found.enters_s:.0f} s on")
    if found.flows_vehph:
        least, most = (f"{limit(found.flows_vehph.values()):,.0f}" for limit in (min, max))
        print(f"traffic in the host's first minute: {least} to {most} vehicles per hour, by the edge of its course")
    for warning in found.warnings:
        print(f"warning: {warning}")


@network.command("list")
def list_networks() -> None:
    """List the networks that come with rail-sumo."""
    from rail_sumo.highway.network import road

    for name in assets.network_names():
        print(_describe(road.load(name)))


def overrides_of(network: str | None, routes: list[str] | None, overrides: list[str] | None) -> list[str]:
    """Return the options that choose a world as overrides of the configuration."""
    world: dict[str, Any] = {}
    if network and is_configuration(Path(network)):
        from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

        world, left_out = sumocfg.read(Path(network))
        if left_out:
            print(f"rail-sumo: sets these options of '{network}' itself: {', '.join(left_out)}", file=sys.stderr)
    elif network:
        world = {"network.file": network}
    if routes:
        world["traffic.routes"] = routes
    if world:
        world["varied.networks"] = []  # it is this one
    # Values in JSON are values in TOML, but for escapes beyond 16 bits.
    return [*(f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in world.items()), *(overrides or ())]


def _describe(road: "Road") -> str:
    lanes = [edge.n_lanes for edge in road.edges]
    count = f"{min(lanes)} to {max(lanes)}" if min(lanes) < max(lanes) else f"{max(lanes)}"
    lanes_word = "lane" if count == "1" else "lanes"
    return f"{road.name}: {'loop' if road.is_loop else 'road'} of {road.length_m:,.0f} m with {count} {lanes_word}"


def _shortened(edges: list[str]) -> str:
    return ", ".join(edges if len(edges) <= 8 else [*edges[:4], f"({len(edges) - 8} more)", *edges[-4:]])


def _workers(text: str) -> int | Literal["ray"]:
    if text == "ray":
        return "ray"
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"--workers takes a number of processes from 1 up, or ray; got '{text}'")
    return int(text)


# What a bar tells of the part just done, where that is known. With all of it the bar fits into 80 columns.
_FIGURES = (
    "reward {mean_return:+.2f}",
    "judge {judge_expert_mean:.2f}/{judge_learner_mean:.2f}",
    "{speed_kmh:.1f} km/h",
    "{lane_changes:.1f} changes",
)


LINE_EVERY_S = 60.0
"""Where nobody watches a terminal, a line tells so often how far work is."""


class _Bars:
    """A `run.Observer` that draws a bar for each piece of work; where there is no terminal, a line now and then."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task = TaskID(0)
        self._told_at = time.monotonic()

    def start(self, work: str, total: int, done: int = 0) -> None:
        self._task = self._progress.add_task(work, total=total, completed=done, figures="")

    def advance(self, figures: Mapping[str, float]) -> None:
        told = []
        for form in _FIGURES:
            with suppress(KeyError):
                told.append(form.format_map(figures))
        self._progress.update(self._task, advance=1, figures=" ".join(told))
        if self._progress.disable and time.monotonic() - self._told_at >= LINE_EVERY_S:
            self._told_at = time.monotonic()
            task = self._progress.tasks[self._task]
            self.note(", ".join([f"{task.description}: {task.completed:.0f} of {task.total:.0f} done", *told]))

    def note(self, text: str) -> None:
        self._progress.console.print(f"rail-sumo: {text}", soft_wrap=True, markup=False, highlight=False)


@contextmanager
def _bars() -> Iterator[_Bars]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=8),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        yield _Bars(progress)


def _show(tables: "Tables", out: Path | None) -> None:
    from rail_sumo.tables import report

    console = Console() if sys.stdout.isatty() else Console(width=100)
    console.print(report.table(tables.summary, width=console.width))
    if out:
        console.print(f"tables in {escape(str(out))}", soft_wrap=True)
