"""Training runs on rollouts made up from the task, so that hundreds of them take no time; SUMO drives in a few."""

import json
import math
import multiprocessing
import os
import re
import shutil
import signal
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from sketch import cut_road

from rail_sumo import assets, config, config_file, drivers, learners, rollout, roster, run, training
from rail_sumo.errors import InputError, NotBegun
from rail_sumo.highway.reward import total_reward
from rail_sumo.highway.sumo.simulation import HOST
from rail_sumo.imitation import gail
from rail_sumo.imitation.demonstrations import Demonstrations, recorded_by
from rail_sumo.policy import PolicyParameters
from rail_sumo.records import DECISION_COLUMNS, METRICS, MetaAction, Trajectory
from rail_sumo.run_directory import CHECKPOINT, CLONE, CONFIG, JUDGE, POLICY, PROGRESS, PROGRESS_COLUMNS, RunDirectory
from rail_sumo.tables import report

N_FEATURES = 8


def drive(task):
    """Stands in for SUMO: what is seen follows from the traffic seed, what is decided from the driver."""
    observations = np.random.default_rng(task.seed).normal(size=(20, N_FEATURES))
    observations[:, : N_FEATURES // 2] = 50.0 + 50.0 * np.tanh(observations[:, : N_FEATURES // 2])  # distances
    if isinstance(task.driver, PolicyParameters):
        actions = np.array([task.driver.policy()(observation) for observation in observations])
    else:
        actions = np.where(observations[:, 0] > 50.0, 1, 2)
    return Trajectory(
        observations=observations,
        decisions=actions,
        carried_out=actions,
        allowed=np.ones((len(actions), 5), dtype=np.bool_),
        decision_step=np.arange(len(actions)),
        decision_place=np.zeros((len(actions), 3)),
        speed_mps=np.full(201, 15.0 + (actions == 1).sum()),
        distance_m=20.0 * (15.0 + (actions == 1).sum()),
        limit_mps=np.full(200, 80.0 / 3.6),
        lane_changing=np.zeros(200, dtype=np.bool_),
        overtakes=int((actions == 1).sum()),
        overtaken=0,
        lane_changes=int((actions == 3).sum()),
        aborted_lane_changes=0,
        refused_decisions=0,
        collisions=0,
        struck=0,
        hard_brakings_behind=0,
        min_ttc_s=math.inf,
        end_reason="duration",
        seed=task.seed,
        network="highway5",
        host="host",
        depart_s=0.0,
    )


@pytest.fixture
def driven(monkeypatch):
    """Every task driven; made up, on a clock that stands still."""
    tasks = []

    def drive_and_note(task):
        tasks.append(task)
        return drive(task)

    def drive_advised(task):
        trajectory = drive(task)
        return trajectory, np.where(trajectory.observations[:, 0] > 0, 1, 2)

    monkeypatch.setattr(rollout, "drive", drive_and_note)
    monkeypatch.setattr(rollout, "_drive_advised", drive_advised)
    monkeypatch.setattr(drivers, "load_expert", lambda world: drivers.Expert([]))
    monkeypatch.setattr(training.time, "perf_counter", lambda: 0.0)
    return tasks


@pytest.fixture
def small(tmp_path):
    """A configuration that trains in a moment, from demonstrations in a file."""
    expert = [drive(rollout.Task("expert", config.Config(), seed)) for seed in range(3)]
    world = config_file.load(None, SMALL)
    features = run.feature_names(world.lidar, world.observation)
    Demonstrations.from_trajectories(expert).save(tmp_path / "demonstrations.parquet", features=features, about={})
    return config_file.load(None, [*SMALL, f"train.demonstrations={tmp_path / 'demonstrations.parquet'}"])


SMALL = (
    f"lidar.n_rays={N_FEATURES // 2}",
    "policy.hidden=3",
    "cloning.epochs=2",
    "search.n_directions=2",
    "search.n_top=1",
    "judge.hidden=[4]",
    "judge.minibatches=2",
    "judge.batch_size=8",
    "gail.rollouts=2",
    "gail.critic_hidden=[4]",
    "gail.epochs=2",
    "gail.batch_size=8",
    "dagger.rollouts=2",
    "train.trajectories=3",
    "train.iterations=3",
    "train.horizon_s=20.0",
    "train.evaluation_episodes=2",
)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def interrupted_after(n_writes, replace=Path.replace):
    """A `Path.replace` that lets some files through and then stops everything."""
    left = iter(range(n_writes))

    def replace_or_stop(self, target):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return replace(self, target)

    return replace_or_stop


def test_interrupted_at_any_write_training_resumes_to_the_same_bytes(small, driven, tmp_path, monkeypatch):
    run.train(small, tmp_path / "whole", seed=1)
    # Configuration and clone; three files for the clone and four for each of three iterations; four tables.
    for n_writes in range(2 + 3 + 4 * 3 + 4):
        out = tmp_path / f"interrupted-{n_writes}"
        with monkeypatch.context() as patched:
            patched.setattr(Path, "replace", interrupted_after(n_writes))
            with pytest.raises(KeyboardInterrupt):
                run.train(small, out, seed=1)
        assert out.exists() == (n_writes >= 5)  # not before it is whole
        run.train(small, out, seed=1, resume=out.exists())
        assert contents(out) == contents(tmp_path / "whole")


class KillsItself:
    """An observer that ends its process as `kill -9` does, after two iterations."""

    def start(self, work, total, done=0):
        self.left = 2

    def note(self, text): ...

    def advance(self, figures):
        self.left -= 1
        if not self.left:
            os.kill(os.getpid(), signal.SIGKILL)


def train_and_die(small, out):
    rollout.drive = drive
    run.train(small, out, seed=1, observer=KillsItself())


def test_killed_training_resumes_to_the_same_policy(small, driven, tmp_path):
    process = multiprocessing.get_context("spawn").Process(target=train_and_die, args=(small, tmp_path / "killed"))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert RunDirectory(tmp_path / "killed").checkpoint().iteration == 2
    run.train(small, tmp_path / "killed", seed=1, resume=True)
    run.train(small, tmp_path / "whole", seed=1)
    for file in (POLICY, JUDGE, "episodes.csv"):
        assert (tmp_path / "killed" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


def test_a_policy_of_no_iterations_is_the_clone(small, driven, tmp_path):
    still = small.model_copy(update={"train": small.train.model_copy(update={"iterations": 0})})
    run.train(still, tmp_path / "run", seed=1)
    policy, clone = (load_file(tmp_path / "run" / file) for file in (POLICY, CLONE))
    np.testing.assert_equal(policy, clone)


def test_training_moves_the_policy_and_tells_of_every_iteration(small, driven, tmp_path):
    episodes, summary, _ = run.train(small, tmp_path / "run", seed=1)
    policy, clone = (load_file(tmp_path / "run" / file)["theta"] for file in (POLICY, CLONE))
    assert not np.array_equal(policy, clone)
    progress = pd.read_csv(tmp_path / "run" / PROGRESS)
    assert tuple(progress.columns) == PROGRESS_COLUMNS
    assert list(progress["iteration"]) == [1, 2, 3]
    assert list(progress["environment_steps"]) == [800, 1600, 2400]  # 2 directions, 2 signs, 200 steps
    assert list(episodes["policy"].unique()) == ["rail", "clone, argmax", "clone, sampled", "expert"]
    pd.testing.assert_frame_equal(episodes, pd.read_parquet(tmp_path / "run" / "episodes.parquet"))
    pd.testing.assert_frame_equal(summary, pd.read_parquet(tmp_path / "run" / "summary.parquet"))


def test_both_signs_meet_the_same_traffic_which_is_new_each_iteration_and_never_evaluated_on(small, driven, tmp_path):
    episodes, *_ = run.train(small, tmp_path / "run", seed=1)
    training = np.array([task.seed for task in driven[:12]]).reshape(3, 2, 2)  # iteration, sign, direction
    np.testing.assert_array_equal(training[:, 0], training[:, 1])
    assert len(np.unique(training)) == 6
    assert not set(training.ravel()) & set(episodes["seed"])
    assert {task.config.episode.duration_s for task in driven[:12]} == {20.0}


def test_every_policy_is_evaluated_on_the_same_traffic(driven):
    episodes, *_ = run.evaluate({"keep": "keep", "rule": "rule"}, config.Config(), episodes=3, seed=5)
    keep, rule = (episodes[episodes["policy"] == name] for name in ("keep", "rule"))
    assert list(keep["seed"]) == list(rule["seed"])
    assert keep["seed"].nunique() == 3
    more, *_ = run.evaluate({"keep": "keep"}, config.Config(), episodes=4, seed=5)
    assert list(more["seed"][:3]) == list(keep["seed"])


def test_demonstrations_are_what_was_seen_and_decided(driven, tmp_path):
    world = config_file.load(None, SMALL)
    recorded = run.demonstrate("rule", world, tmp_path / "new" / "rule.parquet", episodes=2, seed=5)
    features = run.feature_names(world.lidar, world.observation)
    loaded = Demonstrations.load(tmp_path / "new" / "rule.parquet", features=features)
    seen = np.concatenate([drive(task).observations for task in driven])
    np.testing.assert_allclose(loaded.observations, seen, rtol=1e-6)
    np.testing.assert_array_equal(loaded.actions, recorded.actions)
    np.testing.assert_array_equal(loaded.episode, np.repeat([0, 1], 20))


@pytest.fixture
def trained(small, driven, tmp_path):
    run.train(small, tmp_path / "run", seed=1)
    return tmp_path / "run"


def test_a_path_may_be_a_string(trained, small, driven, tmp_path):
    again = run.train(small, str(tmp_path / "again"), seed=1)
    assert contents(tmp_path / "again") == contents(trained)
    again.write(str(tmp_path / "tables"))
    assert set(contents(tmp_path / "tables")) < set(contents(trained))
    assert RunDirectory(str(trained)).config == config_file.load(str(trained / "config.toml"))


def test_resuming_with_another_seed_is_refused(small, trained):
    with pytest.raises(InputError, match=r"was started with seed = 1, not 2; resume it as it was started, or start"):
        run.train(small, trained, seed=2, resume=True)


def test_resuming_with_another_configuration_names_the_key(small, trained):
    other = small.model_copy(update={"search": small.search.model_copy(update={"noise_std": 0.5})})
    with pytest.raises(InputError, match=r"was started with search.noise_std = 0.1, not 0.5"):
        run.train(other, trained, seed=1, resume=True)


def test_resuming_on_other_demonstrations_is_refused(small, trained, tmp_path):
    world = config_file.load(None, SMALL)
    features = run.feature_names(world.lidar, world.observation)
    others = [drive(rollout.Task("expert", world, seed)) for seed in range(3, 6)]
    Demonstrations.from_trajectories(others).save(tmp_path / "demonstrations.parquet", features=features, about={})
    with pytest.raises(InputError, match=r"the content of train\.demonstrations has changed since run directory"):
        run.train(small, trained, seed=1, resume=True)


def lasting(small, iterations):
    return small.model_copy(update={"train": small.train.model_copy(update={"iterations": iterations})})


@pytest.mark.parametrize("learner", ["rail", "gail", "dagger", "ars"])
def test_a_run_resumed_for_more_iterations_is_one_that_was_to_have_them(small, driven, tmp_path, learner):
    world = small.model_copy(update={"train": small.train.model_copy(update={"learner": learner})})
    run.train(lasting(world, 2), tmp_path / "run", seed=1)
    shorter = contents(tmp_path / "run")
    run.train(lasting(world, 4), tmp_path / "run", seed=1, resume=True)
    run.train(lasting(world, 4), tmp_path / "longer", seed=1)
    assert contents(tmp_path / "run") == contents(tmp_path / "longer")
    assert contents(tmp_path / "run")[POLICY] != shorter[POLICY]


def test_a_learner_is_set_beside_its_clone_if_it_has_one(small, driven, tmp_path):
    clones = ["clone, argmax", "clone, sampled"]
    for learner, beside in {"rail": clones, "gail": clones, "dagger": clones, "ars": []}.items():
        world = small.model_copy(update={"train": small.train.model_copy(update={"learner": learner})})
        episodes, *_ = run.train(world, tmp_path / learner, seed=1)
        assert list(episodes["policy"].unique()) == [learner, *beside, "expert"]


def test_a_reward_that_is_to_count_is_the_environments_by_the_decision(small, driven, tmp_path):
    returns = []
    for weight in (0.0, 2.0):
        driven.clear()
        world = small.model_copy(update={"rail": config.Rail(reward_weight=weight)})
        run.train(world, tmp_path / str(weight), seed=1)
        returns.append(pd.read_csv(tmp_path / str(weight) / PROGRESS)["mean_return"][0])
    first_iteration = [drive(task) for task in driven[: 2 * small.search.n_directions]]
    earned = np.mean([total_reward(one, small.adas) / len(one.decisions) for one in first_iteration])
    assert returns[1] - returns[0] == pytest.approx(2.0 * earned)


def test_behaviour_cloning_is_the_clone_that_rail_starts_from(small, driven, trained, tmp_path):
    cloning = {"learner": "bc", "iterations": "default"}
    run.train(small.model_copy(update={"train": small.train.model_copy(update=cloning)}), tmp_path / "bc", seed=1)
    cloned, start = load_file(tmp_path / "bc" / POLICY), load_file(trained / CLONE)
    np.testing.assert_equal(cloned, start)


def test_a_run_cannot_be_resumed_for_fewer_iterations_than_it_has(small, trained):
    before = contents(trained)
    with pytest.raises(InputError, match=r"has done 3 iterations; set train\.iterations to no less, or start another"):
        run.train(lasting(small, 2), trained, seed=1, resume=True)
    assert contents(trained) == before


def test_a_run_is_evaluated_in_its_own_world_unless_told_otherwise(trained, small):
    assert roster.world(["rule", str(trained)]) == training.resolved(small)
    assert roster.world([str(trained)], ["traffic.vehicles=3"]).traffic.vehicles == 3
    assert roster.world(["rule"]) == config.Config()


def test_a_policy_drives_anywhere_with_its_own_senses_unless_others_are_asked_for(trained):
    assert roster.find_driver(str(trained), config.Config()).senses.lidar.n_rays == N_FEATURES // 2
    with pytest.raises(InputError, match=r"was trained with lidar\.n_rays = 4, not 24; set lidar\.n_rays=4, or tr"):
        roster.world(["keep", str(trained)], ["lidar.n_rays=24"])


def test_the_manifest_tells_how_a_run_was_made(trained):
    manifest = json.loads((trained / "manifest.json").read_text())
    files = {path.name: assets.sha256(path) for path in trained.iterdir() if path.name != "manifest.json"}
    assert manifest["files"] == files
    assert POLICY in files
    assert manifest["seed"] == 1
    assert manifest["inputs"]["network.file"] == assets.sha256(assets.network("highway5"))
    shown = RunDirectory(trained).config.train.demonstrations
    assert manifest["inputs"]["train.demonstrations"] == assets.sha256(Path(shown))
    summary = pd.read_csv(trained / "summary.csv")
    speed = summary[(summary["policy"] == "rail") & (summary["metric"] == "speed_kmh")]["mean"].item()
    assert manifest["evaluation"]["speed_kmh"] == round(speed, 3)
    assert not assets.is_expert(trained)  # though it has a manifest


def test_a_run_knows_its_files_from_any_folder(small, driven, tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    (tmp_path / "elsewhere").mkdir()
    for name, text in {"my.net.xml": assets.network("highway3").read_text(), "my.rou.xml": "<routes/>"}.items():
        (tmp_path / "there" / name).write_text(text)
    shutil.copy(small.train.demonstrations, tmp_path / "there" / "mine.parquet")
    own = small.changed(
        network={"file": "my.net.xml"},
        traffic={"routes": ("my.rou.xml",)},
        varied={"networks": ("ring5",)},
        train={"demonstrations": "mine.parquet"},
    )
    monkeypatch.chdir(tmp_path / "there")
    run.train(own, Path("run"), seed=1)
    run.train(own, Path("run"), seed=1, resume=True)
    monkeypatch.chdir(tmp_path / "elsewhere")
    world = roster.world(["../there/run"])
    assert world.varied.networks == ("ring5",)
    training.inputs_of(world)  # all are found
    run.train(world, Path("../there/run"), seed=1, resume=True)


def test_a_run_whose_demand_has_changed_since_is_told_of_where_it_drives_in_it(small, driven, tmp_path):
    demand = tmp_path / "my.rou.xml"
    demand.write_text("<routes/>")
    run.train(small.changed(traffic={"routes": (str(demand),)}), tmp_path / "run", seed=1)
    learned = RunDirectory(tmp_path / "run")
    assert not list(training.changed_since([learned], learned.config))
    demand.write_text("<routes><!-- more --></routes>")
    (told,) = training.changed_since([learned], learned.config)
    assert told.startswith(f"the content of traffic.routes has changed since '{tmp_path / 'run'}' was trained: ")
    assert not list(training.changed_since([learned], learned.config.changed(traffic={"routes": ()})))  # another world


@pytest.mark.parametrize("file", [POLICY, CLONE, CHECKPOINT])
@pytest.mark.parametrize("kept", [0, 4, 100, -1])
def test_a_truncated_file_is_named_in_one_line(trained, small, file, kept):
    path = trained / file
    path.write_bytes(path.read_bytes()[:kept])
    resume = partial(run.train, small, trained, seed=1, resume=True)
    read = resume if file == CHECKPOINT else partial(roster.find_driver, str(trained), small)
    with pytest.raises(
        InputError, match=rf"'.*{file}' is truncated or damaged \(.*\); restore it or train again"
    ) as error:
        read()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("file", ["config.toml", POLICY, CLONE])
def test_a_missing_file_is_named_in_one_line(trained, small, file):
    (trained / file).unlink()
    with pytest.raises(InputError, match=f"is not a .*run directory: it has no {file}"):
        roster.find_driver(str(trained), small)


def replace_theta(path, change):
    """Change the parameters in a policy's file, which then has no SHA-256, as one of an earlier version."""
    with safe_open(path, framework="numpy") as file:
        about = json.loads(file.metadata()["rail_sumo"])
    about.pop("sha256")
    tensors = load_file(path)
    save_file(tensors | {"theta": change(tensors["theta"])}, path, metadata={"rail_sumo": json.dumps(about)})


def test_a_policy_of_another_shape_is_damaged(trained, small):
    replace_theta(trained / POLICY, lambda theta: theta[:-1])
    with pytest.raises(InputError, match=r"damaged \(ValueError: theta must have shape"):
        roster.find_driver(str(trained), small)


@pytest.mark.parametrize(
    ("file", "read"),
    [(POLICY, RunDirectory.policy), (CHECKPOINT, RunDirectory.checkpoint), (JUDGE, RunDirectory.judge)],
)
def test_a_number_that_changed_on_the_disk_is_damage(trained, file, read):
    path = trained / file
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"{file}' is truncated or damaged .*not what was written.*restore it"):
        read(RunDirectory(trained))


def test_a_checkpoint_of_another_run_or_another_configuration_is_refused(trained, small, tmp_path):
    config = trained / CONFIG
    as_it_was = config.read_text()
    config.write_text(as_it_was.replace("step_size = 0.05", "step_size = 0.5"))
    with pytest.raises(InputError, match=r"checkpoint.safetensors' is of another run, or config.toml beside it"):
        RunDirectory(trained).checkpoint()
    config.write_text(as_it_was)
    assert RunDirectory(trained).checkpoint().iteration


def test_an_existing_folder_is_refused_before_any_work(small, driven, tmp_path):
    with pytest.raises(InputError, match=r"exists; go on with it by --resume, or choose another with --out"):
        run.train(small, tmp_path, seed=1)
    assert driven == []


def test_one_worker_and_two_give_the_same_tables_byte_for_byte(tmp_path):
    world = config_file.load(None, ["episode.duration_s=20.0"])
    for workers in (1, 2):
        tables = run.evaluate({"rule": "rule", "random": "random"}, world, episodes=2, seed=0, workers=workers)
        tables.write(tmp_path / str(workers))
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_every_decision_has_its_row_in_order_and_where_it_was_taken():
    world = config_file.load(None, ["episode.duration_s=20.0"])
    tables = run.evaluate({"random": "random", "sumo": "sumo", "rule": "rule"}, world, episodes=2, seed=0)
    decisions, figures = tables.decisions, tables.episodes.set_index(["policy", "episode"])
    assert list(decisions.columns) == list(DECISION_COLUMNS)
    assert set(decisions["policy"]) == {"random", "rule"}  # SUMO's own driver takes none
    for key, taken in decisions.groupby(["policy", "episode"]):
        driven = figures.loc[key]
        assert taken["time_s"].iloc[0] == 0.0
        assert taken["time_s"].is_monotonic_increasing
        assert taken["time_s"].iloc[-1] < driven["duration_s"]
        assert taken["distance_m"].diff().dropna().between(0.0, 25.0).all()
        assert taken["distance_m"].iloc[-1] < driven["distance_m"]
        moved_m = taken["x_m"].diff().sum()  # the shipped highway runs east
        assert moved_m == pytest.approx(taken["distance_m"].iloc[-1] - taken["distance_m"].iloc[0], abs=0.5)
        is_refused = (taken["asked"] != taken["carried_out"]) & taken["asked"].isin(["left", "right"])
        assert (taken["carried_out"][is_refused] == "keep").all()
        assert is_refused.sum() >= driven["refused_decisions"]
    assert decisions["asked"].isin([action.name.lower() for action in MetaAction]).all()


def test_floating_car_data_tell_of_the_very_drives_that_the_tables_tell_of(tmp_path):
    world = config_file.load(None, ["episode.duration_s=20.0"])
    who = {"rule": "rule", "runs/my first": "random"}
    tables = run.evaluate(who, world, episodes=2, seed=0, workers=2, fcd=tmp_path / "fcd")
    for table, without in zip(tables, run.evaluate(who, world, episodes=2, seed=0), strict=True):
        pd.testing.assert_frame_equal(table, without)
    fcd = pd.read_parquet(tmp_path / "fcd")
    by_episode = fcd[fcd["vehicle_id"] == HOST].groupby(["policy", "episode"], observed=True)
    for _, row in tables.episodes.iterrows():
        host = by_episode.get_group((row["policy"], row["episode"]))
        assert len(host) == 1 + 200  # at the start, and after every step
        # Moved by the mean of the speeds before and after each step (ballistic).
        speeds = host["vehicle_speed"].to_numpy(dtype=np.float64)
        assert np.mean((speeds[1:] + speeds[:-1]) / 2) * 3.6 == pytest.approx(row["speed_kmh"], abs=1e-3)
        assert host["vehicle_odometer"].iloc[-1] == pytest.approx(row["distance_m"], abs=1e-2)
    now = ["policy", "episode", "timestep_time"]
    others = fcd.merge(fcd[fcd["vehicle_id"] == HOST], on=now, suffixes=("", "_host"))
    away_m = np.hypot(others["vehicle_x"] - others["vehicle_x_host"], others["vehicle_y"] - others["vehicle_y_host"])
    assert len(others) > 2 * 4 * 201  # the host is not alone
    assert 50.0 < away_m.max() <= world.lidar.max_range_m


class Notes:
    """An observer that keeps what it is told."""

    def __init__(self):
        self.told = []

    def start(self, work, total, done=0): ...

    def advance(self, figures): ...

    def note(self, text):
        self.told.append(text)


def test_an_episode_that_cannot_be_driven_keeps_its_row_and_does_not_take_the_others_with_it(small, monkeypatch):
    def fails_at_times(task):
        if task.seed == seeds[1]:
            raise NotBegun("no gap")
        if (task.driver, task.seed) == ("rule", seeds[2]):
            raise InputError("SUMO stopped: no way on")
        return drive(task)

    seeds = [rollout.traffic_seed(0, rollout.EVALUATION, number) for number in range(4)]
    monkeypatch.setattr(rollout, "drive", fails_at_times)
    notes = Notes()
    who = {"rule": "rule", "keep": "keep"}
    episodes, summary, _ = run.evaluate(who, small, episodes=4, seed=0, observer=notes, reference="keep")
    assert episodes["end_reason"].tolist() == [
        *("duration", "not begun", "SUMO stopped", "duration"),
        *("duration", "not begun", "duration", "duration"),
    ]
    assert episodes["seed"].tolist() == 2 * seeds
    undriven = episodes[episodes["end_reason"] == "not begun"]
    assert undriven[list(METRICS)].isna().all(axis=None)
    assert set(undriven["network"]) == {"highway5"}
    by_policy = summary[summary["metric"] == "overtakes"].set_index("policy")
    assert by_policy["episodes"].to_dict() == {"rule": 2, "keep": 3}
    assert by_policy.loc["rule", "difference"] == pytest.approx(0.0)  # over the two that both drove
    assert notes.told == [
        "rule did not drive episode 1: no gap",
        "keep did not drive episode 1: no gap",
        "rule did not drive episode 2: SUMO stopped: no way on",
    ]
    assert report.cut_short(episodes) == [
        "rule: 1 of 4 episodes could not begin (left out of the means); "
        "1 of 4 episodes ended because SUMO stopped (left out of the means)",
        "keep: 1 of 4 episodes could not begin (left out of the means)",
    ]


def test_if_none_could_be_driven_it_is_an_error(small, monkeypatch):
    def fails(task):
        raise NotBegun("no gap")

    monkeypatch.setattr(rollout, "drive", fails)
    with pytest.raises(InputError, match=r"^no gap$"):
        run.evaluate({"rule": "rule", "keep": "keep"}, small, episodes=2, seed=0)


def test_whose_own_driver_failed_and_when_is_told(small, monkeypatch):
    def fails(task):
        if task.driver != "keep":
            raise ZeroDivisionError
        return drive(task)

    monkeypatch.setattr(rollout, "drive", fails)
    with pytest.raises(ZeroDivisionError) as failed:
        run.evaluate({"keep": "keep", "mine": "rule"}, small, episodes=2, seed=0)
    assert failed.value.__notes__ == ["while 'mine' drove episode 0"]


def test_a_demand_with_one_car_alone_to_draw_is_told_of(tmp_path, monkeypatch):
    notes = []
    monkeypatch.setattr(type(rollout.SILENT), "note", lambda observer, text: notes.append(text))
    for number in (1, 3):
        cars = "".join(f'<vehicle id="{k}" depart="{200 * k}" departLane="1" route="r"/>' for k in range(number))
        (tmp_path / "few.rou.xml").write_text(f'<routes><route id="r" edges="highway"/>{cars}</routes>')
        traffic = [f'traffic.routes=["{tmp_path / "few.rou.xml"}"]', "traffic.warm_up_s=0", "episode.duration_s=2"]
        world = config_file.load(None, ["network.file=highway3", *traffic])
        hosts = run.evaluate({"keep": "keep"}, world, episodes=6, seed=0).episodes["host"].nunique()
        assert hosts == (1 if number == 1 else 2)  # the first of three departs before any moment that is drawn
    (told,) = notes
    assert told.startswith("every episode drives the same car, '0', since the demand has no other to draw")


def test_episodes_that_the_road_cuts_short_are_told_of(tmp_path, monkeypatch):
    notes = []
    monkeypatch.setattr(type(rollout.SILENT), "note", lambda observer, text: notes.append(text))
    (tmp_path / "short.net.xml").write_text(cut_road(300.0))
    (tmp_path / "some.rou.xml").write_text(
        '<routes><flow id="f" begin="0" end="900" period="5" departSpeed="max"><route edges="part0"/></flow></routes>'
    )
    given = [f"network.file={tmp_path / 'short.net.xml'}", f'traffic.routes=["{tmp_path / "some.rou.xml"}"]']
    run.evaluate({"keep": "keep"}, config_file.load(None, given), episodes=2, seed=0)
    assert re.fullmatch(r"episodes last \d s in the mean, and tell how hosts enter rather than how they .*", *notes)
    run.evaluate({"keep": "keep"}, config_file.load(None, ["episode.duration_s=2"]), episodes=2, seed=0)
    assert len(notes) == 1, "so short they were to be"


def test_floating_car_data_that_were_cut_off_are_refused(tmp_path, monkeypatch):
    """On a full disk SUMO stops writing and tells nobody."""
    attempt_all = run.attempt_all

    def cut(work, tasks, *rest):
        yield from attempt_all(work, tasks, *rest)
        part = Path(tasks[1].outputs[1])
        part.write_bytes(part.read_bytes()[:-100])

    monkeypatch.setattr(run, "attempt_all", cut)
    world = config_file.load(None, ["episode.duration_s=2.0"])
    with pytest.raises(InputError, match=r"could not write .* whole \('.*episode=1/part\.parquet'\); is the disk full"):
        run.evaluate({"rule": "rule"}, world, episodes=2, seed=0, fcd=tmp_path / "fcd")
    with pytest.raises(InputError, match="exists"):
        run.evaluate({"rule": "rule"}, world, episodes=2, seed=0, fcd=tmp_path / "fcd")


def test_one_worker_and_two_learn_the_same_policy_bit_for_bit(tmp_path):
    brief = ["search.n_directions=2", "judge.minibatches=2", "cloning.epochs=1", "train.trajectories=1"]
    world = config_file.load(
        None,
        [*brief, "train.iterations=2", "train.horizon_s=10.0", "train.evaluation_episodes=1", "episode.course_m=300"],
    )
    for workers in (1, 2):
        run.train(world, tmp_path / str(workers), seed=3, workers=workers)
    one, two = contents(tmp_path / "1"), contents(tmp_path / "2")
    for name in ("policy.safetensors", "judge.safetensors", "episodes.csv"):
        assert one[name] == two[name]
    assert one["policy.safetensors"] != one["clone.safetensors"]


def other_observation(small, learner):
    train = small.train.model_copy(update={"learner": learner, "demonstrations": "expert", "trajectories": 40})
    return small.model_copy(update={"train": train})


def test_a_learner_without_demonstrations_minds_no_observation(small, driven, tmp_path):
    run.train(other_observation(small, "ars"), tmp_path / "run", seed=1)
    clone = RunDirectory(tmp_path / "run").clone
    np.testing.assert_array_equal([clone.whitening.mean, clone.whitening.std], [np.zeros(8), np.ones(8)])


def test_an_expert_that_cannot_be_asked_is_refused_before_there_is_a_run(small, driven, tmp_path, monkeypatch):
    monkeypatch.undo()
    world = small.model_copy(update={"train": small.train.model_copy(update={"learner": "dagger"})})
    with pytest.raises(InputError, match=r"the expert, who is to be asked, was trained with lidar\.n_rays = 24, not 4"):
        run.train(world, tmp_path / "run", seed=1)
    assert not (tmp_path / "run").exists()


def test_gail_drives_by_chance_and_rail_does_not(small, driven, tmp_path):
    for learner, samples in (("gail", True), ("rail", False)):
        driven.clear()
        train = small.train.model_copy(update={"learner": learner})
        run.train(small.model_copy(update={"train": train}), tmp_path / learner, seed=1)
        practised = [task for task in driven if task.config.episode.duration_s == 20.0]
        assert {task.driver.samples for task in practised} == {samples}


def test_a_search_on_the_environments_reward_reads_no_demonstrations(small, driven, tmp_path):
    train = small.train.model_copy(update={"learner": "ars", "demonstrations": "none.parquet"})
    run.train(small.model_copy(update={"train": train}), tmp_path / "run", seed=1)
    assert RunDirectory(tmp_path / "run").checkpoint().iteration == 3


def test_another_expert_to_ask_is_refused(small, driven, tmp_path, monkeypatch):
    world = small.model_copy(update={"train": small.train.model_copy(update={"learner": "dagger"})})
    run.train(world, tmp_path / "run", seed=1)
    monkeypatch.setattr(training.assets, "expert", lambda file, folder=None: tmp_path / "run" / CLONE)
    with pytest.raises(InputError, match=r"the content of train\.expert has changed"):
        run.train(world, tmp_path / "run", seed=1, resume=True)


def test_a_run_keeps_the_number_of_iterations_that_the_default_was(small, driven, tmp_path):
    train = small.train.model_copy(update={"learner": "dagger", "iterations": "default"})
    run.train(small.model_copy(update={"train": train}), tmp_path / "run", seed=1)
    assert RunDirectory(tmp_path / "run").config.train.iterations == 20
    assert RunDirectory(tmp_path / "run").checkpoint().iteration == 20


def test_one_layer_is_one_layer(small, driven, tmp_path):
    linear = small.model_copy(update={"policy": small.policy.model_copy(update={"layers": 1})})
    run.train(linear, tmp_path / "run", seed=1)
    assert RunDirectory(tmp_path / "run").clone.shape.hidden is None


def test_gail_knows_the_worst_that_its_judge_can_pay(small, driven, tmp_path, monkeypatch):
    worst = []
    ppo = gail.Ppo
    monkeypatch.setattr(
        gail,
        "Ppo",
        lambda *a, lowest_reward, **k: worst.append(lowest_reward) or ppo(*a, lowest_reward=lowest_reward, **k),
    )
    changes = {
        "train": small.train.model_copy(update={"learner": "gail"}),
        "judge": small.judge.model_copy(update={"reward_clip": 3.0}),
    }
    run.train(small.model_copy(update=changes), tmp_path / "run", seed=1)
    assert worst == [-3.0]


def test_as_many_trajectories_are_shown_as_are_to_be(small):
    fewer = small.model_copy(update={"train": small.train.model_copy(update={"trajectories": 2})})
    assert training.demonstrations_of(small).n_episodes == 3
    assert training.demonstrations_of(fewer).n_episodes == 2


def test_demonstrations_of_another_pace_are_refused(small, tmp_path):
    shown, features = training.demonstrations_of(small), run.feature_names(small.lidar, small.observation)
    shown.save(tmp_path / "mine.parquet", features=features, about={"config": config_file.dumps(small)})
    own = small.model_copy(
        update={"train": small.train.model_copy(update={"demonstrations": str(tmp_path / "mine.parquet")})}
    )
    training.demonstrations_of(own)
    slower = own.model_copy(update={"episode": config.Episode(decision_period_s=2.0)})
    with pytest.raises(InputError, match=r"were recorded with episode\.decision_period_s = 1\.0, not 2\.0"):
        training.demonstrations_of(slower)


def test_what_is_read_is_known_by_its_content(small, tmp_path):
    extra = tmp_path / "extra.add.xml"
    world = small.model_copy(update={"traffic": config.Traffic(additional=(str(extra),))})
    contents = []
    for text in ("<additional/>", "<additional></additional>"):
        extra.write_text(text)
        contents.append(training.inputs_of(world))
    assert set(contents[0]) == {"network.file", "traffic.routes", "traffic.additional", "train.demonstrations"}
    assert [key for key in contents[0] if contents[0][key] != contents[1][key]] == ["traffic.additional"]


@pytest.mark.parametrize(("period_s", "decisions"), [(1.0, 200), (2.0, 100), (0.1, 2000)])
def test_the_horizon_in_decisions_depends_on_their_pace(period_s, decisions):
    world = config_file.load(None, [f"episode.decision_period_s={period_s}"])
    assert learners.horizon_decisions(world) == decisions


def test_how_a_policy_acts_is_kept_in_its_run_and_may_be_changed_for_a_look(small, driven, tmp_path):
    for learner, samples in (("rail", False), ("gail", True)):
        for masked in (False, True):
            folder = tmp_path / f"{learner}-{masked}"
            run.train(small.changed(train={"learner": learner}, policy={"masked": masked}), folder, seed=1)
            kept = roster.find_driver(str(folder), small)
            assert (kept.samples, kept.masked) == (samples, masked)
            assert RunDirectory(folder).config.policy.mode == ("sampled" if samples else "argmax")
            for mode in ("argmax", "sampled"):
                assert roster.find_driver(f"{folder}:{mode}", small).samples == (mode == "sampled")
                assert set(roster.judges_of([f"{folder}:{mode}"])) == {f"{folder}:{mode}"}
                assert roster.world([f"{folder}:{mode}"]).train.learner == learner


def test_a_policy_from_before_it_said_how_it_acts_acts_as_it_did(trained, small):
    path = trained / POLICY
    with safe_open(path, framework="numpy") as file:
        about = json.loads(file.metadata()["rail_sumo"])
    for name in ("samples", "masked", "sha256"):
        del about[name]
    save_file(load_file(path), path, metadata={"rail_sumo": json.dumps(about)})
    kept = roster.find_driver(str(trained), small)
    assert (kept.samples, kept.masked) == (False, False)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"policies": {}}, "name at least one policy to evaluate"),
        ({"reference": "ruel"}, "reference 'ruel' is not among the policies: keep, rule; name it there too"),
        ({"workers": 0}, "workers must be 1 or more, or ray; got 0"),
        ({"seed": -1}, "a seed is a whole number from 0 up; got -1"),
        ({"episodes": 0}, "episodes must be at least 1; got 0"),
    ],
)
def test_an_evaluation_that_could_not_be_is_told_what_it_lacks(small, given, message):
    arguments = {"policies": {"keep": "keep", "rule": "rule"}, "episodes": 1, "seed": 0} | given
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        run.evaluate(arguments.pop("policies"), small, **arguments)


