"""Floating-car data of any SUMO run, as a film."""

import itertools
import math
import xml.sax
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial import cKDTree

from rail_sumo.errors import InputError
from rail_sumo.film import Film, Ground, Vehicle
from rail_sumo.highway.network.sumo_xml import UNREADABLE, opened
from rail_sumo.records import Floats

MOST_ROWS = 1_500_000
"""Of longer data only every second, third, ... time is shown, so that the page stays quick."""

SIZES_M: dict[str, tuple[float, float]] = {
    "pedestrian": (0.2, 0.5),
    "bicycle": (1.6, 0.65),
    "moped": (2.1, 0.8),
    "motorcycle": (2.2, 0.9),
    "trailer": (16.5, 2.55),
    "truck": (7.1, 2.4),
    "lorry": (7.1, 2.4),
    "bus": (12.0, 2.5),
    "coach": (14.0, 2.6),
    "tram": (22.0, 2.4),
}
"""Length and width of SUMO's vehicle classes, which floating-car data do not hold: by a word in the vehicle type's
name."""
CAR_M = (5.0, 1.8)

TIME, ID, X, Y, ANGLE, SPEED, TYPE, LANE = (
    "timestep_time",
    *(f"vehicle_{name}" for name in ("id", "x", "y", "angle", "speed", "type", "lane")),
)
NEEDED = (TIME, ID, X, Y, ANGLE, SPEED)
CHECKED, NEAR_M = 2000, 25.0
"""How many positions are compared with the network, and how far from its lanes a vehicle may be."""
PARQUET_MAGIC, XML_BEGINS = b"PAR1", (b"<", b"\xef\xbb\xbf<", b"\x1f\x8b")


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
    if missing:
        raise InputError(
            f"'{file.name}' is no floating-car data of SUMO's: it has no {', '.join(missing)}; write them with "
            f"--fcd-output.attributes x,y,angle,speed,type,lane"
        )
    table = table[table[ID].notna() & table[X].notna() & table[TIME].between(begin_s, end_s)]
    if table.empty:
        raise InputError(f"'{file.name}' has no vehicles in it{_within(begin_s, end_s)}")
    table = table.sort_values(TIME, kind="stable")
    times_s = np.unique(table[TIME].to_numpy())
    step_s = float(np.diff(times_s).min()) if len(times_s) > 1 else 1.0
    moment = np.round((table[TIME].to_numpy() - times_s[0]) / step_s).astype(np.int32)
    every = math.ceil(len(table) / MOST_ROWS)
    table, moment = table[moment % every == 0], moment[moment % every == 0]
    frame = moment // every
    vehicle, ids = pd.factorize(table[ID].astype(str))
    kinds = table[TYPE].to_numpy() if TYPE in table else np.full(len(table), "")
    first = np.unique(vehicle, return_index=True)[1]
    vehicles = tuple(_vehicle(name, str(kinds[row])) for name, row in zip(ids, first, strict=True))
    heading_rad = np.pi / 2 - np.radians(table[ANGLE].to_numpy())
    to_centre_m = np.array([one.length_m for one in vehicles])[vehicle] / 2  # SUMO tells where the front is
    return Film(
        name=file.name,
        start_s=float(times_s[0]),
        step_s=round(step_s * every, 6),
        n_frames=int(frame[-1]) + 1,
        vehicles=vehicles,
        frame=frame,
        vehicle=vehicle.astype(np.int32),
        x_m=table[X].to_numpy() - to_centre_m * np.cos(heading_rad),
        y_m=table[Y].to_numpy() - to_centre_m * np.sin(heading_rad),
        heading_rad=heading_rad,
        speed_mps=table[SPEED].to_numpy(),
        left_out=_left_out(every, len(table)),
    )


def require_same_network(film: Film, ground: Ground) -> None:
    """Raise InputError if most vehicles are nowhere near the network's lanes."""
    sample = np.linspace(0, len(film.x_m) - 1, min(len(film.x_m), CHECKED)).astype(int)
    places = np.column_stack((film.x_m, film.y_m))[sample]
    lanes = [_along(lane.points) for lane in ground.lanes]
    far = len(places) if not lanes else int((cKDTree(np.concatenate(lanes)).query(places)[0] > NEAR_M).sum())
    if 2 * far > len(places):
        raise InputError(
            f"'{film.name}' is of another network than '{ground.name}': {far} of {len(places)} positions are far from "
            f"its lanes; name its own with --network, and write x and y in metres, without --fcd-output.geo"
        )


def _along(line: Floats) -> Floats:
    """Return points along a line, shape (n, 2), no farther apart than `NEAR_M`."""
    pairs = [
        np.linspace(start, stop, math.ceil(math.dist(start, stop) / NEAR_M) + 1)
        for start, stop in itertools.pairwise(line)
    ]
    return np.concatenate(pairs)


def _table(file: Path) -> pd.DataFrame:
    try:
        with file.open("rb") as stream:
            start = stream.read(4)
    except OSError as error:
        raise InputError(f"cannot read floating-car data '{file}': {error.strerror or error}") from None
    if start.startswith(PARQUET_MAGIC):
        how: Callable[[Path], pd.DataFrame] = _of_parquet
    else:
        how = _of_xml if start.startswith(XML_BEGINS) else _of_csv
    try:
        table = how(file)
        return table.astype({column: np.float64 for column in NEEDED if column != ID and column in table})
    except (*UNREADABLE, OSError, pa.ArrowException, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"'{file.name}' is no floating-car data of SUMO's, or is damaged: {reason}") from None


def _of_parquet(file: Path) -> pd.DataFrame:
    return pd.read_parquet(file)


def _of_csv(file: Path) -> pd.DataFrame:
    with file.open(encoding="utf-8", errors="replace") as stream:
        header = stream.readline()
    return pd.read_csv(file, sep=";" if ";" in header else ",", dtype={ID: str, TYPE: str})


def _of_xml(file: Path) -> pd.DataFrame:
    reader = _Reader()
    with opened(file) as stream:
        xml.sax.parse(stream, reader)
    return pd.DataFrame(reader.columns)


class _Reader(xml.sax.ContentHandler):
    """Collects the vehicles of every time step."""

    def __init__(self) -> None:
        super().__init__()
        self.columns: dict[str, list[Any]] = {name: [] for name in (*NEEDED, TYPE)}
        self._time_s = math.nan

    def startElement(self, name: str, attrs: Any) -> None:
        if name == "timestep":
            self._time_s = float(attrs["time"])
        elif name == "vehicle" and "x" in attrs:
            row = {TIME: self._time_s, ID: attrs["id"], TYPE: attrs.get("type", "")}
            row |= {column: float(attrs.get(column.removeprefix("vehicle_"), "nan")) for column in (X, Y, ANGLE, SPEED)}
            for column, value in row.items():
                self.columns[column].append(value)


def _vehicle(name: str, kind: str) -> Vehicle:
    vclass = next((word for word in SIZES_M if word in kind.lower()), "passenger")
    return Vehicle(name, vclass, *SIZES_M.get(vclass, CAR_M))


def _within(begin_s: float, end_s: float) -> str:
    return "" if math.isinf(begin_s) and math.isinf(end_s) else f" from {begin_s:g} to {end_s:g} s"


def _left_out(every: int, n_rows: int) -> str:
    return "" if every == 1 else f"One moment of {every} is shown, {n_rows} positions in all."
