"""The paper's experiments, on cells whose episodes are made up."""

import itertools
import json
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from safetensors.numpy import load_file, save_file
from toy import episode

from rail_sumo import assets, config_file, training
from rail_sumo.config_file import dumps
from rail_sumo.errors import InputError
from rail_sumo.pictures import plot
from rail_sumo.policy import PolicyParameters
from rail_sumo.records import KMH, SECONDS_PER_STEP, MetaAction
from rail_sumo.rollout import EVALUATION, SILENT, traffic_seed
from rail_sumo.run_directory import PROGRESS, Checkpoint, RunDirectory
from rail_sumo.studies import experiment, reproduce
from rail_sumo.studies.experiment import SYSTEMS, Cell, Experiment
from rail_sumo.tables import audit

N_EPISODES, N_DECISIONS = 4, 10
LEARNERS = tuple(name for name, system in SYSTEMS.items() if system.trains)
FEW = ("rail-2", "bc-1", "gail-2-unmasked", "rule", "expert")
"""Of every kind one."""

T1, T7 = 12.7062, 2.3646
"""The 97.5 % points of Student's t with one and with seven degrees of freedom: of two units and of eight."""


@pytest.fixture
def world():
    return config_file.load(None, ["cloning.epochs=0", "train.iterations=5"])


@pytest.fixture
def contacts():
    """How often the host hit and was hit in every made-up episode."""
    return {"collisions": 1, "struck": 1}


@pytest.fixture
def done(monkeypatch, contacts):
    """What was trained, which cells were made, and who drove for them: names, and what was learned."""
    done = []

    def learn(world, folder, *, seed, resume):
        done.append(("learn", Cell.parse(folder.name).system, world.train.n_iterations, resume))
        if resume:
            RunDirectory(folder).go_on(world, seed, training.inputs_of(world))
            return RunDirectory(folder)
        start = training._start(world, a_demonstration(), seed)
        return RunDirectory.create(folder, world, seed, training.inputs_of(world), start)

    def episodes(driver, world, seed, numbers):
        done.append(("drive", driver, seed, numbers))
        return [made_up(driver, world, seed, number, contacts) for number in numbers]

    def note_cell(work):
        done.append(("cell", work.cell.system, work.cell.seed))
        return driven(work)

    driven = experiment._driven
    monkeypatch.setattr(training, "learn", learn)
    monkeypatch.setattr(experiment, "_episodes", episodes)
    monkeypatch.setattr(experiment, "_driven", note_cell)
    monkeypatch.setattr(experiment, "told_apart", told_apart)
    return done


@cache
def a_demonstration():
    return training.demonstrations_of(config_file.load(None, ["train.trajectories=1"]))


def made_up(driver, world, seed, number, contacts):
    """An episode. The expert is 1 km/h faster in each than in the last, and as fast on the traffic of every seed.

    The rule driver gains 2 km/h in each. A learner is as the expert, but for what its layers, its trajectories and its
    training bring, slower by 1 km/h and less like the expert where it samples; who is not masked is refused.
    """
    traffic = traffic_seed(seed, EVALUATION, number)
    sights = np.random.default_rng(traffic).normal(size=(N_DECISIONS, 2))
    actions = np.where(sights[:, 0] > 0, MetaAction.ACCELERATE, MetaAction.LEFT)
    refused = 0
    if isinstance(driver, str):
        speed_kmh = {"rule": 65.0 + number, "sumo": 63.0, "expert": 70.0}[driver] + number
    else:
        layers = 1 if driver.shape.hidden is None else 2
        speed_kmh = 60.0 + 2 * layers + 0.1 * world.train.trajectories + 3 * seed + number - driver.samples
        if driver.samples:
            actions[seed:] = MetaAction.DECELERATE
        refused = 0 if driver.masked else 3
    made = replace(
        episode(sights, actions, seed=traffic),
        distance_m=speed_kmh / KMH * N_DECISIONS * SECONDS_PER_STEP,
        overtakes=1,
        lane_changes=1,
        refused_decisions=refused,
        **contacts,
    )
    made.lane_changing[0] = True
    return made


def told_apart(learner, expert):
    """Stands in for the classifier: from 0.5 for the same decisions to 1 for none of them; 0.48 on other traffic."""
    if [one.seed for one in learner] != [one.seed for one in expert]:
        return np.full(len(learner), 0.48)
    assert all((one.decisions != MetaAction.DECELERATE).all() for one in expert)  # this is the expert indeed
    return np.array([0.5 + 0.5 * (a.decisions != b.decisions).mean() for a, b in zip(learner, expert, strict=True)])


def table1(world, out, systems=tuple(SYSTEMS), *, episodes=N_EPISODES, **how):
    return reproduce.table1(Experiment(world, out, episodes=episodes, **how), systems)


def figures(world, out, **how):
    return reproduce.figures(Experiment(world, out, episodes=N_EPISODES, **how))


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def noted(done, kind):
    return [event[1] for event in done if event[0] == kind]


def rows_of(table, metric):
    return table[table["metric"] == metric].set_index(["system", "mode"])