@pytest.mark.parametrize(
    ("scaled", "message"),
    [
        (
            {"distance_0_m": 1.2},
            r"distance_0_m goes from [\d.]+ to [\d.]+, and can only from 0 to 100; give metres and",
        ),
        (
            {"distance_3_m": -1.0},
            r"distance_3_m goes from -[\d.]+ to -[\d.]+, and can only from 0 to 100; give metres ",
        ),
        ({"relative_speed_1_mps": 3600.0}, r"relative_speed_1_mps goes from .*, and can only from -200 to 200; give "),
        (
            {f"distance_{ray}_m": 0.01 for ray in range(4)},
            r"no distance is above 0\.\d+ m, though a ray that hits no",
        ),
    ],
)
def test_demonstrations_in_other_units_are_refused(small, driven, tmp_path, scaled, message):
    told = pd.read_parquet(tmp_path / "demonstrations.parquet")
    told.assign(**{name: told[name] * by for name, by in scaled.items()}).to_parquet(tmp_path / "scaled.parquet")
    file = tmp_path / "scaled.parquet"
    with pytest.raises(InputError, match=rf"^demonstrations '{re.escape(str(file))}': {message}"):
        training.demonstrations_of(small.changed(train={"demonstrations": str(file)}))


@pytest.mark.parametrize(("frames", "age"), [(1, ""), (2, "_1_ago")])
def test_a_ray_that_hits_nothing_tells_no_speed(small, tmp_path, frames, age):
    file = tmp_path / "theirs.parquet"
    world = small.changed(
        observation={"frames": frames, "host_speed": True}, train={"demonstrations": str(file), "trajectories": 1}
    )
    features = run.feature_names(world.lidar, world.observation)
    distance, speed = (features.index(f"{name}{age}") for name in ("distance_3_m", "relative_speed_3_mps"))
    observations = np.full((100, len(features)), 20.0)  # the host's own speed, and what rays tell that hit something
    observations[:, distance], observations[:, speed] = world.lidar.max_range_m, 0.0

    def read():
        n = len(observations)
        shown = Demonstrations(observations, np.zeros(n, np.int64), np.zeros(n, np.int64))
        shown.save(file, features=features, about={})
        return training.demonstrations_of(world)

    read()
    observations[4, distance], observations[4, speed] = world.lidar.max_range_m - 1e-6, -3.0
    read()  # it has hit something, though 32 bits round that distance to the range
    observations[5:7, speed] = 19.5
    observations[4, distance] = 99.0
    told = (
        f"row 5 has 19.5 as relative_speed_3_mps{age}, where distance_3_m{age} is the range, 100 m; a ray that hits "
        "nothing tells 0 there, and one that hits something how fast that is along the host's heading, minus the"
    )
    with pytest.raises(InputError, match=rf"^demonstrations '{re.escape(str(file))}': {re.escape(told)}"):
        read()


