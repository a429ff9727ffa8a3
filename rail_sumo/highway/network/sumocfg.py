"""A configuration of SUMO's, read by SUMO itself: what it says, in our configuration's own keys.

Everything in it holds but what must be ours: how time goes on, what counts as a contact, what is written and shown.
"""

import os
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any
from urllib.parse import unquote

from rail_sumo.config import Traffic
from rail_sumo.errors import InputError
from rail_sumo.highway import sumo_process
from rail_sumo.highway.network.sumo_xml import UNREADABLE, elements, seconds
from rail_sumo.records import SECONDS_PER_STEP

INPUT_FILES = (
    *("net-file", "route-files", "additional-files", "weight-files", "load-state", "phemlight-path"),
    *("astar.all-distances", "astar.landmark-distances", "device.fcd-replay.files"),
)
"""Options that name files to be read."""
FILE_KEYS = ("network.file", "traffic.routes", "traffic.additional")
"""Those keys of ours whose values are files."""
FILE_KEYS_OF_DEMAND = frozenset(FILE_KEYS[1:])
"""Those of them that may put vehicles on the road."""

UNTOLD_TOPICS = frozenset({"report", "gui_only", "traci_server"})
"""Topics of SUMO's options that are about what is shown, and matter to no result."""
OUR_TOPICS = UNTOLD_TOPICS | {
    "output", "mesoscopic", "random_number", "ssm_device", "fcd_device", "tripinfo_device", "vehroutes_device",
}  # fmt: skip
"""These, and those about what is written and which random numbers are drawn."""

OUR_OPTIONS = re.compile(
    r"net-file|route-files|additional-files|configuration-file|begin|end|seed|random|step-length|step-method\.ballistic"
    r"|threads|lateral-resolution|lanechange\.duration|ignore-accidents|collision\..+|mesosim|remote-port|num-clients"
    r"|(.+[.-])?output(\..+)?|output-prefix|save-.+|netstate-dump.*|device\.(ssm|fcd|tripinfo|vehroutes)\..+"
    r"|device\.toc\.file"
)
"""Options of whatever topic that are ours, or that a configuration has keys of its own for."""
MOVING = frozenset({"step-length", "step-method.ballistic", "lateral-resolution", "lanechange.duration"})
"""Those of them by which SUMO's own vehicles drive otherwise."""
USED = {
    "step-length": SECONDS_PER_STEP,
    "step-method.ballistic": "false",
    "lateral-resolution": 0.0,
    "lanechange.duration": 0.0,
    "collision.mingap-factor": 0.0,
    "collision.check-junctions": "true",
    "random": "false",
    "threads": 1.0,
}
"""What some of them are here."""
UNSAID_STEP = "1 s by default"
"""How SUMO's `step-length` is told where a configuration does not set it: its traffic drives otherwise by ours."""


