"""The paper's experiments, on cells whose episodes are made up."""

import itertools
import re
import shutil
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pandas as pd
import pytest
from safetensors.numpy import load_file, save_file

from rail_sumo import assets, config, experiment, plot, reproduce, run, training
from rail_sumo.config import dumps
from rail_sumo.errors import InputError
from rail_sumo.experiment import Experiment
from rail_sumo.policy import PolicyParameters
from rail_sumo.run_directory import PROGRESS, Checkpoint, RunDirectory

N_EPISODES = 4


@pytest.fixture
def world():
    return config.load(None, [f"train.evaluation_episodes={N_EPISODES}", "cloning.epochs=0", "train.iterations=5"])


@pytest.fixture
def done(monkeypatch):
    """What was trained and driven; learned drivers are known by their layers and demonstrations."""
    done = []

    def learn(world, folder, *, seed, resume):
        done.append(("learn", folder.name, world.train.learner, world.train.n_iterations, resume))
        if resume:
            RunDirectory(folder).go_on(world, seed, training.inputs_of(world))
            return RunDirectory(folder)
        demonstrations = training.demonstrations_of(world)
        return RunDirectory.create(
            folder, world, seed, training.inputs_of(world), training._start(world, demonstrations, seed)
        )

    def evaluate(policies, world, *, episodes, seed):
        ((name, driver),) = policies.items()
        done.append(("evaluate", name, seed))
        speed = {"rule": 65.0, "sumo": 63.0, "expert": 70.0}.get(name)
        if isinstance(driver, PolicyParameters):
            speed = 60.0 + 2.0 * world.policy.layers + 0.1 * world.train.trajectories
        rows = [{**ROW, "policy": name, "episode": i, "seed": 100 * seed + i, "speed_kmh": speed + i} for i in range(4)]
        table = run.report.episodes(rows)
        return table, run.report.summary(table)

    monkeypatch.setattr(training, "learn", learn)
    monkeypatch.setattr(run, "evaluate", evaluate)
    monkeypatch.setattr(reproduce, "interval", partial(reproduce.interval, n_resamples=100))
    return done


def table1(world, out, **how):
    return reproduce.table1(Experiment(world, out, **how))


def figures(world, out, **how):
    return reproduce.figures(Experiment(world, out, **how))


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


ROW = {
    column: "highway5" if kind == "string" else 1 if kind == "int64" else 1.0
    for column, kind in run.report.EPISODE_COLUMNS.items()
}


def test_every_row_of_the_table_is_there_beside_the_papers(world, done, tmp_path):
    table = table1(world, tmp_path, seeds=2)
    assert list(table.columns) == list(reproduce.TABLE_COLUMNS)
    systems = list(dict.fromkeys(zip(table["learner"], table["layers"], strict=True)))
    assert systems == [*reproduce.TABLE1, ("expert", 0)]
    speeds = table[table["metric"] == "speed_kmh"].set_index(["learner", "layers"])
    assert speeds.loc[("rail", 2), "mean"] == 60 + 4 + 4 + 1.5
    assert speeds.loc[("rail", 1), "mean"] == 60 + 2 + 4 + 1.5
    assert speeds.loc[("rail", 2), "ratio"] == pytest.approx(69.5 / 71.5, abs=1e-6)
    assert speeds.loc[("expert", 0), ["ratio", "ratio_low", "ratio_high"]].tolist() == [1.0, 1.0, 1.0]
    difference = ["difference", "difference_low", "difference_high"]
    assert speeds.loc[("rail", 1), difference].tolist() == pytest.approx([66.0 - 70.0] * 3)  # on any traffic
    assert speeds.loc[("expert", 0), "above_expert"] == 0.5
    assert speeds.loc[("rail", 2), ["paper", "paper_ratio"]].tolist() == [70.38, pytest.approx(1.022519, abs=1e-6)]
    assert np.isnan(speeds.loc[("gail", 2), "paper"])
    pd.testing.assert_frame_equal(table, pd.read_csv(tmp_path / "table1.csv", dtype=reproduce.TABLE_COLUMNS))
    markdown = (tmp_path / "table1.md").read_text()
    assert "| RAIL, two layers | 69.5 | 1.0 | 1.0 | 1.0 | 1.0 |" in markdown
    assert "| &emsp;in the paper | 70.4 | 45.0 | 15.0 | 2719.4 | -123.0 |" in markdown


