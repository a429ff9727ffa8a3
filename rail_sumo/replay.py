"""Watch: episodes driven once more with a camera, or any SUMO run's floating-car data, as a page to open."""

import math
import re
from collections.abc import Iterable, Mapping
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np
import pandas as pd

from rail_sumo import assets, learners, rollout, roster
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.files import check_file
from rail_sumo.highway.network import ground
from rail_sumo.pictures import fcd, page
from rail_sumo.records import Trajectory
from rail_sumo.rollout import EVALUATION, Task, Who, traffic_seed
from rail_sumo.run_directory import RunDirectory

NO_JUDGES: Mapping[str, RunDirectory] = {}
SIDE_BY_SIDE = 2
"""How many drivers a page shows at most."""


def write(
    policies: Mapping[str, Who],
    world: Config,
    out: Path,
    *,
    seed: int,
    episode: int = 0,
    judges: Mapping[str, RunDirectory] = NO_JUDGES,
    overwrite: bool = False,
) -> list[Trajectory]:
    """Drive an episode of an evaluation with a camera, and write a page that shows it.

    Args:
        policies: the name on the page, and who drives; one, or two on the same traffic side by side.
        world: where.
        out: the page, .html.
        seed: of the evaluation; see `run.evaluate`.
        episode: its number there.
        judges: by a policy's name, the run whose judge scores its decisions; see `roster.judges_of`.
        overwrite: whether `out` may exist.

    Returns:
        What was driven, in the policies' order; equal to the evaluation's.

    Raises:
        InputError: more policies than two, an episode that cannot be driven, or a page that cannot be written.
    """
    if len(policies) > SIDE_BY_SIDE:
        raise InputError(f"a replay shows one driver, or two side by side; got {len(policies)}: {', '.join(policies)}")
    check_file(out, overwrite=overwrite)
    policies = {name: roster.who_drives(who, world) for name, who in policies.items()}
    traffic = traffic_seed(seed, EVALUATION, episode)
    shots = [rollout.film(Task(who, world, traffic)) for who in policies.values()]
    below = ground.near(shots[0][0].network, *np.concatenate([camera.places for camera, _ in shots], axis=1))
    films = [
        camera.film(name, trajectory, below, learners.verdicts(judges[name], trajectory) if name in judges else ())
        for name, (camera, trajectory) in zip(policies, shots, strict=True)
    ]
    about = {
        "network": below.name,
        "seed": str(seed),
        "episode": str(episode),
        "traffic seed": str(traffic),
        "made by": f"rail-sumo {assets.own_version()}",
    }
    title = f"{' and '.join(policies)} on {below.name}, episode {episode}"
    page.write(below, films, out, title=title, about=about, overwrite=overwrite)
    return [trajectory for _, trajectory in shots]


def write_fcd(
    file: Path,
    network: str,
    out: Path,
    *,
    begin_s: float = -math.inf,
    end_s: float = math.inf,
    overwrite: bool = False,
) -> None:
    """Write a page that shows the floating-car data of any SUMO run; see `fcd.read`.

    Args:
        file: the data.
        network: the network that they are of.
        out: the page, .html.
        begin_s: what is earlier is left out.
        end_s: what is later is left out.
        overwrite: whether `out` may exist.

    Raises:
        InputError: data or a network that cannot be read, or that do not belong together; a page that cannot be
            written.
    """
    check_file(out, overwrite=overwrite)
    film = fcd.read(file, begin_s=begin_s, end_s=end_s)
    below = ground.near(network, film.x_m, film.y_m)
    fcd.require_same_network(film, below)
    about = {"network": below.name, "floating-car data": file.name, "made by": f"rail-sumo {assets.own_version()}"}
    page.write(below, [film], out, title=f"{file.name} on {below.name}", about=about, overwrite=overwrite)


def most_telling(episodes: pd.DataFrame, number: int) -> list[tuple[str, int]]:
    """Return the episodes of an evaluation that are most worth watching, each as policy and number.

    In turns: one with a contact, the one with the hardest braking, the slowest, the fastest; then the next of each.

    Args:
        episodes: the `episodes` table.
        number: how many, at most.
    """
    driven = episodes[episodes["speed_kmh"].notna()].assign(contacts=episodes["collisions"] + episodes["struck"])
    ranked = [
        driven[driven["contacts"] > 0],
        driven.sort_values("hardest_braking_mps2", ascending=False, kind="stable"),
        driven.sort_values("speed_kmh", kind="stable"),
        driven.sort_values("speed_kmh", ascending=False, kind="stable"),
    ]
    queues = [list(zip(table["policy"], table["episode"], strict=True)) for table in ranked]
    in_turns = chain.from_iterable(zip_longest(*queues))
    return list(dict.fromkeys(episode for episode in in_turns if episode))[:number]


def write_most_telling(
    episodes: pd.DataFrame,
    policies: Mapping[str, Who],
    judges: Mapping[str, RunDirectory],
    world: Config,
    folder: Path,
    *,
    seed: int,
    number: int,
) -> list[Path]:
    """Write pages that show the most telling episodes of an evaluation into a folder; returns their files.

    Arguments as in `write` and `most_telling`.
    """
    names = _file_names(policies)
    pages = []
    for policy, episode in most_telling(episodes, number):
        pages.append(folder / f"{names[policy]}-{episode}.html")
        write({policy: policies[policy]}, world, pages[-1], seed=seed, episode=episode, judges=judges)
    return pages


def _file_names(policies: Iterable[str]) -> dict[str, str]:
    """Return a file's name for each policy: `sumo-truck` for sumo:truck; with a number where two come to the same."""
    names: dict[str, str] = {}
    for policy in policies:
        name = re.sub(r"[^\w.-]+", "-", policy).strip("-.") or "policy"
        names[policy] = name if name not in names.values() else f"{name}-{len(names)}"
    return names