def test_every_row_of_the_table_is_there_beside_the_papers(world, done, tmp_path):
    table = table1(world, tmp_path, seeds=2)
    assert list(table.columns) == list(reproduce.TABLE_COLUMNS)
    rows = [(name, mode) for name in SYSTEMS for mode in (("argmax", "sampled") if name in LEARNERS else ("",))]
    assert list(dict.fromkeys(zip(table["system"], table["mode"], strict=True))) == rows
    speeds = rows_of(table, "speed_kmh")
    # The mean episode is 1.5 km/h faster than the first, the mean training of two likewise.
    assert speeds.loc[("rail-2", "argmax"), "mean"] == 60 + 4 + 4 + 1.5 + 1.5
    assert speeds.loc[("rail-1", "argmax"), "mean"] == 60 + 2 + 4 + 1.5 + 1.5
    assert speeds.loc[("rail-1", "sampled"), "mean"] == 60 + 2 + 4 + 1.5 + 1.5 - 1
    assert speeds.loc[("rail-2", "argmax"), "ratio"] == pytest.approx(71.0 / 71.5, abs=1e-6)
    assert speeds.loc[("expert", ""), ["ratio", "difference"]].tolist() == [1.0, 0.0]
    assert speeds.loc[("rail-1", "argmax"), "difference"] == 69.0 - 71.5
    assert speeds.loc[("expert", ""), "above_expert"] == 0.5
    # Of the rule driver's 65, 67, 69 and 71, the last is above the expert's 70 and level with its 71, below 72 and 73.
    assert speeds.loc[("rule", ""), "above_expert"] == 1.5 / 16
    paper = ["paper", "paper_ratio"]
    for mode in ("argmax", "sampled"):
        assert speeds.loc[("rail-2", mode), paper].tolist() == [70.38, pytest.approx(1.022519, abs=1e-6)]
    assert speeds.loc[("gail-2", "sampled"), paper].isna().all()
    from_csv = pd.read_csv(tmp_path / "table1.csv", dtype=reproduce.TABLE_COLUMNS, keep_default_na=False, na_values=NAN)
    pd.testing.assert_frame_equal(table, from_csv)
    markdown = (tmp_path / "table1.md").read_text()
    assert "| RAIL, two layers (argmax) | 71.0 | 1.0 | 1.0 |" in markdown
    assert "| RAIL, two layers (sampled, not as trained) | 70.0 | 1.0 | 1.0 |" in markdown
    assert "| GAIL, two layers (argmax, not as trained) |" in markdown
    assert "| rule driver | 68.0 |" in markdown
    assert markdown.count("| &emsp;in the paper | 70.4 | 45.0 | 15.0 | 2719.4 | -123.0 |") == 1  # of RAIL as trained
    assert "| &emsp;in the paper, of the expert's | 1.023 | 1.013 | 1.069 | 1.029 | 0.928 |" in markdown


def test_elsewhere_the_papers_figures_are_not_set_beside_ours(world, done, tmp_path):
    table = table1(world.changed(network={"file": "ring5"}), tmp_path, ("rail-2",), seeds=1)
    assert table[["paper", "paper_ratio"]].isna().all(axis=None)
    assert "in the paper" not in (tmp_path / "table1.md").read_text()


def test_the_folder_tells_what_made_it(world, done, tmp_path):
    table1(world, tmp_path, ("rule", "bc-2"), seeds=1, command="rail-sumo reproduce table1")
    about = json.loads((tmp_path / "evaluation.json").read_text())
    assert about["command"] == "rail-sumo reproduce table1"
    shown = assets.expert("demonstrations.parquet", assets.expert_folder("shipped"))
    assert about["files"]["train.demonstrations"] == assets.sha256(shown)
    assert about["files"]["network.file"] == assets.sha256(assets.network("highway5"))
    assert config_file.load(tmp_path / "world.toml") == training.located(world)


def test_demonstrations_of_another_than_the_expert_are_told_of_beside_the_table(world, done, tmp_path, monkeypatch):
    shown = shutil.copy(assets.expert("demonstrations.parquet"), tmp_path)  # where it is not known to be the expert's
    own, notes = world.changed(train={"demonstrations": str(shown)}), []
    monkeypatch.setattr(type(SILENT), "note", lambda observer, text: notes.append(text))
    table1(own, tmp_path / "own", ("rail-2",), seeds=1)
    table1(world, tmp_path / "experts", ("rail-2",), seeds=1)
    (told,) = notes
    said = "the demonstrations do not tell for certain whose they are, and ratios and 'told apart' are to the expert"
    assert told.startswith(said)
    assert told in (tmp_path / "own" / "table1.md").read_text()
    assert told not in (tmp_path / "experts" / "table1.md").read_text()


NAN = {name: [""] for name, kind in reproduce.TABLE_COLUMNS.items() if kind == "float64"}
"""An empty figure is none, an empty mode the one of a driver that does not train."""


def test_intervals_are_over_the_trainings_of_a_learner_and_over_the_episodes_of_a_driver(world, done, tmp_path):
    table = table1(world, tmp_path, FEW, seeds=2)
    trainings = table.groupby("system")["trainings"].unique().map(list).to_dict()
    assert trainings == {name: [2 if name in LEARNERS else 0] for name in FEW}
    speeds = rows_of(table, "speed_kmh")
    mean, difference = (["mean", "low", "high"], ["difference", "difference_low", "difference_high"])
    ratio = ["ratio", "ratio_low", "ratio_high"]
    # Two trainings, of 69.5 and 72.5 km/h: their mean has a standard error of 1.5. The expert is at 71.5 beside both.
    rail = speeds.loc[("rail-2", "argmax")]
    assert rail[mean].tolist() == pytest.approx([71.0, 71.0 - 1.5 * T1, 71.0 + 1.5 * T1], abs=1e-3)
    assert rail[difference].tolist() == pytest.approx([-0.5, -0.5 - 1.5 * T1, -0.5 + 1.5 * T1], abs=1e-3)
    assert rail[ratio].tolist() == pytest.approx(np.array([71.0, 71.0 - 1.5 * T1, 71.0 + 1.5 * T1]) / 71.5, abs=1e-5)
    # Eight episodes, of 65, 67, 69 and 71 km/h twice, 5, 4, 3 and 2 km/h below the expert.
    rule = speeds.loc[("rule", "")]
    half = T7 * np.sqrt(2 * (9 + 1 + 1 + 9) / 7 / 8)
    assert rule[mean].tolist() == pytest.approx([68.0, 68.0 - half, 68.0 + half], abs=1e-3)
    assert rule[difference].tolist() == pytest.approx([-3.5, -3.5 - half / 2, -3.5 + half / 2], abs=1e-3)
    assert speeds.loc[("expert", ""), [*ratio, *difference]].tolist() == [1.0] * 3 + [0.0] * 3  # of itself


