"""A .sumocfg: what it says of network, demand and time, in the configuration's own keys."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rail_sumo.errors import InputError
from rail_sumo.highway.network.sumo_xml import UNKNOWN_ENCODING, UNREADABLE, opened, seconds

SUFFIX = ".sumocfg"

READ = {
    "net-file": ("n", "net"),
    "route-files": ("r", "routes"),
    "additional-files": ("a", "additional"),
    "begin": ("b",),
}
"""The options that are read, each with SUMO's other names for it."""
_NAMES = {name: option for option, others in READ.items() for name in (option, *others)}


def read(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Return the keys of a configuration that a file sets, with their values, and the options it has beside them.

    File names in it are relative to its own folder, as they are to SUMO.

    Raises:
        InputError: it cannot be read, names no network, or begins at what is no time.
    """
    try:
        with opened(path) as stream:
            given = dict(_options(ElementTree.parse(stream).getroot()))
    except (*UNREADABLE, *UNKNOWN_ENCODING) as error:
        raise InputError(f"cannot read '{path}': {getattr(error, 'strerror', None) or error}") from None
    options = {_NAMES[name]: value for name, value in given.items() if name in _NAMES}
    if "net-file" not in options:
        raise InputError(f"'{path}' names no net-file; rail-sumo needs a network to drive on")
    keys: dict[str, Any] = {"network.file": str(path.parent / options["net-file"])}
    for option, key in (("route-files", "traffic.routes"), ("additional-files", "traffic.additional")):
        if option in options:
            names = filter(None, map(str.strip, options[option].split(",")))
            keys[key] = [str(path.parent / name) for name in names]
    if "begin" in options:
        try:
            keys["traffic.begin_s"] = seconds(options["begin"])
        except ValueError:
            raise InputError(f"'{path}' begins at '{options['begin']}', which is no time") from None
    return keys, [name for name in given if name not in _NAMES]


def _options(root: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield the options that are set, by name."""
    for element in root.iter():
        value = (element.get("value") or element.get("v") or element.text or "").strip()
        if value:
            yield element.tag, value