def test_the_cells_are_tidy_and_the_same_in_both_files(world, done, tmp_path):
    table1(world, tmp_path, seeds=2)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    assert list(cells.columns) == list(experiment.CELL_COLUMNS)
    assert len(cells) == 2 * (len(reproduce.TABLE1) + 1) * N_EPISODES
    assert not cells.duplicated(["learner", "layers", "trajectories", "training_seed", "episode"]).any()
    drivers = cells[cells["learner"].isin(["rule", "sumo", "expert"])]
    assert (drivers[["layers", "trajectories"]] == 0).all(axis=None)
    from_csv = pd.read_csv(tmp_path / "cells.csv", dtype=experiment.CELL_COLUMNS)
    pd.testing.assert_frame_equal(cells, from_csv)


def test_the_experts_episodes_are_on_the_traffic_of_every_seed(world, done, tmp_path):
    table1(world, tmp_path, seeds=3)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    traffic = cells.groupby(["training_seed", "episode"])["seed"].nunique()
    assert (traffic == 1).all()
    assert cells["seed"].nunique() == 3 * N_EPISODES


def test_interrupted_at_any_cell_it_goes_on_to_the_same_bytes(world, done, tmp_path, monkeypatch):
    table1(world, tmp_path / "whole", seeds=1)
    evaluate = run.evaluate
    for n_cells in range(len(reproduce.TABLE1) + 1):
        left = iter(range(n_cells))

        def evaluate_or_stop(*arguments, left=left, **named):
            if next(left, None) is None:
                raise KeyboardInterrupt
            return evaluate(*arguments, **named)

        out = tmp_path / f"interrupted-{n_cells}"
        with monkeypatch.context() as patched:
            patched.setattr(run, "evaluate", evaluate_or_stop)
            with pytest.raises(KeyboardInterrupt):
                table1(world, out, seeds=1)
        done.clear()
        table1(world, out, seeds=1)
        assert sum(event[0] == "evaluate" for event in done) == len(reproduce.TABLE1) + 1 - n_cells
        for file in ("cells.csv", "cells.parquet", "table1.csv", "table1.md"):
            assert (out / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


def test_what_was_quick_goes_on_to_the_whole_and_not_back(world, done, tmp_path):
    whole = world.model_copy(update={"train": world.train.model_copy(update={"iterations": "default"})})
    table1(whole, tmp_path, seeds=1, quick=True)
    quick = {event[1].partition("-")[0]: event[3:] for event in done if event[0] == "learn"}
    quarter = {"rail": 40, "rewarded": 40, "gail": 40, "bc": 0, "dagger": 5}
    assert quick == {learner: (n, False) for learner, n in quarter.items()}
    done.clear()
    table1(whole, tmp_path, seeds=1)
    resumed = {event[1].partition("-")[0]: event[3:] for event in done if event[0] == "learn"}
    long = dict.fromkeys(("rail", "rewarded", "gail"), (160, True))
    assert resumed == long | {"dagger": (20, True)}  # a clone is a clone


def test_another_configuration_is_refused(world, done, tmp_path):
    table1(world, tmp_path, seeds=1)
    before = contents(tmp_path)
    done.clear()
    other = world.model_copy(update={"search": world.search.model_copy(update={"noise_std": 0.5})})
    with pytest.raises(InputError, match=r"was started with search\.noise_std = .*, not 0\.5"):
        table1(other, tmp_path, seeds=1)
    assert contents(tmp_path) == before
    assert done == []


def test_a_quick_look_at_a_finished_experiment_is_refused_and_leaves_it_alone(world, done, tmp_path, monkeypatch):
    whole = world.model_copy(update={"train": world.train.model_copy(update={"iterations": "default"})})
    monkeypatch.setattr(Checkpoint, "iteration", 160)
    table1(whole, tmp_path, seeds=1)
    before = contents(tmp_path)
    with pytest.raises(InputError, match="has done 160 iterations"):
        table1(whole, tmp_path, seeds=1, quick=True)
    assert contents(tmp_path) == before


def test_other_files_under_the_same_names_are_another_experiment(world, done, tmp_path, monkeypatch):
    table1(world, tmp_path, seeds=1)
    done.clear()
    table1(world, tmp_path, seeds=1)
    assert done == []
    monkeypatch.setattr(training, "inputs_of", lambda config: {"network.file": "changed"})
    with pytest.raises(InputError, match=r"the content of network\.file has changed"):
        table1(world, tmp_path, seeds=1)


def test_drivers_that_do_not_train_are_driven_again_on_other_files(done, tmp_path, monkeypatch):
    mine = shutil.copytree(assets.data_root() / "expert", tmp_path / "mine")
    world = config.load(None, [f"train.evaluation_episodes={N_EPISODES}", f"train.expert={mine}"])

    def driven():
        done.clear()
        Experiment(world, tmp_path / "out", 1).drive([("rule", 0, 0), reproduce.EXPERT_CELL])
        return [who for _, who, _ in done]

    assert driven() == ["rule", "expert"]
    assert driven() == []
    monkeypatch.setattr(training, "inputs_of", lambda config: {"network.file": "changed"})
    assert driven() == ["rule", "expert"]
    policy, manifest = mine / assets.EXPERT_POLICY, mine / assets.MANIFEST
    before = assets.sha256(policy)
    save_file(load_file(policy), policy, metadata={"another": "one"})
    manifest.write_text(manifest.read_text().replace(before, assets.sha256(policy)))
    assert driven() == ["expert"]


def test_a_cell_from_before_a_key_was_there_is_finished(world, done, tmp_path, monkeypatch):
    with monkeypatch.context() as before:
        before.setattr(experiment, "dumps", lambda config: re.sub(r"\[rail\]\nreward_weight = .*\n", "", dumps(config)))
        table1(world, tmp_path, seeds=1)
    done.clear()
    table1(world, tmp_path, seeds=1)
    assert [event[1] for event in done if event[0] == "evaluate"] == ["rewarded"]  # whose key had another value


def test_files_that_are_no_cells_are_let_be(world, done, tmp_path):
    whole = table1(world, tmp_path, seeds=1)
    for name in ("rail-2-layer-40-seed0 (copy)", "rail-3-layer-40-seed0", "notes"):
        (tmp_path / "cells" / f"{name}.parquet").write_bytes(b"no table")
    pd.testing.assert_frame_equal(table1(world, tmp_path, seeds=1), whole)


def test_contacts_are_in_the_table(world, done, tmp_path):
    table = table1(world, tmp_path, seeds=2)  # made-up episodes have one of either kind each
    struck = table[table["metric"] == "struck"].set_index(["learner", "layers"]).loc[("rail", 2)]
    assert (struck["mean"], struck["high"]) == (1.0, 1.0)
    assert 0.6 < struck["low"] < 0.7  # Wilson's, at 8 of 8
    rail = (tmp_path / "table1.md").read_text().splitlines()[2]
    assert rail.startswith("| RAIL, two layers |")
    assert rail.endswith("| 16 |")


def test_contacts_that_never_happened_are_compared_without_an_interval(world, done, tmp_path, monkeypatch):
    monkeypatch.setitem(ROW, "struck", 0)
    table = table1(world, tmp_path, seeds=2)
    struck = table[table["metric"] == "struck"].set_index(["learner", "layers"]).loc[("rail", 2)]
    assert (struck["mean"], struck["difference"], struck["low"]) == (0.0, 0.0, 0.0)
    assert struck["high"] > 0.3
    assert struck[["ratio", "ratio_low", "ratio_high", "difference_low", "difference_high"]].isna().all()


def test_a_damaged_cell_is_made_again(world, done, tmp_path):
    whole = table1(world, tmp_path, seeds=1)
    for damaged in (b"", b"PAR1 and no more"):
        (tmp_path / "cells" / "rule-0-layer-0-seed0.parquet").write_bytes(damaged)
        done.clear()
        pd.testing.assert_frame_equal(table1(world, tmp_path, seeds=1), whole)
        assert done == [("evaluate", "rule", 0)]


@pytest.mark.parametrize(("given", "beside"), [(0.0, experiment.REWARD_WEIGHT), (3.0, 3.0)])
def test_the_reward_is_paid_in_its_own_row_alone(done, tmp_path, given, beside):
    paid = config.load(None, ["cloning.epochs=0", "train.iterations=5", f"rail.reward_weight={given}"])
    table1(paid, tmp_path, seeds=1)
    weights = {
        path.name.partition("-seed")[0]: RunDirectory(path).config.rail.reward_weight
        for path in (tmp_path / "runs").iterdir()
    }
    assert weights.pop("rewarded-2-layer-40") == beside
    assert set(weights.values()) == {0.0}


def test_a_cluster_is_refused_before_any_work(world, done, tmp_path):
    with pytest.raises(InputError, match="takes a number of --workers, not ray"):
        table1(world, tmp_path, seeds=1, workers="ray")
    assert done == []


def test_too_few_demonstrations_are_found_out_before_any_work(world, done, tmp_path):
    many = world.model_copy(update={"train": world.train.model_copy(update={"trajectories": 41})})
    with pytest.raises(InputError, match="41 demonstrated trajectories wanted, and there are 40"):
        table1(many, tmp_path, seeds=1)
    assert done == []


def test_no_seed_is_refused_before_any_work(world, done, tmp_path):
    with pytest.raises(InputError, match="--seeds must be at least 1; got 0"):
        table1(world, tmp_path / "out", seeds=0)
    assert done == []
    assert not (tmp_path / "out").exists()


def test_the_figures_show_ratios_against_demonstrated_trajectories(world, done, tmp_path, monkeypatch):
    drawn = {}

    def note(trajectories, curves, what):
        drawn[what] = curves
        return figure(trajectories, curves, what)

    figure = plot.against_trajectories
    monkeypatch.setattr(plot, "against_trajectories", note)
    cells = figures(world, tmp_path, seeds=2)
    assert len(cells) == 2 * (4 * 5 + 1) * N_EPISODES
    assert list(drawn) == ["speed", "overtakes", "lane changes", "longitudinal reward", "lateral reward"]
    np.testing.assert_allclose(
        drawn["speed"]["RAIL, one layer"][:, 0], [(62 + 0.1 * n + 1.5) / 71.5 for n in reproduce.TRAJECTORIES]
    )
    names = ("speed", "lane_changes", "overtakes", "longitudinal", "lateral")
    for name in names:
        assert (tmp_path / f"figure_{name}.png").read_bytes().startswith(b"\x89PNG")
        assert b"demonstrated trajectories" in (tmp_path / f"figure_{name}.svg").read_bytes()


def test_table_and_figures_share_their_cells(world, done, tmp_path):
    table1(world, tmp_path, seeds=1)
    done.clear()
    figures(world, tmp_path, seeds=1)
    learned = [event[1] for event in done if event[0] == "learn"]
    assert len(learned) == 4 * 5 - 4
    assert "rail-2-layer-40-seed0" not in learned
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    # The figures' and what the table has beside: DAgger, rule, sumo, RAIL with the reward, one layer's clone, expert.
    assert len(cells) == (4 * 5 + 6) * N_EPISODES
    table1(world, tmp_path, seeds=1)
    pd.testing.assert_frame_equal(cells, pd.read_parquet(tmp_path / "cells.parquet"))


SMALL = [
    "cloning.epochs=1",
    "search.n_directions=2",
    "gail.rollouts=2",
    "dagger.rollouts=1",
    "judge.minibatches=2",
    "train.iterations=4",
    "train.horizon_s=10.0",
    "train.evaluation_episodes=2",
    "episode.duration_s=10.0",
]


@pytest.mark.slow
def test_killed_amid_a_training_it_goes_on_with_other_workers_to_the_same_bytes(tmp_path):
    small = config.load(None, SMALL)
    table1(small, tmp_path / "whole", seeds=1)
    overrides = itertools.chain.from_iterable(("--set", override) for override in SMALL)
    command = ["reproduce", "table1", "--seeds", "1", "--workers", "2", "--out", str(tmp_path / "killed"), *overrides]
    under_way = subprocess.Popen([sys.executable, "-c", "from rail_sumo.cli import main; main()", *command])
    run_under_way = tmp_path / "killed" / "runs" / "rail-2-layer-40-seed0"
    while not (run_under_way / PROGRESS).exists():
        assert under_way.poll() is None
        time.sleep(0.01)
    under_way.kill()
    under_way.wait()
    assert RunDirectory(run_under_way).checkpoint().iteration < 4
    assert not (tmp_path / "killed" / "table1.csv").exists()
    table1(small, tmp_path / "killed", seeds=1, workers=2)
    for file in ("cells.parquet", "cells.csv", "table1.csv", "table1.md"):
        assert (tmp_path / "whole" / file).read_bytes() == (tmp_path / "killed" / file).read_bytes()