def test_one_training_has_no_interval_and_of_contacts_wilsons(world, done, tmp_path):
    table = table1(world, tmp_path, ("rail-2",), seeds=1)
    speed, struck = (rows_of(table, metric).loc[("rail-2", "argmax")] for metric in ("speed_kmh", "struck"))
    assert (speed["mean"], speed["ratio"]) == (69.5, pytest.approx(69.5 / 71.5, abs=1e-6))
    assert speed[[name for name in table.columns if name.endswith(("low", "high"))]].isna().all()
    assert (struck["mean"], struck["high"]) == (1.0, 1.0)
    assert 0.5 < struck["low"] < 0.52  # at 4 of 4: 1 / (1 + z^2 / 4)
    assert "| &emsp;of the expert's | 0.972 |" in (tmp_path / "table1.md").read_text()


def test_the_cells_are_tidy_and_the_same_in_both_files(world, done, tmp_path):
    table1(world, tmp_path, seeds=2)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    assert {column: str(kind) for column, kind in cells.dtypes.items()} == experiment.CELL_COLUMNS
    assert list(cells.columns) == list(experiment.CELL_COLUMNS)
    assert len(cells) == 2 * (2 * len(LEARNERS) + 3) * N_EPISODES
    assert not cells.duplicated(["system", "mode", "trajectories", "training_seed", "episode"]).any()
    drivers = cells[cells["system"].isin(["rule", "sumo", "expert"])]
    assert (drivers["trajectories"] == 0).all()
    assert (drivers["mode"] == "").all()
    assert (cells[cells["system"].isin(LEARNERS)]["trajectories"] == 40).all()
    from_csv = pd.read_csv(tmp_path / "cells.csv", dtype=experiment.CELL_COLUMNS, keep_default_na=False, na_values=NONE)
    pd.testing.assert_frame_equal(cells, from_csv)


NONE = {"told_apart": [""]}


def test_every_training_is_driven_in_both_modes_and_one_of_them_is_the_one_it_was_trained_in(world, done, tmp_path):
    table1(world, tmp_path, seeds=2)
    assert sorted(noted(done, "learn")) == sorted(2 * LEARNERS)
    drove = [event[1] for event in done if event[0] == "drive" and isinstance(event[1], PolicyParameters)]
    assert len(drove) == 2 * 2 * len(LEARNERS)
    for argmax, sampled in zip(drove[::2], drove[1::2], strict=True):
        assert (argmax.samples, sampled.samples) == (False, True)
        assert argmax.theta.tolist() == sampled.theta.tolist()
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    as_trained = cells.groupby(["system", "mode"])["as_trained"].unique().map(list).to_dict()
    argmaxes = ("rail-2", "rail-1", "rewarded-2", "rail-2-unmasked")
    right = {(name, mode): [(mode == "argmax") == (name in argmaxes)] for name in LEARNERS for mode in MODES}
    assert as_trained == right | {(name, ""): [True] for name in ("rule", "sumo", "expert")}


MODES = ("argmax", "sampled")


def test_a_mode_that_was_set_is_the_one_it_was_trained_in(done, tmp_path):
    world = config_file.load(None, ["cloning.epochs=0", "train.iterations=5", "policy.mode=sampled"])
    table = rows_of(table1(world, tmp_path, ("rail-2",), seeds=1), "speed_kmh")
    assert table.loc["rail-2"]["as_trained"].to_dict() == {"argmax": False, "sampled": True}


def test_all_are_on_the_same_traffic_and_the_expert_on_that_of_every_seed(world, done, tmp_path):
    table1(world, tmp_path, seeds=3)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    traffic = cells.groupby(["training_seed", "episode"])["seed"].nunique()
    assert (traffic == 1).all()
    assert cells["seed"].nunique() == 3 * N_EPISODES


def test_who_is_told_apart_is_set_beside_the_expert_on_the_same_traffic_but_the_expert_on_other(world, done, tmp_path):
    table = table1(world, tmp_path, (*FEW, "sumo"), seeds=2)
    apart = rows_of(table, "told_apart")
    assert apart.loc[("rail-2", "argmax"), "mean"] == 0.5
    # It samples otherwise in all decisions after the first training, and in 9 of 10 after the second: 1 and 0.95.
    sampled = apart.loc[("rail-2", "sampled"), ["mean", "low", "high"]].tolist()
    assert sampled == pytest.approx([0.975, 0.975 - 0.025 * T1, 0.975 + 0.025 * T1], abs=1e-4)
    assert apart.loc[("rule", ""), "mean"] == 0.5
    assert apart.loc[("expert", ""), "mean"] == 0.48
    others = [event[3] for event in done if event[0] == "drive" and event[3] != range(N_EPISODES)]
    assert others == 2 * [range(N_EPISODES, 2 * N_EPISODES)]
    assert np.isnan(apart.loc[("sumo", ""), "mean"])  # it takes no decisions


