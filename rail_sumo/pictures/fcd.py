"""Floating-car data of any SUMO run, as a film."""

import math
import re
import xml.sax
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rail_sumo.errors import InputError
from rail_sumo.film import Film, Ground, Vehicle
from rail_sumo.highway.names import HOST
from rail_sumo.highway.network.polylines import densified
from rail_sumo.highway.network.sumo_xml import UNREADABLE, opened
from rail_sumo.records import Floats

MOST_ROWS = 1_500_000
"""Of longer data only every second, third, ... time is shown, so that the page stays quick."""

KINDS: dict[str, tuple[str, float, float]] = {
    "pedestrian": ("pedestrian", 0.2, 0.5),
    "pedtype": ("pedestrian", 0.2, 0.5),
    "bicycle": ("bicycle", 1.6, 0.65),
    "bike": ("bicycle", 1.6, 0.65),
    "biketype": ("bicycle", 1.6, 0.65),
    "moped": ("moped", 2.1, 0.8),
    "motorcycle": ("motorcycle", 2.2, 0.9),
    "trailer": ("trailer", 16.5, 2.55),
    "truck": ("truck", 7.1, 2.4),
    "lorry": ("truck", 7.1, 2.4),
    "bus": ("bus", 12.0, 2.5),
    "coach": ("coach", 14.0, 2.6),
    "tram": ("tram", 22.0, 2.4),
}
"""SUMO's vehicle class with its length and width, which floating-car data do not hold, by what a word in the vehicle
type's name ends with."""
CAR = ("passenger", 5.0, 1.8)
DRIVEN = ("driven car", 5.0, 1.8)
"""What the vehicles of a sweep are that we drive; the page marks them (`vehicles.js`)."""
MOST_FRAMES = 200_000
"""A page of more moments would be too much for a browser."""

TIME, ID, X, Y, ANGLE, SPEED, TYPE = (
    "timestep_time",
    *(f"vehicle_{name}" for name in ("id", "x", "y", "angle", "speed", "type")),
)
NEEDED = (TIME, ID, X, Y, ANGLE, SPEED)
UNEVEN = 0.1
"""Of a step: times that are farther from a multiple of it are none."""
CHECKED, NEAR_M = 2000, 25.0
"""How many positions are compared with the network, and how far from its lanes a vehicle may be."""
PARQUET_MAGIC = b"PAR1"


