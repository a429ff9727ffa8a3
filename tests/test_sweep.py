"""Sweeps over shares and keys: what they write, go on with and refuse."""

import json
import math
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from sketch import cut_road

from rail_sumo import assets, cli, config_file, rollout
from rail_sumo.errors import InputError
from rail_sumo.pictures import fcd, plot
from rail_sumo.studies import share_run, sweep, sweep_report
from rail_sumo.studies.sweep import Sweep
from rail_sumo.tables import cautions, report, shares, traffic
from rail_sumo.tables.shares import AS_THEY_ARE, TOLD, compared, summarised, told_table

ROUTES = """<routes>
    <vType id="car" speedFactor="normc(0.9,0.1,0.7,1.1)"/><vType id="lorry" vClass="truck" maxSpeed="22"/>
    <route id="r" edges="highway"/>
    <flow id="car" type="car" route="r" begin="0" end="200" period="exp(0.4)" departLane="random"/>
    <flow id="lorry" type="lorry" route="r" begin="0" end="200" period="exp(0.1)" departLane="0" departSpeed="desired"/>
</routes>"""


@pytest.fixture
def figures():
    """For the tests that look at figures: they take most of a small sweep's time, and are not drawn for others."""


@pytest.fixture(autouse=True)
def only_figures_that_are_looked_at(request, monkeypatch):
    if "figures" not in request.fixturenames:
        monkeypatch.setattr(sweep_report, "draw", lambda *_: None)


@pytest.fixture
def demand(tmp_path):
    path = tmp_path / "light.rou.xml"
    path.write_text(ROUTES)
    return path


@pytest.fixture
def world(demand):
    return config_file.validate({"network": {"file": "highway3"}, "traffic": {"routes": [str(demand)]}})


def small(world, out, **changes):
    given = {"drivers": ("rule", "acc"), "shares": (0.0, 0.5, 1.0), "seeds": 2, "duration_s": 10.0, "warm_up_s": 20.0}
    return Sweep(world, out=out, **given | changes)


class Hears:
    """An observer that keeps what it is told."""

    def __init__(self):
        self.said = []

    def start(self, work, total, done=0): ...

    def advance(self, figures): ...

    def note(self, text):
        self.said.append(text)


TABLES = ("traffic.csv", "summary.csv", "differences.csv", "edges.parquet", "sweep.md")


def test_one_and_two_workers_write_the_same_and_what_is_missing_is_driven_again(world, tmp_path):
    once, twice = tmp_path / "once", tmp_path / "twice"
    small(world, once).drive()
    small(world, twice, workers=2).drive()
    for name in TABLES:
        assert (once / name).read_bytes() == (twice / name).read_bytes()
    cells = sorted((once / "cells").iterdir())
    assert len(cells) == 2 * 2 * (1 + 2 * 2)  # of each run, the rows and the edges
    kept = {cell: cell.stat().st_mtime_ns for cell in cells}
    cells[0].unlink()
    cells[3].write_bytes(b"cut off")
    for name in TABLES:
        (once / name).unlink()
    small(world, once).drive()
    for name in TABLES:
        assert (once / name).read_bytes() == (twice / name).read_bytes()
    driven = {cell for cell in cells if cell.stat().st_mtime_ns != kept[cell]}
    assert driven == set(cells[:4])


@pytest.mark.parametrize(("n_done", "whole"), [(2, 0), (7, 1), (13, 2)])
def test_an_interrupted_sweep_leaves_the_tables_of_the_seeds_that_all_have_driven(
    world, tmp_path, monkeypatch, n_done, whole
):
    """Two settings of two drivers and nobody: six runs a seed."""
    finish, done = share_run.finish, []

    def finish_until(one):
        if len(done) == n_done:
            raise KeyboardInterrupt
        done.append(one)
        return finish(one)

    of_two = {"key": "adas.time_gap_s", "settings": ("1", "2"), "drivers": ("rule", "keep"), "shares": (0.5,)}
    swept = small(world, tmp_path / "out", seeds=3, **of_two)
    monkeypatch.setattr(share_run, "finish", finish_until)
    with pytest.raises(KeyboardInterrupt) as stopped:
        swept.drive()
    assert getattr(stopped.value, "seeds", 0) == whole
    assert (tmp_path / "out" / "traffic.csv").exists() == bool(whole)
    monkeypatch.setattr(share_run, "finish", finish)
    if whole:
        assert f"interrupted: the tables are of {whole} of 3 seeds" in (tmp_path / "out" / "sweep.md").read_text()
        few = small(world, tmp_path / "few", seeds=whole, **of_two).drive()
        pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "out" / "traffic.parquet"), few.traffic)
    assert set(swept.drive().traffic["seed"]) == {0, 1, 2}
    assert "interrupted" not in (tmp_path / "out" / "sweep.md").read_text()


def test_what_a_learned_driver_has_driven_is_known_again_by_another_process(demand):
    """The order of a set of strings, such as of the fields of a configuration that are set, is another in each."""
    named = ("rail", "road-expert", "rule")
    told = (
        "from pathlib import Path; from rail_sumo import config_file; from rail_sumo.studies.sweep import Sweep; "
        f"world = config_file.load(None, ['network.file=highway3', 'traffic.routes=[\"{demand}\"]']); "
        f"print([one.made_of for one in Sweep(world, {named}, (0.5,), Path('out'), seeds=1)._work()])"
    )
    first, second = (
        subprocess.run(
            [sys.executable, "-c", told],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    )
    assert first == second
    assert assets.sha256(assets.driver("rail") / "policy.safetensors") in first


def test_floating_car_data_are_of_the_very_runs_and_are_made_where_they_are_missing(world, tmp_path):
    swept = small(world, tmp_path / "out", drivers=("rule",), shares=(1.0,), seeds=1)
    swept.drive()
    assert not (tmp_path / "out" / "fcd").exists()
    tables = replace(swept, fcd=True).drive()
    for name, vehicles in (("rule-1", 1.0), ("sumo-0", 0.0)):
        data = pd.read_parquet(tmp_path / "out" / "fcd" / f"{name}-seed0.parquet")
        counted = data[(data["timestep_time"] >= 20.0) & (data["timestep_time"] < 30.0)]
        rows = tables.traffic[(tables.traffic["vehicles"] == "all") & (tables.traffic["share"] == vehicles)]
        row = rows[rows["driver"] == name.partition("-")[0]].iloc[0]
        assert counted["vehicle_id"].nunique() == row["n_vehicles"]
        assert 3.6 * counted["vehicle_speed"].mean() == pytest.approx(row["speed_kmh"])
        film = fcd.read(tmp_path / "out" / "fcd" / f"{name}-seed0.parquet")
        assert film.step_s == 0.5
        assert 55 <= film.n_frames <= 61  # the first car departs by chance


def test_runs_of_another_world_or_period_are_kept_and_told_of(world, tmp_path):
    first = small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1)
    first.drive()
    kept = {file: file.read_bytes() for file in (tmp_path / "out").rglob("*.*")}
    other = config_file.changed(world, ["network.limit_factor=0.5"])
    with pytest.raises(InputError, match=r"were driven with network.limit_factor = 1.0, not 0.5; choose another --out"):
        replace(first, config=other).drive()
    with pytest.raises(InputError, match=r"were driven with \d+ s after \d+ s of warm-up, not 33 after"):
        replace(first, duration_s=33.0).drive()
    assert {file: file.read_bytes() for file in (tmp_path / "out").rglob("*.*")} == kept