def test_demonstrations_that_do_not_tell_what_was_open_are_told_to_who_clones_them_masked(small, driven, tmp_path):
    told = pd.read_parquet(tmp_path / "demonstrations.parquet")
    told.drop(columns=[name for name in told if name.startswith("allowed_")]).to_parquet(tmp_path / "bare.parquet")
    told.assign(allowed_left=told["action"] == MetaAction.LEFT).to_parquet(tmp_path / "masked.parquet")
    said = {}
    for file, masked in (("masked", True), ("bare", True), ("bare", False)):
        notes = said[file, masked] = Notes()
        world = small.changed(
            train={"demonstrations": str(tmp_path / f"{file}.parquet"), "iterations": 0}, policy={"masked": masked}
        )
        training.learn(world, tmp_path / f"{file}-{masked}", seed=1, observer=notes)
    untold = [[line for line in notes.told if line == training.UNTOLD] for notes in said.values()]
    assert list(map(len, untold)) == [0, 1, 0]
    assert training.UNTOLD.endswith("too seldom; tell there what was open, or set policy.masked=false")


def test_keys_that_a_learner_does_not_read_are_told_before_it_learns(small, driven, tmp_path):
    notes = {}
    for learner in ("bc", "rail"):
        notes[learner] = Notes()
        keys = {"judge": {"minibatches": 3}, "cloning": {"epochs": 1}, "train": {"learner": learner, "iterations": 0}}
        world = small.changed(**keys)
        training.learn(world, tmp_path / learner, seed=1, observer=notes[learner])
    unread = {}
    for learner, said in notes.items():
        (line,) = (line for line in said.told if line.endswith(f": without effect on learner '{learner}'"))
        unread[learner] = {key.partition(".")[0] for key in line.partition(":")[0].split(", ")}
    assert unread == {"bc": {"search", "judge", "gail", "dagger"}, "rail": {"gail", "dagger"}}


