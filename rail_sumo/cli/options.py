"""Options that several commands have, and what they say of the world."""

import json
import os
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rail_sumo import config_file
from rail_sumo.errors import InputError
from rail_sumo.highway.network.sumo_xml import is_configuration
from rail_sumo.records import SECONDS_PER_STEP

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


def overrides_of(network: str | None, routes: list[str] | None, overrides: list[str] | None) -> list[str]:
    """Return the options that choose a world as overrides of the configuration."""
    world: dict[str, Any] = {}
    if network and is_configuration(Path(network)):
        from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

        own = _given(routes, overrides)
        world, left_out = sumocfg.read(Path(network))
        sumocfg.require_files(Path(network), {key: value for key, value in world.items() if key not in own})
        for line in (*_unused(network, left_out), *_replaced(network, world, own)):
            tell(line)
        if {"traffic.routes", "traffic.additional"}.isdisjoint(own.keys() | world.keys()):
            tell(f"'{network}' names no route-files: traffic is made around the host")
    elif network:
        world = {"network.file": network}
    if routes:
        world["traffic.routes"] = routes
    if world:
        world["varied.networks"] = []  # it is this one
    # Values in JSON are values in TOML, but for escapes beyond 16 bits.
    return [*(f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in world.items()), *(overrides or ())]


def notes_of(network: str | None, routes: list[str] | None, overrides: list[str] | None) -> tuple[str, ...]:
    """Return what to know of a configuration of SUMO's: what of it is not used, if anything."""
    if not network or not is_configuration(Path(network)):
        return ()
    from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

    world, left_out = sumocfg.read(Path(network))
    unused = (f"rail-sumo {line}" for line in _unused(network, left_out))
    return (*unused, *_replaced(network, world, _given(routes, overrides)))


def _given(routes: list[str] | None, overrides: list[str] | None) -> dict[str, str]:
    """Return the keys that are set on the command line, with what they are set to, as it is written."""
    own = {config_file.key_of(one): one.partition("=")[2] for one in overrides or ()}
    return ({"traffic.routes": json.dumps(routes, ensure_ascii=False)} if routes else {}) | own


def _unused(network: str, left_out: Mapping[str, str]) -> Iterator[str]:
    """Tell which options of a configuration of SUMO's are ours to set."""
    from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

    if not left_out:
        return
    options = ", ".join(option if "/" in value else f"{option} {value}" for option, value in left_out.items())
    steps = f"; steps take {SECONDS_PER_STEP:g} s" if "step-length" in left_out else ""
    moves = bool(sumocfg.MOVING & left_out.keys())
    differs = "; traffic here may differ from that of your own runs with them, see docs/roads.md" if moves else ""
    yield f"does not use these options of '{network}', and sets them itself: {options}{steps}{differs}"


def _replaced(network: str, world: Mapping[str, Any], own: Mapping[str, str]) -> Iterator[str]:
    """Tell what of a configuration of SUMO's does not hold, since the command line names something in its place."""
    for key in sorted(own.keys() & world.keys()):
        lost = [one for one in world[key] if Path(one).name not in own[key]] if isinstance(world[key], list) else []
        if lost:
            yield (
                f"{key} on the command line takes the place of what '{network}' says, and without effect is "
                f"{', '.join(lost)}; to keep that, name it too"
            )


def tell(what: str) -> None:
    """Print what is worth knowing, and stops nothing."""
    print(f"rail-sumo: {what}", file=sys.stderr)


def network_of(network: str) -> str:
    """Return the network that an option names: that of a configuration of SUMO's, or what it says."""
    if not is_configuration(Path(network)):
        return network
    from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

    return sumocfg.read(Path(network))[0]["network.file"]


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