def test_a_sweep_is_not_written_over_an_evaluation_or_a_run(world, tmp_path):
    for name in ("episodes.parquet", "config.toml"):
        out = tmp_path / name.partition(".")[0]
        out.mkdir()
        (out / name).write_text("mine")
        with pytest.raises(InputError, match="holds a run or an evaluation"):
            small(world, out, drivers=("acc",), shares=(1.0,), seeds=1).drive()
        assert [path.name for path in out.iterdir()] == [name]


def test_the_table_has_a_row_for_each_driver_share_seed_and_kind(world, tmp_path):
    table = small(world, tmp_path / "out").drive().traffic
    assert list(table.columns) == list(shares.TRAFFIC_COLUMNS)
    keys = table[["driver", "share", "seed", "vehicles"]]
    assert not keys.duplicated().any()
    assert len(table) == 2 * 3 * (3 + 2 * 2)  # seeds, kinds; as they are at every share, two drivers at two
    of_all = table[table["vehicles"] == traffic.ALL]
    assert of_all.groupby("seed")["inserted"].nunique().max() == 1
    for _, one in table.groupby(["driver", "share", "seed"]):
        by_kind = one.set_index("vehicles")
        for count in ("n_vehicles", "vehkm", "flow_vehph"):
            assert by_kind.loc["driven", count] + by_kind.loc["others", count] == pytest.approx(
                by_kind.loc["all", count], abs=1e-5
            )
    driven = (
        table[table["vehicles"] == traffic.DRIVEN].set_index(["driver", "share", "seed"])["n_vehicles"].sort_index()
    )
    assert (driven[(AS_THEY_ARE, 0.0)] == 0).all()
    assert (driven[("rule", 0.5)] > 0).all()
    assert (driven[("rule", 0.5)] < driven[("rule", 1.0)]).all()
    lorries = table[(table["share"] == 1.0) & (table["vehicles"] == traffic.OTHERS)]
    assert (lorries["n_vehicles"] > 0).all()
    as_they_are = table[(table["driver"] == AS_THEY_ARE) & (table["vehicles"] == traffic.ALL)]
    assert as_they_are.drop(columns="share").drop_duplicates().shape[0] == 2  # at every share the same: the placebo


def made_up(values):
    """A `traffic` table of two seeds in which only the speed differs: by driver, share and kind."""
    rows = [
        {"driver": driver, "setting": "", "share": share, "seed": seed, "vehicles": kind, "undriven": 0}
        | dict.fromkeys(traffic.MEASURES, 1.0)
        | {"speed_kmh": speed, "collisions": 0}
        for (driver, share, kind), speeds in values.items()
        for seed, speed in enumerate(speeds)
    ]
    return report.typed(rows, shares.TRAFFIC_COLUMNS)


@pytest.mark.parametrize(("unfinished", "told"), [(100, False), (110, False), (121, True)])
def test_a_road_that_fills_up_in_the_period_is_told_of_whoever_drives(unfinished, told):
    """From 100 vehicles on the road at the beginning; as they are it stays at that."""
    counts = {"vehicles": "all", "setting": "", "inserted": 60}
    table = pd.DataFrame([
        counts | {"driver": "sumo", "share": 0.0, "seed": 0, "unfinished": 100, "arrived": 60},
        counts | {"driver": "rule", "share": 0.5, "seed": 0, "unfinished": unfinished, "arrived": 160 - unfinished},
    ])  # fmt: skip
    notes = list(cautions.growth(table))
    assert bool(notes) == told
    if told:
        assert notes[0].startswith(
            "the road fills up in the period, by vehicles in the mean over seeds: rule at 50% from 100 to 121 (as they "
            "are from 100 to 100): figures"
        )


def test_a_run_that_breaks_down_where_others_do_not_is_told_of():
    def runs(*speeds_kmh, share=0.3):
        about = {"vehicles": "all", "setting": "", "driver": "rule", "share": share}
        return [about | {"seed": seed, "speed_kmh": speed} for seed, speed in enumerate(speeds_kmh)]

    [note] = cautions.breakdowns(pd.DataFrame([*runs(40.0, 41.0, 10.1, 40.5), *runs(38.0, 39.0, 40.0, share=1.0)]))
    assert "some seeds (traffic.csv): rule at 30% seed 2 at 10 km/h, the others at 40: means" in note
    assert not list(cautions.breakdowns(pd.DataFrame(runs(40.0, 41.0, 21.0))))
    assert not list(cautions.breakdowns(pd.DataFrame(runs(40.0, 10.0))))  # which of two?


def test_seeds_that_make_no_difference_are_told_of():
    rows = [
        *(("sumo", 0.0, k, 40.0 + k, 900.0) for k in range(3)),
        *(("rule", 0.5, k, 41.0, 900.0 + k) for k in range(3)),
        *(("rule", 1.0, k, 42.0, 900.0) for k in range(3)),
        *(("acc", 0.5, k, 42.0 + k / 500, 900.0) for k in range(3)),
        ("acc", 1.0, 0, 42.0, 900.0),  # one run is no interval
    ]
    table = pd.DataFrame(rows, columns=["driver", "share", "seed", "speed_kmh", "flow_vehph"])
    table = table.assign(vehicles="all", setting="")
    same, nearly = cautions.alike(table)
    assert same.startswith("every seed drove the same: rule at 100%: that is one run")
    assert "less than 0.01 % in speed and flow: acc at 50%: that is nearly one run" in nearly
    assert not list(cautions.alike(table[(table["share"] < 1.0) & (table["driver"] != "acc")]))


