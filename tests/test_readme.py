"""What README shows is run as it stands, only shorter."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from rail_sumo import config, config_file

README = Path(__file__).parent.parent.joinpath("README.md").read_text(encoding="utf-8")
LONG_AND_SHORT = {
    '"train.iterations=20"': '"train.iterations=1", "search.n_directions=2", "train.evaluation_episodes=1"',
    "episodes=16": "episodes=2",
    "runs/mine": "runs/linear",
}


def shown(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def shortened(text):
    for long, short in LONG_AND_SHORT.items():
        text = text.replace(long, short)
    return text


def run(folder, *command):
    """What Python prints, started in a folder."""
    finished = subprocess.run([sys.executable, *command], cwd=folder, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def test_the_configuration_shown_is_one_and_changes_what_it_names(tmp_path):
    (text,) = shown("toml")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    chosen, default = config_file.load(tmp_path / "mine.toml").flat(), config.Config().flat()
    assert {key: value for key, value in chosen.items() if value != default[key]} == {
        "traffic.vehicles": 24,
        "policy.layers": 1,
    }


@pytest.mark.slow
def test_the_python_shown_runs_in_an_empty_folder(tmp_path):
    training, environment, floating_car_data = map(shortened, shown("python"))
    (tmp_path / "training.py").write_text(training, encoding="utf-8")
    speeds = run(tmp_path, "training.py")
    assert [line.split()[0] for line in speeds.splitlines()[1:]] == ["runs/linear", "expert", "rule"]
    run(tmp_path, "-c", environment)
    (command,) = re.findall(r"# rail-sumo (eval .*)", floating_car_data)
    run(tmp_path, "-c", "from rail_sumo import cli; cli.main()", *command.split(), "--episodes", "1")
    by_lane = run(tmp_path, "-c", floating_car_data)
    assert {"runs/linear", "rule"} <= set(by_lane.split())
    assert "highway_2" in by_lane  # the lane in the middle, where neither can help driving
