"""What SUMO wrote of a run -> how all its vehicles drove, those of a share of them, and the others.

A row for each of these kinds, and sums for each edge and type of vehicles.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rail_sumo.highway.vehicle import hard_braking
from rail_sumo.highway.vehicle.hard_braking import AVERAGED_STEPS, EASED_MPS2, HARD_MPS2
from rail_sumo.records import KMH, SECONDS_PER_STEP, Lane

SAMPLED_S = AVERAGED_STEPS * SECONDS_PER_STEP
"""How often every vehicle's speed, lane and leader are noted: two samples tell the braking that may be hard."""
LEADER_WITHIN_M = 200.0
"""How far ahead somebody counts as the leader."""
PLACE_M = 20.0
"""So much of a lane is one place, at which speeds of different times are compared."""

TTC_S = 1.5
DRAC_MPS2 = 3.4
"""Deceleration to avoid a crash: (v - w)^2 / (2 gap). Archer (2005)."""
STANDS_MPS = 0.1
"""A vehicle stands that is slower, as SUMO counts."""
STUCK_S, FREE_M = 30.0, 15.0
"""A vehicle is stuck that stands for so long, and has nobody so near ahead, where nobody need wait."""
PETROL_G_PER_ML = 0.742
"""SUMO tells fuel by its mass."""

ALL, DRIVEN, OTHERS = "all", "driven", "others"
KINDS = (ALL, DRIVEN, OTHERS)

MEASURES: dict[str, str] = {
    "n_vehicles": "int64",  # on the road at some time of the period
    "inserted": "int64",
    "arrived": "int64",
    "unfinished": "int64",  # on the road at the end of the period
    "waiting": "int64",  # to be inserted, at the end of the period
    "vehkm": "float64",
    "flow_vehph": "float64",
    "density_vehpkm_lane": "float64",
    "speed_kmh": "float64",
    "speed_std_kmh": "float64",
    "speed_std_at_place_kmh": "float64",
    "time_loss_s_per_km": "float64",
    "depart_delay_s": "float64",
    "travel_time_s": "float64",
    "lane_changes_per_vehkm": "float64",
    "hard_brakings_per_vehkm": "float64",
    "ttc_below_1_5s_per_vehkm": "float64",
    "drac_above_3_4_per_vehkm": "float64",
    "co2_g_per_vehkm": "float64",
    "fuel_ml_per_vehkm": "float64",
    "collisions": "int64",
    "teleports": "int64",
    "stuck": "int64",
}
"""The measures, in order, with their pandas types. Their definitions are in docs/measures.md."""

SUMS: dict[str, str] = {
    "vehicle_s": "float64",
    "vehkm": "float64",
    "time_loss_s": "float64",
    "lane_changes": "int64",
    "hard_brakings": "int64",
    "ttc_below_1_5s": "int64",
    "drac_above_3_4": "int64",
    "stops": "int64",
    "stuck": "int64",
    "collisions": "int64",
}
"""What is summed for each edge, in order, with its pandas types."""


class Vehicle(NamedTuple):
    """Of which type a vehicle is, and how fast it is meant to drive: by its factor where a limit applies, at most."""

    kind: str
    speed_factor: float
    fastest_mps: float


@dataclass(frozen=True)
class Run:
    """What is known of a run beside SUMO's reports."""

    folder: Path
    """Where SUMO wrote them; see `options`."""
    from_s: float
    """When the period that counts begins, ..."""
    until_s: float
    """... and when it ends."""
    vehicles: Mapping[str, Vehicle]
    """Every vehicle that was inserted, by its id."""
    lanes: Mapping[str, Lane]
    """By their id."""
    edges: Set[str]
    """The road whose flow and density are told: the same in all runs of a demand, however far its vehicles get."""
    teleported: tuple[tuple[float, str], ...] = ()
    """When who was taken off the road to be put on again elsewhere."""


def options(folder: Path, *, places: bool = False) -> tuple[str, ...]:
    """Return the options that have SUMO write what `measures` reads, and where everybody is, if that is wanted."""
    attributes = "speed,pos,lane,leaderGap,leaderSpeed" + (",x,y,angle,type" if places else "")
    return (
        *("--fcd-output", str(folder / "fcd.csv"), "--fcd-output.attributes", attributes),
        *("--fcd-output.max-leader-distance", str(LEADER_WITHIN_M), "--device.fcd.period", str(SAMPLED_S)),
        *("--tripinfo-output", str(folder / "trips.xml"), "--tripinfo-output.write-unfinished", "true"),
        *("--tripinfo-output.write-undeparted", "true"),
        *("--lanechange-output", str(folder / "changes.xml"), "--collision-output", str(folder / "collisions.xml")),
    )