def test_demonstrations_of_another_road_are_told_to_who_learns_from_them(small, driven, tmp_path):
    file = tmp_path / "told.parquet"
    features = run.feature_names(small.lidar, small.observation)
    driven_here = Demonstrations.load(tmp_path / "demonstrations.parquet", features=features)
    driven_here.save(file, features=features, about={"config": config_file.dumps(small)})
    world = small.changed(train={"demonstrations": str(file), "iterations": 0})
    here, elsewhere = Notes(), Notes()
    training.learn(world, tmp_path / "here", seed=1, observer=here)
    training.learn(world.changed(network={"file": "ring5"}), tmp_path / "elsewhere", seed=1, observer=elsewhere)
    own = assets.network_name(small.network.file)
    (said,) = set(elsewhere.told) - set(here.told)
    assert said.startswith(f"the demonstrations were recorded on {own}, and this trains on ring5: ")


EXPERTS_SHA256 = assets.sha256(assets.expert(assets.EXPERT_POLICY))


@pytest.mark.parametrize(
    ("about", "said"),
    [
        ({}, "do not tell for certain whose they are"),
        ({"driver": "expert"}, "do not tell for certain whose they are"),  # any expert's file said so once
        ({"driver": "expert", "driver_sha256": EXPERTS_SHA256}, None),
        ({"driver": "runs/copy", "driver_sha256": EXPERTS_SHA256}, None),
        ({"driver": "expert", "driver_sha256": "0123456789abcdef"}, "are of 'expert' (SHA-256 0123456789ab...)"),
        ({"driver": "rule"}, "are of 'rule'"),
    ],
)
def test_whom_the_table_compares_with_is_told_unless_it_made_the_demonstrations(small, tmp_path, about, said):
    file, features = tmp_path / "demonstrations.parquet", run.feature_names(small.lidar, small.observation)
    Demonstrations.load(file, features=features).save(file, features=features, about=about)
    told = list(training.other_expert(small))
    named = f"the expert that train.expert names, 'shipped' (SHA-256 {EXPERTS_SHA256[:12]}...)"
    begins = f"the demonstrations {said}, and the table at the end compares with {named}"
    assert [line[: len(begins)] for line in told] == ([begins] if said else [])
    asked = list(training.other_expert(small.changed(train={"learner": "dagger"})))
    assert [f"{named}, and dagger asks that one too" in line for line in asked] == [True] * len(told)
    of_a_study = list(training.other_expert(small, "ratios and 'told apart' are to"))
    assert [f", and ratios and 'told apart' are to {named}" in line for line in of_a_study] == [True] * len(told)


