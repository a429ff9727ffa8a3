"""What the options of a command say of the world, a configuration of SUMO's among them."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rail_sumo import config_file
from rail_sumo.cli.options import tell
from rail_sumo.highway.network.sumo_xml import is_configuration
from rail_sumo.records import SECONDS_PER_STEP


class Choice(NamedTuple):
    """What options choose."""

    overrides: list[str]
    """As overrides of the configuration."""
    notes: tuple[str, ...] = ()
    """What of a configuration of SUMO's does not hold. It has been told, and is worth keeping beside tables."""


def choice_of(network: str | None, routes: list[str] | None, overrides: list[str] | None) -> Choice:
    """Return the world that --network, --routes and --set choose, and tell what is worth knowing of it."""
    world: dict[str, Any] = {}
    notes: tuple[str, ...] = ()
    if network and is_configuration(Path(network)):
        world, notes = _configured(network, _given(routes, overrides))
    elif network:
        world = {"network.file": network}
    if routes:
        world["traffic.routes"] = routes
    if world:
        world["varied.networks"] = []  # it is this one
    # Values in JSON are values in TOML, but for escapes beyond 16 bits.
    lines = [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in world.items()]
    return Choice([*lines, *(overrides or ())], notes)


def network_of(network: str) -> str:
    """Return the network that an option names: that of a configuration of SUMO's, or what it says."""
    if not is_configuration(Path(network)):
        return network
    from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

    return sumocfg.read(Path(network))[0]["network.file"]


def _given(routes: list[str] | None, overrides: list[str] | None) -> dict[str, Any]:
    """Return the keys that are set on the command line, with what they are set to."""
    own = {config_file.key_of(one): config_file.value_of(one) for one in overrides or ()}
    return ({"traffic.routes": routes} if routes else {}) | own


def _configured(network: str, own: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the keys that a configuration of SUMO's sets, and what of it does not hold.

    Args:
        network: its name.
        own: what the command line sets in place of some of it.
    """
    from rail_sumo.highway.network import sumocfg  # SUMO takes half a second to import

    world, left_out = sumocfg.read(Path(network))
    sumocfg.require_files(Path(network), {key: value for key, value in world.items() if key not in own})
    unused, replaced = tuple(_unused(network, left_out)), tuple(_replaced(network, world, own))
    for line in (*unused, *replaced):
        tell(line)
    if {"traffic.routes", "traffic.additional"}.isdisjoint(own.keys() | world.keys()):
        tell(f"'{network}' names no route-files: traffic is made around the host")
    return world, (*(f"rail-sumo {line}" for line in unused), *replaced)


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


def _replaced(network: str, world: Mapping[str, Any], own: Mapping[str, Any]) -> Iterator[str]:
    """Tell what of a configuration of SUMO's does not hold, since the command line names something in its place."""
    for key in sorted(own.keys() & world.keys()):
        if not isinstance(world[key], list):
            continue
        kept = {Path(one).name for one in own[key]}
        lost = [one for one in world[key] if Path(one).name not in kept]
        if lost:
            yield (
                f"{key} on the command line takes the place of what '{network}' says, and without effect is "
                f"{', '.join(lost)}; to keep that, name it too"
            )