def floating_car_data(folder: Path) -> pd.DataFrame:
    """Return SUMO's floating-car data of a run as it has written them, from its beginning on."""
    return pd.read_csv(folder / "fcd.csv", sep=";", dtype={"vehicle_id": "str", "vehicle_type": "str"})


class Reports:
    """SUMO's reports of one run, read once; `measures` may be asked for several shares.

    Args:
        run: where they are, and what SUMO does not write.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._samples = _samples(run)
        self._trips = _trips(run.folder / "trips.xml")
        self._changes = _noted(run, "changes.xml", "change", id="id", lane="from")
        self._contacts = _noted(run, "collisions.xml", "collision", collider="collider", victim="victim", lane="lane")
        lanes_m: dict[str, list[float]] = {edge: [] for edge in run.edges}
        for name, lane in run.lanes.items():
            if lane.is_open and (edge := name.rpartition("_")[0]) in lanes_m:
                lanes_m[edge].append(lane.length_m)
        self._road_m = sum(max(of_edge) for of_edge in lanes_m.values() if of_edge)
        self._lanes_m = sum(sum(of_edge) for of_edge in lanes_m.values())

    @property
    def waiting(self) -> dict[str, str]:
        """The ids of those that were still to be inserted at the end, each with its type's."""
        waiting = self._trips[self._trips["depart"] < 0]
        return dict(zip(waiting["id"], waiting["kind"], strict=True))

    def measures(self, driven: Set[str]) -> Iterator[dict[str, Any]]:
        """Yield the measures of all vehicles, of those named and of the others, each with its kind as `vehicles`."""
        samples, trips = self._samples, self._trips
        for kind in KINDS:
            of_kind = samples if kind == ALL else samples[samples["id"].isin(driven) == (kind == DRIVEN)]
            trips_of_kind = trips if kind == ALL else trips[trips["id"].isin(driven) == (kind == DRIVEN)]
            belongs = {ALL: lambda name: True, DRIVEN: driven.__contains__, OTHERS: lambda name: name not in driven}
            yield {"vehicles": kind} | self._of(of_kind, trips_of_kind, belongs[kind])

    def edges(self, driven: Set[str]) -> pd.DataFrame:
        """Return `SUMS` by `vehicles` (those named or others), `type` and `edge`, of the edges that such drove on.

        And how many they were, as `n_vehicles`.
        """
        sums = self._sums.assign(vehicles=np.where(self._sums["id"].isin(driven), DRIVEN, OTHERS))
        groups = sums.groupby(["vehicles", "type", "edge"])
        return groups[list(SUMS)].sum().assign(n_vehicles=groups["id"].nunique()).reset_index()

    @cached_property
    def _sums(self) -> pd.DataFrame:
        """`SUMS` by the vehicles' `id`, with their `type`, and `edge`."""
        counts = {
            "hard_brakings": "brakes_hard",
            "ttc_below_1_5s": "ttc_short",
            "drac_above_3_4": "drac_high",
            "stops": "stops",
            "stuck": "is_stuck",
        }
        samples = self._samples.assign(
            vehicle_s=SAMPLED_S,
            vehkm=SAMPLED_S / 1000 * self._samples["speed"],
            time_loss_s=_time_loss_s(self._samples),
            **{name: self._samples[begins].astype("int64") for name, begins in counts.items()},
        )
        of_lanes = samples.groupby(["id", "lane"])[["vehicle_s", "vehkm", "time_loss_s", *counts]].sum()
        changes = self._changes.groupby(["id", "lane"]).size().rename("lane_changes")
        contacts = self._contacts.groupby(["collider", "lane"]).size().rename("collisions").rename_axis(["id", "lane"])
        sums = of_lanes.join([changes, contacts], how="outer").fillna(0).astype(SUMS).reset_index()
        kinds = {name: vehicle.kind for name, vehicle in self._run.vehicles.items()}
        edges = [lane.rpartition("_")[0] for lane in sums["lane"]]
        return sums.assign(type=sums["id"].map(kinds), edge=pd.Series(edges, dtype="str"))

    def _of(self, samples: pd.DataFrame, trips: pd.DataFrame, belongs: Callable[[str], bool]) -> dict[str, Any]:
        run = self._run
        period_s = run.until_s - run.from_s
        road_m, lanes_m = self._road_m, self._lanes_m
        there = samples[samples["is_on_edges"]]
        there_s, there_m = SAMPLED_S * len(there), SAMPLED_S * float(there["speed"].sum())
        driven_s, driven_m = SAMPLED_S * len(samples), SAMPLED_S * float(samples["speed"].sum())
        vehkm = driven_m / 1000
        departed = trips[(trips["depart"] >= run.from_s) & (trips["depart"] < run.until_s)]
        arrived = trips[(trips["arrival"] >= run.from_s) & (trips["arrival"] < run.until_s)]
        waiting = trips[trips["depart"] < 0]
        delays = pd.concat([departed["delay"], waiting["delay"]])
        whole_km = departed["metres"].sum() / 1000

        def within(events: list[tuple[float, Any]]) -> list[Any]:
            return [who for time_s, who in events if run.from_s <= time_s < run.until_s]

        def per_vehkm(count: float, km: float = vehkm) -> float:
            return count / km if km else np.nan

        return {
            "n_vehicles": samples["id"].nunique(),
            "inserted": len(departed),
            "arrived": len(arrived),
            "unfinished": int(((trips["depart"] >= 0) & (trips["arrival"] < 0)).sum()),
            "waiting": len(waiting),
            "vehkm": vehkm,
            "flow_vehph": 3600 * there_m / (road_m * period_s) if road_m else np.nan,
            "density_vehpkm_lane": 1000 * there_s / (lanes_m * period_s) if lanes_m else np.nan,
            "speed_kmh": KMH * driven_m / driven_s if driven_s else np.nan,
            "speed_std_kmh": KMH * _std_within(samples, "speed"),
            "speed_std_at_place_kmh": KMH * _std_within(samples, "faster"),
            "time_loss_s_per_km": per_vehkm(float(_time_loss_s(samples).sum())),
            "depart_delay_s": delays.mean() if len(delays) else np.nan,
            "travel_time_s": (arrived["arrival"] - arrived["depart"]).mean() if len(arrived) else np.nan,
            "lane_changes_per_vehkm": per_vehkm(sum(map(belongs, self._changes["id"]))),
            "hard_brakings_per_vehkm": per_vehkm(int(samples["brakes_hard"].sum())),
            "ttc_below_1_5s_per_vehkm": per_vehkm(int(samples["ttc_short"].sum())),
            "drac_above_3_4_per_vehkm": per_vehkm(int(samples["drac_high"].sum())),
            "co2_g_per_vehkm": per_vehkm(departed["co2_mg"].sum() / 1000, whole_km),
            "fuel_ml_per_vehkm": per_vehkm(departed["fuel_mg"].sum() / 1000 / PETROL_G_PER_ML, whole_km),
            "collisions": sum(
                belongs(collider) or belongs(victim)
                for collider, victim in zip(self._contacts["collider"], self._contacts["victim"], strict=True)
            ),
            "teleports": sum(map(belongs, within(list(run.teleported)))),
            "stuck": int(samples["is_stuck"].sum()),
        }