def test_of_who_takes_no_decisions_it_is_not_known_how_often_it_is_above_the_expert(world, done, tmp_path):
    apart = rows_of(table1(world, tmp_path, ("sumo",), seeds=1), "told_apart")
    assert np.isnan(apart.loc[("sumo", ""), "above_expert"])


def test_refused_decisions_and_how_well_one_is_told_apart_are_in_the_table(world, done, tmp_path):
    table1(world, tmp_path, (*FEW, "sumo"), seeds=2)
    lines = (tmp_path / "table1.md").read_text().splitlines()
    last = {line.split(" | ")[0].removeprefix("| "): line.removesuffix(" |").split(" | ")[-3:] for line in lines}
    assert lines[0].endswith("| refused decisions | told apart | contacts |")
    assert last["RAIL, two layers (argmax)"] == ["0.0", "0.500", "16"]
    assert last["RAIL, two layers (sampled, not as trained)"] == ["0.0", "0.975 (0.657 to 1.293)", "16"]
    assert last["GAIL, two layers, unmasked (argmax, not as trained)"] == ["3.0", "0.500", "16"]
    assert last["expert"] == ["0.0", "0.480", "16"]
    assert last["SUMO's driver"] == ["0.0", "", "16"]


@pytest.mark.parametrize(
    ("interval", "shown"),
    [
        ((0.9971, 0.9945, 0.9997), "0.9971 (0.9945 to 0.9997)"),
        ((0.9971, 0.9945, 1.0003), "0.997 (0.995 to 1.000)"),
        ((1.0021, 1.00004, 1.0041), "1.00210 (1.00004 to 1.00410)"),
        ((np.nan, np.nan, np.nan), ""),
        ((1.0, np.nan, np.nan), "1.000"),
        ((0.2148, -0.0004, 0.43), "0.215 (0.000 to 0.430)"),  # no -0.000
    ],
)
def test_a_ratio_whose_interval_is_without_1_does_not_look_as_if_it_held_1(interval, shown):
    assert reproduce.ratio_with_interval(*interval) == shown


def test_some_rows_alone_are_in_the_tables_order_and_the_expert_is_always_there(world, done, tmp_path):
    assert reproduce.chosen("") == tuple(SYSTEMS)
    assert reproduce.chosen(" rule,bc-2-unmasked, rail-1,,rule") == ("rail-1", "bc-2-unmasked", "rule")
    table = table1(world, tmp_path, ("rule", "rail-1"), seeds=1)
    assert list(table["system"].unique()) == ["rail-1", "rule", "expert"]
    assert noted(done, "cell") == ["rail-1", "rule", "expert"]


@pytest.mark.parametrize(("only", "name", "meant"), [("rail-2,rial-1", "rial-1", "rail-1"), ("RULE", "RULE", None)])
def test_a_row_that_is_not_known_is_one_clear_line(only, name, meant):
    question = f"; did you mean '{meant}'" if meant else r" \(available: bc-1, "
    with pytest.raises(InputError, match=f"^--only: system '{name}' not found{question}"):
        reproduce.chosen(only)


@pytest.mark.parametrize(("seeds", "few"), [(1, True), (4, True), (5, False)])
def test_fewer_than_five_trainings_are_noted(world, done, tmp_path, seeds, few):
    table1(world, tmp_path, ("bc-1", "rule"), seeds=seeds)
    markdown = (tmp_path / "table1.md").read_text()
    assert f"Trainings of each learner: {seeds}; held-out episodes of each in either mode, " in markdown
    assert f"training's traffic: {N_EPISODES}. Means" in markdown
    assert ("**Fewer than 5 trainings**" in markdown) == few
    assert ("of told apart may reach below 0 or above 1" in markdown) == few


def test_drivers_that_do_not_train_cannot_have_too_few_trainings(world, done, tmp_path):
    table1(world, tmp_path, ("rule",), seeds=1)
    assert "Fewer than" not in (tmp_path / "table1.md").read_text()


def test_the_table_made_from_cells_is_the_experiments_byte_for_byte(world, done, tmp_path):
    world = world.changed(train={"iterations": "default"})  # of other numbers the cells do not know, nor of other keys
    some = ("rule", "rail-1", "gail-2")
    of_all, of_some = table1(world, tmp_path / "all", seeds=2), table1(world, tmp_path / "some", some, seeds=2)
    others = [("rail-2", 5), ("gail-2", 5), ("expert", 0)]  # as the figures leave among the cells
    Experiment(world, tmp_path / "all", 2, N_EPISODES).drive(others)
    done.clear()
    cells = tmp_path / "all" / "cells.parquet"
    pd.testing.assert_frame_equal(reproduce.table1_of(cells, tmp_path / "made of all"), of_all)
    pd.testing.assert_frame_equal(reproduce.table1_of(cells, tmp_path / "made of some", some), of_some)
    assert done == []
    for name, file in itertools.product(("all", "some"), ("table1.csv", "table1.md")):
        whole = (tmp_path / name / file).read_bytes().removesuffix(b"\nOther than the defaults: cloning.epochs = 0.\n")
        assert (tmp_path / f"made of {name}" / file).read_bytes() == whole
    assert {path.name for path in (tmp_path / "made of all").iterdir()} == {"table1.csv", "table1.md"}