def test_a_training_and_its_manifest_tell_whose_the_demonstrations_are(small, driven, tmp_path):
    notes = Notes()
    run.train(small.changed(train={"iterations": 0}), tmp_path / "run", seed=1, observer=notes)
    (told,) = training.other_expert(small)
    assert notes.told.count(told) == 1
    assert told in json.loads((tmp_path / "run" / "manifest.json").read_text())["notes"]


def test_the_experts_own_file_is_known_by_its_place():
    shown = assets.expert(assets.EXPERT_DEMONSTRATIONS)
    for given in ("expert", str(shown)):
        assert not list(training.other_expert(config.Config().changed(train={"demonstrations": given})))


@pytest.mark.parametrize("driver", ["expert", "rail:sampled", "rule"])
def test_a_recording_tells_whose_it_is_and_by_which_weights(driver, tmp_path):
    world = config_file.load(None, ["episode.duration_s=5"])
    run.demonstrate(driver, world, tmp_path / "its.parquet", episodes=1, seed=0)
    name, content = recorded_by(tmp_path / "its.parquet")
    assert (name, content) == (driver, roster.content_of(driver, world))
    assert (content == EXPERTS_SHA256) == (driver == "expert")
    assert bool(content) == (driver != "rule")


def test_a_driver_is_recorded_with_its_own_senses_where_no_others_are_configured(tmp_path):
    world, notes = config_file.load(None, ["episode.duration_s=5"]), Notes()
    run.demonstrate("road-expert", world, tmp_path / "road.parquet", episodes=1, seed=0, observer=notes)
    keys = ["observation.host_speed=true", "observation.speed_limit=true"]
    said = "the demonstrations have the senses of 'road-expert'; to learn from them, set"
    fewer = "learners want 40 episodes; to learn from so few, set train.trajectories=1"
    assert notes.told == [f"{said} {' '.join(keys)}", fewer]
    as_told = config_file.load(
        None, [*keys, f"train.demonstrations={tmp_path / 'road.parquet'}", "train.trajectories=1"]
    )
    assert training.demonstrations_of(as_told).observations.shape == (5, 50)
    recorded = run.record(
        roster.find_driver("road-expert", as_told), as_told.changed(episode={"duration_s": 5.0}), episodes=1, seed=0
    )
    np.testing.assert_array_equal(training.demonstrations_of(as_told).observations, recorded.observations)