def test_a_road_that_locks_with_some_seeds_is_told_of():
    about = {"vehicles": "all", "setting": "", "teleports": 0}
    table = pd.DataFrame([
        about | {"driver": "sumo", "share": 0.0, "seed": 0},
        about | {"driver": "sumo", "share": 0.5, "seed": 1, "teleports": 3},  # told once, of share 0
        about | {"driver": "rule", "share": 0.5, "seed": 0, "teleports": 2},
        about | {"driver": "rule", "share": 0.5, "seed": 3, "teleports": 1},
    ])  # fmt: skip
    (note,) = cautions.locks(table)
    assert "with the seeds rule at 50% 0, 3: the road may be locked there" in note
    assert not list(cautions.locks(table[table["teleports"] == 0]))


def test_a_run_that_begins_with_more_vehicles_than_with_other_seeds_is_told_of():
    def row(driver, share, seed, begins):
        counts = {"unfinished": begins + 6, "inserted": 376, "arrived": 370}
        return {"vehicles": "all", "setting": "", "driver": driver, "share": share, "seed": seed} | counts

    as_they_are = [row("sumo", 0.0, seed, begins) for seed, begins in enumerate((262, 240, 261))]
    driven = [row("rule", 0.25, seed, begins) for seed, begins in enumerate((276, 241, 260))]
    (note,) = cautions.full_starts(pd.DataFrame([*as_they_are, *driven]))
    assert "against other seeds: rule at 25% seed 0, 276 vehicles for 262: they may have stood in the warm-up" in note
    alike = [row("rule", 0.25, seed, begins) for seed, begins in enumerate((282, 260, 280))]  # as their traffic is
    assert not list(cautions.full_starts(pd.DataFrame([*as_they_are, *alike])))
    emptier = [row("rule", 0.25, seed, begins) for seed, begins in enumerate((266, 220, 241))]  # by 4, -20, -20
    assert not list(cautions.full_starts(pd.DataFrame([*as_they_are, *emptier])))
    assert not list(cautions.full_starts(pd.DataFrame([*as_they_are[:2], *driven[:2]])))  # which of two is the fuller?


def test_runs_in_which_somebody_stands_on_a_free_road_are_told_of():
    about = {"vehicles": "all", "setting": ""}
    table = pd.DataFrame([
        *(about | {"driver": "sumo", "share": 0.0, "seed": seed, "stuck": n} for seed, n in enumerate((2, 0, 1))),
        about | {"driver": "sumo", "share": 0.5, "seed": 0, "stuck": 2},  # told once, of share 0
        *(about | {"driver": "rule", "share": 0.5, "seed": seed, "stuck": 3 * (seed == 1)} for seed in range(3)),
        *(about | {"driver": "rule", "share": 1.0, "seed": seed, "stuck": 0} for seed in range(3)),
    ])  # fmt: skip
    rows = [
        *(("sumo", share, "others", edge, n) for share in (0.0, 0.5) for edge, n in (("main", 1), ("ramp", 2))),
        *(("rule", 0.5, kind, "ramp", n) for kind, n in (("others", 2), ("driven", 1))),
        *(("rule", 1.0, "driven", edge, 0) for edge in ("main", "ramp")),
    ]
    edges = pd.DataFrame(rows, columns=["driver", "share", "vehicles", "edge", "stuck"]).assign(setting="")
    (note,) = cautions.stuck(table, edges)
    told = (
        "as they are in 2 of 3 runs (0 of 3 driven, most on ramp); rule at 50% in 1 of 3 runs (1 of 3 driven, most on"
    )
    assert f"a free road ahead (column stuck): {told} ramp): those behind lost" in note
    assert not list(cautions.stuck(table[table["share"] == 1.0], edges))


def test_edges_where_vehicles_hardly_move_without_any_driven_car_are_told_of():
    def rows(driver, share, seed, **ramps):
        """Of each ramp: by how many vehicles, for how long together, at what speed; and a main road of 10,000 s."""
        about = {"driver": driver, "setting": "", "share": share, "seed": seed, "vehicles": "others"}
        return [
            about | {"edge": edge, "n_vehicles": n, "vehicle_s": time_s, "vehkm": speed_kmh * time_s / 3600}
            for edge, (n, time_s, speed_kmh) in {"main": (200, 10_000.0, 50.0), **ramps}.items()
        ]

    def notes(*of_runs):
        return list(cautions.standstills(pd.DataFrame([row for of_run in of_runs for row in of_run])))

    locked, full, free = (20, 2000.0, 0.4), (20, 2000.0, 0.8), (20, 100.0, 40.0)
    (note,) = notes(
        rows("sumo", 0.0, 0, ramp=locked, other=locked),
        rows("sumo", 0.0, 1, ramp=full, other=free),
        rows("sumo", 0.5, 0, ramp=free),  # told once, of share 0
        rows("rule", 0.5, 0, ramp=free),  # whoever drives
    )
    assert "any driven car, at so many km/h and for so much of the time of all vehicles (edges.parquet): " in note
    assert ": as they are: ramp (0.6 km/h, 15%): the figures of the whole road" in note  # 4,000 of 26,100 s
    for unlike in (
        (5, 500.0, 0.4),  # less than a twentieth of the time of all
        (20, 2000.0, 5.1),  # they walk
        (50, 2000.0, 3.0),  # 40 s each, as before a light
    ):
        assert not notes(rows("sumo", 0.0, 0, ramp=locked), rows("sumo", 0.0, 1, ramp=unlike))
    assert not notes(rows("sumo", 0.0, 0, **{":junction": locked}))
    assert not notes(rows("rule", 0.5, 0, ramp=locked), rows("sumo", 0.0, 0, ramp=free))
    (note,) = notes(rows("sumo", 0.0, 0, **{f"ramp{k}": (20, 2000.0 + k, 0.4) for k in range(5)}))
    assert ": ramp4 (0.4 km/h, 10%); ramp3 (0.4 km/h, 10%); ramp2 (0.4 km/h, 10%) and 2 more: " in note


@pytest.mark.parametrize(("period_s", "is_told"), [(1.2, True), (30.0, False)])
def test_a_minor_road_that_finds_no_gap_is_told_of_though_nobody_is_driven(tmp_path, period_s, is_told):
    demand = tmp_path / "crossing.rou.xml"
    demand.write_text(
        '<routes><route id="major" edges="in out"/><route id="minor" edges="up on"/>'
        f'<flow id="a" route="major" begin="0" end="300" period="{period_s}" departSpeed="max"/>'
        '<flow id="b" route="minor" begin="0" end="300" period="5" departLane="random" departPos="400"/></routes>'
    )
    network = {"file": str(Path(__file__).with_name("crossing.net.xml"))}
    world = config_file.validate({"network": network, "traffic": {"routes": [str(demand)]}})
    swept = small(world, tmp_path / "out", drivers=("sumo",), shares=(0.0,), duration_s=120.0, warm_up_s=120.0)
    told = [note for note in swept.drive().notes if note.startswith("vehicles hardly move")]
    assert len(told) == is_told
    assert all(
        re.search(r": as they are: up \(\d\.\d km/h, \d\d%\): the figures of the whole road", note) for note in told
    )