def test_the_table_is_made_from_cells_of_as_many_trajectories_as_are_wanted(world, done, tmp_path):
    ten = world.changed(train={"trajectories": 10})
    table = table1(ten, tmp_path, ("rail-2",), seeds=2)
    made = reproduce.table1_of(tmp_path / "cells.parquet", tmp_path / "made", trajectories=10)
    pd.testing.assert_frame_equal(made, table)
    assert rows_of(made, "speed_kmh").loc[("rail-2", "argmax"), "mean"] == 71.0 - 3.0


def test_what_is_no_cells_file_or_has_no_expert_is_one_clear_line(world, done, tmp_path):
    table1(world, tmp_path, ("bc-1",), seeds=1)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    cells[cells["system"] != "expert"].to_parquet(tmp_path / "alone.parquet")
    cells.drop(columns="system").to_parquet(tmp_path / "nobody.parquet")
    cells.drop(columns="training_seed").to_parquet(tmp_path / "unseeded.parquet")
    (tmp_path / "cut.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match=r"'.*alone.parquet' holds no episodes of the expert"):
        reproduce.table1_of(tmp_path / "alone.parquet", tmp_path / "made")
    with pytest.raises(InputError, match=r"cells '.*none.parquet' not found; name the cells.parquet of an experiment"):
        reproduce.table1_of(tmp_path / "none.parquet", tmp_path / "made")
    for name in ("unseeded", "cut"):
        with pytest.raises(InputError, match=rf"'.*{name}.parquet' is not the cells.parquet of an experiment \("):
            reproduce.table1_of(tmp_path / f"{name}.parquet", tmp_path / "made")
    with pytest.raises(InputError):
        reproduce.table1_of(tmp_path / "nobody.parquet", tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_cells_of_a_seed_that_was_interrupted_do_not_spoil_the_table_made_from_them(world, done, tmp_path, monkeypatch):
    driven = experiment._driven

    def stop_before_the_second_expert(work):
        if (work.cell.system, work.cell.seed) == ("expert", 1):
            raise KeyboardInterrupt
        return driven(work)

    with monkeypatch.context() as patched:
        patched.setattr(experiment, "_driven", stop_before_the_second_expert)
        with pytest.raises(KeyboardInterrupt):
            table1(world, tmp_path, ("bc-1", "rule"), seeds=2)
    table1(world, tmp_path, ("bc-1", "rule"), seeds=1)  # whose cells are a table already
    made = rows_of(reproduce.table1_of(tmp_path / "cells.parquet", tmp_path / "made"), "speed_kmh")
    assert made.loc[("rule", ""), "difference"] == -3.5


def test_interrupted_at_any_cell_it_goes_on_to_the_same_bytes(world, done, tmp_path, monkeypatch):
    table1(world, tmp_path / "whole", FEW, seeds=1)
    drives = [name for kind, name, *_ in done if kind == "cell" for _ in range(3 if name in LEARNERS else 2)]
    assert len(drives) == sum(event[0] == "drive" for event in done) == 3 * 3 + 2 * 2
    episodes = experiment._episodes
    for n_drives, under_way in enumerate(drives):
        left = iter(range(n_drives))

        def episodes_or_stop(*arguments, left=left):
            if next(left, None) is None:
                raise KeyboardInterrupt
            return episodes(*arguments)

        out = tmp_path / f"interrupted-{n_drives}"
        with monkeypatch.context() as patched:
            patched.setattr(experiment, "_episodes", episodes_or_stop)
            with pytest.raises(KeyboardInterrupt):
                table1(world, out, FEW, seeds=1)
        done.clear()
        table1(world, out, FEW, seeds=1)
        assert noted(done, "cell") == list(FEW[FEW.index(under_way) :])
        resumed = [event[1] for event in done if event[0] == "learn" and event[3]]
        assert resumed == [under_way] * (under_way in LEARNERS)  # trained it was, but not driven
        for file in ("cells.csv", "cells.parquet", "table1.csv", "table1.md"):
            assert (out / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


def test_what_was_quick_goes_on_to_the_whole_and_not_back(world, done, tmp_path):
    whole = world.changed(train={"iterations": "default"})
    table1(whole, tmp_path, seeds=1, quick=True)
    quick = {event[1]: event[2:] for event in done if event[0] == "learn"}
    quarter = {"rail": 40, "rewarded": 40, "gail": 40, "bc": 0, "dagger": 5}
    assert quick == {name: (quarter[name.partition("-")[0]], False) for name in LEARNERS}
    done.clear()
    table1(whole, tmp_path, seeds=1)
    resumed = {event[1]: event[2:] for event in done if event[0] == "learn"}
    long = {"rail": 160, "rewarded": 160, "gail": 160, "dagger": 20}  # a clone is a clone
    assert resumed == {name: (long[kind], True) for name in LEARNERS if (kind := name.partition("-")[0]) != "bc"}


def test_the_table_tells_of_other_iterations_and_keys_than_the_usual(world, done, tmp_path):
    whole, systems = world.changed(train={"iterations": "default"}), ("rail-2", "rail-1", "dagger-2", "bc-2", "rule")
    quick = [
        "Trained for 40 iterations in place of 160 (--quick): RAIL, two layers; RAIL, one layer.",
        "Trained for 5 iterations in place of 20 (--quick): DAgger, two layers.",
        "Other than the defaults: cloning.epochs = 0.",
    ]
    table1(whole, tmp_path / "quick", systems, seeds=1, quick=True)
    told = (tmp_path / "quick" / "table1.md").read_text()
    assert told.endswith("\n\n" + "\n\n".join(quick) + "\n")
    assert json.loads((tmp_path / "quick" / "evaluation.json").read_text())["notes"] == quick
    reproduce.table1_of(tmp_path / "quick" / "cells.parquet", tmp_path / "again", systems)  # which cannot know
    assert (tmp_path / "again" / "table1.md").read_text() == told.removesuffix("\n" + "\n\n".join(quick) + "\n")
    table1(whole, tmp_path / "quick", systems, seeds=1)  # goes on to the whole
    assert "Trained for" not in (tmp_path / "quick" / "table1.md").read_text()
    table1(world.changed(train={"iterations": 20}), tmp_path / "own", systems, seeds=1, quick=True)
    told = (tmp_path / "own" / "table1.md").read_text()  # quick changes nothing that is said
    own = "Trained for 20 iterations in place of 160: RAIL, two layers; RAIL, one layer."
    assert told.endswith(f"\n\n{own}\n\n{quick[-1]}\n")
    table1(config_file.load(None), tmp_path / "usual", ("expert",), seeds=1)
    assert "Other than" not in (tmp_path / "usual" / "table1.md").read_text()


def test_other_episodes_are_driven_without_training_again(world, done, tmp_path):
    table1(world, tmp_path, ("rail-2", "rule"), seeds=1)
    before = (tmp_path / "runs" / "rail-2-40-seed0" / "policy.safetensors").read_bytes()
    table = table1(world, tmp_path, ("rail-2", "rule"), seeds=1, episodes=6)
    assert rows_of(table, "speed_kmh").loc[("rail-2", "argmax"), "mean"] == 68.0 + 2.5
    assert [event[3] for event in done if event[0] == "learn"] == [False, True]
    assert (tmp_path / "runs" / "rail-2-40-seed0" / "policy.safetensors").read_bytes() == before
    assert len(pd.read_parquet(tmp_path / "cells.parquet")) == (2 + 1 + 1) * 6


def test_another_configuration_is_refused(world, done, tmp_path):
    table1(world, tmp_path, FEW, seeds=1)
    before = contents(tmp_path)
    done.clear()
    other = world.changed(search={"noise_std": 0.5})
    with pytest.raises(InputError, match=r"was started with search\.noise_std = .*, not 0\.5"):
        table1(other, tmp_path, FEW, seeds=1)
    assert contents(tmp_path) == before
    assert done == []


def test_a_quick_look_at_a_finished_experiment_is_refused_and_leaves_it_alone(world, done, tmp_path, monkeypatch):
    whole = world.changed(train={"iterations": "default"})
    monkeypatch.setattr(Checkpoint, "iteration", 160)
    table1(whole, tmp_path, ("rail-2",), seeds=1)
    before = contents(tmp_path)
    with pytest.raises(InputError, match="has done 160 iterations"):
        table1(whole, tmp_path, ("rail-2",), seeds=1, quick=True)
    assert contents(tmp_path) == before


def test_other_files_under_the_same_names_are_another_experiment(world, done, tmp_path, monkeypatch):
    table1(world, tmp_path, FEW, seeds=1)
    done.clear()
    table1(world, tmp_path, FEW, seeds=1)
    assert done == []
    monkeypatch.setattr(training, "inputs_of", lambda config: {"network.file": "changed"})
    with pytest.raises(InputError, match=r"the content of network\.file has changed"):
        table1(world, tmp_path, FEW, seeds=1)


def test_what_is_not_trained_anew_is_driven_again_on_other_files(done, tmp_path, monkeypatch):
    mine = shutil.copytree(assets.data_root() / "expert", tmp_path / "mine")
    world = config_file.load(None, ["cloning.epochs=0", f"train.expert={mine}"])

    def made(*grid):
        done.clear()
        Experiment(world, tmp_path / "out", 1, N_EPISODES).drive(grid)
        return noted(done, "cell")

    drivers = ("rule", 0), ("expert", 0)
    assert made(*drivers) == ["rule", "expert"]
    assert made(*drivers) == []
    with monkeypatch.context() as changed:
        changed.setattr(training, "inputs_of", lambda config: {"network.file": "changed"})
        assert made(*drivers) == ["rule", "expert"]
    assert made(("bc-1", 40), *drivers) == ["bc-1", "rule", "expert"]
    policy, manifest = mine / assets.EXPERT_POLICY, mine / assets.MANIFEST
    before = assets.sha256(policy)
    save_file(load_file(policy), policy, metadata={"another": "one"})
    manifest.write_text(manifest.read_text().replace(before, assets.sha256(policy)))
    assert made(("bc-1", 40), *drivers) == ["bc-1", "rule", "expert"]  # all are set beside that expert
    assert [event for event in done if event[0] == "learn"] == [("learn", "bc-1", 0, True)]


def test_a_cell_from_before_a_key_was_there_is_finished(world, done, tmp_path, monkeypatch):
    with monkeypatch.context() as before:
        before.setattr(experiment, "dumps", lambda config: re.sub(r"\[rail\]\nreward_weight = .*\n", "", dumps(config)))
        table1(world, tmp_path, (*FEW, "rewarded-2"), seeds=1)
    done.clear()
    table1(world, tmp_path, (*FEW, "rewarded-2"), seeds=1)
    assert noted(done, "cell") == ["rewarded-2"]  # whose key had another value


def test_files_that_are_no_cells_are_let_be(world, done, tmp_path):
    whole = table1(world, tmp_path, FEW, seeds=1)
    for name in ("rail-2-40-seed0 (copy)", "rail-3-40-seed0", "rail-2-layer-40-seed0", "notes"):
        (tmp_path / "cells" / f"{name}.parquet").write_bytes(b"no table")
    pd.testing.assert_frame_equal(table1(world, tmp_path, FEW, seeds=1), whole)


def test_every_cell_is_known_by_the_name_of_its_files():
    for number, name in enumerate(SYSTEMS):
        assert Cell.parse(Cell(name, 40, number).name) == Cell(name, 40, number)
    assert Cell("rail-2-unmasked", 5, 11).name == "rail-2-unmasked-5-seed11"


def test_contacts_are_in_the_table(world, done, tmp_path):
    table = table1(world, tmp_path, FEW, seeds=2)  # made-up episodes have one of either kind each
    struck = rows_of(table, "struck").loc[("rail-2", "argmax")]
    assert (struck["mean"], struck["high"]) == (1.0, 1.0)
    assert 0.6 < struck["low"] < 0.7  # Wilson's, at 8 of 8
    rail = (tmp_path / "table1.md").read_text().splitlines()[2]
    assert rail.startswith("| RAIL, two layers (argmax) |")
    assert rail.endswith("| 16 |")


def test_contacts_of_drivers_that_do_not_train_are_counted_on_the_traffic_of_every_seed(world, done, tmp_path):
    table1(world, tmp_path, ("rule",), seeds=3)
    lines = (tmp_path / "table1.md").read_text().splitlines()
    assert next(line for line in lines if line.startswith("| rule driver |")).endswith("| 24 |")


def test_contacts_that_never_happened_are_compared_without_an_interval(world, done, tmp_path, contacts):
    contacts["struck"] = 0
    table = table1(world, tmp_path, FEW, seeds=2)
    struck = rows_of(table, "struck").loc[("rail-2", "argmax")]
    assert (struck["mean"], struck["difference"], struck["low"]) == (0.0, 0.0, 0.0)
    assert struck["high"] > 0.3
    assert struck[["ratio", "ratio_low", "ratio_high", "difference_low", "difference_high"]].isna().all()


def test_a_damaged_cell_is_made_again(world, done, tmp_path):
    whole = table1(world, tmp_path, FEW, seeds=1)
    for damaged in (b"", b"PAR1 and no more"):
        (tmp_path / "cells" / "rule-0-seed0.parquet").write_bytes(damaged)
        done.clear()
        pd.testing.assert_frame_equal(table1(world, tmp_path, FEW, seeds=1), whole)
        assert noted(done, "cell") == ["rule"]


@pytest.mark.parametrize("given", [0.0, 3.0])
def test_the_reward_is_paid_in_its_own_row_alone(done, tmp_path, given):
    paid = config_file.load(None, ["cloning.epochs=0", "train.iterations=5", f"rail.reward_weight={given}"])
    table1(paid, tmp_path, seeds=1)
    weights = {path.name: RunDirectory(path).config.rail.reward_weight for path in (tmp_path / "runs").iterdir()}
    assert weights.pop("rewarded-2-40-seed0") == 3.0
    assert len(weights) == len(LEARNERS) - 1
    assert set(weights.values()) == {0.0}


def test_every_row_is_trained_with_what_its_name_tells(world, done, tmp_path):
    table1(world, tmp_path, seeds=1)
    for name in LEARNERS:
        trained = RunDirectory(tmp_path / "runs" / f"{name}-40-seed0").config
        kind, layers, *rest = name.split("-")
        assert trained.train.learner == ("rail" if kind == "rewarded" else kind)
        assert trained.policy.layers == int(layers)
        assert trained.policy.masked == (rest != ["unmasked"])
        assert trained.train.trajectories == 40


def test_a_cluster_is_refused_before_any_work(world, done, tmp_path):
    with pytest.raises(InputError, match="takes a number of --workers, not ray"):
        table1(world, tmp_path, seeds=1, workers="ray")
    assert done == []


def test_too_few_demonstrations_are_found_out_before_any_work(world, done, tmp_path):
    many = world.changed(train={"trajectories": 41})
    with pytest.raises(InputError, match="41 demonstrated trajectories wanted, and there are 40"):
        table1(many, tmp_path, seeds=1)
    assert done == []


@pytest.mark.parametrize(
    ("size", "told"),
    [({"seeds": 0}, "--seeds must be at least 1; got 0"), ({"seeds": 1, "episodes": 0}, "at least 1; got 0")],
)
def test_no_seed_and_no_episode_are_refused_before_any_work(world, done, tmp_path, size, told):
    with pytest.raises(InputError, match=told):
        table1(world, tmp_path / "out", **size)
    assert done == []
    assert not (tmp_path / "out").exists()


@pytest.fixture
def drawn(monkeypatch):
    """The curves of every figure that was drawn, by what it shows."""
    drawn = {}

    def note(trajectories, curves, what):
        drawn[what] = curves
        return figure(trajectories, curves, what)

    figure = plot.against_trajectories
    monkeypatch.setattr(plot, "against_trajectories", note)
    return drawn


def test_the_figures_show_ratios_against_demonstrated_trajectories(world, done, tmp_path, drawn):
    cells = figures(world, tmp_path, seeds=2)
    assert len(cells) == 2 * (2 * 4 * 5 + 1) * N_EPISODES
    assert list(drawn) == ["speed", "overtakes", "lane changes", "longitudinal reward", "lateral reward"]
    labels = ["RAIL, two layers", "RAIL, one layer", "GAIL, two layers", "behaviour cloning, two layers"]
    assert list(drawn["speed"]) == labels
    shown = np.array(reproduce.TRAJECTORIES)
    rail = (62 + 0.1 * shown + 1.5 + 1.5) / 71.5
    half = 1.5 * T1 / 71.5  # of two trainings
    expected = np.column_stack([rail, rail - half, rail + half])
    np.testing.assert_allclose(drawn["speed"]["RAIL, one layer"], expected, atol=1e-5)
    sampled = (64 + 0.1 * shown + 1.5 + 1.5 - 1) / 71.5  # GAIL's mode
    np.testing.assert_allclose(drawn["speed"]["GAIL, two layers"][:, 0], sampled, atol=1e-6)
    names = ("speed", "lane_changes", "overtakes", "longitudinal", "lateral")
    for name in names:
        assert (tmp_path / f"figure_{name}.png").read_bytes().startswith(b"\x89PNG")
        assert b"demonstrated trajectories" in (tmp_path / f"figure_{name}.svg").read_bytes()


def test_the_figures_made_from_cells_are_the_experiments(world, done, tmp_path, drawn):
    figures(world, tmp_path / "whole", seeds=1)
    table1(world, tmp_path / "whole", FEW, seeds=1)  # there are other systems among the cells
    before = dict(drawn)
    drawn.clear()
    done.clear()
    reproduce.figures_of(tmp_path / "whole" / "cells.parquet", tmp_path / "made")
    assert done == []
    assert list(drawn) == list(before)
    for what, curves in drawn.items():
        assert list(curves) == list(before[what])
        for label, curve in curves.items():
            np.testing.assert_array_equal(curve, before[what][label])
        png = f"figure_{what.split()[0] if 'reward' in what else what.replace(' ', '_')}.png"
        assert (tmp_path / "made" / png).read_bytes() == (tmp_path / "whole" / png).read_bytes()


def test_a_figure_has_as_many_curves_as_there_are_learners(world, done, tmp_path, drawn):
    reproduce.figures(Experiment(world, tmp_path, 1, N_EPISODES), tuple(SYSTEMS))
    assert list(drawn["speed"]) == [SYSTEMS[name].label for name in LEARNERS]


def test_table_and_figures_share_their_cells(world, done, tmp_path, monkeypatch):
    monkeypatch.setattr(reproduce, "_draw", lambda cells, systems, out: None)
    table1(world, tmp_path, seeds=1)
    done.clear()
    figures(world, tmp_path, seeds=1)
    learned = noted(done, "learn")
    assert len(learned) == 4 * 5 - 4
    assert {path.name for path in (tmp_path / "runs").iterdir()} == RUNS
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    # The figures' 20 trainings and the table's 6 others in either mode, and three drivers.
    assert len(cells) == (2 * (4 * 5 + 6) + 3) * N_EPISODES
    table1(world, tmp_path, seeds=1)
    pd.testing.assert_frame_equal(cells, pd.read_parquet(tmp_path / "cells.parquet"))


RUNS = {f"{name}-40-seed0" for name in LEARNERS} | {
    f"{name}-{n}-seed0" for name in reproduce.FIGURES for n in reproduce.TRAJECTORIES
}


SMALL = [
    "cloning.epochs=1",
    "search.n_directions=2",
    "judge.minibatches=2",
    "train.iterations=4",
    "train.horizon_s=10.0",
    "episode.duration_s=10.0",
]


@pytest.mark.slow
def test_killed_amid_a_training_it_goes_on_with_other_workers_to_the_same_bytes(tmp_path):
    small = config_file.load(None, SMALL)
    systems, few = ("rail-2", "expert"), audit.FOLDS - 1  # of so few nobody is told apart, which would take the longest
    table1(small, tmp_path / "whole", systems, seeds=1, episodes=few)
    overrides = itertools.chain.from_iterable(("--set", override) for override in SMALL)
    size = ["--only", ",".join(systems), "--seeds", "1", "--episodes", str(few), "--workers", "2"]
    command = ["reproduce", "table1", *size, "--out", str(tmp_path / "killed"), *overrides]
    under_way = subprocess.Popen([sys.executable, "-c", "from rail_sumo.cli import main; main()", *command])
    run_under_way = tmp_path / "killed" / "runs" / "rail-2-40-seed0"
    while not (run_under_way / PROGRESS).exists():
        assert under_way.poll() is None
        time.sleep(0.01)
    under_way.kill()
    under_way.wait()
    assert RunDirectory(run_under_way).checkpoint().iteration < 4
    assert not (tmp_path / "killed" / "table1.csv").exists()
    table1(small, tmp_path / "killed", systems, seeds=1, episodes=few, workers=2)
    for file in ("cells.parquet", "cells.csv", "table1.csv", "table1.md"):
        assert (tmp_path / "whole" / file).read_bytes() == (tmp_path / "killed" / file).read_bytes()


def test_all_but_sumo_are_told_apart_by_the_audits_classifier(tmp_path, monkeypatch):
    monkeypatch.setattr(audit, "MINIBATCHES", 1)
    table1(config_file.load(None, SMALL), tmp_path, ("rule", "sumo", "expert"), seeds=1)
    apart = pd.read_parquet(tmp_path / "cells.parquet").groupby("system")["told_apart"].count()
    assert apart.to_dict() == {"rule": N_EPISODES, "sumo": 0, "expert": N_EPISODES}
