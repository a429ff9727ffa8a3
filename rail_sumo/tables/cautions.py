"""What the runs of a sweep tell against its own figures: who waits, where the road fills up or locks, who loses."""

import math
from collections.abc import Iterable, Iterator, Sequence

import pandas as pd

from rail_sumo.tables import shares, traffic

MOST_TOLD = 4
"""A note names so many groups of runs at most."""
GROWN, GROWN_BY = 10.0, 0.1
"""A road fills up where there are so many vehicles more at the end of the period, and by this share of those before."""
ALIKE = 1e-4
"""Seeds make hardly any difference where speed and flow agree to within this part of them."""
FULLER, FULLER_BY = 10.0, 0.04
"""A run begins fuller than share 0, and than with other seeds, by so many vehicles and by this share of them."""
BROKEN_DOWN = 0.5
"""A run has broken down if its mean speed is less than this share of the median of its other seeds'."""
FEWER, AT_LEAST = 0.5, 20
"""Traffic has gone from an edge where less than this share of the vehicles is left, if there were so many."""
SLOWER, SLOWER_S, EVEN = 2.0, 10.0, 1.5
"""Vehicles lose on an edge where each loses so many times as long there as at share 0, and so much longer; where the
time loss of all together is this many times as long, they lose everywhere."""
HARDLY_MOVES_KMH, OF_ALL_TIME, LINGERS_S, MOST_EDGES = 5.0, 0.05, 60.0, 3
"""Vehicles hardly move on an edge where they are slower than who walks, spend so much of the time of all vehicles, and
each more than before a light that is red; a note names so many edges at most."""
STOPS, STOPS_MORE = 3, 5.0
"""Driven cars stop where others hardly do if they have so many stops, so many times what comes on them at share 0."""
RESTLESS, RESTLESS_PER_KM = 3.0, 2.0
"""Cars change lanes far more often than others at so many times their rate, and so often a kilometre."""
FEW_TRIPS = 10
"""Of fewer trips in a period a mean tells little."""


def of_runs(table: pd.DataFrame, edges: pd.DataFrame) -> Iterator[str]:
    """Yield a note for each of what follows that the runs show.

    Args:
        table: `TRAFFIC_COLUMNS`.
        edges: `EDGE_COLUMNS`.
    """
    yield from backlog(table)
    yield from growth(table)
    yield from few_trips(table)
    yield from full_starts(table)
    yield from locks(table)
    yield from stuck(table, edges)
    yield from standstills(edges)
    yield from contacts(table, edges)
    yield from breakdowns(table)
    yield from restless(table)
    yield from alike(table)
    yield from emptied(edges)
    yield from losers(edges)
    yield from stops(edges)


def backlog(table: pd.DataFrame) -> Iterator[str]:
    """Tell where vehicles found no room to enter, which no mean of those on the road shows."""
    waiting = shares.of_all_vehicles(table).groupby(shares.ARM)["waiting"].mean()
    if waiting.max() >= 1.0:
        fewest, most = (
            f"{number:.0f} ({shares.called(*arm)})"
            for number, arm in ((waiting.min(), waiting.idxmin()), (waiting.max(), waiting.idxmax()))
        )
        n_waiting = f"from {fewest} to {most}" if round(waiting.min()) < round(waiting.max()) else f"about {most}"
        yield (
            f"vehicles still wait for room to enter at the end (column waiting), in the mean over seeds {n_waiting}: "
            "where fewer have entered, speeds are of less traffic, and flow is less without a lower capacity"
        )


def growth(table: pd.DataFrame) -> Iterator[str]:
    """Tell where more vehicles came than left, so that the figures depend on when the period begins and ends."""
    on_road = shares.of_all_vehicles(table).groupby(shares.ARM)[["unfinished", "inserted", "arrived"]].mean()
    ends = on_road["unfinished"]
    begins = _at_the_beginning(on_road)
    growth = ends - begins
    grown = growth[(growth >= GROWN) & (growth > GROWN_BY * begins)].sort_values(ascending=False)
    if len(grown):

        def told(arms: Iterable[tuple[str, str, float]]) -> str:
            return listed([f"{shares.called(*arm)} from {begins[arm]:.0f} to {ends[arm]:.0f}" for arm in arms])

        beside = [arm for arm in growth.index if arm[0] == shares.AS_THEY_ARE and not arm[2] and arm not in grown]
        yield (
            f"the road fills up in the period, by vehicles in the mean over seeds: {told(grown.index)}"
            f"{f' ({told(beside)})' if beside else ''}: figures depend on when it begins and ends"
        )


