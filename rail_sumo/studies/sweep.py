"""What happens on a road as the share of driven vehicles grows: every share and driver on the same traffic.

A run is one simulation of a user's demand, of which a share of the cars has a driver. Its seed settles the traffic and
which cars those are, so that shares and drivers are compared on the same vehicles, departures and routes. What a
finished run came to is one file under `cells/`; the same command goes on with those that are missing.
"""

import hashlib
import itertools
import json
import math
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from rail_sumo import assets, config_file, drivers, rollout, run, training
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.files import check_folder, whole_file
from rail_sumo.highway import fleet
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.fleet import Fleet
from rail_sumo.highway.network import demand
from rail_sumo.pictures import plot
from rail_sumo.records import Floats
from rail_sumo.rollout import EVALUATION, SILENT, Observer, Who, traffic_seed
from rail_sumo.tables import report, statistics, traffic, warm_up

SHARE = "share"
"""What is swept over, unless it is a key of the configuration."""
ACC, AS_THEY_ARE = "acc", "sumo"
"""SUMO's own adaptive cruise control; and the placebo: vehicles that count as driven, and are left as they are."""
AUTO = "auto"
SECTIONS_WITH_EFFECT, WITH_EFFECT = (
    ("network", "traffic", "adas", "lidar", "observation"),
    ("episode.decision_period_s",),
)
"""Where what changes how many vehicles drive stands: in these sections, and under this key."""
FOUND_OVER, FOUND_WITHIN_S = 2.0, 1200.0
"""To find the warm-up the traffic is watched for so many times the period that counts, and no less long than this."""

EMISSIONS = "device.emissions.probability"
MADE_OF = b"rail_sumo"
KEYS = {"driver": "string", "setting": "string", "share": "float64", "seed": "int64", "vehicles": "string"}
TRAFFIC_COLUMNS = {**KEYS, **traffic.MEASURES, "undriven": "int64"}
"""Columns of the `traffic` table: a row per driver, setting, share, seed and kind of vehicles.

`setting` is the value of the key that is swept over, empty where that is the share; `undriven` is how many cars of the
share SUMO drove all the way, since their route is too short or closed to a host, from the beginning of the run on.
"""
MEASURED = tuple(traffic.MEASURES)
SUMMARY_COLUMNS = {
    "driver": "string",
    "setting": "string",
    "share": "float64",
    "vehicles": "string",
    "measure": "string",
    "seeds": "int64",
    "mean": "float64",
    "low": "float64",
    "high": "float64",
    "seeds_for_5_percent": "float64",
}
DIFFERENCE_COLUMNS = {
    **dict(itertools.islice(SUMMARY_COLUMNS.items(), 6)),
    "difference": "float64",
    "difference_low": "float64",
    "difference_high": "float64",
    "relative": "float64",
    "relative_low": "float64",
    "relative_high": "float64",
}


