"""Every example runs, with less to do than by itself, and tells what it promises."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
SHORTER = {'"file": "ring5"}': '"file": "ring5"}, "episode": {"duration_s": 5.0}', "range(30)": "range(5)"}
"""What the programs shown in docs/environment.md have in place of something long."""


def example(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_ppo_trains_and_is_evaluated_beside_it(capsys):
    best = example("ppo").main(["--decisions", "128", "--between", "64"])
    printed = capsys.readouterr().out
    assert printed.count("Success rate: 100.00%") == 2
    assert f"a reward of {best:.1f} an episode" in printed
    assert 0.0 < best < 1000.0  # at most 1 for each step of the two minutes that 2 km take


def test_ppo_is_compared_with_the_expert_on_the_same_traffic(capsys):
    tables = example("ppo_compared").main(["--decisions", "64"])
    assert tables.episodes.groupby("policy")["seed"].apply(tuple).nunique() == 1
    assert set(tables.episodes["policy"]) == {"ppo", "expert"}
    speeds = tables.summary[tables.summary["metric"] == "speed_kmh"].set_index("policy")["mean"]
    assert f"{speeds['ppo']:.6f}" in capsys.readouterr().out


def test_a_taught_driver_sees_observations_as_its_learner_did():
    taught = example("ppo_compared").Taught
    normalised = SimpleNamespace(normalize_obs=lambda observation: observation - 50.0)
    policy = SimpleNamespace(predict=lambda seen, deterministic: (np.array(4 if seen[0] == 7.0 else 0), None))
    assert taught(SimpleNamespace(policy=policy), normalised).decide(np.array([57.0]), None) == 4


def test_two_vector_environments_tell_light_traffic_from_dense(capsys):
    speeds = example("two_environments").main(["--decisions", "62", "--seconds", "30"])
    assert speeds["light"] > speeds["dense"] > 40.0
    printed = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in printed] == ["light", "dense"]
    assert all(line.endswith("in 4 episodes") for line in printed)


def test_eight_agents_drive_to_their_ends_and_are_listed(capsys):
    ended = example("eight_agents").main(["--seconds", "20"])
    assert sorted(ended) == [f"host_{number}" for number in range(8)]
    assert {(told["end_reason"], told["duration_s"], told["refused_decisions"]) for told in ended.values()} <= {
        ("duration", 20.0, refused) for refused in range(3)
    }
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split()[:2] == ["agent", "vehicle"]
    assert [row.split()[0] for row in rows] == sorted(ended)
    assert [float(row.split()[2]) for row in rows] == [round(ended[name]["speed_kmh"], 1) for name in sorted(ended)]


def test_three_shares_are_compared_with_none(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("rail_sumo.studies.sweep.find_spec", lambda name: None)  # figures would take the longest
    given = ["--seeds", "2", "--seconds", "10", "--warm-up", "5", "--workers", "1", "--out", str(tmp_path)]
    differences = example("shares").main(given)
    assert differences["share"].tolist() == [0.1, 0.1, 0.5, 0.5, 1.0, 1.0]
    assert np.isfinite(differences["difference"]).all()
    assert (differences["difference_low"] < differences["difference_high"]).all()
    assert (tmp_path / "sweep.md").exists()
    assert "lane_changes_per_vehkm" in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_examples_are_short_and_each_has_its_test(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 40
    assert f'example("{path.stem}")' in Path(__file__).read_text(encoding="utf-8")


def test_the_programs_of_the_page_run_in_an_empty_folder(tmp_path):
    programs = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "environment.md").read_text(encoding="utf-8"), re.S)
    for program in programs:
        for long, short in SHORTER.items():
            program = program.replace(long, short)
        subprocess.run([sys.executable, "-W", "error", "-c", program], cwd=tmp_path, check=True)
    assert len(programs) == 2
    assert len(list(tmp_path.glob("films/*.mp4"))) == 1
