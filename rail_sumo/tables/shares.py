"""Rows of runs with a share of driven cars -> means, differences from share 0, and the table that is printed."""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from rail_sumo.tables import report, statistics, traffic

AS_THEY_ARE = "sumo"
"""The driver of vehicles that count as driven and are left as they are: the placebo."""

TRAFFIC_COLUMNS = {
    "driver": "string",
    "setting": "string",
    "share": "float64",
    "seed": "int64",
    "vehicles": "string",
    **traffic.MEASURES,
    "undriven": "int64",
}
"""Columns of the `traffic` table: a row per driver, setting, share, seed and kind of vehicles.

`setting` is the value of the key that is swept over, empty where that is the share; `undriven` is how many cars of the
share SUMO drove all the way, since their route is too short or closed to a host, from the beginning of the run on.
"""
EDGE_COLUMNS = {
    "driver": "string",
    "setting": "string",
    "share": "float64",
    "seed": "int64",
    "vehicles": "string",
    "type": "string",
    "edge": "string",
    "n_vehicles": "int64",
    **traffic.SUMS,
}
"""Columns of the `edges` table: a row per driver, setting, share, seed, kind and type of vehicles, and edge."""
EDGES = "edges.parquet"
"""The file of that table, which has no CSV: it may be long."""
ARM = ["driver", "setting", "share"]
"""The columns that are the same in runs which differ by their seed alone."""
MEASURED = tuple(traffic.MEASURES)
_OF_SEEDS = {
    "driver": "string",
    "setting": "string",
    "share": "float64",
    "vehicles": "string",
    "measure": "string",
    "seeds": "int64",
}
SUMMARY_COLUMNS = {
    **_OF_SEEDS,
    "mean": "float64",
    "low": "float64",
    "high": "float64",
    "seeds_for_5_percent": "float64",
}
DIFFERENCE_COLUMNS = {
    **_OF_SEEDS,
    "difference": "float64",
    "difference_low": "float64",
    "difference_high": "float64",
    "relative": "float64",
    "relative_low": "float64",
    "relative_high": "float64",
    "seeds_to_tell": "float64",
}


def summarised(table: pd.DataFrame) -> pd.DataFrame:
    """Return each measure's mean over seeds, with its 95 % interval: `SUMMARY_COLUMNS`.

    `seeds_for_5_percent` is how many seeds an interval of ±5 % of the mean would take: (s t / (e x))^2.
    """
    rows = []
    for about, of_seeds in table.groupby(["driver", "setting", "share", "vehicles"], sort=False):
        told = dict(zip(("driver", "setting", "share", "vehicles"), about, strict=True))
        for measure in MEASURED:
            scores = of_seeds[measure].to_numpy(np.float64)
            n_seeds = int(np.isfinite(scores).sum())
            found = statistics.mean(scores[np.isfinite(scores)])
            needed = _seeds_for(0.05 * found.value, found, n_seeds)
            rows.append(
                told
                | {"measure": measure, "seeds": n_seeds, "seeds_for_5_percent": needed}
                | {"mean": found.value, "low": found.low, "high": found.high}
            )
    return report.typed(rows, SUMMARY_COLUMNS)


def _seeds_for(half_width: float, found: statistics.Estimate, seeds: int) -> float:
    """Return how many seeds an interval of half this width would take, if as many spread as these do."""
    reach = (found.high - found.low) / 2 * math.sqrt(seeds)
    return max(math.ceil((reach / half_width) ** 2), 2) if half_width and reach > 0 else math.nan


def compared(table: pd.DataFrame) -> pd.DataFrame:
    """Return how measures differ from share 0, seed by seed, with 95 % intervals: `DIFFERENCE_COLUMNS`.

    Driven vehicles are compared with the same vehicles as they are, and so are the others. `seeds_to_tell` is how many
    seeds it would take until the interval of a difference like this one excludes 0: (s t / d)^2.
    """
    keys = ["setting", "share", "vehicles"]
    as_they_are = table[table["driver"] == AS_THEY_ARE].set_index(keys)
    rows = []
    driven = table[(table["share"] > 0.0) & (table["driver"] != AS_THEY_ARE)]
    for about, of_seeds in driven.groupby(["driver", *keys], sort=False):
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
                | {"seeds_to_tell": _seeds_for(differs.value, differs, int(both.sum()))}
            )
    return report.typed(rows, DIFFERENCE_COLUMNS)