@dataclass(frozen=True)
class Sweep:
    """Several drivers, each with several shares of the cars, on several seeds; or several values of a key."""

    config: Config
    drivers: tuple[str, ...]
    """Whatever `rail-sumo eval` takes, but SUMO's types; `acc`, and `sumo`: as they are."""
    shares: tuple[float, ...]
    out: Path
    """Its folder, which may hold some of it already."""
    key: str = SHARE
    """What is swept over."""
    settings: tuple[str, ...] = ("",)
    """Its values, if it is a key of the configuration."""
    seeds: int = 10
    duration_s: float = 600.0
    """The period that counts."""
    warm_up_s: float | None = None
    """How long the traffic drives before; None to find it."""
    workers: int = 1
    observer: Observer = SILENT

    def drive(self) -> "Tables":
        """Bring every run to its end; write the tables, `sweep.md` and a figure for each measure into `out`.

        Raises:
            InputError: a share outside 0 to 1, doubled, or none; a driver that is not found, senses something else than
                its configuration says, or is named twice; no demand, or one without cars.
        """
        self._check()
        check_folder(self.out, overwrite=True)
        list(self._work(0.0))  # whoever is not found is not found before anybody drives
        warm_up_s = self._warm_up_s() if self.warm_up_s is None else self.warm_up_s
        work = list(self._work(warm_up_s))
        self.observer.start("runs", len(work))
        driven = []
        with rollout.workers(self.workers) as pool:
            for rows in pool.map(_finish, work):
                driven.append(rows)
                self.observer.advance({})
        table = report.typed(pd.concat(driven, ignore_index=True), TRAFFIC_COLUMNS)
        if not table.loc[table["vehicles"] == traffic.DRIVEN, "n_vehicles"].any():
            raise InputError("no car of the share was on the road in the period; change traffic.begin_s or --duration")
        tables = Tables(table, summarised(table), compared(table), warm_up_s)
        report.write(self.out, traffic=table, summary=tables.summary, differences=tables.differences, overwrite=True)
        with whole_file(self.out / "sweep.md") as partial:
            partial.write_text(markdown(self, tables), encoding="utf-8")
        self._draw(tables.summary)
        return tables

    def _draw(self, summary: pd.DataFrame) -> None:
        """Draw every measure of all vehicles, as PNG and SVG, if there is anything to draw with."""
        if find_spec("matplotlib") is None:
            self.observer.note("no figures without matplotlib; install it with: pip install 'rail-sumo[plots]'")
            return
        across = "share" if self.key == SHARE else "setting"
        of_all = summary[summary["vehicles"] == traffic.ALL]
        zero = of_all[(of_all["driver"] == AS_THEY_ARE) & (of_all["share"] == 0.0)]
        for measure in MEASURED:
            curves = {}
            for driver in (*self.drivers, *([AS_THEY_ARE] if self.key != SHARE else ())):
                told = of_all[(of_all["driver"] == driver) & (of_all["share"] > 0.0)]
                told = pd.concat([zero, told]) if self.key == SHARE else zero if driver == AS_THEY_ARE else told
                told = told[told["measure"] == measure]
                label = "as they are" if driver == AS_THEY_ARE else driver
                curves[label] = told[[across, "mean", "low", "high"]].astype("float64").sort_values(across).to_numpy()
            figure = plot.with_bands(curves, "share of the cars" if self.key == SHARE else self.key, HEADINGS[measure])
            for suffix in (".png", ".svg"):
                plot.save(figure, self.out / "figures" / f"{measure}{suffix}", overwrite=True)

    def _check(self) -> None:
        if self.seeds < 1:
            raise InputError(f"--seeds must be at least 1; got {self.seeds}")
        if not self.duration_s >= 1.0 or math.isinf(self.duration_s):
            raise InputError(f"--duration takes seconds, at least 1; got {self.duration_s:g}")
        if self.warm_up_s is not None and not 0.0 <= self.warm_up_s < math.inf:
            raise InputError(f"--warm-up takes seconds from 0 up, or {AUTO}; got {self.warm_up_s:g}")
        for share in self.shares:
            if not 0.0 <= share <= 1.0:
                raise InputError(f"a share is a number from 0 to 1; got {share:g}")
        if self.config.varied.networks:
            raise InputError("a share is of the cars of one demand; leave out varied.networks")
        if self.key not in (SHARE, *WITH_EFFECT) and self.key.partition(".")[0] not in SECTIONS_WITH_EFFECT:
            raise InputError(
                f"{self.key} has no effect on a sweep; vary a number of [{'], ['.join(SECTIONS_WITH_EFFECT)}] or "
                f"{WITH_EFFECT[0]}"
            )
        for setting in self.settings if self.key != SHARE else ():
            try:
                float(setting)
            except ValueError:
                raise InputError(f"what is swept over are numbers; got {self.key} = '{setting}'") from None
        for what, given in (("share", self.shares), ("driver", self.drivers), (f"value of {self.key}", self.settings)):
            twice = next((one for one in given if given.count(one) > 1), None)
            if twice is not None:
                raise InputError(f"{what} {twice} is given twice; leave one out")
        if not [share for share in self.shares if share]:
            raise InputError("give at least one share above 0; share 0 is always driven beside")
        for name in self.drivers:
            if drivers.hands_off(name) and name != AS_THEY_ARE:
                raise InputError(f"driver '{name}' drives one vehicle; for SUMO's own drivers take '{AS_THEY_ARE}'")

    def _work(self, warm_up_s: float) -> Iterator["_Work"]:
        shares = [share for share in self.shares if share > 0.0]
        for setting in self.settings:
            world = self._world(setting)
            who = {name: run.find_driver(name, world) for name in self.drivers if name not in (ACC, AS_THEY_ARE)}
            if self.key.startswith(("lidar.", "observation.")):
                for name, driver in who.items():
                    drivers.require_same_senses(driver, world, f"driver '{name}'")
            for seed in range(self.seeds):
                one = _Work(
                    self.out, world, AS_THEY_ARE, None, setting, 0.0, (0.0, *shares), seed, warm_up_s, self.duration_s
                )
                yield one
                for name in self.drivers:
                    if name != AS_THEY_ARE:
                        yield from (
                            replace(one, driver=name, who=who.get(name), share=share, shares=(share,))
                            for share in shares
                        )

    def _world(self, setting: str) -> Config:
        if self.key == SHARE:
            return self.config
        return config_file.changed(self.config, [f"{self.key}={setting}"])

    def _warm_up_s(self) -> float:
        """Return how long the number of vehicles on the road takes to settle, as they are, at the slowest setting."""
        found_s = 0
        self.observer.start("warm-up", len(self.settings))
        for setting in self.settings:
            world = self._world(setting)
            pilot = Fleet(world, 0.0, traffic_seed(0, EVALUATION, 0), "nothing")
            begin_s, own = world.traffic.begin_s, demand.read(world.traffic)
            last_s = own.departs_s[1] if own.has_traffic else begin_s
            watched_s = max(FOUND_OVER * self.duration_s, FOUND_WITHIN_S)
            counts = pilot.drive(min(begin_s + watched_s, max(last_s, begin_s + 1.0)))
            self.observer.advance({})
            seconds, settles = warm_up.found_s(counts)
            found_s = max(found_s, seconds)
            if not settles:
                self.observer.note(
                    f"the number of vehicles on the road does not settle within {len(counts)} s"
                    f"{f' at {self.key} = {setting}' if setting else ''}: more come than leave; {seconds:.0f} s are "
                    f"left out, and what follows depends on the period"
                )
            if begin_s + found_s + self.duration_s > last_s:
                self.observer.note(
                    f"the last vehicle departs at {last_s:.0f} s, before the period ends at "
                    f"{begin_s + found_s + self.duration_s:.0f} s: choose a shorter --duration, or lengthen the demand"
                )
        return float(found_s)