def few_trips(table: pd.DataFrame) -> Iterator[str]:
    """Tell where few vehicles enter in the period, or few arrive, since some measures are of their trips alone."""
    trips = shares.of_all_vehicles(table).groupby(shares.ARM)[["inserted", "arrived"]].min()
    few = (trips < FEW_TRIPS).any(axis=1)
    if few.any():
        told = [
            f"{shares.called(*arm)} {entered:.0f} and {arrived:.0f}"
            for arm, entered, arrived in trips[few].itertuples()
        ]
        yield (
            f"few vehicles enter or arrive in the period of a run (columns inserted, arrived), at the least "
            f"{listed(told)}: travel times are of those that arrive alone, and departure delays and CO2 of those that "
            "enter, CO2 as far as they come; begin earlier, or let the period be longer"
        )


def full_starts(table: pd.DataFrame) -> Iterator[str]:
    """Tell which runs begin with more vehicles on the road than share 0 does, and with other seeds do not."""
    of_all = shares.of_all_vehicles(table)
    runs = of_all[[*shares.ARM, "seed"]].assign(begins=_at_the_beginning(of_all))
    as_they_are = runs[runs["driver"] == shares.AS_THEY_ARE]
    zero = as_they_are.drop_duplicates(["setting", "seed"]).set_index(["setting", "seed"])["begins"]
    told = []
    for arm, of_arm in runs[runs["driver"] != shares.AS_THEY_ARE].groupby(shares.ARM, sort=False):
        if len(of_arm) <= 2:  # which of two is the fuller?
            continue
        more = of_arm["begins"] - zero.reindex(pd.MultiIndex.from_frame(of_arm[["setting", "seed"]])).to_numpy()
        least = more.clip(upper=more - more.median())  # than share 0, and than it is with the other seeds
        full = of_arm.assign(zero=of_arm["begins"] - more)[(least >= FULLER) & (least >= FULLER_BY * of_arm["begins"])]
        told += [
            f"{shares.called(*arm)} seed {seed}, {begun:.0f} vehicles for {zero:.0f}"
            for seed, begun, zero in full[["seed", "begins", "zero"]].itertuples(index=False)
        ]
    if told:
        yield (
            "the period begins with more vehicles than share 0 of the same seed, against other seeds: "
            f"{listed(told)}: they may have stood in the warm-up, and what dissolves is counted as flow; sweep --fcd "
            "shows it"
        )


def locks(table: pd.DataFrame) -> Iterator[str]:
    """Tell where SUMO took vehicles off the road that had stood for too long, as where it is locked."""
    locked = shares.of_all_vehicles(table).query("teleports > 0")
    if len(locked):
        yield (
            f"SUMO took vehicles off the road that had stood too long (column teleports), with the seeds "
            f"{_seeds(locked)}: the road may be locked there, or a light stay red (rail-sumo network check tells), and "
            "means are of unlike runs"
        )


def stuck(table: pd.DataFrame, edges: pd.DataFrame) -> Iterator[str]:
    """Tell in which runs who stood on a free road, and where, as two of SUMO's do that wait for each other."""
    runs = shares.of_all_vehicles(table)
    some = runs.assign(some=runs["stuck"] > 0).groupby(shares.ARM, sort=False)["some"].agg(["sum", "size"])
    standing = shares.told_once(edges)
    standing = standing.assign(driven=standing["stuck"].where(standing["vehicles"] == traffic.DRIVEN, 0))
    by_arm = standing.groupby(shares.ARM)
    told = []
    for arm, n, n_runs in some[some["sum"] > 0].itertuples(name=None):
        of_arm = by_arm.get_group(arm)
        by_edge = of_arm.groupby("edge")["stuck"].sum()
        who = f"{of_arm['driven'].sum()} of {by_edge.sum()} driven"
        told.append(f"{shares.called(*arm)} in {n} of {n_runs} runs ({who}, most on {by_edge.idxmax()})")
    if told:
        yield (
            f"vehicles stood for 30 s and longer with a free road ahead (column stuck): {listed(told)}: those behind "
            "lost that time too. Where it happens at share 0 alone, part of what driven cars gain is that, and where "
            "with driven cars alone, of what they lose: tell how many runs locked; sweep --fcd shows it"
        )


