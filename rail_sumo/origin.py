"""What tables and drivers are kept with: what was typed, the files read, the versions."""

import json
import math
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rail_sumo import assets, training
from rail_sumo.config import Config
from rail_sumo.config_file import dumps, dumps_world
from rail_sumo.files import whole_file
from rail_sumo.tables import report


def describe(
    folder: Path, world: Config, command: str, *, notes: Sequence[str] = (), trains: bool = False, **more: Any
) -> None:
    """Write beside tables what made them: the command, the world, the SHA-256 of its files, and the versions.

    Args:
        folder: of the tables.
        world: where was driven.
        command: what was typed.
        notes: what to know of the tables.
        trains: whether drivers were trained for them, so that the sections about learning matter too.
        more: what else there is to tell, by name, or in place of these: more `files`.
    """
    noted = {"notes": list(notes)} if notes else {}
    about = {"command": command, "files": training.world_inputs(world), **more, **noted, **_versions()}
    for name, text in (
        (report.WORLD, (dumps if trains else dumps_world)(training.located(world))),
        (report.ORIGIN, json.dumps(about, indent=2) + "\n"),
    ):
        with whole_file(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")


def manifest(
    folder: Path, means: Mapping[str, float], seed: int, inputs: Mapping[str, str], notes: Sequence[str] = ()
) -> str:
    """Return what tells how a driver's folder was made, as JSON.

    Args:
        folder: its files, whose SHA-256 it holds.
        means: of the evaluation, by metric.
        seed: of everything random.
        inputs: the SHA-256 of the files that it follows from, by the keys that name them.
        notes: what to know of its tables.
    """
    kept = [path for path in sorted(folder.iterdir()) if path.is_file() and path.name != assets.MANIFEST]
    written = {
        **({"notes": list(notes)} if notes else {}),
        "inputs": {key: checksum for key, checksum in inputs.items() if checksum},
        "files": {path.name: assets.sha256(path) for path in kept},
        "seed": seed,
        **_versions(),
        "evaluation": {metric: round(mean, 3) for metric, mean in means.items() if math.isfinite(mean)},
    }
    return json.dumps(written, indent=2) + "\n"


def _versions() -> dict[str, str]:
    others = {name: version(name) for name in ("libsumo", "numpy", "torch")}
    return {"rail-sumo": assets.own_version(), "python": platform.python_version(), **others}