class Tables(NamedTuple):
    """What a sweep came to."""

    traffic: pd.DataFrame
    """A row per driver, setting, share, seed and kind of vehicles: `TRAFFIC_COLUMNS`."""
    summary: pd.DataFrame
    """Means over seeds: `SUMMARY_COLUMNS`."""
    differences: pd.DataFrame
    """From share 0: `DIFFERENCE_COLUMNS`."""
    warm_up_s: float
    """How long the traffic drove before it counted."""


@dataclass(frozen=True)
class _Work:
    """One run."""

    out: Path
    """The sweep's folder."""
    world: Config
    driver: str
    who: Who | None
    """Who drives, as it travels to a worker; None of what SUMO drives."""
    setting: str
    share: float
    shares: tuple[float, ...]
    """The shares that rows are made of: of vehicles as they are, all shares of the sweep, as the placebo."""
    seed: int
    warm_up_s: float
    duration_s: float

    @property
    def made_of(self) -> str:
        """What its rows follow from."""
        learned = None if isinstance(self.who, str) else hashlib.sha256(pickle.dumps(self.who)).hexdigest()
        about = {
            "config": config_file.dumps(self.world),
            "inputs": training.world_inputs(self.world),
            "learned": learned,
            "driver": self.driver,
            "shares": self.shares,
            "seed": self.seed,
            "period": (self.warm_up_s, self.duration_s),
            "by": assets.own_version(),
        }
        return json.dumps(about, sort_keys=True)

    @property
    def file(self) -> Path:
        """Where its rows are kept."""
        parts = [quote(one, safe="") for one in (self.driver, self.setting) if one]
        return self.out / "cells" / f"{'-'.join(parts)}-{self.share:g}-seed{self.seed}.parquet"


