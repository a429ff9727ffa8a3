"""The commands that drive: eval and replay."""

import math
import shutil
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rail_sumo import files
from rail_sumo.cli.apps import INTERRUPTED, app
from rail_sumo.cli.options import (
    POLICY,
    NetworkFile,
    Overrides,
    Overwrite,
    Routes,
    Seed,
    Workers,
    WorldFile,
    require_page,
    tell,
    typed,
    workers_of,
)
from rail_sumo.cli.progress import progress_bars, show
from rail_sumo.cli.world import choice_of, network_of
from rail_sumo.errors import InputError

if TYPE_CHECKING:
    from rail_sumo.config import Config
    from rail_sumo.rollout import Who
    from rail_sumo.run import Tables

FCD, REPLAYS = "fcd", "replays"
"""The folders of the floating-car data, and of pages to watch, beside the tables."""
FCD_SUFFIXES = (".parquet", ".csv", ".xml", ".gz")


@app.command("eval", rich_help_panel="Drive")
def evaluate(
    policies: Annotated[list[str], typer.Argument(metavar="POLICY...", help=POLICY)],
    config_path: WorldFile = None,
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
        str | None,
        typer.Option(
            metavar="POLICY",
            help="The policy that ratios refer to.",
            show_default="expert or road-expert, else the last",
        ),
    ] = None,
) -> None:
    """Drive policies through the same held-out traffic and compare them.

    The world is that of --config, of the first run directory among the policies, or the default; options change it.
    """
    from rail_sumo import replay, roster, run

    _require_place(out, {"--fcd": (FCD, fcd), "--replay": (REPLAYS, bool(replays))}, overwrite=overwrite)
    n_workers = workers_of(workers)
    choice = choice_of(network, routes, overrides)
    world, who, doubts = _found(policies, choice.overrides, config_path)

    def keep(tables: "Tables", whole: Path, **more: Any) -> None:
        notes = [*choice.notes, *doubts, *bars.notes]
        _keep(tables, whole, world, who, notes, seed=seed, episodes=episodes, **more)

    try:
        place = files.whole_folder(out, overwrite=overwrite) if out and fcd else nullcontext()
        with progress_bars() as bars, place as whole:
            tables = run.evaluate(
                who,
                world,
                episodes=episodes,
                seed=seed,
                workers=n_workers,
                observer=bars,
                fcd=whole / FCD if whole else None,
                reference=reference,
            )
            if whole:
                keep(tables, whole)
    except run.Interrupted as stop:
        after = f"after {len(stop.tables.episodes)} of {stop.episodes} episodes"
        if out:
            with files.whole_folder(out, overwrite=overwrite) as whole:
                keep(stop.tables, whole, interrupted=after)
            _forget(out, FCD, REPLAYS)
        show(stop.tables, out)
        print(f"rail-sumo: interrupted {after}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    # Written only after driving: what stops that leaves nothing behind, and is not told as a failure to write.
    if out and not fcd:
        with files.whole_folder(out, overwrite=overwrite) as whole:
            keep(tables, whole)
    show(tables, out)
    if out and fcd:
        print(f"floating-car data in {out / FCD}")
    if out and replays:
        _forget(out, REPLAYS)
        judges = roster.judges_of(policies)
        try:
            with files.whole_folder(out / REPLAYS) as whole:
                replay.write_most_telling(tables.episodes, who, judges, world, whole, seed=seed, number=replays)
        except KeyboardInterrupt:
            print(f"rail-sumo: interrupted; the tables are in {out}, without pages to watch", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None
        print(f"pages to watch in {out / REPLAYS}")


def _keep(
    tables: "Tables", whole: Path, world: "Config", who: "Mapping[str, Who]", notes: list[str], **more: Any
) -> None:
    """Write an evaluation's tables into a folder that is not whole yet, and beside them what made them."""
    from rail_sumo import origin, roster
    from rail_sumo.tables import report

    tables.save(whole)
    notes = [*notes, *report.cut_short(tables.episodes), *report.alike(tables.episodes)]
    learned = {policy: roster.content_of(policy, world) for policy in who}
    origin.describe(whole, world, typed(), notes=notes, drivers=learned, modes=roster.modes_of(who), **more)


def _require_place(out: Path | None, beside: Mapping[str, tuple[str, bool]], *, overwrite: bool) -> None:
    """Raise InputError if tables, or what is asked for beside them, have no place to go to.

    Args:
        out: the tables' folder, if they are kept.
        beside: by option, the folder of what it writes beside the tables, and whether it is asked for.
        overwrite: whether `out` may exist.
    """
    if out is None:
        for option, (_, is_asked) in beside.items():
            if is_asked:
                raise InputError(f"{option} writes into the folder of --out; name one")
        return
    files.check_folder(out, overwrite=overwrite, instead=", or replace its tables with --overwrite")
    for option, (folder, is_asked) in beside.items():
        if (out / folder).exists() and not is_asked:
            raise InputError(
                f"'{out / folder}' is of other drives than these; replace it by {option}, or choose another --out"
            )


def _forget(out: Path, *folders: str) -> None:
    """Remove what was written beside earlier tables, of other drives."""
    for folder in folders:
        shutil.rmtree(out / folder, ignore_errors=True)


@app.command(rich_help_panel="Drive")
def replay(
    what: Annotated[
        list[str],
        typer.Argument(metavar="POLICY...|FCD", help="One policy, two side by side, or floating-car data of SUMO's."),
    ],
    config_path: WorldFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
    seed: Seed = 0,
    episode: Annotated[int, typer.Option(min=0, help="Its number in an evaluation with this seed.")] = 0,
    begin: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FCD: what is earlier is left out.")] = None,
    end: Annotated[float | None, typer.Option(metavar="SECONDS", help="Of FCD: what is later is left out.")] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page.")] = Path("replay.html"),
    overwrite: Overwrite = False,
) -> None:
    """Watch an episode of an evaluation, or any SUMO run, in a browser: one file, which needs nothing else."""
    from rail_sumo import replay, roster

    require_page(out, "a replay")
    recordings = [one for one in what if Path(one).is_file()]
    if recordings and len(what) > 1:
        raise InputError(f"one file of floating-car data is shown at a time; got {', '.join(what)}")
    if recordings:
        if network is None:
            raise InputError("floating-car data do not hold the road; name their network by --network")
        if routes or overrides or config_path:
            raise InputError("floating-car data are shown as they are; leave out --config, --routes and --set")
        replay.write_fcd(
            Path(recordings[0]),
            network_of(network),
            out,
            begin_s=-math.inf if begin is None else begin,
            end_s=math.inf if end is None else end,
            overwrite=overwrite,
        )
    else:
        if begin is not None or end is not None:
            raise InputError("--begin and --end cut floating-car data; of an episode all is shown")
        _require_no_recordings(what)
        world, who, _ = _found(what, choice_of(network, routes, overrides).overrides, config_path)
        replay.write(who, world, out, seed=seed, episode=episode, judges=roster.judges_of(what), overwrite=overwrite)
    print(f"replay in {out}; open it in a browser")


def _require_no_recordings(policies: list[str]) -> None:
    """Raise InputError if what was named as a policy was meant as floating-car data."""
    from rail_sumo.run import PART

    for one in map(Path, policies):
        if one.suffix in FCD_SUFFIXES and not one.exists():
            raise InputError(f"floating-car data '{one}' do not exist (current folder: {Path.cwd()})")
        part = next(one.rglob(PART), None) if FCD in (one.name, *one.parent.parts) else None
        if part:
            raise InputError(f"'{one}' is a folder of floating-car data, a file an episode; name one, such as '{part}'")


def _found(
    policies: list[str], overrides: list[str], config_path: Path | None
) -> "tuple[Config, dict[str, Who], list[str]]":
    """Return the world to drive in, who drives, by the names given, and what those leave in doubt, which is told."""
    from rail_sumo import roster, training

    twice = {policy for policy in policies if policies.count(policy) > 1}
    if twice:
        raise InputError(f"each policy is driven once; named twice: {', '.join(sorted(twice))}")
    world = roster.world(policies, overrides, config=config_path)
    who = {policy: roster.find_driver(policy, world) for policy in policies}
    learned = roster.judges_of(policies).values()
    if config_path:
        unheeded = [*roster.unheeded_senses(who, world)]
    else:
        unheeded = [*roster.other_worlds(policies, world), *roster.borrowed_senses(who, policies, world)]
    doubts = [*unheeded, *roster.doubts(policies, world), *training.changed_since(learned, world)]
    doubts += roster.unlike_modes(who)
    for line in doubts:
        tell(line)
    return world, who, doubts