def standstills(edges: pd.DataFrame) -> Iterator[str]:
    """Tell where vehicles hardly move in every run without driven cars, as before a junction that locks in SUMO."""
    once = shares.told_once(edges)
    told = []
    for setting, as_they_are in once[once["driver"] == shares.AS_THEY_ARE].groupby("setting", sort=False):
        found = _where_vehicles_hardly_move(as_they_are)
        where = [f"{row.edge} ({row.speed_kmh:.1f} km/h, {row.part:.0%})" for row in found.itertuples()]
        if where:
            told.append(f"{shares.called(shares.AS_THEY_ARE, str(setting), 0.0)}: {listed(where, MOST_EDGES)}")
    if told:
        yield (
            "vehicles hardly move on some edges in every run without any driven car, at so many km/h and for so much "
            f"of the time of all vehicles (edges.parquet): {listed(told)}: the figures of the whole road are to a "
            "good part of those who stand there; look at single edges, or mend the network or the demand"
        )


def contacts(table: pd.DataFrame, edges: pd.DataFrame) -> Iterator[str]:
    """Tell in which runs vehicles touched, which a mean over seeds does not, where, and how often driven ones did."""
    touched = shares.of_all_vehicles(table).query("collisions > 0")
    driven = table[(table["vehicles"] == traffic.DRIVEN) & (table["driver"] != shares.AS_THEY_ARE)]
    of_driven = driven.groupby(shares.ARM)["collisions"].sum()
    by_edge = edges.groupby([*shares.ARM, "edge"])["collisions"].sum()
    told, without_driven = [], 0
    for arm, of_arm in touched.groupby(shares.ARM, sort=False):
        n, n_driven, there = of_arm["collisions"].sum(), of_driven.get(arm, 0), by_edge[arm]
        without_driven += n - n_driven
        seeds = f"{'seeds' if len(of_arm) > 1 else 'seed'} {', '.join(map(str, of_arm['seed']))}"
        who = "" if arm[0] == shares.AS_THEY_ARE else f", {n_driven} of driven cars"
        where = "" if there.max() == n else f"{there.max()} of them "
        n_contacts = f"{n} contact{'s' if n > 1 else ''}"
        told.append(f"{shares.called(*arm)} with {seeds} ({n_contacts}{who}, {where}on {there.idxmax()})")
    if told:
        same = "; they may be the same two at the same time in several runs, which are no independent ones"
        alone = (
            "; those of SUMO's vehicles alone, as where a lorry waits in the way of others, are no gain or loss in "
            "safety that driven cars bring"
        )
        yield (
            f"vehicles touched (column collisions): {listed(told)}{same if len(touched) > 1 else ''}"
            f"{alone if without_driven else ''}. docs/measures.md says how to list them: when, which two, on which lane"
        )


def restless(table: pd.DataFrame) -> Iterator[str]:
    """Tell where driven cars change lanes many times as often as the same cars do as they are."""
    of_cars = table[table["vehicles"] == traffic.DRIVEN]
    rates = of_cars.groupby(shares.ARM, sort=False)["lane_changes_per_vehkm"].mean()
    told = []
    for (driver, setting, share), rate in rates.items():
        theirs = rates.get((shares.AS_THEY_ARE, setting, share), math.nan)
        if driver != shares.AS_THEY_ARE and rate > max(RESTLESS * theirs, RESTLESS_PER_KM):
            told.append(f"{shares.called(driver, setting, share)} {rate:.1f} times a km, as they are {theirs:.1f}")
    if told:
        yield (
            f"driven cars change lanes far more often than the same cars do as they are: {listed(told)}: a learned "
            "driver may do so for nothing, as where bends are tight; see docs/limits.md, and compare with rule"
        )