def _finish(work: _Work) -> pd.DataFrame:
    """Bring a run to its end, if it has not come to it, and return its rows; in a process of its own."""
    try:
        known = pq.read_schema(work.file).metadata or {}
    except (OSError, pa.ArrowException):  # not there, or damaged
        known = {}
    if known.get(MADE_OF, b"").decode() != work.made_of:
        rows = pa.Table.from_pandas(report.typed(_rows(work), TRAFFIC_COLUMNS), preserve_index=False)
        with whole_file(work.file) as partial:
            pq.write_table(rows.replace_schema_metadata({MADE_OF: work.made_of}), partial)
    return report.typed(pd.read_parquet(work.file), TRAFFIC_COLUMNS)


def _rows(work: _Work) -> pd.DataFrame:
    """Drive, and return a row for each share and kind of vehicles."""
    seed, begin_s = traffic_seed(work.seed, EVALUATION, 0), work.world.traffic.begin_s
    from_s = begin_s + work.warm_up_s
    with tempfile.TemporaryDirectory() as folder:
        reports = Path(folder)
        driven = Fleet(_driven_in(work), work.share, seed, _driver_of(work, seed), traffic.options(reports))
        try:
            driven.drive(from_s + work.duration_s)
        except InputError as error:
            raise InputError(f"driver '{work.driver}', share {work.share:g}, seed {work.seed}: {error}") from None
        run_ = traffic.Run(
            reports,
            from_s,
            from_s + work.duration_s,
            wishes={name: traffic.Wish(car.speed_factor, car.fastest_mps) for name, car in driven.inserted.items()},
            lanes={name: traffic.Lane(*lane) for name, lane in driven.lanes.items()},
            teleported=tuple(driven.teleported),
        )
        told = traffic.Reports(run_)
    if driven.undriven and not driven.driven:
        raise InputError(
            f"driver '{work.driver}' could drive none of {len(driven.undriven)} cars: "
            f"{next(iter(driven.undriven.values()))}"
        )
    about = {"driver": work.driver, "setting": work.setting, "seed": work.seed, "undriven": len(driven.undriven)}
    kinds = {name: car.kind for name, car in driven.inserted.items()} | told.waiting
    rows: list[dict[str, Any]] = []
    for share in work.shares:
        of_share = {name for name, kind in kinds.items() if driven.is_of_the_share(name, kind, share)}
        rows += [about | {"share": share} | measures for measures in told.measures(of_share)]
    return pd.DataFrame(rows)


def _driven_in(work: _Work) -> Config:
    """Return the world as the driver senses it, with SUMO accounting for everybody's emissions."""
    world = work.world.seen_with(getattr(work.who, "senses", None))
    others = [option for option in world.traffic.options if not option.startswith(EMISSIONS)]
    return world.changed(traffic={"options": (*others, f"{EMISSIONS}=1")})


def _driver_of(work: _Work, seed: int) -> Callable[[str], fleet.Decide] | fleet.Instead:
    """Return what decides for a vehicle; each draws from a stream of its own, by its id."""
    if work.driver == AS_THEY_ARE:
        return "nothing"
    if work.driver == ACC:
        return "acc"
    assert work.who is not None
    who, world = work.who, work.world

    def of(name: str) -> Callable[[Floats, Agent], int]:
        return rollout.driver_of(who, world, traffic_seed(seed, *name.encode())).decide

    return of