@pytest.mark.parametrize("shares", [(0.0,), (0.0, 1.0)])
def test_vehicles_as_they_are_may_be_looked_at_alone(world, tmp_path, figures, shares):
    tables = small(world, tmp_path / "out", drivers=("sumo",), shares=shares).drive()
    assert set(tables.traffic["driver"]) == {"sumo"}
    assert tables.differences.empty
    assert "| as they are | 0% |" in (tmp_path / "out" / "sweep.md").read_text()
    assert (tmp_path / "out" / "figures" / "speed_kmh.svg").exists()


@pytest.mark.parametrize(("theirs", "ours", "is_told"), [(1.3, 13.1, True), (1.3, 3.0, False), (0.1, 1.0, False)])
def test_driven_cars_that_change_lanes_far_more_often_than_as_they_are_are_told_of(theirs, ours, is_told):
    about = {"vehicles": "driven", "setting": "", "share": 1.0, "seed": 0}
    rates = {"sumo": theirs, "road-rail": ours}
    table = pd.DataFrame([about | {"driver": one, "lane_changes_per_vehkm": rate} for one, rate in rates.items()])
    told = list(cautions.restless(table))
    assert len(told) == is_told
    assert all("as they are: road-rail at 100% 13.1 times a km, as they are 1.3: a learned" in line for line in told)


@pytest.mark.parametrize(("entered", "arrived"), [(2, 30), (30, 2)])
def test_measures_of_trips_are_told_to_be_of_few_where_few_begin_or_end_in_the_period(entered, arrived):
    about = {"vehicles": "all", "setting": "", "driver": "rule", "share": 1.0}
    trips = ((30, 20), (entered, arrived))
    table = pd.DataFrame([about | {"seed": k, "inserted": one[0], "arrived": one[1]} for k, one in enumerate(trips)])
    (note,) = cautions.few_trips(table)
    least = f"{min(entered, 30)} and {min(arrived, 20)}"
    assert f"(columns inserted, arrived), at the least rule at 100% {least}: travel times" in note
    assert not list(cautions.few_trips(table[:1]))


def test_runs_in_which_vehicles_touch_are_told_of():
    about = {"vehicles": "all", "setting": "", "driver": "rule", "share": 1.0}
    rows = [about | {"seed": seed, "collisions": number} for seed, number in enumerate((1, 0, 2))]
    placebo = {"driver": "sumo", "vehicles": "driven", "seed": 0, "collisions": 7}
    sumo = about | {"driver": "sumo", "share": 0.0, "seed": 1, "collisions": 1}
    table = pd.DataFrame([*rows, rows[2] | {"vehicles": "driven", "collisions": 1}, rows[0] | placebo, sumo])
    places = [
        *(("rule", 1.0, "driven", edge, n) for edge, n in (("main", 0), (":j", 1))),
        *(("rule", 1.0, "others", edge, n) for edge, n in (("main", 1), (":j", 1))),
        *(("sumo", share, "others", "ramp", n) for share, n in ((0.0, 1), (1.0, 7))),  # told once, of share 0
    ]
    edges = pd.DataFrame(places, columns=["driver", "share", "vehicles", "edge", "collisions"]).assign(setting="")
    (note,) = cautions.contacts(table, edges)
    assert note.startswith(
        "vehicles touched (column collisions): rule at 100% with seeds 0, 2 (3 contacts, 1 of driven cars, 2 of them "
        "on :j); as they are with seed 1 (1 contact, on ramp); they may be the same two at the same time in several "
        "runs, which are no independent ones; those of SUMO's vehicles alone, as where a lorry waits"
    )
    assert not list(cautions.contacts(table[table["collisions"] == 0], edges))


@pytest.mark.parametrize(("n_driven", "are_alone"), [(2, False), (1, True)])
def test_of_contacts_in_one_run_or_of_driven_cars_alone_no_more_is_said_than_holds(n_driven, are_alone):
    about = {"driver": "rule", "setting": "", "share": 1.0}
    counts = {"all": 2, "driven": n_driven}
    table = pd.DataFrame([about | {"seed": 4, "vehicles": kind, "collisions": n} for kind, n in counts.items()])
    edges = pd.DataFrame([about | {"vehicles": "driven", "edge": ":j", "collisions": 2}])
    (note,) = cautions.contacts(table, edges)
    assert f"rule at 100% with seed 4 (2 contacts, {n_driven} of driven cars, on :j)" in note
    assert "several runs" not in note
    assert ("SUMO's vehicles alone" in note) == are_alone


def test_a_sweep_tells_where_vehicles_touch_as_sumo_lists_it(tmp_path):
    """Lorries wait within the crossing to turn left, and SUMO's cars touch their corners."""
    flow = '<flow id="{}" from="{}" to="{}" begin="0" end="120" departSpeed="max" '.format
    (tmp_path / "left.rou.xml").write_text(
        '<routes><vType id="lorry" vClass="truck"/><vType id="car"/>'
        + flow("left", "sc", "cw")
        + 'type="lorry" period="12" departLane="best"/>'
        + flow("ahead", "nc", "cs")
        + 'type="car" period="6" departLane="0"/></routes>'
    )
    network = {"file": str(Path(__file__).with_name("left_turns.net.xml"))}
    world = config_file.validate({"network": network, "traffic": {"routes": [str(tmp_path / "left.rou.xml")]}})
    alone = {"drivers": ("sumo",), "shares": (0.0,), "seeds": 1, "duration_s": 80.0, "warm_up_s": 60.0}
    tables = small(world, tmp_path / "out", **alone).drive()
    listed = tmp_path / "contacts.xml"
    seed = rollout.traffic_seed(0, rollout.EVALUATION, 0)
    rollout.fleet_of("nothing", world, 0.0, seed, ("--collision-output", str(listed))).drive(140.0)
    theirs = Counter(
        contact.get("lane").rpartition("_")[0]
        for contact in ElementTree.parse(listed).getroot()
        if float(contact.get("time")) >= 60.0
    )
    ours = tables.edges.groupby("edge")["collisions"].sum()
    assert ours[ours > 0].to_dict() == theirs
    assert tables.traffic.set_index("vehicles").loc["all", "collisions"] == theirs.total() > 0
    (note,) = (one for one in tables.notes if one.startswith("vehicles touched"))
    assert re.search(rf"\(\d+ contacts, .*on {theirs.most_common(1)[0][0]}\); ", note)