def breakdowns(table: pd.DataFrame) -> Iterator[str]:
    """Tell which runs broke down where others of the same driver and share did not: a mean describes neither."""
    told = []
    for arm, of_arm in shares.of_all_vehicles(table).groupby(shares.ARM, sort=False):
        speeds = of_arm.set_index("seed")["speed_kmh"].dropna()
        for seed, speed in speeds.items() if len(speeds) > 2 else ():
            others = speeds.drop(seed).median()
            if speed < BROKEN_DOWN * others:
                told.append(f"{shares.called(*arm)} seed {seed} at {speed:.0f} km/h, the others at {others:.0f}")
    if told:
        yield (
            f"traffic breaks down with some seeds (traffic.csv): {listed(told)}: means and intervals are of unlike "
            "runs; tell how many broke down"
        )


def alike(table: pd.DataFrame) -> Iterator[str]:
    """Tell where seeds make no difference or hardly any, as where nothing is drawn: an interval tells little there."""
    runs = shares.of_all_vehicles(table)
    measured = [name for name in shares.MEASURED if name in runs]
    same, nearly = [], []
    for arm, of_arm in runs.groupby(shares.ARM, sort=False):
        if len(of_arm) == 1:
            continue
        traffic_of_run = of_arm[["speed_kmh", "flow_vehph"]]
        spread = traffic_of_run.max() - traffic_of_run.min()
        if len(of_arm[measured].drop_duplicates()) == 1:
            same.append(shares.called(*arm))
        elif (spread <= ALIKE * traffic_of_run.mean()).all():
            nearly.append(shares.called(*arm))
    vary = "vary the demand, for example by --set 'traffic.options=[\"random-depart-offset=5\"]'"
    if same:
        yield f"every seed drove the same: {listed(same)}: that is one run, and its interval says nothing; {vary}"
    if nearly:
        yield (
            f"seeds make hardly any difference, less than 0.01 % in speed and flow: {listed(nearly)}: that is nearly "
            f"one run, and its interval says little; {vary}"
        )


def emptied(edges: pd.DataFrame) -> Iterator[str]:
    """Tell where far fewer vehicles come to an edge than at share 0, as to an exit before which they stand."""
    once = shares.told_once(_outside_junctions(edges))
    counts = once.groupby([*shares.ARM, "edge"], sort=False)["n_vehicles"].sum().reset_index()
    as_they_are = counts[counts["driver"] == shares.AS_THEY_ARE]
    told = []
    for (driver, setting, share), of_arm in counts.groupby(shares.ARM, sort=False):
        before = as_they_are[as_they_are["setting"] == setting].set_index("edge")["n_vehicles"]
        now = of_arm.set_index("edge")["n_vehicles"].reindex(before.index, fill_value=0)
        gone = before[(before >= AT_LEAST) & (now < FEWER * before)].index
        if len(gone):
            worst = (now[gone] / before[gone]).nsmallest(MOST_TOLD).index
            where = ", ".join(f"{edge} ({now[edge]} of {before[edge]})" for edge in worst)
            told.append(f"{shares.called(driver, setting, share)}: {where}")
    if told:
        yield (
            f"far fewer vehicles come to some edges than at share 0 (edges.parquet; all seeds together): "
            f"{listed(told)}: they may stand before, or have not come so far"
        )


def losers(edges: pd.DataFrame) -> Iterator[str]:
    """Tell where vehicles lose far more time than at share 0, and all together do not: a mean hides who loses."""
    once = shares.told_once(_outside_junctions(edges))
    sums = once.groupby([*shares.ARM, "edge"])[["n_vehicles", "time_loss_s"]].sum()
    each = (sums["time_loss_s"] / sums["n_vehicles"])[sums["n_vehicles"] >= AT_LEAST]
    of_all = shares.rates(edges, shares.ARM).set_index(shares.ARM)["time_loss_s_per_km"]
    by_edge = each.unstack("edge").reindex(of_all.index)
    told = []
    for arm in of_all.index:
        as_they_are = (shares.AS_THEY_ARE, arm[1], 0.0)
        if arm == as_they_are or as_they_are not in of_all.index or of_all[arm] > EVEN * of_all[as_they_are]:
            continue
        before, now = by_edge.loc[as_they_are], by_edge.loc[arm]
        worst = (now - before)[(now > SLOWER * before) & (now > before + SLOWER_S)].nlargest(MOST_TOLD).index
        if len(worst):
            where = ", ".join(f"{edge} ({before[edge]:.0f} to {now[edge]:.0f})" for edge in worst)
            of_both = f"{of_all[as_they_are]:.0f} to {of_all[arm]:.0f} s/km"
            told.append(f"{shares.called(*arm)}: {where}, while all together go from {of_both}")
    if told:
        yield f"some lose far more time than at share 0, in s a vehicle on an edge (edges.parquet): {listed(told)}"