def summarised(table: pd.DataFrame) -> pd.DataFrame:
    """Return each measure's mean over seeds, with its 95 % interval: `SUMMARY_COLUMNS`.

    `seeds_for_5_percent` is how many seeds an interval of ±5 % of the mean would take: (s t / (e x))^2.
    """
    rows = []
    for about, of_seeds in table.groupby(["driver", "setting", "share", "vehicles"], sort=False):
        told = dict(zip(("driver", "setting", "share", "vehicles"), about, strict=True))
        for measure in MEASURED:
            scores = of_seeds[measure].to_numpy(np.float64)
            found = statistics.mean(scores[np.isfinite(scores)])
            reach = (found.high - found.low) / 2 * math.sqrt(np.isfinite(scores).sum())
            needed = math.ceil((reach / (0.05 * abs(found.value))) ** 2) if found.value and reach > 0 else math.nan
            rows.append(
                told
                | {"measure": measure, "seeds": int(np.isfinite(scores).sum()), "seeds_for_5_percent": needed}
                | {"mean": found.value, "low": found.low, "high": found.high}
            )
    return report.typed(rows, SUMMARY_COLUMNS)


def compared(table: pd.DataFrame) -> pd.DataFrame:
    """Return how measures differ from share 0, seed by seed, with 95 % intervals: `DIFFERENCE_COLUMNS`.

    Driven vehicles are compared with the same vehicles as they are, and so are the others.
    """
    keys = ["setting", "share", "vehicles"]
    as_they_are = table[table["driver"] == AS_THEY_ARE].set_index(keys)
    rows = []
    for about, of_seeds in table[table["share"] > 0.0].groupby(["driver", *keys], sort=False):
        beside = as_they_are.loc[[about[1:]]].set_index("seed").reindex(of_seeds["seed"])
        told = dict(zip(("driver", *keys), about, strict=True))
        for measure in MEASURED:
            ours, theirs = of_seeds[measure].to_numpy(np.float64), beside[measure].to_numpy(np.float64)
            both = np.isfinite(ours) & np.isfinite(theirs)
            differs = statistics.difference(ours[both], theirs[both])
            ratio = statistics.ratio(ours[both], theirs[both])
            rows.append(
                told
                | {"measure": measure, "seeds": int(both.sum()), "difference": differs.value}
                | {"difference_low": differs.low, "difference_high": differs.high, "relative": ratio.value - 1}
                | {"relative_low": ratio.low - 1, "relative_high": ratio.high - 1}
            )
    return report.typed(rows, DIFFERENCE_COLUMNS)


HEADINGS = {
    "n_vehicles": "vehicles",
    "inserted": "vehicles inserted",
    "arrived": "vehicles arrived",
    "unfinished": "vehicles on the road at the end",
    "waiting": "vehicles not yet inserted",
    "vehkm": "vehicle kilometres",
    "flow_vehph": "flow, vehicles an hour",
    "density_vehpkm_lane": "density, vehicles a kilometre of lane",
    "speed_kmh": "speed, km/h",
    "speed_std_kmh": "standard deviation of a vehicle's speed, km/h",
    "time_loss_s_per_km": "time loss, s a kilometre",
    "depart_delay_s": "delay of departure, s",
    "lane_changes_per_vehkm": "lane changes a vehicle kilometre",
    "hard_brakings_per_vehkm": "hard brakings a vehicle kilometre",
    "ttc_below_1_5s_per_vehkm": "times to collision below 1.5 s a vehicle kilometre",
    "drac_above_3_4_per_vehkm": "decelerations to avoid a crash above 3.4 m/s² a vehicle kilometre",
    "co2_g_per_vehkm": "CO2, g a vehicle kilometre",
    "fuel_ml_per_vehkm": "fuel, ml a vehicle kilometre",
    "collisions": "contacts",
    "teleports": "teleports",
}
"""What figures call the measures."""
TOLD = {
    "flow_vehph": ("flow, veh/h", 0),
    "speed_kmh": ("speed, km/h", 1),
    "time_loss_s_per_km": ("time loss, s/km", 2),
    "lane_changes_per_vehkm": ("lane changes / veh km", 2),
    "hard_brakings_per_vehkm": ("hard brakings / veh km", 3),
    "ttc_below_1_5s_per_vehkm": ("TTC < 1.5 s / veh km", 3),
    "co2_g_per_vehkm": ("CO2, g / veh km", 1),
    "collisions": ("contacts", 1),
}
"""The measures that `sweep.md` and the terminal show: heading and decimals."""


