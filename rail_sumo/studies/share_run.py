"""One run of a sweep: a demand is simulated with a share of its cars driven, and what happened is written to files."""

import json
import tempfile
import tomllib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from rail_sumo import assets, config_file, rollout, training
from rail_sumo.config import Config, flat
from rail_sumo.config_file import first_difference
from rail_sumo.errors import InputError
from rail_sumo.highway.traffic.fleet import Instead
from rail_sumo.rollout import EVALUATION, Who, traffic_seed
from rail_sumo.studies import cells
from rail_sumo.tables import report, traffic
from rail_sumo.tables.shares import EDGE_COLUMNS, TRAFFIC_COLUMNS

FCD = "fcd"
"""The folder of floating-car data."""
EMISSIONS = "device.emissions.probability"


@dataclass(frozen=True)
class ShareRun:
    """One simulation, and what it is to be of."""

    out: Path
    """The sweep's folder."""
    world: Config
    driver: str
    who: Who | Instead
    """Who drives, as it travels to a worker, or what a vehicle of the share gets instead."""
    setting: str
    share: float
    shares: tuple[float, ...]
    """The shares that rows are made of: of vehicles as they are, all shares of the sweep, as the placebo."""
    seed: int
    duration_s: float
    learned: str = ""
    """What the driver has learned, or its module, as SHA-256."""
    keeps_fcd: bool = False
    warm_up_s: float = 0.0

    @property
    def made_of(self) -> str:
        """What its rows follow from."""
        about = {
            "config": config_file.dumps(self.world),
            "inputs": training.world_inputs(self.world),
            "learned": self.learned,
            "driver": self.driver,
            "shares": self.shares,
            "seed": self.seed,
            "period": (self.warm_up_s, self.duration_s),
            "columns": [*TRAFFIC_COLUMNS, *EDGE_COLUMNS],
            "by": assets.own_version(),
        }
        return json.dumps(about, sort_keys=True)

    def require_same_study(self) -> None:
        """Raise InputError if its file holds a run of another world or period."""
        about = cells.made_of(self.file)
        if not about:
            return
        theirs, ours = json.loads(about), json.loads(self.made_of)
        if theirs["config"] != ours["config"]:
            what = first_difference(*(flat(tomllib.loads(one["config"])) for one in (theirs, ours))) or "other keys"
        elif theirs["period"] != ours["period"]:
            what = "{:g} s after {:g} s of warm-up, not {:g} after {:g}".format(
                *theirs["period"][::-1], *ours["period"][::-1]
            )
        elif theirs["inputs"] != ours["inputs"]:
            what = "other content of the network's or the demand's files"
        else:
            return
        raise InputError(f"'{self.out}' holds runs that were driven with {what}; choose another --out")

    @property
    def file(self) -> Path:
        """Where its rows are kept."""
        parts = [quote(one, safe="") for one in (self.driver, self.setting) if one]
        return self.out / report.FINISHED / f"{'-'.join(parts)}-{self.share:g}-seed{self.seed}.parquet"

    @property
    def edges_file(self) -> Path:
        """Where its sums for each edge are kept."""
        return self.file.with_suffix(".edges.parquet")

    @property
    def fcd_file(self) -> Path:
        """Where its floating-car data are kept, if they are."""
        return self.out / FCD / self.file.name

    def discard(self) -> None:
        """Remove what it has written."""
        for file in (self.file, self.edges_file, self.fcd_file):
            file.unlink(missing_ok=True)
            with suppress(OSError):  # it holds others', or is not there
                file.parent.rmdir()

    @property
    def is_finished(self) -> bool:
        """Whether all of its files are there, and made of the same."""
        files = (self.file, self.edges_file, *((self.fcd_file,) if self.keeps_fcd else ()))
        wanted = self.made_of
        return all(cells.made_of(file) == wanted for file in files)


def finish(one: ShareRun) -> pd.DataFrame:
    """Return a run's rows, after driving it unless its files are there already; in a process of its own."""
    if not one.is_finished:
        rows, edges = _drive(one)
        cells.write(one.edges_file, report.typed(edges, EDGE_COLUMNS), one.made_of)
        cells.write(one.file, report.typed(rows, TRAFFIC_COLUMNS), one.made_of)
    return report.typed(pd.read_parquet(one.file), TRAFFIC_COLUMNS)


def _drive(one: ShareRun) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Drive, and return a row for each share and kind of vehicles, and sums for each edge."""
    seed, begin_s = traffic_seed(one.seed, EVALUATION, 0), one.world.traffic.begin_s
    from_s = begin_s + one.warm_up_s
    with tempfile.TemporaryDirectory() as folder:
        reports = Path(folder)
        world = _with_emissions(one.world)
        driven = rollout.fleet_of(one.who, world, one.share, seed, traffic.options(reports, places=one.keeps_fcd))
        try:
            driven.drive(from_s + one.duration_s)
        except InputError as error:
            raise InputError(f"driver '{one.driver}', share {one.share:g}, seed {one.seed}: {error}") from None
        about_run = traffic.Run(
            reports,
            from_s,
            from_s + one.duration_s,
            vehicles={
                name: traffic.Vehicle(car.kind, car.speed_factor, car.fastest_mps)
                for name, car in driven.inserted.items()
            },
            lanes=driven.lanes,
            edges=driven.edges,
            teleported=tuple(driven.teleported),
        )
        told = traffic.Reports(about_run)
        if one.keeps_fcd:
            cells.write(one.fcd_file, traffic.floating_car_data(reports), one.made_of)
    if driven.undriven and not driven.driven:
        raise InputError(
            f"driver '{one.driver}' could drive none of {len(driven.undriven)} cars: "
            f"{next(iter(driven.undriven.values()))}"
        )
    about = {"driver": one.driver, "setting": one.setting, "seed": one.seed, "undriven": len(driven.undriven)}
    kinds = {name: car.kind for name, car in driven.inserted.items()} | told.waiting
    rows: list[dict[str, Any]] = []
    edges: list[pd.DataFrame] = []
    for share in one.shares:
        of_share = {name for name, kind in kinds.items() if driven.is_of_the_share(name, kind, share)}
        rows += [about | {"share": share} | measures for measures in told.measures(of_share)]
        edges.append(told.edges(of_share).assign(**about, share=share))
    return pd.DataFrame(rows), pd.concat(edges)


def _with_emissions(world: Config) -> Config:
    """Return the world with SUMO accounting for everybody's emissions, whatever its options say of them."""
    others = [option for option in world.traffic.options if not option.startswith(EMISSIONS)]
    return world.changed(traffic={"options": (*others, f"{EMISSIONS}=1")})