def test_an_edge_that_traffic_no_longer_comes_to_is_told_of():
    def rows(driver, share, seed, **counts):
        about = {"driver": driver, "setting": "", "share": share, "seed": seed, "vehicles": "others", "type": "car"}
        return [about | {"edge": edge, "n_vehicles": n} for edge, n in counts.items()]

    edges = pd.DataFrame([
        *(row for seed in (0, 1) for row in rows("sumo", 0.0, seed, main=90, exit=30, lane=4)),
        *rows("sumo", 0.5, 0, main=90, exit=0),  # told once, of share 0
        *rows("rule", 0.5, 0, main=90, exit=9, lane=0),
        *rows("rule", 0.5, 1, main=60),
        *rows("keep", 0.5, 0, main=90, exit=16),
        *rows("keep", 0.5, 1, main=90, exit=14),
    ])  # fmt: skip
    (note,) = cautions.emptied(edges)
    assert "(edges.parquet; all seeds together): rule at 50%: exit (9 of 60): they may stand before" in note
    assert not list(cautions.emptied(edges[edges["driver"] != "rule"]))
    assert not list(cautions.emptied(edges[edges["driver"] != "sumo"]))  # nobody was on the road


def test_edges_where_driven_cars_stop_and_others_hardly_do_are_told_of():
    def rows(driver, share, vehicles, stops, n=100):
        about = {"driver": driver, "setting": "", "share": share, "seed": 0, "vehicles": vehicles, "type": "car"}
        return [about | {"edge": edge, "n_vehicles": n, "stops": number} for edge, number in stops.items()]

    as_they_are = rows("sumo", 0.0, "others", {"signal": 50, "ramp": 0, "main": 1, ":junction": 0})
    driven = rows("rule", 1.0, "driven", {"signal": 90, "ramp": 3, "main": 5, ":junction": 9, "new": 9})
    (note,) = cautions.stops(pd.DataFrame(as_they_are + driven))
    assert "(column stops of edges.parquet; all seeds): rule at 100%: ramp (3 by 100): means hide that" in note
    few = rows("rule", 1.0, "driven", {"ramp": 2})
    of_others = rows("rule", 0.5, "others", {"ramp": 9})
    same_as_they_are = rows("sumo", 0.5, "driven", {"ramp": 9})
    for others in (few, of_others, same_as_they_are, []):
        assert not list(cautions.stops(pd.DataFrame(as_they_are + others)))


def test_edges_where_some_lose_far_more_time_though_all_together_do_not_are_told_of():
    def rows(driver, share, losses_s, n=100):
        about = {"driver": driver, "setting": "", "share": share, "seed": 0, "vehicles": "others", "type": "car"}
        sums = dict.fromkeys(traffic.SUMS, 0) | {"vehkm": 10.0, "vehicle_s": 1000.0}
        return [
            about | {"edge": edge, "n_vehicles": n} | sums | {"time_loss_s": loss_s}
            for edge, loss_s in losses_s.items()
        ]

    as_they_are = rows("sumo", 0.0, {"main": 2000.0, "ramp": 800.0, ":junction": 10.0})
    ramp_loses = rows("rule", 1.0, {"main": 1000.0, "ramp": 2000.0, ":junction": 500.0})
    (note,) = cautions.losers(pd.DataFrame(as_they_are + ramp_loses))
    assert note.endswith("(edges.parquet): rule at 100%: ramp (8 to 20), while all together go from 94 to 117 s/km")
    all_lose = rows("rule", 1.0, {"main": 4000.0, "ramp": 2000.0})
    a_little = rows("rule", 1.0, {"main": 1000.0, "ramp": 1700.0})
    from_nothing = rows("rule", 1.0, {"main": 2000.0, "ramp": 800.0, "new": 2000.0})
    few = rows("rule", 1.0, {"main": 1000.0, "ramp": 2000.0}, n=10)
    for others in (all_lose, a_little, from_nothing, few, []):
        assert not list(cautions.losers(pd.DataFrame(as_they_are + others)))
    assert not list(cautions.losers(pd.DataFrame(ramp_loses)))  # nothing to compare with


@pytest.mark.parametrize(("driver", "told"), [("acc", True), ("rule", False)])
def test_keys_of_the_assistance_layer_are_told_to_do_nothing_to_sumos_own_cruise_control(world, driver, told):
    swept = small(world, "out", drivers=(driver,), key="adas.time_gap_s", settings=("1", "2"))
    assert bool(list(swept._idle_keys())) == told
    changed = replace(swept, config=world.changed(adas={"max_speed_kmh": 90.0}), key="traffic.scale")
    assert ([note.partition(":")[0] for note in changed._idle_keys()] == ["adas.max_speed_kmh"]) == told


def test_types_that_follow_otherwise_than_driven_cars_are_told_of(tmp_path):
    demand = tmp_path / "types.rou.xml"
    demand.write_text(
        '<routes><vType id="like" tau="1.05" accel="2.6"/><vType id="far" tau="1.4" accel="1"/><vType id="plain"/>'
        '<vType id="near" tau="0.8"/><vType id="lorry" vClass="truck" tau="3"/><vType id="odd" accel="?"/>'
        '<route id="along" edges="highway"/><vehicle id="one" type="far" route="along" depart="0"/></routes>'
    )
    config = config_file.validate({"network": {"file": "highway5"}, "traffic": {"routes": [str(demand)]}})
    swept = small(config, tmp_path / "out", drivers=("rule", "acc"))
    (note,) = swept._unlike_types()
    assert note.startswith("driven cars keep 1 s and speed up by 2 m/s², and types of the demand do otherwise ")
    assert "('far' tau 1.4; 'far' accel 1; 'near' tau 0.8): " in note
    for drivers in (("acc",), ("sumo",)):
        assert not list(replace(swept, drivers=drivers)._unlike_types())
    assert not list(replace(swept, key="adas.time_gap_s", settings=("1", "1.4"))._unlike_types())


def test_types_that_want_other_speeds_than_driven_cars_are_told_of(tmp_path):
    demand = tmp_path / "types.rou.xml"
    demand.write_text(
        '<routes><vType id="plain"/><vType id="even" speedFactor="1" speedDev="0"/><vType id="wide" speedDev="0.3"/>'
        '<vType id="slow" speedFactor="normc(0.8, 0.05,0.5,1.1)"/><vType id="fast" speedFactor="1.2"/>'
        '<vType id="lorry" vClass="truck" speedFactor="0.5"/><vType id="odd" speedFactor="?" speedDev="?"/>'
        '<vType id="usual" speedFactor="norm(1.04,0.1)"/>'
        '<route id="along" edges="highway"/><vehicle id="one" type="plain" route="along" depart="0"/></routes>'
    )
    config = config_file.validate({"network": {"file": "highway5"}, "traffic": {"routes": [str(demand)]}})
    (note,) = small(config, tmp_path / "out", drivers=("rule", "acc"))._unlike_wishes()
    wide, slow, fast = "speedFactor 1, speedDev 0.3", "speedFactor 0.8, speedDev 0.05", "speedFactor 1.2, speedDev 0.1"
    assert f"do not ('wide' {wide}; 'slow' {slow}; 'fast' {fast}): " in note
    assert not list(small(config, tmp_path / "out", drivers=("acc", "sumo"))._unlike_wishes())