def test_a_driver_is_not_recorded_with_other_senses_than_its_own(tmp_path):
    other = config_file.load(None, ["lidar.n_rays=12", "observation.host_speed=true"])
    keys = r"lidar\.n_rays=24 observation\.speed_limit=true"
    with pytest.raises(
        InputError, match=rf"^driver 'road-expert' was trained with lidar\.n_rays = 24, not 12; set {keys}, or train"
    ):
        run.demonstrate("road-expert", other, tmp_path / "other.parquet", episodes=1, seed=0)


@pytest.fixture
def practice():
    """What a learner drives with, of the shipped RAIL, in SUMO and for 5 s."""
    shipped = RunDirectory(assets.driver("rail"))
    config = shipped.config.changed(train={"horizon_s": 5.0})
    return learners.Practice(SimpleNamespace(config=config, seed=shipped.seed), rollout._Serial())


@pytest.mark.parametrize("name", ["sumo", "sumo:truck"])
def test_who_takes_no_decisions_is_neither_recorded_nor_asked(name, small, practice, tmp_path):
    refused = rf"^driver '{name}' takes no decisions that could be recorded; take rule, expert or a run directory$"
    with pytest.raises(InputError, match=refused):
        run.record(name, small, episodes=1, seed=0)
    with pytest.raises(InputError, match=refused):
        run.record(name, small, episodes=1, seed=0, adviser="rule")
    with pytest.raises(InputError, match=refused):
        run.record("keep", small, episodes=1, seed=0, adviser=name)
    with pytest.raises(InputError, match=refused):
        run.demonstrate(name, small, tmp_path / "shown.parquet", episodes=1, seed=0)
    with pytest.raises(InputError, match=refused):
        practice.advised(roster.find_driver("rail", small), name, 1, 1)