def markdown(sweep: Sweep, tables: Tables) -> str:
    """Return the study as a page: what was driven, the means of all vehicles, and how they differ from share 0."""
    headings, rows = _told(sweep, tables)
    lines = [
        f"# {sweep.config.network.file}: {', '.join(sweep.drivers)}",
        "",
        _caption(sweep, tables),
        "",
        f"| {' | '.join(headings)} |",
        "| --- |" + " ---: |" * (len(headings) - 1),
        *(f"| {' | '.join(cells)} |" for cells in rows),
    ]
    return "\n".join(lines) + "\n"


def shown(sweep: Sweep, tables: Tables) -> Table:
    """Return the same for the terminal."""
    headings, rows = _told(sweep, tables)
    told = Table(box=SIMPLE_HEAD, caption=_caption(sweep, tables))
    for number, heading in enumerate(headings):
        told.add_column(heading, justify="right" if number else "left", no_wrap=not number)
    for cells in rows:
        told.add_row(*(escape(cell).replace(" (", "\n(") for cell in cells))
    return told


def _caption(sweep: Sweep, tables: Tables) -> str:
    seeds = f"{sweep.seeds} seeds" if sweep.seeds > 1 else "one seed: no interval"
    undriven = tables.traffic.loc[tables.traffic["vehicles"] == traffic.DRIVEN, "undriven"].max()
    left = (
        f" Up to {undriven} cars of a run's share are left to SUMO, on routes too short for a host." if undriven else ""
    )
    return (
        f"{seeds}; {sweep.duration_s:g} s each, after {tables.warm_up_s:g} s that do not count. Means of all vehicles; "
        f"in brackets the difference from share 0 on the same traffic, ± half its 95 % interval.{left}"
    )


def _told(sweep: Sweep, tables: Tables) -> tuple[list[str], list[list[str]]]:
    """Return headings and cells; the value of the key only where one is swept over."""
    headings = ["driver", sweep.key, "share", *(heading for heading, _ in TOLD.values())]
    rows = told_rows(tables.traffic, tables.differences)
    if sweep.key != SHARE:
        return headings, rows
    return [headings[0], *headings[2:]], [[cells[0], *cells[2:]] for cells in rows]


def told_rows(table: pd.DataFrame, differences: pd.DataFrame) -> list[list[str]]:
    """Return for each driver, setting and share its cells: who, where, how many, and the measures of `TOLD`."""
    of_all = table[(table["vehicles"] == traffic.ALL) & ((table["driver"] != AS_THEY_ARE) | (table["share"] == 0.0))]
    changes = differences[differences["vehicles"] == traffic.ALL].set_index(["driver", "setting", "share", "measure"])
    rows = []
    for (driver, setting, share), of_seeds in of_all.groupby(["driver", "setting", "share"], sort=False):
        cells = [driver if share else "as they are", setting, f"{share:.0%}"]
        for measure, (_, decimals) in TOLD.items():
            cell = f"{of_seeds[measure].mean():.{decimals}f}"
            if share:
                change = changes.loc[(driver, setting, share, measure)]
                cell += f" ({change['difference']:+.{decimals}f}"
                reach = (change["difference_high"] - change["difference_low"]) / 2
                cell += f" ± {reach:.{decimals}f})" if np.isfinite(reach) else ")"
            cells.append(cell)
        rows.append(cells)
    return rows


def shares_of(texts: Sequence[str]) -> tuple[float, ...]:
    """Return shares as numbers.

    Raises:
        InputError: one is none.
    """
    try:
        return tuple(float(text) for text in texts)
    except ValueError:
        raise InputError(f"shares are numbers from 0 to 1; got '{' '.join(texts)}'") from None
