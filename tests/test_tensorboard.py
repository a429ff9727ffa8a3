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


def written(run):
    events = EventAccumulator(str(run / tensorboard.FOLDER)).Reload()
    return {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def test_every_figure_of_every_iteration_is_written_over_environment_steps(tmp_path):
    events = tensorboard.Events(SILENT, tmp_path / "run")
    for iteration in (1, 2):
        events.advance(row(iteration, 60.0 + iteration))
    assert written(tmp_path / "run") == {"iteration": [(1000, 1), (2000, 2)], "speed_kmh": [(1000, 61), (2000, 62)]}


def test_what_a_resumed_training_does_again_is_written_once(tmp_path):
    first = tensorboard.Events(SILENT, tmp_path)
    for iteration in (1, 2, 3):
        first.advance(row(iteration, 60.0))
    resumed = tensorboard.Events(SILENT, tmp_path)
    for iteration in (3, 4):
        resumed.advance(row(iteration, 70.0))
    assert written(tmp_path)["speed_kmh"] == [(1000, 60), (2000, 60), (3000, 70), (4000, 70)]


def test_the_other_observer_is_told_of_everything_and_the_evaluation_is_not_written(tmp_path):
    recorder = Recorder()
    events = tensorboard.Events(recorder, tmp_path / "run")
    events.start("eval", 16)
    events.advance({"speed_kmh": 60.0})
    assert recorder.told == [("eval", 16, 0), {"speed_kmh": 60.0}]
    assert not (tmp_path / "run").exists()


def test_without_tensorboard_the_user_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(tensorboard, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"install it with: pip install 'rail-sumo\[tensorboard\]'"):
        tensorboard.Events(SILENT, tmp_path)