def told_once(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a sweep's table with those of the runs without driven cars once, of share 0."""
    return table[(table["driver"] != AS_THEY_ARE) | (table["share"] == 0.0)]


def of_all_vehicles(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the `traffic` table that are of all vehicles, each run's once."""
    return told_once(table[table["vehicles"] == traffic.ALL])


def called(driver: str, setting: str, share: float) -> str:
    """Return what runs that differ by their seed alone are called: the values of `ARM` as people read them."""
    who = f"{driver} at {share:.0%}" if share and driver != AS_THEY_ARE else "as they are"
    return f"{who}, {setting}" if setting else who


def rates(edges: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return what the sums of the `edges` table come to, of all vehicles on all seeds, for each group of rows.

    Mean speed, and the others a vehicle kilometre. Of the runs without driven cars share 0 is told alone.

    Args:
        edges: `EDGE_COLUMNS`.
        by: its columns that make a group.
    """
    counted = ["lane_changes", "hard_brakings", "ttc_below_1_5s", "drac_above_3_4", "stops"]
    sums = told_once(edges).groupby(by, sort=False)[["vehicle_s", "vehkm", "time_loss_s", *counted]].sum()
    return pd.DataFrame({
        "vehkm": sums["vehkm"],
        "speed_kmh": 3600 * sums["vehkm"] / sums["vehicle_s"],
        "time_loss_s_per_km": sums["time_loss_s"] / sums["vehkm"],
        **{f"{name}_per_vehkm": sums[name] / sums["vehkm"] for name in counted},
    }).reset_index()  # fmt: skip


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
    "speed_std_at_place_kmh": "standard deviation of speeds at a place, km/h",
    "time_loss_s_per_km": "time loss, s a kilometre",
    "depart_delay_s": "delay of departure, s",
    "travel_time_s": "travel time of those that arrived, s",
    "lane_changes_per_vehkm": "lane changes a vehicle kilometre",
    "hard_brakings_per_vehkm": "hard brakings a vehicle kilometre",
    "ttc_below_1_5s_per_vehkm": "times to collision below 1.5 s a vehicle kilometre",
    "drac_above_3_4_per_vehkm": "decelerations to avoid a crash above 3.4 m/s² a vehicle kilometre",
    "co2_g_per_vehkm": "CO2, g a vehicle kilometre",
    "fuel_ml_per_vehkm": "fuel, ml a vehicle kilometre",
    "collisions": "contacts",
    "teleports": "teleports",
    "stuck": "vehicles stuck",
}
"""What figures call the measures."""


class Shown(NamedTuple):
    """How a measure is shown."""

    name: str
    unit: str
    decimals: int

    @property
    def heading(self) -> str:
        """Its name with its unit, on one line."""
        return ", ".join(filter(None, (self.name, self.unit)))


CONTACTS = "collisions"
TOLD = {
    "flow_vehph": Shown("flow", "veh/h", 0),
    "speed_kmh": Shown("speed", "km/h", 1),
    "time_loss_s_per_km": Shown("time loss", "s/km", 2),
    "lane_changes_per_vehkm": Shown("lane changes", "per veh km", 2),
    "hard_brakings_per_vehkm": Shown("hard brakings", "per veh km", 3),
    "ttc_below_1_5s_per_vehkm": Shown("TTC < 1.5 s", "per veh km", 3),
    "co2_g_per_vehkm": Shown("CO2", "g per veh km", 1),
    CONTACTS: Shown("contacts", "", 1),
}
"""The measures that `sweep.md` shows, and the terminal as many of them as fit."""


class Cell(NamedTuple):
    """A measure as it is told."""

    mean: str
    """A dash where it has no value, as emissions where no trip began."""
    difference: str
    """From share 0, with its interval; empty of share 0."""

    @property
    def on_one_line(self) -> str:
        """Both."""
        return f"{self.mean} ({self.difference})" if self.difference else self.mean

    @property
    def on_two_lines(self) -> str:
        """Both, the difference dimmed in Rich's markup."""
        return f"{self.mean}\n[dim]{self.difference}[/]" if self.difference else self.mean


class Row(NamedTuple):
    """A driver, a setting and a share."""

    driver: str
    setting: str
    share: str
    cells: dict[str, Cell]
    """By measure, of `TOLD`."""


def told_rows(table: pd.DataFrame, differences: pd.DataFrame) -> list[Row]:
    """Return a row for each driver, setting and share."""
    of_all = of_all_vehicles(table)
    changes = differences[differences["vehicles"] == traffic.ALL].set_index(["driver", "setting", "share", "measure"])
    rows = []
    for (driver, setting, share), of_seeds in of_all.groupby(["driver", "setting", "share"], sort=False):
        cells = {}
        for measure, (_, _, decimals) in TOLD.items():
            mean, difference = of_seeds[measure].mean(), ""
            change = changes.loc[(driver, setting, share, measure)] if share else None
            if change is not None and np.isfinite(change["difference"]):
                reach = (change["difference_high"] - change["difference_low"]) / 2
                within = f" ± {reach:.{decimals}f}" if np.isfinite(reach) else ""
                difference = f"{change['difference']:+.{decimals}f}{within}"
            cells[measure] = Cell(f"{mean:.{decimals}f}" if np.isfinite(mean) else "-", difference)
        rows.append(Row(driver if share else "as they are", setting, f"{share:.0%}", cells))
    return rows


def told_table(key: str, rows: list[Row], caption: str, *, width: int) -> Table:
    """Return the table for the terminal: a row per driver and share, dimmed below each the differences.

    Args:
        key: the key that is swept over; empty where that is the share.
        rows: as `told_rows` returns them.
        caption: is told below it, and which measures are left out.
        width: of the terminal; where the table does not fit, the last measures before the contacts are left out.
    """
    others = [measure for measure in TOLD if measure != CONTACTS]
    for n in range(len(others), -1, -1):
        shown = _table(key, rows, caption, [*others[:n], CONTACTS])
        if report.width_of(shown, [row.driver for row in rows]) <= width:
            break
    return shown


def _table(key: str, rows: list[Row], caption: str, measures: list[str]) -> Table:
    left_out = [told.name for measure, told in TOLD.items() if measure not in measures]
    more = f"\nNot shown for want of room, but in sweep.md: {', '.join(left_out)}." if left_out else ""
    shown = Table(box=SIMPLE_HEAD, caption=caption + more, collapse_padding=True, pad_edge=False)
    shown.add_column("driver", min_width=report.NAME_WIDTH)
    for heading in (*([key] if key else []), "share", *(f"{TOLD[one].name}\n{TOLD[one].unit}" for one in measures)):
        shown.add_column(heading, justify="right", no_wrap=True)
    for driver, setting, share, cells in rows:
        shown.add_row(
            report.Name(driver),
            *([escape(setting)] if key else []),
            share,
            *(cells[one].on_two_lines for one in measures),
        )
    return shown
