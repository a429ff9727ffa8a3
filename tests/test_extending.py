"""What docs/extending.md and the page of DAgger show is run as it stands, only shorter."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from safetensors.numpy import load_file

from rail_sumo import assets, learners, registry, rollout, roster, training
from rail_sumo.config_file import load
from rail_sumo.errors import InputError
from rail_sumo.imitation.demonstrations import recorded_on
from rail_sumo.imitation.losses import LOSSES
from rail_sumo.records import MetaAction, Scene
from rail_sumo.run import demonstrate
from rail_sumo.run_directory import RunDirectory

DOCS = Path(__file__).parent.parent / "docs"
DOCUMENT = (DOCS / "extending.md").read_text(encoding="utf-8")
DAGGER = (DOCS / "learners" / "dagger.md").read_text(encoding="utf-8")
BRIEF = [
    "cloning.epochs=5",
    "train.iterations=2",
    "train.horizon_s=10",
    "train.evaluation_episodes=1",
    "episode.duration_s=10",
]


@pytest.fixture
def shown(tmp_path):
    """The folder of the files shown, and the commands."""
    for name, text in re.findall(r"```python\n# (\w+\.py)\n(.*?)```", DOCUMENT, re.DOTALL):
        (tmp_path / name).write_text(text.replace("N_ELITE, NOISE_STD = 32, 8,", "N_ELITE, NOISE_STD = 4, 2,"))
    return tmp_path, re.findall(r"rail-sumo (train .*)", DOCUMENT)


def run(folder, *command):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
    finished = subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def rail_sumo(folder, command, *more, workers=1):
    brief = [part for override in BRIEF for part in ("--set", override)]
    how = [*command.split(), *brief, "--workers", str(workers), *more]
    run(folder, "-c", "from rail_sumo import cli; cli.main()", *how)


@pytest.mark.slow
def test_the_driver_shown_drives_in_workers_and_keeps_to_the_right(shown):
    folder, _ = shown
    file = folder / "courteous.py"
    file.write_text(file.read_text().replace("config_file.load()", 'config_file.load(None, ["episode.duration_s=60"])'))
    rows = [line.split() for line in run(folder, "courteous.py").splitlines()[1:]]
    means = {(policy, metric): float(mean) for policy, metric, mean, _ in rows}
    assert means["courteous", "speed_kmh"] > 50.0
    assert means["courteous", "lane_changes"] > means["rule", "lane_changes"]  # it goes back each time
    assert means["courteous", "refused_decisions"] == 0.0


@pytest.mark.slow
def test_the_driver_shown_is_driven_and_recorded_by_its_name(shown):
    folder, _ = shown
    brief = ["--set", "episode.duration_s=30", "--episodes", "2", "--workers", "2"]
    main = "from rail_sumo import cli; cli.main()"
    run(folder, "-c", main, "eval", "courteous:Courteous", "rule", *brief, "--out", "beside")
    driven = pd.read_parquet(folder / "beside" / "episodes.parquet")
    by_name = driven[driven["policy"] == "courteous:Courteous"]["speed_kmh"].tolist()
    record = ["expert", "record", "--driver", "courteous:Courteous", "--out", "courteous.parquet"]
    run(folder, "-c", main, *record, *brief)
    assert pd.read_parquet(folder / "courteous.parquet")["allowed_keep"].all()
    assert recorded_on(folder / "courteous.parquet") == ("highway5",)
    (folder / "in_code.py").write_text(
        "from courteous import Courteous\nfrom rail_sumo import config_file, run\n"
        "world = config_file.load(None, ['episode.duration_s=30'])\n"
        "print(*run.evaluate({'mine': Courteous()}, world, episodes=2, seed=0).episodes['speed_kmh'])\n"
    )
    assert [float(speed) for speed in run(folder, "in_code.py").split()] == by_name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "nowhere:Driver",
            r"policy 'nowhere:Driver': No module named 'nowhere'; install it, or add its folder to PYTHON",
        ),
        ("math:pi", r"a driver is a name, a run's policy, or an object with senses and decide\(\); got 3\.14"),
        ("fractions:Decimal.x", r"policy 'fractions:Decimal\.x' is neither a run directory nor a driver"),
        (
            "rail_sumo.drivers:Rule",
            r"policy 'rail_sumo\.drivers:Rule' is a class that takes arguments \(.*adas.*; name ",
        ),
        ("rail:gredy", r"policy 'rail:gredy' is neither a run directory nor a driver; did you mean 'rail:"),
    ],
)
def test_what_is_no_driver_of_ones_own_is_refused_in_one_line(name, message):
    with pytest.raises(InputError, match=f"^{message}"):
        roster.find_driver(name, load())


def test_the_radar_shown_finds_the_nearest_ahead(shown, monkeypatch):
    folder, _ = shown
    monkeypatch.syspath_prepend(folder)
    radar = import_module("radar").radar
    # A host at 20 m/s heads north. 40 m and 90 m ahead, 12 m to its right and 20 m behind it a car; all 5 m long.
    places = np.array([[0.0, 0.0], [0.0, 40.0], [1.0, 90.0], [12.0, 20.0], [0.0, -20.0]])
    scene = Scene(
        0.0, list("habcd"), np.array([*places.T, [np.pi / 2] * 5, [20.0, 15.0, 9.0, 9.0, 9.0], [5.0] * 5, [1.8] * 5])
    )
    assert radar(scene) == pytest.approx([35.0, -5.0])
    assert radar(scene, range_m=30.0) == pytest.approx([30.0, 0.0])
    assert radar(scene, half_angle_rad=0.6, range_m=30.0) == pytest.approx([15.0, -11.0])


@pytest.mark.slow
def test_the_radar_shown_is_added_to_the_observation(shown):
    folder, _ = shown
    distance_m, closing_mps = map(float, run(folder, "radar.py").strip(" [\n]").split())
    assert 0.0 < distance_m <= 150.0
    assert abs(closing_mps) < 20.0


@pytest.mark.slow
def test_the_learner_shown_learns_in_workers_and_is_resumed_to_the_same_policy(shown):
    folder, (command, *_) = shown
    rail_sumo(folder, command, workers=2)
    progress = pd.read_csv(folder / "runs" / "cem" / "progress.csv")
    assert progress[["mean_return", "judge_loss", "speed_kmh"]].notna().all(axis=None)
    policy, clone = (load_file(folder / "runs" / "cem" / f"{name}.safetensors") for name in ("policy", "clone"))
    assert (policy["theta"] != clone["theta"]).any()
    again = command.replace("runs/cem", "runs/again")
    rail_sumo(folder, again, "--set", "train.iterations=1")
    rail_sumo(folder, again, "--resume")
    assert (load_file(folder / "runs" / "again" / "policy.safetensors")["theta"] == policy["theta"]).all()
    file = folder / "cem.py"
    file.write_text(file.read_text().replace("N_ELITE, NOISE_STD = 4, 2, 0.1", "N_ELITE, NOISE_STD = 4, 2, 0.5"))
    more = ["train", "--out", "runs/again", "--resume", "--set", "train.iterations=3"]
    with pytest.raises(AssertionError, match=r"the content of train\.learner has changed since run directory"):
        run(folder, "-c", "from rail_sumo import cli; cli.main()", *more)


def test_the_dagger_shown_asks_the_teacher_named_and_is_resumed_to_the_same_policy(tmp_path, monkeypatch):
    (text,) = re.findall(r"```python\n# ask\.py\n(.*?)```", DAGGER, re.DOTALL)
    (tmp_path / "ask.py").write_text(text)
    (tmp_path / "left.py").write_text(
        "class Left:\n    senses = None\n\n    def decide(self, observation, agent):\n        return 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(import_module("ask"), "ROLLOUTS", 2)
    (command,) = re.findall(r"rail-sumo train (.*learner=ask.*)", DAGGER)
    brief = load(None, [*re.findall(r"--set (\S+)", command), *BRIEF, "train.trajectories=3"])
    once = brief.changed(train={"iterations": 1})
    demonstrate("rule", load(None, BRIEF), "rule.parquet", episodes=3, seed=0)
    for teacher in ("rule", "left:Left"):
        monkeypatch.setattr("ask.TEACHER", teacher)
        whole = training.learn(brief, tmp_path / teacher, seed=1).checkpoint()
        training.learn(once, tmp_path / f"{teacher}-again", seed=1)
        again = training.learn(brief, tmp_path / f"{teacher}-again", seed=1, resume=True).checkpoint()
        assert (again.learned.theta == whole.learned.theta).all()
        assert whole.memory["episode"].max() + 1 == 3 + 2 * 2  # the demonstrations, and two rollouts of each iteration
        asked = whole.memory["actions"][whole.memory["episode"] >= 3]
        assert (asked == MetaAction.LEFT).all() == (teacher == "left:Left")


@pytest.mark.slow
def test_the_loss_shown_is_what_the_judge_minimises_and_the_log_tells(shown):
    folder, (_, command, _) = shown
    rail_sumo(folder, command, "--set", "judge.minibatches=300", "--set", "judge.learning_rate=0.01")
    loss = pd.read_csv(folder / "runs" / "linear-judge" / "progress.csv")["judge_loss"]
    rail_sumo(folder, command.replace("linear_judge:LINEAR", "cross-entropy").replace("-judge", "-other"))
    other = pd.read_csv(folder / "runs" / "linear-other" / "progress.csv")["judge_loss"]
    assert loss.max() < 0.26  # of squares, with labels 1 and 0: 0.25 where the two look the same
    assert other.min() > 0.6  # of logarithms: 0.69


@pytest.mark.slow
def test_the_demonstrations_shown_are_learned_from(shown):
    folder, (*_, command) = shown
    run(folder, "mine.py")
    more = ["--set", "train.iterations=0", "--set", "cloning.epochs=100"]
    rail_sumo(folder, f"{command} --set train.learner=bc --out runs/mine", *more)
    policy = RunDirectory(folder / "runs" / "mine").policy().policy()
    assert policy(np.array([100.0] * 24 + [0.0] * 24)) == MetaAction.ACCELERATE  # all it was shown


def test_the_weights_shown_are_the_policy_and_the_judge_of_a_run(shown, monkeypatch):
    folder, _ = shown
    file = folder / "weights.py"
    file.write_text(file.read_text().replace("runs/first", str(assets.driver("rail"))))
    monkeypatch.syspath_prepend(folder)
    weights = import_module("weights")
    world = load(None, ["episode.duration_s=60"])
    driven = rollout.drive(rollout.Task(roster.find_driver("rail", world), world, 7))
    seen, done = torch.tensor(driven.observations).float(), torch.tensor(driven.carried_out)
    policy = roster.find_driver("rail", world).policy()
    expected = [policy.outputs(observation) for observation in driven.observations]
    np.testing.assert_allclose(weights.logits(seen).numpy(), expected, atol=1e-3)
    by_judge = learners.verdicts(RunDirectory(assets.driver("rail")), driven)
    np.testing.assert_allclose(weights.verdicts(seen, done).detach().numpy(), by_judge, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "rial",
            r"learner 'rial' not found; did you mean 'rail'\? \(available: ars, bc, .*; one from outside is written",
        ),
        ("nowhere:X", r"learner 'nowhere:X': No module named 'nowhere'; install it, or add its folder to PYTHONPATH"),
        ("math:X", r"learner 'math:X': module 'math' has no 'X'"),
        ("math:pi", r"learner 'math:pi' must be a rail_sumo\.learners\.Learner; it is a float"),
    ],
)
def test_what_is_no_learner_is_refused_in_one_line(name, message):
    with pytest.raises(InputError, match=f"^{message}"):
        learners.learner_of(load(None, [f"train.learner={name}"]))


def test_what_is_known_by_name_is_found_without_importing_anything():
    for name, loss in LOSSES.items():
        assert registry.find("loss", name, LOSSES) is loss