def test_flow_is_of_the_same_road_at_every_share_however_far_vehicles_get(tmp_path):
    """Where all cars are driven, a driver that crawls keeps nearly all of the last edge empty."""
    network, routes = tmp_path / "two.net.xml", tmp_path / "two.rou.xml"
    network.write_text(cut_road(800.0, 800.0))
    routes.write_text(
        '<routes><vType id="car"/><route id="r" edges="part0 part1"/><flow id="f" type="car" route="r" begin="0" '
        'end="200" period="4" departLane="random"/></routes>'
    )
    world = config_file.validate({"network": {"file": str(network)}, "traffic": {"routes": [str(routes)]}})
    world = world.changed(adas={"min_speed_kmh": 10.0, "start_speed_kmh": 10.0, "max_speed_kmh": 12.0})
    swept = small(world, tmp_path / "out", drivers=("keep",), shares=(1.0,), seeds=1, duration_s=60.0)
    table = swept.drive().traffic
    of_all = table[table["vehicles"] == "all"].set_index(["driver", "share"])
    road_km = 3600 / 60.0 * of_all["vehkm"] / of_all["flow_vehph"]
    assert of_all.loc[("keep", 1.0), "arrived"] == 0
    assert road_km.to_numpy() == pytest.approx(1.6, abs=0.01)


def test_sums_over_edges_and_types_are_those_of_the_whole_road(world, tmp_path):
    tables = small(world, tmp_path / "out").drive()
    assert list(tables.edges.columns) == list(shares.EDGE_COLUMNS)
    assert set(tables.edges["type"]) == {"car", "lorry"}
    run = ["driver", "share", "seed", "vehicles"]
    assert not tables.edges.duplicated([*run, "type", "edge"]).any()
    sums = tables.edges.groupby(run)[list(traffic.SUMS)].sum()
    of_road = tables.traffic.set_index(run)
    of_road = of_road[(of_road["vehkm"] > 0) & (of_road.index.get_level_values("vehicles") != "all")]
    assert len(of_road) == len(sums)
    of_road = of_road.loc[sums.index]
    assert sums["vehkm"].to_numpy() == pytest.approx(of_road["vehkm"].to_numpy())
    assert (3600 * sums["vehkm"] / sums["vehicle_s"]).to_numpy() == pytest.approx(of_road["speed_kmh"].to_numpy())
    for name in ("time_loss_s", "lane_changes", "hard_brakings", "ttc_below_1_5s", "drac_above_3_4"):
        per_km = of_road[f"{name}_per_km" if name == "time_loss_s" else f"{name}_per_vehkm"]
        assert sums[name].to_numpy() == pytest.approx((per_km * of_road["vehkm"]).to_numpy(), abs=1e-4), name
    assert sums["lane_changes"].sum() > 0


def test_differences_are_from_the_same_vehicles_as_they_are_seed_by_seed():
    table = made_up({
        (AS_THEY_ARE, 0.0, "all"): (60.0, 70.0),
        (AS_THEY_ARE, 0.5, "driven"): (50.0, 60.0),
        ("rule", 0.5, "driven"): (55.0, 67.0),
    })  # fmt: skip
    told = compared(table).set_index(["driver", "share", "vehicles", "measure"])
    assert set(told.index.get_level_values("driver")) == {"rule"}, "of those as they are nothing differs"
    speed = told.loc[("rule", 0.5, "driven", "speed_kmh")]
    assert speed["difference"] == pytest.approx(6.0)
    assert speed["difference_high"] - speed["difference"] == pytest.approx(12.706 * 1.0, abs=1e-3)
    assert speed["relative"] == pytest.approx(61 / 55 - 1, abs=1e-6)
    assert speed["seeds_to_tell"] == math.ceil((12.7062 * math.sqrt(2.0) / 6.0) ** 2)


def test_the_summary_says_how_many_seeds_five_percent_would_take():
    told = summarised(made_up({("rule", 0.5, "all"): (60.0, 70.0)})).set_index("measure")
    speed = told.loc["speed_kmh"]
    reach = 12.7062 * 5.0  # Student's, of two: standard error 5
    assert (speed["mean"], speed["high"]) == (65.0, pytest.approx(65.0 + reach, abs=1e-2))
    assert speed["seeds_for_5_percent"] == math.ceil((12.7062 * math.sqrt(50.0) / (0.05 * 65.0)) ** 2)
    assert np.isnan(told.loc["collisions", "seeds_for_5_percent"])


MEANS = ["1369", "105.6", "1.21", "0.72", "0.020", "0.000", "252.6", "0.0"]
CHANGES = ["+1 ± 3", "+5.2 ± 10.5", "+0.02 ± 0.14", "+0.05 ± 0.04"]
CHANGES += ["-0.057 ± 0.005", "+0.000 ± 0.000", "+14.8 ± 0.9", "+0.0 ± 0.0"]


def row(driver, share, changes):
    cells = map(shares.Cell, MEANS, changes)
    return shares.Row(driver, "", share, dict(zip(TOLD, cells, strict=True)))


@pytest.mark.parametrize(
    ("width", "left_out"),
    [
        (80, ["lane changes", "hard brakings", "TTC < 1.5 s", "CO2"]),
        (120, ["CO2"]),
        (160, []),
    ],
)
@pytest.mark.parametrize("driver", ["road-rail", "runs/a-name-that-is-folded"])
def test_the_terminal_shows_what_fits_with_whole_headings_and_says_where_the_rest_is(width, left_out, driver):
    rows = [row("as they are", "0%", [""] * len(CHANGES)), row(driver, "50%", CHANGES)]
    console = Console(width=width)
    with console.capture() as shown:
        console.print(told_table("", rows, "What these are.", width=width))
    lines = shown.get().splitlines()
    assert max(map(len, lines)) <= width
    assert "…" not in shown.get()
    names = [told.name for told in TOLD.values() if told.name not in left_out]
    assert re.split(r"  +", lines[1].strip()) == names
    differences = [change for change, told in zip(CHANGES, TOLD.values(), strict=True) if told.name in names]
    assert re.split(r"  +", lines[6].strip())[-len(names) :] == differences
    rest = f"What these are. Not shown for want of room, but in sweep.md: {', '.join(left_out)}."
    below = " ".join(" ".join(lines[7:]).split())
    assert below.endswith(rest if left_out else "What these are.")