def test_an_adviser_goes_by_every_name_that_drivers_have(practice, tmp_path, monkeypatch):
    (tmp_path / "asked.py").write_text(
        "class Left:\n    senses = None\n\n    def decide(self, observation, agent):\n        return 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    learned = RunDirectory(assets.driver("rail")).policy().acting("argmax")
    for name in ("asked:Left", "rail:argmax", f"{assets.driver('rail')}:argmax"):
        ((driven, advice),) = practice.advised(learned, name, 1, 1)
        assert len(advice) == len(driven.decisions) == 5
        assert advice.tolist() == ([3] * 5 if name == "asked:Left" else driven.decisions.tolist())
    with pytest.raises(InputError, match=r"^policy 'rial' is neither .* did you mean 'rail'"):
        practice.advised(learned, "rial", 1, 1)


def test_an_adviser_with_other_senses_than_the_drivers_is_refused(practice):
    further = config_file.load(None, ["episode.duration_s=5", "lidar.max_range_m=150"])
    refused = (
        r"^adviser 'expert' was trained with lidar\.max_range_m = 100\.0, not 150\.0; set lidar\.max_range_m=100\.0"
    )
    with pytest.raises(InputError, match=refused):
        run.record("keep", further, episodes=1, seed=0, adviser="expert")
    recorded = run.record("rail", further, episodes=1, seed=0, adviser="expert")  # rail drives with its own senses
    assert recorded.observations.shape == (5, 48)
    with pytest.raises(InputError, match=r"^the adviser was trained with observation\.host_speed = True"):
        practice.advised(
            roster.find_driver("rail", further), roster.find_driver("road-expert", config_file.load()), 1, 1
        )


def test_a_run_that_is_not_done_says_so(small, driven, tmp_path):
    world = small.changed(train={"iterations": 1})
    training.learn(world, tmp_path / "run", seed=1)
    assert roster.doubts([str(tmp_path / "run"), "rail", "keep"], small) == []
    config = tmp_path / "run" / CONFIG
    config.write_text(config.read_text().replace("iterations = 1\n", "iterations = 5\n"))
    (told,) = roster.doubts([str(tmp_path / "run"), "rail", "keep"], small)
    assert told == f"'{tmp_path / 'run'}' has done 1 of 5 iterations; go on with --resume"


def test_where_ray_is_missing_no_run_is_begun(small, driven, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray.util.multiprocessing", None)
    world = small.changed(train={"demonstrations": str(tmp_path / "demonstrations.parquet"), "iterations": 0})
    with pytest.raises(InputError, match="needs Ray"):
        training.learn(world, tmp_path / "run", seed=1, workers="ray")
    assert not (tmp_path / "run").exists()


def test_in_python_drivers_go_by_their_names_too(small):
    tables = run.evaluate({"mine": "expert", "other": "keep"}, small, episodes=1, seed=0)
    assert list(tables.episodes["policy"]) == ["mine", "other"]
    with pytest.raises(InputError, match=r"^policy 'rial' is neither .* did you mean 'rail'"):
        run.evaluate({"mine": "rial"}, small, episodes=1, seed=0)
    with pytest.raises(InputError, match=r"^a driver is a name, a run's policy, or an object with senses and decide"):
        run.evaluate({"mine": 7}, small, episodes=1, seed=0)


OWN_LEARNERS = """
from dataclasses import replace

import numpy as np

from rail_sumo.learners import Iteration, Learner, memory_of

def gives_up(practice, checkpoint, demonstrations):
    yield Iteration(checkpoint.learned, {}, practice.drive([checkpoint.learned], 1), {})

def says_something_else(practice, checkpoint, demonstrations):
    yield {"learned": checkpoint.learned}

def with_theta(change):
    def iterate(practice, checkpoint, demonstrations):
        start = checkpoint.learned
        yield Iteration(replace(start, theta=change(start.theta)), {}, practice.drive([start], 1), {})
    return iterate

def has_a_figure_of_its_own(practice, checkpoint, demonstrations):
    for iteration in with_theta(lambda theta: theta)(practice, checkpoint, demonstrations):
        yield replace(iteration, figures={"my_loss": 1.0})

def counts_for_itself(practice, checkpoint, demonstrations):
    for iteration in with_theta(lambda theta: theta)(practice, checkpoint, demonstrations):
        yield replace(iteration, figures={"environment_steps": 7})

def looks_before(practice, checkpoint, demonstrations):
    for number in range(checkpoint.iteration + 1, 4):
        practice.advised(checkpoint.learned, "rule", 1, number)
        practice.drive([checkpoint.learned] * 2, number)
        yield Iteration(checkpoint.learned, {}, practice.drive([checkpoint.learned], number), {})

LOOKS_BEFORE = Learner(looks_before, iterations=3, samples=False)

def remembers(memory):
    def iterate(practice, checkpoint, demonstrations):
        start = checkpoint.learned
        assert not checkpoint.memory or (checkpoint.memory["theta"] == start.theta / 2).all()
        learned = replace(start, theta=start.theta + 0.01)
        yield Iteration(learned, memory(learned), practice.drive([learned], 1), {})
    return iterate

def yields(**wrong):
    def iterate(practice, checkpoint, demonstrations):
        start = checkpoint.learned
        yield replace(Iteration(start, {}, practice.drive([start], 1), {}), **wrong)
    return Learner(iterate, iterations=1, samples=False)

NO_MEMORY, NO_DRIVES, NAMED_BY_A_NUMBER = yields(memory=None), yields(driven=None), yields(memory={1: np.ones(2)})
TOO_WIDE = yields(memory={"n": np.ones(2, np.longdouble)})
WORDS_FOR_DRIVES = yields(driven=["fast"])
LIST = Learner(with_theta(lambda theta: list(theta)), iterations=1, samples=False)
RETURNS = Learner(lambda practice, checkpoint, demonstrations: None, iterations=1, samples=False)

def strided(practice, checkpoint, demonstrations):
    theta = np.column_stack([checkpoint.learned.theta + 0.01, checkpoint.learned.theta])[:, 0]
    memory = {"theta": theta / 2, "turned": np.asfortranarray([[0, 1, 2], [3, 4, 5]]), "every": np.arange(10)[::2]}
    memory["one"] = np.array(7.0)
    learned = replace(checkpoint.learned, theta=theta)
    yield Iteration(learned, memory, practice.drive([learned], 1), {})

STRIDED = Learner(strided, iterations=1, samples=False)

HALF, PLAIN_NUMBER = remembers(lambda new: {"theta": new.theta / 2}), remembers(lambda new: {"n": 3})
WORDS = remembers(lambda new: {"n": np.array(["a"])})

def has_a_word_for_a_figure(practice, checkpoint, demonstrations):
    for iteration in with_theta(lambda theta: theta)(practice, checkpoint, demonstrations):
        yield replace(iteration, figures={"mean_return": "high"})

HALF, PLAIN_NUMBER, WORDS, WORD_FOR_A_FIGURE = (
    Learner(one, iterations=1, samples=False) for one in (HALF, PLAIN_NUMBER, WORDS, has_a_word_for_a_figure)
)

TOO_SHORT, NOT_FINITE = with_theta(lambda theta: theta[:-1]), with_theta(lambda theta: theta / 0.0)
BEYOND = with_theta(lambda theta: theta + 1e300)
GIVES_UP, SAYS_SOMETHING_ELSE, HAS_A_FIGURE_OF_ITS_OWN, COUNTS_FOR_ITSELF, TOO_SHORT, NOT_FINITE, BEYOND = (
    Learner(one, iterations=2, samples=False)
    for one in (
        gives_up, says_something_else, has_a_figure_of_its_own, counts_for_itself, TOO_SHORT, NOT_FINITE, BEYOND
    )
)
"""


def test_a_learner_that_gives_up_or_says_something_else_is_told(small, driven, tmp_path, monkeypatch):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    notes = Notes()
    world = small.changed(train={"learner": "own_learners:GIVES_UP"})
    training.learn(world, tmp_path / "one", seed=1, observer=notes)
    assert notes.told[-1] == "learner 'own_learners:GIVES_UP' ended by itself, after 1 of 3 iterations"
    other = small.changed(train={"learner": "own_learners:SAYS_SOMETHING_ELSE"})
    with pytest.raises(InputError, match=r"^learner '.*:SAYS_SOMETHING_ELSE' yields a dict; it has to yield an `Iter"):
        training.learn(other, tmp_path / "other", seed=1)
    for name, figure in (("HAS_A_FIGURE_OF_ITS_OWN", "my_loss"), ("COUNTS_FOR_ITSELF", "environment_steps")):
        world = small.changed(train={"learner": f"own_learners:{name}"})
        told = rf"^'{figure}' is no column of progress.csv that a learner tells; figures may be: mean_return, "
        with pytest.raises(InputError, match=told):
            training.learn(world, tmp_path / name, seed=1)


def test_all_that_a_learner_drives_is_counted_whatever_it_tells_of_and_after_an_interruption(
    small, driven, tmp_path, monkeypatch
):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    world = small.changed(train={"learner": "own_learners:LOOKS_BEFORE", "iterations": 2})
    training.learn(world, tmp_path / "run", seed=1)
    training.learn(world.changed(train={"iterations": 3}), tmp_path / "run", seed=1, resume=True)
    steps = pd.read_csv(tmp_path / "run" / PROGRESS)["environment_steps"]
    a_rollout = len(drive(rollout.Task("rule", world, 0)).lane_changing)
    assert steps.tolist() == [4 * a_rollout, 8 * a_rollout, 12 * a_rollout]


@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("TOO_SHORT", r"theta must have shape \(47,\) for Shape\(.*\); got \(46,\)"),
        ("NOT_FINITE", r"theta must be finite; 47 of 47 values are not"),
        ("BEYOND", r"theta has values beyond 1e\+09: it diverged; lower its step size or learning rate"),
    ],
)
def test_what_a_learner_yields_that_cannot_drive_is_refused_at_once(small, driven, tmp_path, monkeypatch, name, why):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    world = small.changed(train={"learner": f"own_learners:{name}"})
    with pytest.raises(
        InputError, match=rf"^what learner 'own_learners:{name}' yields in iteration 1 cannot drive: {why}$"
    ):
        training.learn(world, tmp_path / "run", seed=1)
    assert RunDirectory(tmp_path / "run").checkpoint().iteration == 0


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("PLAIN_NUMBER", r"memory 'n' is 3; memory is numpy arrays of numbers, such as np\.array\(3\)"),
        ("WORDS", r"memory 'n' is array\(\['a'\], dtype='<U1'\); memory is numpy arrays of numbers, such as .*"),
        ("NO_MEMORY", "memory is None; it is a Mapping"),
        ("NO_DRIVES", "driven is None; it is a list"),
        ("WORDS_FOR_DRIVES", "driven holds 'fast'; it is a list of what `practice.drive` returns"),
        ("NAMED_BY_A_NUMBER", "memory has the name 1; names are strings"),
        ("TOO_WIDE", r"memory 'n' is array\(\[1., 1.\], dtype=.*; memory is numpy arrays of numbers, such as .*"),
        ("LIST", "theta is a list; it is a numpy array"),
        ("WORD_FOR_A_FIGURE", "figure 'mean_return' is 'high'; figures are numbers"),
    ],
)
def test_what_a_learner_yields_that_cannot_be_kept_is_refused_at_once(small, driven, tmp_path, monkeypatch, name, why):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    world = small.changed(train={"learner": f"own_learners:{name}", "iterations": 1})
    with pytest.raises(
        InputError, match=rf"^what learner 'own_learners:{name}' yields in iteration 1 cannot be kept: {why}$"
    ):
        training.learn(world, tmp_path / "run", seed=1)
    assert RunDirectory(tmp_path / "run").checkpoint().iteration == 0