_SAMPLED = {
    "timestep_time": "float64",
    "vehicle_id": "str",
    "vehicle_speed": "float64",
    "vehicle_pos": "float64",
    "vehicle_lane": "str",
    "vehicle_leaderGap": "float64",
    "vehicle_leaderSpeed": "float64",
}


def _samples(run: Run) -> pd.DataFrame:
    """Return who drove how fast where in the period, twice a second, and where which conflict or braking begins."""
    try:
        read = pd.read_csv(
            run.folder / "fcd.csv",
            sep=";",
            usecols=list(_SAMPLED),
            dtype=_SAMPLED,
            na_values=[""],
            keep_default_na=False,
        )
    except (pd.errors.EmptyDataError, ValueError):  # nobody was on the road at any time
        read = pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in _SAMPLED.items()})
    read.columns = [name.rpartition("_")[2] for name in read.columns]
    read = read[(read["time"] >= run.from_s) & (read["time"] < run.until_s) & read["id"].notna()]
    read = read.sort_values(["id", "time"], kind="stable", ignore_index=True)
    on_edges = {lane for lane in read["lane"].unique() if lane.rpartition("_")[0] in run.edges}
    read["is_on_edges"] = read["lane"].isin(on_edges)
    read["faster"] = read["speed"] - read.groupby(["lane", read["pos"] // PLACE_M])["speed"].transform("mean")
    limits = read["lane"].map({name: lane.limit_mps for name, lane in run.lanes.items()}).to_numpy(np.float64)
    factors, fastest = (read["id"].map({name: one[n] for name, one in run.vehicles.items()}) for n in (1, 2))
    read["wish"] = np.minimum(limits * factors.to_numpy(np.float64), fastest.to_numpy(np.float64))
    speed, gap = read["speed"].to_numpy(), read["leaderGap"].to_numpy()
    closing = speed - read["leaderSpeed"].to_numpy()
    closes = (gap > 0.0) & (closing > 0.0)
    ttc = np.divide(gap, closing, out=np.full(len(read), np.inf), where=closes)
    drac = np.divide(closing**2, 2 * gap, out=np.zeros(len(read)), where=closes)
    is_next = (read["id"] == read["id"].shift()) & ((read["time"] - read["time"].shift()).round(1) == SAMPLED_S)
    is_next = is_next.to_numpy()
    braking = np.where(is_next, -np.diff(speed, prepend=speed[:1]) / SAMPLED_S, 0.0)
    read["brakes_hard"] = hard_braking.beginnings(braking > HARD_MPS2, braking < EASED_MPS2)
    read["ttc_short"] = _begins(ttc < TTC_S, is_next)
    read["drac_high"] = _begins(drac > DRAC_MPS2, is_next)
    read["stops"] = _begins(speed < STANDS_MPS, is_next)
    with_priority = {name for name, lane in run.lanes.items() if lane.has_priority}
    waits_for_nobody = read["lane"].isin(with_priority).to_numpy() & ((gap < 0.0) | (gap > FREE_M))
    read["is_stuck"] = _lasts((speed < STANDS_MPS) & waits_for_nobody, is_next, round(STUCK_S / SAMPLED_S))
    return read


def _time_loss_s(samples: pd.DataFrame) -> pd.Series:
    """Return how much later than by its wish a vehicle got on in each sample, in s."""
    return SAMPLED_S * (1 - samples["speed"] / samples["wish"]).clip(0)


def _noted(run: Run, file: str, tag: str, **attributes: str) -> pd.DataFrame:
    """Return what a file notes in the period: a row for each such element, and of each column the attribute named."""
    found = [
        tuple(map(one.get, attributes.values()))
        for one in _elements(run.folder / file, tag)
        if run.from_s <= float(one.get("time", "")) < run.until_s
    ]
    return pd.DataFrame(found, columns=list(attributes), dtype="str")


def _begins(holds: np.ndarray, is_next: np.ndarray) -> np.ndarray:
    """Return where something begins to hold for a vehicle; rows of a vehicle follow one another."""
    before = np.concatenate(([False], holds[:-1])) & is_next
    return holds & ~before


def _lasts(holds: np.ndarray, is_next: np.ndarray, n_samples: int) -> np.ndarray:
    """Return where something has just held for a vehicle for so many samples."""
    begins = _begins(holds, is_next)
    numbers = np.arange(len(holds))
    since = numbers - np.maximum.accumulate(np.where(begins, numbers, 0)) if len(holds) else numbers
    return holds & (since == n_samples - 1)


def _std_within(samples: pd.DataFrame, column: str) -> float:
    """Return how much something varies within vehicles: the root of the mean variance about each one's own mean."""
    if not len(samples):
        return np.nan
    deviation = samples[column] - samples.groupby("id")[column].transform("mean")
    return float(np.sqrt((deviation**2).mean()))


def _trips(file: Path) -> pd.DataFrame:
    """Return SUMO's `tripinfo`; of who has not departed or arrived the time is negative.

    Not of who was to depart just when the run ended, and has not waited for room.
    """
    rows = []
    for trip in _elements(file, "tripinfo"):
        depart, delay = float(trip.get("depart", "")), float(trip.get("departDelay", ""))
        if depart < 0.0 and delay <= 0.0:
            continue
        emissions = trip.find("emissions")
        rows.append({
            "id": trip.get("id"),
            "kind": trip.get("vType", ""),
            "depart": depart,
            "delay": delay,
            "arrival": float(trip.get("arrival", "")),
            "metres": float(trip.get("routeLength", "")),
            "co2_mg": 0.0 if emissions is None else float(emissions.get("CO2_abs", "0")),
            "fuel_mg": 0.0 if emissions is None else float(emissions.get("fuel_abs", "0")),
        })  # fmt: skip
    columns = ["id", "kind", "depart", "delay", "arrival", "metres", "co2_mg", "fuel_mg"]
    return pd.DataFrame(rows, columns=columns)


def _elements(file: Path, tag: str) -> Iterator[ElementTree.Element]:
    for _, element in ElementTree.iterparse(file):
        if element.tag == tag:
            yield element