def read(file: Path, *, begin_s: float = -math.inf, end_s: float = math.inf) -> Film:
    """Return the vehicles of SUMO's `--fcd-output`, as Parquet, CSV or XML, told apart by content.

    Args:
        file: the data.
        begin_s: what is earlier is left out, in the data's own time.
        end_s: what is later, likewise.

    Raises:
        InputError: no such file, another kind of file, a damaged one, geographic coordinates, or nobody in that time.
    """
    table = _table(file)
    missing = [column for column in NEEDED if column not in table]
    if not missing:
        table = table[table[ID].notna()]
        missing = [column for column in NEEDED if len(table) and table[column].isna().all()]
    if missing:
        raise InputError(
            f"'{file.name}' is no floating-car data of SUMO's: it has no {', '.join(missing)}; write them with "
            f"--fcd-output.attributes x,y,angle,speed,type,lane"
        )
    known = np.isfinite(table[[TIME, X, Y, ANGLE, SPEED]].to_numpy(np.float64)).all(axis=1)
    is_shown = known & table[TIME].between(begin_s, end_s)
    if not known.any():
        raise InputError(f"'{file.name}' has no vehicles in it")
    if not is_shown.any():
        first_s, last_s = table.loc[known, TIME].agg(["min", "max"])
        raise InputError(
            f"'{file.name}' has no vehicles {_within(begin_s, end_s)}; it is of {first_s:g} to {last_s:g} s"
        )
    table = table[is_shown].sort_values(TIME, kind="stable").drop_duplicates([TIME, ID])
    start_s, step_s, moment = _moments(table[TIME].to_numpy(), file)
    every = math.ceil(len(table) / MOST_ROWS)
    table, moment = table[moment % every == 0], moment[moment % every == 0]
    frame = (moment // every).astype(np.int32)
    vehicle, ids = pd.factorize(table[ID].astype(str))
    kinds = table[TYPE].to_numpy() if TYPE in table else np.full(len(table), "")
    first = np.unique(vehicle, return_index=True)[1]
    vehicles = tuple(_vehicle(name, str(kinds[row])) for name, row in zip(ids, first, strict=True))
    heading_rad = np.pi / 2 - np.radians(table[ANGLE].to_numpy())
    to_centre_m = np.array([one.length_m for one in vehicles])[vehicle] / 2  # SUMO tells where the front is
    return Film(
        name=file.name,
        start_s=start_s,
        step_s=round(step_s * every, 6),
        n_frames=int(frame[-1]) + 1,
        vehicles=vehicles,
        frame=frame,
        vehicle=vehicle.astype(np.int32),
        x_m=table[X].to_numpy() - to_centre_m * np.cos(heading_rad),
        y_m=table[Y].to_numpy() - to_centre_m * np.sin(heading_rad),
        heading_rad=heading_rad,
        speed_mps=table[SPEED].to_numpy(),
        left_out="" if every == 1 else f"One moment of {every} is shown, {len(table)} positions in all.",
    )


def _moments(time_s: Floats, file: Path) -> tuple[float, float, NDArray[np.int64]]:
    """Return when the data begin, how far apart moments are, and the number of the moment of each row.

    Times that are no multiples of the shortest step between two of them are numbered one after the other, at their
    mean distance.

    Args:
        time_s: of each row, not descending, shape (n_rows,).
        file: what they are of.

    Raises:
        InputError: there are too many moments between the first and the last.
    """
    times_s, row = np.unique(time_s, return_inverse=True)
    if len(times_s) == 1:
        return float(times_s[0]), 1.0, row.astype(np.int64)
    step_s = float(np.diff(times_s).min())
    steps = (times_s - times_s[0]) / step_s
    if np.abs(steps - np.round(steps)).max() > UNEVEN:
        step_s, steps = float(times_s[-1] - times_s[0]) / (len(times_s) - 1), np.arange(len(times_s), dtype=np.float64)
    if steps[-1] >= MOST_FRAMES:
        raise InputError(
            f"'{file.name}' lasts from {times_s[0]:g} to {times_s[-1]:g} s, {steps[-1]:.0f} steps of {step_s:g} s; cut "
            f"out a part with --begin and --end"
        )
    return float(times_s[0]), step_s, np.round(steps).astype(np.int64)[row]


def require_same_network(film: Film, ground: Ground) -> None:
    """Raise InputError if most vehicles are nowhere near the network's lanes."""
    sample = np.linspace(0, len(film.x_m) - 1, min(len(film.x_m), CHECKED)).astype(int)
    places = np.column_stack((film.x_m, film.y_m))[sample]
    lanes = [densified(lane.points, NEAR_M) for lane in ground.lanes]
    far = len(places) if not lanes else int((cKDTree(np.concatenate(lanes)).query(places)[0] > NEAR_M).sum())
    if 2 * far > len(places):
        raise InputError(
            f"'{film.name}' is of another network than '{ground.name}': {far} of {len(places)} positions are far from "
            f"its lanes; name its own with --network, and write x and y in metres, without --fcd-output.geo"
        )


def _table(file: Path) -> pd.DataFrame:
    try:
        with file.open("rb") as stream:
            is_parquet = stream.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC
        if is_parquet:
            table = pd.read_parquet(file)
        else:
            with opened(file) as stream:
                is_xml = stream.read(8).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
            table = _of_xml(file) if is_xml else _of_csv(file)
        return table.astype({column: np.float64 for column in NEEDED if column != ID and column in table})
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        raise InputError(f"cannot read floating-car data '{file}': {error.strerror or error}") from None
    except (*UNREADABLE, pa.ArrowException, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"'{file.name}' is no floating-car data of SUMO's, or is damaged: {reason}") from None


def _of_csv(file: Path) -> pd.DataFrame:
    with opened(file) as stream:
        separator = ";" if b";" in stream.readline() else ","
    with opened(file) as stream:  # an id may be "NA" or "null"
        table = pd.read_csv(stream, sep=separator, dtype={ID: str, TYPE: str}, keep_default_na=False, na_values=[""])
    return table if ID not in table else table.assign(**{ID: table[ID].replace("", None)})


def _of_xml(file: Path) -> pd.DataFrame:
    reader = _Reader()
    with opened(file) as stream:
        xml.sax.parse(stream, reader)
    if not reader.has_times:
        raise ValueError("it has no <timestep>")
    return pd.DataFrame(reader.columns)


class _Reader(xml.sax.ContentHandler):
    """Collects the vehicles of every time step."""

    def __init__(self) -> None:
        super().__init__()
        self.columns: dict[str, list[Any]] = {name: [] for name in (*NEEDED, TYPE)}
        self._time_s = math.nan
        self.has_times = False

    def startElement(self, name: str, attrs: Any) -> None:
        if name == "timestep":
            self._time_s, self.has_times = float(attrs["time"]), True
        elif name == "vehicle" and "x" in attrs:
            row = {TIME: self._time_s, ID: attrs["id"], TYPE: attrs.get("type", "")}
            row |= {column: float(attrs.get(column.removeprefix("vehicle_"), "nan")) for column in (X, Y, ANGLE, SPEED)}
            for column, value in row.items():
                self.columns[column].append(value)


def _vehicle(name: str, kind: str) -> Vehicle:
    if kind.startswith(HOST):
        return Vehicle(name, *DRIVEN)
    words = re.split(r"[^a-z]+", kind.lower())
    found = (KINDS[ending] for ending in KINDS if any(word.endswith(ending) for word in words))
    return Vehicle(name, *next(found, CAR))


def _within(begin_s: float, end_s: float) -> str:
    if math.isinf(end_s):
        return f"from {begin_s:g} s on"
    return f"until {end_s:g} s" if math.isinf(begin_s) else f"from {begin_s:g} to {end_s:g} s"