def stops(edges: pd.DataFrame) -> Iterator[str]:
    """Tell where driven cars come to a stop and vehicles of share 0 hardly do, as at the end of a lane that joins."""
    once = shares.told_once(_outside_junctions(edges))
    as_they_are = once[once["driver"] == shares.AS_THEY_ARE].groupby(["setting", "edge"])[["stops", "n_vehicles"]].sum()
    each = (as_they_are["stops"] / as_they_are["n_vehicles"]).rename("each").reset_index()
    of_driven = once[(once["vehicles"] == traffic.DRIVEN) & (once["driver"] != shares.AS_THEY_ARE)]
    sums = of_driven.groupby([*shares.ARM, "edge"], sort=False)[["stops", "n_vehicles"]].sum().reset_index()
    sums = sums.merge(each, how="left", on=["setting", "edge"])
    many = sums[(sums["stops"] >= STOPS) & (sums["stops"] > STOPS_MORE * sums["each"] * sums["n_vehicles"])]
    told = []
    for arm, of_arm in many.groupby(shares.ARM, sort=False):
        worst = of_arm.nlargest(MOST_TOLD, "stops")
        where = ", ".join(f"{row.edge} ({row.stops} by {row.n_vehicles})" for row in worst.itertuples())
        told.append(f"{shares.called(*arm)}: {where}")
    if told:
        yield (
            "driven cars come to a stop where vehicles hardly do at share 0, in stops by so many cars on an edge "
            f"(column stops of edges.parquet; all seeds): {listed(told)}: means hide that, as at the end of a lane "
            "that joins; see docs/share.md"
        )


def listed(told: Sequence[str], most: int = MOST_TOLD) -> str:
    """Return the first of what is told, and how many more there are."""
    more = f" and {len(told) - most} more" if len(told) > most else ""
    return "; ".join(told[:most]) + more


def _outside_junctions(edges: pd.DataFrame) -> pd.DataFrame:
    return edges[~edges["edge"].str.startswith(":")]


def _where_vehicles_hardly_move(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the edges where that holds in every run: their `speed_kmh`, and `part` of the time of all vehicles."""
    in_runs = runs.groupby(["edge", "seed"])[["n_vehicles", "vehicle_s", "vehkm"]].sum().reset_index()
    hardly_move = (
        (3600 * in_runs["vehkm"] < HARDLY_MOVES_KMH * in_runs["vehicle_s"])
        & (in_runs["vehicle_s"] >= LINGERS_S * in_runs["n_vehicles"])
        & (in_runs["vehicle_s"] >= OF_ALL_TIME * in_runs.groupby("seed")["vehicle_s"].transform("sum"))
    )
    in_all_runs = hardly_move.groupby(in_runs["edge"]).sum() == runs["seed"].nunique()
    sums = in_runs.groupby("edge")[["vehicle_s", "vehkm"]].sum()
    rates = pd.DataFrame({
        "speed_kmh": 3600 * sums["vehkm"] / sums["vehicle_s"],
        "part": sums["vehicle_s"] / sums["vehicle_s"].sum(),
    })  # fmt: skip
    return _outside_junctions(rates[in_all_runs].reset_index()).sort_values("part", ascending=False)


def _at_the_beginning(counts: pd.DataFrame) -> "pd.Series[float]":
    """Return how many vehicles were on the road when the period began, from those of its end."""
    return counts["unfinished"] - counts["inserted"] + counts["arrived"]


def _seeds(runs: pd.DataFrame) -> str:
    """Return the seeds of some runs, by driver and share."""
    return listed(
        [
            f"{shares.called(driver, setting, share)} {', '.join(map(str, of_arm['seed']))}"
            for (driver, setting, share), of_arm in runs.groupby(shares.ARM, sort=False)
        ]
    )
