import csv
import json

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from rail_sumo import tensorboard
from rail_sumo.errors import InputError
from rail_sumo.rollout import SILENT


class Recorder:
    def __init__(self):
        self.told = []

    def start(self, work, total, done=0):
        self.told.append((work, total, done))

    def advance(self, figures):
        self.told.append(figures)


def row(iteration, speed_kmh):
    return {"iteration": iteration, "environment_steps": 1000 * iteration, "seconds": 1.0, "speed_kmh": speed_kmh}


def progress(run, *rows):
    run.mkdir(exist_ok=True)
    with (run / "progress.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [*row(0, 0.0), "judge_loss"])
        writer.writeheader()
        writer.writerows(rows)


def written(run):
    events = EventAccumulator(str(run / tensorboard.FOLDER)).Reload()
    return {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def test_every_figure_of_every_iteration_is_written_over_environment_steps(tmp_path):
    events = tensorboard.Events(SILENT, tmp_path / "run")
    for iteration in (1, 2):
        progress(tmp_path / "run", *(row(i, 60.0 + i) for i in range(1, iteration + 1)))
        events.advance(row(iteration, 60.0 + iteration))
    assert written(tmp_path / "run") == {"iteration": [(1000, 1), (2000, 2)], "speed_kmh": [(1000, 61), (2000, 62)]}


def test_resumed_it_writes_once_what_was_done_before_whether_it_was_told_or_not(tmp_path):
    rows = [row(iteration, 60.0 + iteration) for iteration in (1, 2, 3)]
    progress(tmp_path, rows[0])
    tensorboard.Events(SILENT, tmp_path).advance(rows[0])  # then killed between saving the second and telling of it
    progress(tmp_path, *rows)
    tensorboard.Events(SILENT, tmp_path).advance(rows[2])
    assert written(tmp_path)["speed_kmh"] == [(1000, 61), (2000, 62), (3000, 63)]
    assert "judge_loss" not in written(tmp_path)


def test_the_other_observer_is_told_of_everything_and_the_evaluation_is_not_written(tmp_path):
    recorder = Recorder()
    events = tensorboard.Events(recorder, tmp_path / "run")
    events.start("eval", 16)
    events.advance({"speed_kmh": 60.0})
    assert recorder.told == [("eval", 16, 0), {"speed_kmh": 60.0}]
    assert not (tmp_path / "run").exists()


def test_events_that_cannot_be_written_are_one_line(tmp_path):
    progress(tmp_path, row(1, 60.0))
    (tmp_path / tensorboard.FOLDER).touch()
    with pytest.raises(InputError, match=r"cannot write '.*tensorboard': "):
        tensorboard.Events(SILENT, tmp_path).advance(row(1, 60.0))


def test_without_tensorboard_the_user_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(tensorboard, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"install it with: pip install 'rail-sumo\[tensorboard\]'"):
        tensorboard.Events(SILENT, tmp_path)


def test_a_training_that_writes_event_files_comes_to_its_end(rail_sumo, tmp_path):
    brief = ["train.iterations=1", "search.n_directions=2", "search.n_top=1", "train.trajectories=2"]
    brief += ["train.horizon_s=5", "train.evaluation_episodes=1", "episode.duration_s=5"]
    overrides = [word for one in brief for word in ("--set", one)]
    code, _, err = rail_sumo("train", "--tensorboard", "--workers", "1", "--out", "run", *overrides)
    assert (code, err) == (0, "")
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert "policy.safetensors" in manifest["files"]
    assert (tmp_path / "run" / "tensorboard").is_dir()