def test_a_measure_without_a_value_is_a_dash():
    table = made_up(
        {
            (AS_THEY_ARE, 0.0, "all"): (60.0, 70.0),
            (AS_THEY_ARE, 0.5, "all"): (60.0, 70.0),
            ("rule", 0.5, "all"): (61.0, 71.0),
        }
    )
    table["co2_g_per_vehkm"] = np.nan
    rows = shares.told_rows(table, compared(table))
    assert [row.cells["co2_g_per_vehkm"] for row in rows] == [("-", ""), ("-", "")]
    assert rows[1].cells["speed_kmh"].on_one_line == "66.0 (+1.0 ± 0.0)"


def test_a_key_may_be_swept_over(world, tmp_path, figures):
    swept = small(
        world, tmp_path / "out", drivers=("acc",), shares=(0.5,), seeds=1, key="traffic.scale", settings=("0.5", "1.5")
    )
    tables = swept.drive()
    of_all = tables.traffic[tables.traffic["vehicles"] == traffic.ALL].set_index(["driver", "setting", "share"])
    assert of_all.loc[("acc", "0.5", 0.5), "inserted"] < of_all.loc[("acc", "1.5", 0.5), "inserted"]
    page = (tmp_path / "out" / "sweep.md").read_text()
    assert "| driver | traffic.scale | share |" in page
    assert (tmp_path / "out" / "figures" / "speed_kmh.svg").exists()


def test_a_figure_shows_each_run_also_one_that_broke_down(world, tmp_path, monkeypatch, figures):
    drawn = {}
    monkeypatch.setattr(plot, "save", lambda figure, path, **_: drawn.update({path.name: figure.axes[0]}))
    swept = small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,))
    tables = swept.drive()
    broken = tables.traffic.copy()
    is_one = (broken["driver"] == "acc") & (broken["vehicles"] == traffic.ALL) & (broken["seed"] == 1)
    broken.loc[is_one, "speed_kmh"] = 5.0
    sweep_report.draw(tables._replace(traffic=broken), swept.out)
    axes = drawn["speed_kmh.svg"]
    _, points = axes.get_lines()
    of_all = broken[broken["vehicles"] == traffic.ALL].set_index(["driver", "share", "seed"])["speed_kmh"]
    runs = [("sumo", 0.0, 0), ("sumo", 0.0, 1), ("acc", 1.0, 0), ("acc", 1.0, 1)]
    assert points.get_xydata().tolist() == [[share, of_all[driver, share, seed]] for driver, share, seed in runs]
    assert axes.get_ylim()[0] <= 5.0
    assert axes.xaxis.get_major_formatter()(0.5) == "50%"


def test_what_makes_figures_doubtful_is_kept_beside_them(world, tmp_path, figures):
    hears = Hears()
    world = world.changed(traffic={"lorries": 0.5})
    swept = small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1, duration_s=190.0, observer=hears)
    swept = replace(swept, known=("told already",))
    notes = (
        "traffic.lorries: of made traffic",
        "the last vehicle departs at 200 s, before the period ends at ",
        "the road fills up in the period, by vehicles in the mean over seeds: acc at 100% from",
        "few vehicles enter or arrive in the period of a run (columns inserted, arrived), at the least ",
    )
    tables = swept.drive()
    assert tables.notes[0] == "told already"
    assert "told already" not in hears.said
    assert "Note: told already." in (tmp_path / "out" / "sweep.md").read_text()
    for told, begins in zip(tables.notes[1:], notes, strict=True):
        assert told.startswith(begins)
        assert told in hears.said
        assert f"{told}." in (tmp_path / "out" / "sweep.md").read_text()
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text())["notes"] == list(tables.notes)


def one_lane(tmp_path, flow):
    """A world whose demand is a flow of 60 s that departs on one lane, which takes less."""
    path = tmp_path / "flow.rou.xml"
    path.write_text(
        f'<routes><route id="r" edges="highway"/><flow {flow} route="r" begin="0" end="60" departLane="0"/></routes>'
    )
    return config_file.validate({"network": {"file": "highway3"}, "traffic": {"routes": [str(path)]}})


def test_who_finds_no_room_to_enter_is_told_of(tmp_path):
    world = one_lane(tmp_path, 'id="f" period="0.2"')
    late = small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1)
    assert re.fullmatch(
        r"vehicles still wait for room to enter at the end \(column waiting\), in the mean over seeds from \d+ \(a.*\) "
        r"to \d+ \(a.*\): where fewer have entered, .*",
        late.drive().notes[0],
    )
    after = small(world, tmp_path / "after", drivers=("acc",), shares=(1.0,), seeds=1, warm_up_s=60.0)
    assert (
        "the last vehicle departs at 60 s, before the period begins at 60 s: unless they drive round and round, choose"
        in after.drive().notes[0]
    )


def test_without_matplotlib_there_are_tables_and_a_word(monkeypatch, world, tmp_path, figures):
    monkeypatch.setattr(sweep, "find_spec", lambda name: None)
    monkeypatch.setattr(plot, "with_bands", None)
    hears = Hears()
    small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1, observer=hears).drive()
    assert hears.said[0].startswith("few vehicles enter or arrive in the period of a run")
    assert hears.said[1:] == ["no figures without matplotlib; install it with: pip install 'rail-sumo[plots]'"]
    assert not (tmp_path / "out" / "figures").exists()


def test_ids_that_look_like_numbers_are_ids_and_who_waits_is_driven_too(tmp_path):
    world = one_lane(tmp_path, 'id="1" period="0.5"')
    table = small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1).drive().traffic
    driven, others = (
        table[(table["driver"] == "acc") & (table["vehicles"] == kind)].iloc[0] for kind in ("driven", "others")
    )
    assert (driven["n_vehicles"] > 10, others["n_vehicles"]) == (True, 0)
    assert (driven["waiting"] > 10, others["waiting"]) == (True, 0)


def test_cars_that_no_host_could_drive_are_an_error_and_not_no_difference(world, tmp_path):
    swept = small(
        world, tmp_path / "out", drivers=("keep",), shares=(1.0,), seeds=1, key="adas.max_speed_kmh", settings=("8",)
    )
    with pytest.raises(
        InputError, match=r"driver 'keep' could drive none of \d+ cars: network 'highway3': the lowest set"
    ):
        swept.drive()


