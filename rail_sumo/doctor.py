"""What an installation has, what it lacks, and whether it drives."""

import os
import platform
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from rail_sumo import config_file
from rail_sumo.assets import own_version
from rail_sumo.errors import InputError
from rail_sumo.rollout import Task, drive

NEEDED = re.compile(r"""(?P<package>[\w.-]+)[^;]*(;.*extra == ['"](?P<extra>\w+)['"])?.*""")
"""A requirement in a package's metadata."""
TRIED_S = 20.0
"""How long the simulation is that is tried."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    what: str
    state: str
    advice: str = ""
    """What to do about it; empty if nothing is amiss."""
    is_needed: bool = True
    """Whether rail-sumo does not work without it."""


def examine() -> Iterator[Finding]:
    """Look at versions, dependencies and extras, and drive for a moment."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding(
        "rail-sumo", f"{own_version()}, Python {platform.python_version()}, {platform.system()}, {cores} cores"
    )
    yield from _packages()
    yield _drive()


def _packages() -> Iterator[Finding]:
    try:
        needed = [NEEDED.fullmatch(requirement) for requirement in requires("rail-sumo") or ()]
    except PackageNotFoundError:
        yield Finding("packages", "unknown: run from a checkout", "install it with: pip install .")
        return
    for found in filter(None, needed):
        package, extra = found["package"], found["extra"] or ""
        try:
            yield Finding(f"{package} ({extra})" if extra else package, version(package))
        except PackageNotFoundError:
            wanted = f"'rail-sumo[{extra}]'" if extra else "rail-sumo"
            yield Finding(
                f"{package} ({extra})" if extra else package,
                "not installed",
                f"pip install {wanted}",
                is_needed=not extra,
            )


def _drive() -> Finding:
    world = config_file.load(None, [f"episode.duration_s={TRIED_S}"])
    started = time.perf_counter()
    try:
        driven = drive(Task("rule", world, seed=0))
    except (InputError, OSError, RuntimeError) as error:
        return Finding("simulation", f"failed: {error}", "reinstall rail-sumo; if that does not help, report it")
    seconds = time.perf_counter() - started
    return Finding("simulation", f"drove {driven.distance_m:.0f} m in {TRIED_S:.0f} s, computed in {seconds:.2f} s")
