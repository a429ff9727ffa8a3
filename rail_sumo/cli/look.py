"""The commands that look at what there is: pictures, configurations, networks, this machine."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rail_sumo import assets, config_file
from rail_sumo.cli.apps import app, network
from rail_sumo.cli.options import (
    NETWORK,
    ConfigFile,
    NetworkFile,
    Overrides,
    Overwrite,
    Routes,
    Seed,
    require_page,
    tell,
)
from rail_sumo.cli.world import choice_of

if TYPE_CHECKING:
    from rail_sumo.highway.network.road import Road


@app.command(rich_help_panel="Look")
def report(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER...", help="What train, eval, sweep or reproduce has written.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page.")] = Path("report.html"),
    overwrite: Overwrite = False,
) -> None:
    """Put all that is known of runs, evaluations, sweeps or studies on one page, with pictures; one file."""
    from rail_sumo.pictures import report_page

    require_page(out, "a report")
    report_page.write(folders, out, overwrite=overwrite)
    print(f"report in {out}; open it in a browser")


@app.command(rich_help_panel="Look")
def plot(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories, finished or under way.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The picture: .png, .svg or .pdf.")] = Path("curves.png"),
    against: Annotated[Literal["steps", "time"], typer.Option(help="What runs from left to right.")] = "steps",
    overwrite: Overwrite = False,
) -> None:
    """Draw how training went; runs that differ by the number in their names and their seed alone become one curve."""
    from rail_sumo.pictures import plot

    for line in plot.apart(runs):
        tell(line)
    plot.save(plot.learning_curves(runs, against), out, overwrite=overwrite)
    print(f"learning curves in {out}")


@app.command("config", rich_help_panel="Look")
def show_config(
    config_path: ConfigFile = None,
    network: NetworkFile = None,
    routes: Routes = None,
    overrides: Overrides = None,
) -> None:
    """Print every key with what it means and its value, as TOML; a file to start from."""
    from rail_sumo import learners

    chosen = config_file.load(config_path, choice_of(network, routes, overrides).overrides)
    learners.learner_of(chosen)  # or there is none of that name
    print(config_file.explained(chosen), end="")


@app.command("doctor", rich_help_panel="Look")
def examine() -> None:
    """Tell versions and what is missing, drive for a moment, and say what to do about what is amiss."""
    from rail_sumo import doctor

    findings = []
    for found in doctor.examine():
        print(f"{found.what:32} {found.state}{f'  -> {found.advice}' if found.advice else ''}")
        findings.append(found)
    amiss = [found for found in findings if found.advice]
    if any(found.is_needed for found in amiss):
        raise typer.Exit(1)
    print(f"Nothing is amiss{'; what is not installed is for extras alone' if amiss else ''}.")


@network.command()
def check(
    file: Annotated[str, typer.Argument(help=NETWORK)],
    routes: Routes = None,
    overrides: Overrides = None,
    seed: Seed = 0,
    as_json: Annotated[bool, typer.Option("--json", help="All edges and findings, as JSON.")] = False,
) -> None:
    """Tell where on a network rail-sumo would drive, and what may go wrong there."""
    from rail_sumo.highway import trial
    from rail_sumo.rollout import EVALUATION, traffic_seed

    world = config_file.load(None, choice_of(file, routes, overrides).overrides)
    found = trial.check(world, seed=traffic_seed(seed, EVALUATION, 0))
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
        ending = _shortened(list(found.ending_lanes))
        print(f"lanes end on: {ending}; the host has to leave them, and stands at the end where it finds no gap")
    if found.host:
        print(f"host of the first episode: '{found.host}' of the demand, from {found.enters_s:.0f} s on")
    if found.flows_vehph:
        least, most = (f"{limit(found.flows_vehph.values()):,.0f}" for limit in (min, max))
        flows = least if least == most else f"{least} to {most}"
        print(
            f"traffic in the host's first {found.watched_s:.0f} s: {flows} vehicles per hour on the edges of its course"
        )
    for warning in found.warnings:
        print(f"warning: {warning}")


@network.command("list")
def list_networks() -> None:
    """List the networks that come with rail-sumo."""
    from rail_sumo.highway.network import road

    for name in assets.network_names():
        print(_describe(road.load(name)))


def _describe(road: "Road") -> str:
    lanes = [edge.n_lanes for edge in road.edges]
    count = f"{min(lanes)} to {max(lanes)}" if min(lanes) < max(lanes) else f"{max(lanes)}"
    lanes_word = "lane" if count == "1" else "lanes"
    return f"{road.name}: {'loop' if road.is_loop else 'road'} of {road.length_m:,.0f} m with {count} {lanes_word}"


def _shortened(edges: list[str]) -> str:
    return ", ".join(edges if len(edges) <= 8 else [*edges[:4], f"({len(edges) - 8} more)", *edges[-4:]])