def test_arrays_of_any_order_in_memory_are_kept_as_they_are(small, driven, tmp_path, monkeypatch):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    world = small.changed(train={"learner": "own_learners:STRIDED", "iterations": 1})
    run = training.learn(world, tmp_path / "run", seed=1)
    kept = RunDirectory(run.path).checkpoint()
    assert (kept.learned.theta == run.clone.theta + 0.01).all()
    assert (kept.memory["theta"] == kept.learned.theta / 2).all()
    assert kept.memory["turned"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert kept.memory["every"].tolist() == [0, 2, 4, 6, 8]
    assert (kept.memory["one"].shape, float(kept.memory["one"])) == ((), 7.0)
    none = small.changed(train={"learner": "own_learners:RETURNS", "iterations": 1})
    with pytest.raises(
        InputError, match=r"^learner 'own_learners:RETURNS' returns None; it has to yield an `Iteration`"
    ):
        training.learn(none, tmp_path / "none", seed=1)


def test_drivers_of_ones_own_that_name_no_senses_are_told_with_whose_they_drive(trained, small, tmp_path, monkeypatch):
    (tmp_path / "own_senses.py").write_text(
        "from rail_sumo import config_file\n\n\n"
        "class Takes:\n    senses = None\n\n    def decide(self, observation, agent):\n        return 0\n\n\n"
        "class Has(Takes):\n    senses = config_file.load().senses\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    names = [str(trained), "own_senses:Takes", "own_senses:Has", "rule"]
    world = roster.world(names)
    who = {name: roster.find_driver(name, world) for name in names}
    (told,) = roster.borrowed_senses(who, names, world)
    assert told.startswith(
        f"'own_senses:Takes' names no senses, and drives with those of '{trained}', the first run named: lidar.n_rays ="
    )
    assert not list(roster.borrowed_senses(who, names, config_file.load()))


def test_the_drives_of_an_evaluation_may_be_had_whole_and_by_several_workers(small):
    rows = run.evaluate({"rule": "rule"}, small, episodes=3, seed=4).episodes
    drives = run.drive("rule", small, episodes=3, seed=4, workers=2)
    assert [one.seed for one in drives] == rows["seed"].tolist()
    assert [one.distance_m for one in drives] == pytest.approx(rows["distance_m"], abs=1e-5)
    assert all(len(one.observations) == len(one.decisions) > 0 for one in drives)
    with pytest.raises(InputError, match="episodes must be at least 1; got 0"):
        run.drive("rule", small, episodes=0, seed=4)


def test_runs_of_other_worlds_than_that_of_the_first_are_told_of(trained, small, tmp_path):
    assert not list(roster.other_worlds([str(trained), "rule"], small))
    other = shutil.copytree(trained, tmp_path / "other")
    text = (other / "config.toml").read_text()
    vehicles = small.traffic.vehicles
    (other / "config.toml").write_text(text.replace(f"vehicles = {vehicles}", f"vehicles = {vehicles + 3}"))
    (told,) = roster.other_worlds([str(trained), str(other)], small)
    assert told.endswith(f"'{other}' was trained with traffic.vehicles = {vehicles + 3}")
    assert not list(roster.other_worlds([str(trained), str(other)], small.changed(traffic={"vehicles": vehicles + 3})))


def test_a_learners_memory_may_have_any_names_beside_its_policys(small, driven, tmp_path, monkeypatch):
    (tmp_path / "own_learners.py").write_text(OWN_LEARNERS)
    monkeypatch.syspath_prepend(tmp_path)
    world = small.changed(train={"learner": "own_learners:HALF", "iterations": 1})
    begun = training.learn(world, tmp_path / "run", seed=1).checkpoint()
    assert (begun.memory["theta"] == begun.learned.theta / 2).all()
    more = world.changed(train={"iterations": 2})
    resumed = training.learn(more, tmp_path / "run", seed=1, resume=True).checkpoint()
    assert (resumed.learned.theta == begun.learned.theta + 0.01).all()


def test_a_policy_whose_parameters_are_not_finite_is_not_loaded(trained, small):
    replace_theta(trained / POLICY, lambda theta: np.full_like(theta, np.nan))
    with pytest.raises(InputError, match=r"damaged \(ValueError: theta must be finite; 47 of 47 values are not\)"):
        roster.find_driver(str(trained), small)


def test_an_expert_that_is_not_the_shipped_one_is_told():
    assert roster.doubts(["expert", "rule"], config.Config()) == []
    other = config.Config().changed(train={"expert": "runs/mine"})
    assert roster.doubts(["rule"], other) == []
    (told,) = roster.doubts(["rule", "expert"], other)
    assert told.startswith("'expert' is 'runs/mine' here, as train.expert says, and not the shipped one")
