"""What README and the pages for newcomers show is run as it stands, only shorter."""

import io
import re
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from rail_sumo import config, config_file
from rail_sumo.records import METRICS, SUMMARY_COLUMNS
from rail_sumo.tables import report

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
LONG_AND_SHORT = {
    '"train.iterations=20"': '"train.iterations=1", "search.n_directions=2", "train.evaluation_episodes=1", '
    '"cloning.epochs=5", "episode.duration_s=60"',
    "episodes=16": "episodes=2",
}


def shown(page, language):
    text = (ROOT / page).read_text(encoding="utf-8")
    return [dedent(block) for block in re.findall(rf"^ *```{language}\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE)]


def shortened(text):
    for long, short in LONG_AND_SHORT.items():
        assert long in text
        text = text.replace(long, short)
    return text


def in_one_process(text):
    """It in one process: to start two takes longer than what they do here."""
    assert "workers=2" in text
    return text.replace("workers=2", "workers=1")


def run(folder, *command):
    """What Python prints, started in a folder."""
    finished = subprocess.run([sys.executable, *command], cwd=folder, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def test_a_newcomer_reads_it_in_three_minutes():
    assert len(README.splitlines()) <= 150


TOLD = ("speed_kmh", "overtakes", "lane_changes")
ALONE = ("refused_decisions", "overtaken", "hard_brakings")


def test_the_table_shown_is_what_the_command_prints_of_such_figures():
    """Of the figures in README's table, `report.table` makes README's table, to the last space."""
    (shown_table,) = re.findall(r"```\n( +speed.*?)\ntables in runs/first\n```", README, re.DOTALL)
    name, number = r"^  (\w[\w, ]*?)  ", r" ±? *([\d.]+)"  # of a ratio the ends alone are shown
    of_policies = re.findall(name + number * 10 + r"\n(?: {8,}(\d.*))?", shown_table, re.MULTILINE)
    assert [policy for policy, *_ in of_policies] == ["rail", "clone, argmax", "clone, sampled", "expert"]
    rows = []
    for policy, *figures, ratios in of_policies:
        values = [float(figure) for figure in figures]
        beside = [float(figure) for figure in re.findall(r"[\d.]+", ratios)] or [np.nan] * 6
        of_metric = dict.fromkeys(METRICS, (0.0, np.nan, np.nan, np.nan))
        of_metric |= {metric: (*values[2 * n : 2 * n + 2], *beside[2 * n : 2 * n + 2]) for n, metric in enumerate(TOLD)}
        of_metric["distance_m"] = (7222.0, np.nan, np.nan, np.nan)
        of_metric |= {metric: (values[6 + n], np.nan, np.nan, np.nan) for n, metric in enumerate(ALONE)}
        for metric, (mean, reach, ratio_low, ratio_high) in of_metric.items():
            rows.append(
                {"policy": policy, "metric": metric, "episodes": 16, "reference": "expert", "mean": mean}
                | {"low": mean - reach, "high": mean + reach, "ratio": ratio_low}
                | {"ratio_low": ratio_low, "ratio_high": ratio_high}
            )
    console = Console(width=report.WIDE, file=io.StringIO())
    console.print(report.table(report.typed(rows, SUMMARY_COLUMNS), width=report.WIDE))
    printed = "\n".join(line.rstrip() for line in console.file.getvalue().splitlines()).strip("\n")
    assert printed == shown_table


def test_the_configuration_shown_is_one_and_changes_what_it_names(tmp_path):
    (text,) = shown("docs/start.md", "toml")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    chosen, default = config_file.load(tmp_path / "mine.toml").flat(), config.Config().flat()
    assert {key: value for key, value in chosen.items() if value != default[key]} == {
        "traffic.vehicles": 24,
        "policy.layers": 1,
    }


@pytest.fixture
def printed(capsys):
    """Run a program in this process, since to start another and load torch takes longer; return what it prints."""

    def of(program):
        exec(compile(program, "shown", "exec"), {"__name__": "__main__"})
        return capsys.readouterr().out

    return of


@pytest.mark.slow
def test_the_python_shown_runs_in_an_empty_folder(tmp_path, rail_sumo, printed):
    (training,) = shown("docs/start.md", "python")
    edges, waves, stops, one_run = shown("docs/share.md", "python")
    over_trainings, apart = shown("docs/learners.md", "python")
    (environment,) = shown("README.md", "python")
    floating_car_data, staged = shown("docs/watch.md", "python")
    _, nearest = shown("docs/learners/dagger.md", "python")
    (tmp_path / "training.py").write_text(shortened(training), encoding="utf-8")
    speeds = run(tmp_path, "training.py")
    assert [line.split()[0] for line in speeds.splitlines()[1:]] == ["runs/linear", "expert", "rule"]
    for seed in range(3):
        shutil.copytree(tmp_path / "runs" / "linear", tmp_path / "runs" / f"mine-seed{seed}")
    brief = in_one_process(over_trainings).replace("episodes=16", "episodes=1")
    brief = brief.replace('"]', '", "episode.duration_s=60"]', 1)
    assert re.fullmatch(r"[01]\.\d+ \(.* to .*\) of the expert's speed", printed(brief).strip())
    brief = in_one_process(apart).replace("episodes=16", "episodes=4").replace('"]', '", "episode.duration_s=60"]', 1)
    assert re.fullmatch(r"told apart: [01]\.\d\d", printed(brief).strip())
    brief = '"train.horizon_s=10", "search.n_directions=2", "train.evaluation_episodes=1", "episode.duration_s=20", '
    brief += '"cloning.epochs=5"'
    in_two = in_one_process(staged).replace("(20, 40, 80, 160)", "(1, 2)").replace("> 20", "> 1")
    stages = printed(in_two.replace("load()", f"load(None, [{brief}])"))
    assert [line.split()[0] for line in stages.splitlines()] == ["1", "2"]
    (tmp_path / "nearest.py").write_text(
        nearest.replace("load()", 'load(None, ["episode.duration_s=40"])').replace("episodes=16", "episodes=2"),
        encoding="utf-8",
    )
    taught = run(tmp_path, "nearest.py").splitlines()[1:]
    assert [line.split()[1] for line in taught] == ["nearest", "expert"]
    assert float(taught[0].split()[2]) > 50.0
    assert "(48,)" in printed(environment + "print(observation.shape)\nenv.close()\n")
    (command,) = re.findall(r"# rail-sumo (eval .*)", floating_car_data)
    assert rail_sumo(*command.split(), "--episodes", "1")[0] == 0
    small = "--network onramp --routes onramp --seeds 1 --duration 60 --warm-up 30 --workers 1"
    share = f"sweep share 0 0.5 --driver road-rail --fcd --out share {small}"
    assert rail_sumo(*share.split())[0] == 0
    assert {"share", "type", "van", "edge"} <= set(printed(edges).split())
    printed(waves)
    assert (tmp_path / "waves.png").stat().st_size > 10_000
    when = printed(waves + stops.replace("120.0", "30.0").replace("< 0.1", "< 30.0")).splitlines()
    assert when[0].split() == ["min", "max"]
    assert when[2].startswith("joining1.")
    printed(one_run.replace("seed(4,", "seed(0,").replace("720.0", "90.0"))
    alone, rows = pd.read_parquet(tmp_path / "seed4.parquet"), pd.read_csv(tmp_path / "share" / "traffic.csv")
    alone_mps = alone.loc[alone["timestep_time"].between(30.0, 89.9), "vehicle_speed"].astype("float64").mean()
    of_run = rows[(rows["driver"] == "road-rail") & (rows["vehicles"] == "all")]
    # The sweep measures in steps of 0.01 m/s, as SUMO writes text; the file written here holds 32-bit numbers.
    assert alone_mps == pytest.approx(of_run["speed_kmh"].item() / 3.6, abs=0.001)
    by_lane = printed(floating_car_data)
    assert {"runs/linear", "rule"} <= set(by_lane.split())
    assert "highway_2" in by_lane  # the lane in the middle, where neither can help driving
    fcd = pd.read_parquet(tmp_path / "judged" / "fcd")
    assert fcd.loc[fcd["vehicle_id"].isna(), "vehicle_x"].isna().all()  # the rows without a vehicle