def read(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the keys of our configuration that a file of SUMO's sets, and the options left out, with their values.

    Of the latter only such as could matter to a result.

    File names in it are relative to its own folder, with `%20` for a space and `${NAME}` for an environment variable,
    as they are to SUMO.

    Raises:
        InputError: it cannot be read, has an option that SUMO does not know, names no network, or begins at no time.
    """
    topic_of, options = _resolved(path)
    if "net-file" not in options:
        raise InputError(f"'{path}' names no net-file; rail-sumo needs a network to drive on")
    keys: dict[str, Any] = {"network.file": options.pop("net-file")}
    for option, key in (("route-files", "traffic.routes"), ("additional-files", "traffic.additional")):
        if option in options:
            keys[key] = options.pop(option).split(",")
    begin = options.pop("begin", None)
    if begin is not None:
        try:
            keys["traffic.begin_s"] = seconds(begin)
        except ValueError:
            raise InputError(f"'{path}' begins at '{begin}', which is no time") from None
    keys |= _early_entry(keys.get("traffic.begin_s", 0.0), options.get("end", ""))
    if "step-length" not in options and not FILE_KEYS_OF_DEMAND.isdisjoint(keys):
        topic_of["step-length"], options["step-length"] = "time", UNSAID_STEP
    left_out = [option for option in options if is_ours(option, topic_of[option])]
    passed_on = {option: value for option, value in options.items() if option not in left_out}
    if passed_on:
        keys["traffic.options"] = [f"{option}={value}" for option, value in passed_on.items()]
    told = (option for option in left_out if topic_of[option] not in UNTOLD_TOPICS)
    return keys, {option: options[option] for option in told if not _is_as_ours(option, options[option])}


def _is_as_ours(option: str, value: str) -> bool:
    """Whether an option that is left out says what is done all the same."""
    used = USED.get(option)
    try:
        return value == used or seconds(value) == used
    except ValueError:
        return False


def require_files(path: Path, keys: Mapping[str, Any]) -> None:
    """Raise InputError if a file that a configuration of SUMO's names is not there.

    Args:
        path: the configuration.
        keys: those of ours that it sets, as of `read`, without what is not to be used.
    """
    for key in filter(keys.__contains__, FILE_KEYS):
        for file in [keys[key]] if isinstance(keys[key], str) else keys[key]:
            if not Path(file).exists():
                raise InputError(f"'{path}' names '{file}', which does not exist; correct it, or set {key} by --set")


def _early_entry(begin_s: float, end: str) -> dict[str, float]:
    """Return the keys that have the host enter well before a configuration ends, where it ends soon.

    Later its demand may jam: nobody ever looked.
    """
    try:
        lasts_s = seconds(end) - begin_s
    except ValueError:
        return {}
    usual = Traffic()
    warm_up_s = min(usual.warm_up_s, lasts_s / 4)
    enters_within_s = lasts_s - 2 * warm_up_s
    if not 0.0 < enters_within_s < usual.entry_within_s:  # it has no end, or a late one
        return {}
    return {"traffic.warm_up_s": warm_up_s, "traffic.entry_within_s": enters_within_s}


def is_ours(option: str, topic: str = "") -> bool:
    """Return whether an option of SUMO's, by its present name, is not the user's to set."""
    return topic in OUR_TOPICS or OUR_OPTIONS.fullmatch(option) is not None


def _resolved(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return the topics and the values of the options that are set, by their present names, as SUMO reads them."""
    tags = {element.tag for element in elements(path)}  # before SUMO, which takes its time over what looks like one
    if "configuration-file" in tags:
        raise InputError(f"'{path}' names another configuration (configuration-file); give that one to --network")
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "resolved.sumocfg"
        try:
            sumo_process.start({"configuration-file": path, "save-configuration": written})
            sumo_process.close()
            root = ElementTree.parse(written).getroot()
        except (sumo_process.Refused, *UNREADABLE) as error:
            raise InputError(f"cannot read '{path}': {getattr(error, 'strerror', None) or error}") from None
    topics = {option.tag: topic.tag for topic in root for option in topic}
    values = {option.tag: option.get("value", "") for topic in root for option in topic}
    values |= {
        name: _paths(values[name], path.parent, Path(folder).resolve()) for name in INPUT_FILES if name in values
    }
    return topics, {name: value for name, value in values.items() if value}


def _paths(value: str, folder: Path, seen_from: Path) -> str:
    """Return the paths of a list of files, with commas between them.

    Args:
        value: their names, as SUMO writes them.
        folder: the configuration's, which they are relative to.
        seen_from: the folder that SUMO writes them relative to.
    """
    paths: list[Path] = []
    for encoded in filter(None, value.split(",")):
        name = unquote(unquote(encoded)).replace("\\", "/")  # SUMO encodes once more what it writes from elsewhere
        if PureWindowsPath(name.strip()).is_absolute():
            paths.append(Path(name.strip()))  # another computer's, to be told as it stands there
            continue
        if not name.startswith("$"):
            name = os.path.relpath(seen_from / name, folder.resolve())
        name = os.path.expandvars(name).strip()
        parts = [folder / part for part in name.split()]
        are_several = not (folder / name).exists() and all(part.exists() for part in parts)
        paths += parts if are_several else [folder / name]
    return ",".join(str(path) for path in paths if path != folder)