def test_demand_before_or_after_the_period_is_told(world, demand, tmp_path):
    late = config_file.changed(world, ["traffic.begin_s=300"])
    with pytest.raises(
        InputError, match=r"last vehicle departs at 200 s, before traffic.begin_s = 300; set it to an ear"
    ):
        small(late, tmp_path / "late", drivers=("acc",), shares=(1.0,), seeds=1).drive()
    assert not (tmp_path / "late").exists()
    few = {"drivers": ("acc",), "shares": (1.0,), "seeds": 1}
    with pytest.raises(
        InputError, match=r"no vehicle was on the road in the period, from 1500 to .* depart from 0 s to 200 s: change"
    ):
        small(world, tmp_path / "out", **few, warm_up_s=1500.0).drive()
    assert not list(tmp_path.glob("out/*"))
    small(world, tmp_path / "out", **few).drive()  # what showed nothing is not in the way
    hears = Hears()
    once = {"drivers": ("acc",), "shares": (1.0,), "seeds": 1, "warm_up_s": None, "duration_s": 200.0}
    small(world, tmp_path / "short", observer=hears, **once).drive()
    assert any("the last vehicle departs at 200 s, before the period ends at" in one for one in hears.said)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"key": "adas.max_speed_kmh", "settings": ("limit",)},
            "what is swept over are numbers; got adas.max_speed_kmh",
        ),
        ({"key": "lidar.max_range_m", "settings": ("50",), "drivers": ("road-rail",)}, "was trained with"),
        ({"shares": (0.5, 1.2)}, "a share is a number from 0 to 1; got 1.2 "),
        ({"shares": (0.5, 50.0)}, "a share is a number from 0 to 1; got 50 (for 50 %, write 0.5)"),
        ({"shares": (0.5, math.nan)}, "a share is a number from 0 to 1; got nan"),
        ({"shares": (0.5, 0.5)}, "share 0.5 is given twice; leave one out"),
        ({"shares": (0.0,)}, "give at least one share above 0; share 0 is always driven beside"),
        ({"drivers": ("rule", "rule")}, "driver rule is given twice; leave one out"),
        ({"drivers": ("sumo:car",)}, "driver 'sumo:car' drives one vehicle; for SUMO's own drivers take 'sumo'"),
        ({"drivers": ("nobody",)}, "nobody"),
        ({"seeds": 0}, "--seeds must be at least 1; got 0"),
        ({"duration_s": 0.0}, "--duration takes seconds, at least 1; got 0"),
        ({"warm_up_s": -1.0}, "--warm-up takes seconds from 0 up, or auto; got -1"),
        ({"key": "traffic.scale", "settings": ("2", "2")}, "value of traffic.scale 2 is given twice; leave one out"),
        ({"key": "traffic.scal", "settings": ("2", "3")}, "did you mean"),
        ({"key": "traffic.scale", "settings": ("0", "3")}, "traffic.scale"),
    ],
)
def test_what_cannot_be_swept_is_refused_before_anybody_drives(monkeypatch, world, tmp_path, changes, told):
    monkeypatch.setattr(sweep.share_run, "finish", lambda work: pytest.fail("somebody drives"))
    with pytest.raises(InputError) as refused:
        small(world, tmp_path / "out", **changes).drive()
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_a_demand_without_cars_is_refused(demand, world, tmp_path):
    demand.write_text(demand.read_text().replace('id="car" speedFactor', 'id="car" vClass="bus" speedFactor'))
    with pytest.raises(InputError, match=r"^only cars are driven, and the demand has none; give one with vehicles of"):
        small(world, tmp_path / "out", drivers=("acc",), shares=(1.0,), seeds=1).drive()


def test_on_the_command_line(monkeypatch, capsys, demand, tmp_path):
    monkeypatch.chdir(tmp_path)
    asked = ["sweep", "share", "0", "0.5", "--driver", "acc", "--network", "highway3", "--routes", str(demand)]
    few = ["--seeds", "1", "--duration", "10", "--warm-up", "20", "--workers", "1"]

    def call(*words):
        monkeypatch.setattr("sys.argv", ["rail-sumo", *words])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    code, out, _ = call(*asked, *few)
    assert code == 0
    assert "as they are" in out
    assert "one seed: no interval; 10 s each, after 20 s that do not count." in " ".join(out.split())
    assert "tables and sweep.md in runs/sweep" in out  # nothing is drawn here
    code, out, _ = call(*asked, *few, "--json")
    differences = pd.DataFrame(json.loads(out))
    assert set(differences["measure"]) == set(traffic.MEASURES)
    for words, told in (
        (["sweep", "share", "half", "--driver", "acc"], "shares are numbers from 0 to 1; got 'half'"),
        (["sweep", "shares", "0.5", "--driver", "acc"], "varied is share, or a key of the configuration"),
        (
            ["sweep", "share", "0.5", "--driver", "acc", "--share", "0.2"],
            "shares are what is varied; leave out --share",
        ),
        (
            ["sweep", "share", "0.5", "--driver", "acc", "--warm-up", "long"],
            "--warm-up takes seconds, or auto; got 'long'",
        ),
        (["sweep", "share", "0.5", "--driver", "acc"], "a share is of the cars of a demand, and there is none"),
        (
            [
                "sweep",
                "traffic.lorries",
                "0",
                "0.5",
                "--driver",
                "acc",
                "--network",
                "highway3",
                "--routes",
                str(demand),
            ],
            "traffic.lorries is of made traffic, without effect on a demand; vary traffic.scale",
        ),
        (
            ["sweep", "share", "0.5", "--driver", "acc", "--driver", "rail", "--set", "lidar.n_rays=12"],
            "policy 'rail' was trained with lidar.n_rays = 24, not 12",
        ),
        (["sweep", "share", "0.5", "--driver", "acc", "--workers", "ray"], "takes a number of --workers, not ray"),
    ):
        code, out, error = call(*words)
        assert (code, out) == (2, "")
        assert told in error
        assert error.count("\n") == 1


def test_the_page_names_what_was_given_as_the_road(monkeypatch, demand, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.net.xml").write_bytes(assets.network("highway3").read_bytes())
    files = f'<net-file value="my.net.xml"/><route-files value="{demand.name}"/>'
    (tmp_path / "mine.sumocfg").write_text(f"<configuration>{files}</configuration>")
    few = ["--driver", "acc", "--seeds", "1", "--duration", "10", "--warm-up", "20", "--workers", "1"]
    for network, routes in (("mine.sumocfg", []), ("highway3", ["--routes", demand.name])):
        words = ["sweep", "share", "0.5", *few, "--network", network, *routes, "--out", f"of {network}"]
        monkeypatch.setattr("sys.argv", ["rail-sumo", *words])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code == 0
        assert (tmp_path / f"of {network}" / "sweep.md").read_text().startswith(f"# {network}: acc\n")
