import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from rail_sumo import assets, config, config_file, doctor, expert, records, rollout, run
from rail_sumo.cli import progress
from rail_sumo.errors import InputError
from rail_sumo.highway.observation import feature_names
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.run_directory import PROGRESS_COLUMNS, Checkpoint, RunDirectory
from rail_sumo.tables import report

SHORT = ("--set", "episode.duration_s=5.0", "--workers", "1")

CLOSED = """<net version="1.20">
<location netOffset="0,0" convBoundary="0,0,9,0" origBoundary="0,0,9,0" projParameter="!"/>
<edge id="e" from="a" to="b">
<lane id="e_0" index="0" disallow="passenger" speed="13.9" length="9.0" shape="0,0 9,0"/></edge>
<junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0"/>
<junction id="b" type="dead_end" x="9" y="0" incLanes="e_0" intLanes="" shape="9,0"/>
</net>"""


def lay_out(folder):
    """Everything a user can point at that is wrong."""
    (folder / "exists").mkdir()
    (folder / "exists" / "notes.txt").touch()
    (folder / "file").touch()
    (folder / "there.parquet").touch()
    (folder / "runs" / "x").mkdir(parents=True)
    (folder / "runs" / "x" / "config.toml").touch()
    (folder / "runs" / "x" / "policy.safetensors").touch()
    (folder / "expert").mkdir()
    (folder / "expert" / "config.toml").touch()
    (folder / "expert" / "manifest.json").write_text('{"files": {"demonstrations.parquet": ""}}')
    (folder / "cut.net.xml").write_text('<net version="1.20"><edge ')
    (folder / "cut.sumocfg").write_text("<configuration>")
    (folder / "closed.net.xml").write_text(CLOSED)
    (folder / "no.toml").write_text("[traffic\n")
    decision = {"action": [0], "episode": [0]}
    features = feature_names(config.Lidar(), config.Observation())
    pd.DataFrame(decision).to_parquet(folder / "blind.parquet")
    pd.DataFrame({name: [np.nan] for name in features} | decision).to_parquet(folder / "nan.parquet")
    (folder / "cut").mkdir()
    (folder / "cut" / "config.toml").touch()
    (folder / "cut" / "clone.safetensors").write_bytes(b"\x08")


DRIVERS = "(available: expert, keep, rail, random, road-expert, road-rail, rule, sumo, sumo:TYPE)"

BAD = {
    "train none.toml": "cannot read configuration 'none.toml': No such file or directory (current folder: ",
    "train --set train.learner=sac": "learner 'sac' not found (available: ars, bc, dagger, gail, rail); one ",
    "train --set train.learner=bc --set train.iterations=3": "learner 'bc' has no iterations, got 3; leave train.itera",
    "reproduce table1 --seeds 0": "--seeds must be at least 1; got 0",
    "reproduce table1 --cells cells.parquet --quick": "--cells makes tables of what was driven before: leave out --s",
    "reproduce table1 --out file/out": "cannot write to 'file/out': '",
    "train no.toml": "configuration 'no.toml' is not valid TOML: ",
    "train --set search.noise=1": "configuration: unknown key 'search.noise'; did you mean 'search.noise_std'? (",
    "train --set traffic.vehicles=many": "configuration: traffic.vehicles: Input should be a valid integer, got 'many'",
    "train --set search.n_top=best": "configuration: search.n_top: Input should be a valid integer or 'all', got ",
    "train --set expert.batch_size=100": "configuration: expert: decisions_per_update 2048 must be a multiple of batch",
    "expert record --out o.parquet --driver sumo": "driver 'sumo' takes no decisions that could be recorded; take rule",
    "plot none": "run directory 'none' not found",
    "plot cut": "'cut/clone.safetensors' is truncated or damaged (",
    "train --set traffic.vehicles=-1": "configuration: traffic.vehicles: Input should be greater than or equal to 0, g",
    "train --set nonsense": "--set takes section.key=value, for example traffic.vehicles=30; got 'nonsense'",
    "train --out exists": "output folder 'exists' exists; go on with it by --resume, or choose another with --out",
    "train --out none --resume": "run directory 'none' not found",
    "train --out exists --resume": "'exists' is not a run directory: it has no config.toml",
    "train --set train.demonstrations=none.parquet": "demonstrations 'none.parquet' not found; give a Parquet",
    "train --set train.demonstrations=file": "demonstrations 'file' are not a Parquet file, or a damaged one (",
    "train --set train.demonstrations=blind.parquet": "demonstrations 'blind.parquet' have 0 features (no 'distance_0",
    "train --set train.demonstrations=nan.parquet": "demonstrations 'nan.parquet': column 'distance_0_m' must be",
    "train --workers many": "--workers takes a number of processes from 1 up, or ray; got 'many'",
    "eval keep --workers 0": "--workers takes a number of processes from 1 up, or ray; got '0'",
    "eval keep --episodes 0": "episodes must be at least 1; got 0",
    "eval exprt": f"policy 'exprt' is neither a run directory nor a driver; did you mean 'expert'? {DRIVERS}",
    "eval exists": "'exists' is not a run directory: it has no config.toml",
    "eval file": "'file' is a file; name the run's folder\n",
    "eval runs/x/policy.safetensors": "'runs/x/policy.safetensors' is a file; name the run's folder, 'runs/x'\n",
    "plot expert": "'expert' is an expert's folder, not a run directory: it drives under that name",
    "train --out expert --resume": "'expert' is an expert's folder, not a run directory: it drives under that name",
    "eval cut": "'cut/clone.safetensors' is truncated or damaged (SafetensorError: ",
    "eval keep --out exists": "output folder 'exists' exists; choose another, or replace its tables with --overwrite",
    "eval keep --episodes 0 --out new/folder": "episodes must be at least 1; got 0",
    "eval keep --episodes 0 --out new/folder --fcd": "episodes must be at least 1; got 0",
    "eval keep --out file/out": "cannot write to 'file/out': '",
    "eval keep --fcd --out 12:30": "SUMO writes floating-car data to no path with ':' or '$' in it; choose another",
    "reproduce table2": "invalid value for 'what': 'table2' is not one of 'table1', 'figures'; see --help",
    "train --set train.expert=none": "no expert here: 'none/manifest.json' is missing; train one (rail-sumo expert tr",
    "eval keep --fcd": "--fcd writes into the folder of --out; name one",
    "eval keep --workers ray --fcd --out new": "floating-car data are written on this machine: drive with a number of",
    "eval keep --network highwy5": "network 'highwy5' not found; did you mean 'highway5'? (available: arterial, ",
    "eval rail --set policy.mode=argmax": "policy.mode is about learning, and changes nobody who drives: what",
    "eval keep --set judge.hidden=[]": "judge.hidden is about learning, and changes nobody who drives; leave it out",
    "eval keep --network none.net.xml": "network file 'none.net.xml' does not exist (current folder: ",
    "eval keep --network none.sumocfg": "network file 'none.sumocfg' does not exist (current folder: ",
    "eval keep --network cut.sumocfg": "'cut.sumocfg' is not a complete XML file: ",
    "eval keep --set network.file=cut.sumocfg": "network 'cut.sumocfg' is not a complete XML file: ",
    "eval keep --network cut.net.xml": "network 'cut.net.xml' is not a complete XML file: ",
    "eval keep --network closed.net.xml": "network 'closed.net.xml' has no edge that is open to cars; rail",
    "eval keep --routes none.rou.xml": "routes file 'none.rou.xml' does not exist (current folder: ",
    "network check closed.net.xml": "network 'closed.net.xml' has no edge that is open to cars; rail",
    "eval acc": "'acc' drives a share of a demand; compare it in: rail-sumo sweep share",
    "eval some.toml": "'some.toml' is a configuration, not a driver; name it by --config",
    "expert record --driver road-expert --out new.parquet --set observation.host_speed=false": "policy 'road-expert' w",
    "expert record --out new.csv": "demonstrations are a Parquet file, FILE.parquet; got 'new.csv'",
    "expert record --out there.parquet": "output file 'there.parquet' exists; choose another, or replace it with --ov",
    "expert record --driver rul --out new.parquet": "policy 'rul' is neither a run directory nor a driver; did you",
    "expert record --episodes 0 --driver keep --out new.parquet": "episodes must be at least 1; got 0",
}


def test_senses_in_a_configuration_that_a_driver_does_not_have_are_told_of(rail_sumo, tmp_path):
    (tmp_path / "rays.toml").write_text("[lidar]\nn_rays = 36\n[episode]\nduration_s = 5.0\n")
    code, _, err = rail_sumo("eval", "rail", "rule", "--config", "rays.toml", "--episodes", "1", "--out", "out")
    assert code == 0
    told = "'rail' keeps the senses that it was trained with: without effect on it is lidar.n_rays"
    assert told in err
    assert "'rule'" not in err
    assert told in json.loads((tmp_path / "out" / "evaluation.json").read_text())["notes"]


@pytest.mark.parametrize("arguments", BAD)
def test_bad_input_is_one_clear_line_and_exit_2(arguments, rail_sumo, tmp_path):
    lay_out(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    code, out, err = rail_sumo(*arguments.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"rail-sumo: {BAD[arguments]}")
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


MISUSED = {
    "evl keep": "no such command 'evl'. Did you mean 'eval'; see --help",
    "eval": "missing argument 'POLICY...'; see --help",
    "eval keep --episodes few": "invalid value for '--episodes': ",
    "eval keep --episodes": "option '--episodes' requires an argument; see --help",
    "eval keep --epsodes 3": "no such option: --epsodes (Possible options: --episodes); see --help",
}


@pytest.mark.parametrize("arguments", MISUSED)
def test_a_mistyped_command_is_one_line_and_exit_2(arguments, rail_sumo):
    code, out, err = rail_sumo(*arguments.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"rail-sumo: {MISUSED[arguments]}")
    assert err.count("\n") == 1


def test_without_a_command_the_help_is_printed(rail_sumo):
    code, out, err = rail_sumo()
    assert (code, err) == (2, "")
    assert "Usage: rail-sumo" in out


def test_our_own_mistakes_keep_their_traceback(rail_sumo, monkeypatch):
    monkeypatch.setattr(run, "evaluate", lambda *arguments, **named: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        rail_sumo("eval", "keep", *SHORT)


def test_eval_and_replay_drive_in_the_world_of_a_toml_changed_by_options(rail_sumo, tmp_path):
    (tmp_path / "mine.toml").write_text('[network]\nfile = "highway3"\n[episode]\nduration_s = 9.0\n')
    few = ("--config", "mine.toml", "--set", "episode.duration_s=5.0")
    assert rail_sumo("eval", "keep", "--episodes", "1", "--out", "out", *few)[0] == 0
    episodes = pd.read_csv(tmp_path / "out" / "episodes.csv")
    assert (episodes.loc[0, "network"], episodes.loc[0, "duration_s"]) == ("highway3", 5.0)
    assert rail_sumo("replay", "keep", "--out", "page.html", *few)[0] == 0
    assert '"highway3"' in (tmp_path / "page.html").read_text()


def test_a_sumocfg_without_a_demand_is_told_to_drive_in_made_traffic(rail_sumo, tmp_path):
    (tmp_path / "my.net.xml").write_bytes(assets.network("highway3").read_bytes())
    (tmp_path / "my.sumocfg").write_text('<configuration><net-file value="my.net.xml"/></configuration>')
    note = "rail-sumo: 'my.sumocfg' names no route-files: traffic is made around the host\n"
    assert rail_sumo("network", "check", "my.sumocfg")[2] == note
    demand = str(assets.routes("highway3"))
    assert rail_sumo("network", "check", "my.sumocfg", "--routes", demand)[2] == ""


def test_eval_prints_a_row_per_policy_and_writes_the_tables(rail_sumo, tmp_path):
    code, out, err = rail_sumo("eval", "keep", "rule", "--episodes", "2", "--out", "out", *SHORT)
    assert code == 0, err
    table = out.partition("means over")[0].splitlines()
    assert [line.split()[0] for line in table if line.strip().startswith(("keep", "rule"))] == ["keep", "rule"]
    assert max(map(len, out.splitlines())) <= 100
    written = {"episodes.csv", "episodes.parquet", "summary.csv", "summary.parquet"}
    written |= {"decisions.parquet", "world.toml", "evaluation.json"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == written
    episodes = pd.read_csv(tmp_path / "out" / "episodes.csv")
    assert list(episodes["policy"]) == ["keep", "keep", "rule", "rule"]
    assert set(episodes["duration_s"][:2]) == {5.0}


PARKED = """<routes><route id="r" edges="highway"/>
<vehicle id="parked" depart="0" route="r" departLane="0"><stop lane="highway_0" endPos="400" duration="9999"/></vehicle>
<vehicle id="me" depart="9" route="r" departLane="0"/></routes>"""


def test_under_its_table_eval_tells_which_episodes_stood_still(rail_sumo, tmp_path):
    (tmp_path / "parked.rou.xml").write_text(PARKED)
    behind = ("--network", "highway3", "--routes", "parked.rou.xml", "--set", "traffic.host=me")
    code, out, err = rail_sumo("eval", "keep", "--episodes", "2", "--workers", "1", *behind)
    assert code == 0, err
    assert out.splitlines()[-1] == "keep: 2 of 2 episodes ended at a standstill"


def test_floating_car_data_lie_beside_the_tables_that_tell_of_the_same_drives(rail_sumo, tmp_path):
    assert rail_sumo("eval", "keep", "rule", "--episodes", "1", "--out", "out", "--fcd", *SHORT)[0] == 0
    assert {path.name for path in (tmp_path / "out" / "fcd").iterdir()} == {"policy=keep", "policy=rule"}
    before = (tmp_path / "out" / "episodes.csv").read_bytes()
    code, _, err = rail_sumo("eval", "keep", "--episodes", "1", "--out", "out", "--overwrite", *SHORT)
    assert (code, err) == (
        2,
        "rail-sumo: 'out/fcd' is of other drives than these; replace it by --fcd, or choose another --out\n",
    )
    assert (tmp_path / "out" / "episodes.csv").read_bytes() == before
    assert rail_sumo("eval", "keep", "--episodes", "1", "--out", "out", "--overwrite", "--fcd", *SHORT)[0] == 0
    assert {path.name for path in (tmp_path / "out" / "fcd").iterdir()} == {"policy=keep"}
    assert pd.read_csv(tmp_path / "out" / "episodes.csv")["policy"].tolist() == ["keep"]


def test_tables_go_into_the_folder_one_is_in(rail_sumo, tmp_path):
    assert rail_sumo("eval", "keep", "--episodes", "1", "--out", ".", "--overwrite", *SHORT)[0] == 0
    assert (tmp_path / "episodes.csv").exists()


@pytest.fixture
def world_of(rail_sumo, monkeypatch):
    """A function that returns the world a command line asks for, before anybody drives in it."""
    worlds = []
    load = config_file.load

    def look_and_stop(path=None, overrides=()):
        worlds.append(load(path, overrides))
        raise InputError("seen enough")

    def ask(*command):
        monkeypatch.setattr(config_file, "load", look_and_stop)
        assert rail_sumo(*command) == (2, "", "rail-sumo: seen enough\n")
        return worlds.pop()

    return ask


@pytest.mark.parametrize(
    "command",
    ["train", "eval keep", "expert train", "expert record --out new.parquet", "reproduce table1", "reproduce figures"],
)
def test_whatever_drives_takes_a_network_and_a_demand(world_of, command):
    options = ("--network", "highway3", "--routes", "highway3", "--routes", "my.rou.xml", "--set", "traffic.begin_s=5")
    world = world_of(*command.split(), *options)
    assert world.network.file == "highway3"
    assert world.traffic.routes == ("highway3", "my.rou.xml")
    assert world.traffic.begin_s == 5.0


def test_a_sumocfg_brings_its_network_demand_and_options_and_what_is_ours_is_told_once(rail_sumo, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "my.net.xml").write_bytes(assets.network("highway3").read_bytes())
    (tmp_path / "a" / "my.rou.xml").write_bytes(assets.routes("highway3").read_bytes())
    options = '<n value="my.net.xml"/><r value="my.rou.xml"/><begin value="0:02:00"/><scale v="0.5"/>'
    options += '<end v="9"/><step-length v="1"/>'
    (tmp_path / "a" / "my.sumocfg").write_text(f"<configuration>{options}</configuration>")
    note = "rail-sumo: does not use these options of 'a/my.sumocfg', and sets them itself: "
    note += "end 9, step-length 1; steps take 0.1 s; traffic here may differ from that of your own runs with them, see "
    note += "docs/roads.md\n"
    code, printed, err = rail_sumo("config", "--network", "a/my.sumocfg")
    (tmp_path / "read.toml").write_text(printed)
    world = config_file.load(tmp_path / "read.toml")
    assert (world.network.file, world.traffic.routes) == ("a/my.net.xml", ("a/my.rou.xml",))
    assert (world.traffic.begin_s, code, err) == (120.0, 0, note)
    assert world.traffic.options == ("scale=0.5",)
    code, out, err = rail_sumo("network", "check", "a/my.sumocfg")
    told = "my: road of 8,200 m with 3 lanes\nedges: highway\nlimit: 80 km/h\nhost of the first episode: 'follow."
    assert (code, err) == (0, note)
    assert out.startswith(told)
    as_ours = options.replace('<end v="9"/><step-length v="1"/>', '<step-length v="0.10"/><threads v="1"/>')
    as_ours += '<lateral-resolution v="0"/><lanechange.duration v="0:00:00"/><step-method.ballistic v="false"/>'
    (tmp_path / "a" / "my.sumocfg").write_text(f"<configuration>{as_ours}</configuration>")
    assert rail_sumo("config", "--network", "a/my.sumocfg")[2] == ""
    others = ("--routes", "highway3", "--set", "traffic.begin_s=9")
    assert 'routes = [\n    "highway3",\n]' in rail_sumo("config", "--network", "a/my.sumocfg", *others)[1]
    assert "begin_s = 9.0" in rail_sumo("config", "--network", "a/my.sumocfg", *others)[1]


def test_what_the_command_line_takes_from_a_sumocfg_is_told(rail_sumo, tmp_path):
    for kind, name in ((assets.network, "my.net.xml"), (assets.routes, "my.rou.xml")):
        (tmp_path / name).write_bytes(kind("highway3").read_bytes())
    for name in ("signals.add.xml", "works.add.xml"):
        (tmp_path / name).write_text("<additional/>")
    options = '<n value="my.net.xml"/><r value="my.rou.xml"/><a value="signals.add.xml"/><scale v="0.5"/>'
    options += '<step-length v="0.1"/><time-to-teleport v="120"/>'
    (tmp_path / "my.sumocfg").write_text(f"<configuration>{options}</configuration>")

    def told(*more):
        code, _, err = rail_sumo("config", "--network", "my.sumocfg", *more)
        assert code == 0
        return err

    assert told() == told("--set", "traffic.begin_s=9", "--set", "traffic.scale=2.0") == ""
    place = "on the command line takes the place of what 'my.sumocfg' says, and without effect is"
    additional = told("--set", 'traffic.additional=["works.add.xml"]')
    assert additional == f"rail-sumo: traffic.additional {place} signals.add.xml; to keep that, name it too\n"
    assert told("--set", 'traffic.additional=["works.add.xml", "signals.add.xml"]') == ""
    assert f"traffic.options {place} scale=0.5; to" in told("--set", 'traffic.options=["time-to-teleport=120"]')
    assert f"traffic.routes {place} my.rou.xml; to" in told("--routes", "highway3")
    arguments = ("--routes", "highway3", "--episodes", "1", "--set", "episode.duration_s=5", "--out", "out")
    rail_sumo("eval", "keep", "--network", "my.sumocfg", *arguments)
    notes = json.loads((tmp_path / "out" / "evaluation.json").read_text())["notes"]
    assert notes[0] == f"traffic.routes {place} my.rou.xml; to keep that, name it too"


def test_what_an_evaluation_tells_is_kept_beside_its_tables(rail_sumo, tmp_path):
    path = tmp_path / "one.rou.xml"
    cars = "".join(f'<vehicle id="v{at}" type="slow" depart="{at}" route="on"/>' for at in (50, 40))
    slow = '<vType id="slow" maxSpeed="5"/><route id="on" edges="highway"/>'
    path.write_text(f"<routes>{slow}{cars}</routes>")
    (tmp_path / "one.net.xml").write_bytes(assets.network("highway3").read_bytes())
    options = '<n v="one.net.xml"/><r v="one.rou.xml"/><step-length v="1"/>'
    (tmp_path / "one.sumocfg").write_text(f"<configuration>{options}</configuration>")
    arguments = ("--network", "one.sumocfg", "--episodes", "2", "--set", "episode.duration_s=5", "--out", "out")
    code, out, err = rail_sumo("eval", "keep", "rule", *arguments)
    assert code == 0
    unused, *notes = json.loads((tmp_path / "out" / "evaluation.json").read_text())["notes"]
    assert unused.startswith(
        "rail-sumo does not use these options of 'one.sumocfg', and sets them itself: step-length 1"
    )
    assert unused.endswith("traffic here may differ from that of your own runs with them, see docs/roads.md")
    assert "demand 'one.rou.xml' is not in order of departure: 'v40' may enter late or never" in notes[0]
    assert notes[1].startswith("every episode drives the same car")
    assert notes[2:] == report.alike(pd.read_parquet(tmp_path / "out" / "episodes.parquet")) != []
    assert all(note in err + out for note in notes)
    assert not any("done" in note for note in notes)  # how far it is


def test_a_file_that_a_sumocfg_names_and_is_not_there_is_told_with_it_unless_another_is_given(rail_sumo, tmp_path):
    (tmp_path / "a").mkdir()
    network = assets.network("highway3")
    options = f'<net-file value="{network}"/><route-files value="lost.rou.xml"/><end value="9"/>'
    (tmp_path / "a" / "my.sumocfg").write_text(f"<configuration>{options}</configuration>")
    told = "rail-sumo: 'a/my.sumocfg' names 'a/lost.rou.xml', which does not exist; correct it, or set traffic.routes"
    for command in (("network", "check"), ("eval", "keep", "--network")):
        code, _, err = rail_sumo(*command, "a/my.sumocfg")
        assert (code, err.strip()) == (2, f"{told} by --set")
    for instead in (("--routes", "highway3"), ("--set", 'traffic.routes=["highway3"]')):
        code, out, _ = rail_sumo("config", "--network", "a/my.sumocfg", *instead)
        assert code == 0
        assert "highway3" in out


def test_check_tells_the_edges_and_where_the_road_ends_too_soon(rail_sumo):
    assert rail_sumo("network", "check", "highway5")[1] == (
        "highway5: road of 8,200 m with 5 lanes\nedges: highway\nlimit: 80 km/h\n"
    )
    longer = ("--set", "episode.course_m=8000")
    assert rail_sumo("network", "check", "highway5", *longer)[1].splitlines()[3] == (
        "warning: the road ends 7928 m after the host's start, and so will episodes of up to 8000 m; "
        "set episode.course_m to 7927 or less"
    )
    timed = ("--set", "episode.course_m=inf", "--set")
    assert "warning" not in rail_sumo("network", "check", "highway5", *timed, "episode.duration_s=300")[1]
    assert "episodes of up to 8000 m;" in rail_sumo("network", "check", "highway5", *timed, "episode.duration_s=360")[1]
    demanding = ("--set", "traffic.behind_m=2000", "--set", "episode.course_m=7000")
    assert "warning" in rail_sumo("network", "check", "highway5", *demanding)[1]
    with_routes = rail_sumo("network", "check", "highway5", "--routes", "highway5", *demanding)[1]
    assert with_routes.splitlines()[-1] == "warning: traffic.behind_m: of made traffic, without effect on a demand"
    assert with_routes.count("warning") == 1


@pytest.fixture
def a_run(tmp_path):
    """A run directory of one iteration, started with other than the default configuration."""
    shape = Shape(48, 1)
    clone = PolicyParameters(np.zeros(shape.size), shape, Whitening(np.zeros(48), np.ones(48)))
    started = RunDirectory.create(tmp_path / "mine", config_file.load(None, ["search.noise_std=0.07"]), 4, {}, clone)
    started.save(Checkpoint(clone, {}, (dict.fromkeys(PROGRESS_COLUMNS, 1.0),)))


def test_resumed_with_an_override_the_rest_of_the_configuration_is_the_runs(rail_sumo, monkeypatch, a_run):
    def train(chosen, out, *, seed, resume, **named):
        assert (chosen.search.noise_std, chosen.train.iterations, seed, resume) == (0.07, 500, 4, True)
        raise InputError("come so far")

    monkeypatch.setattr(run, "train", train)
    code, _, err = rail_sumo("train", "--out", "mine", "--resume", "--set", "train.iterations=500")
    assert (code, err) == (2, "rail-sumo: come so far\n")


def test_learning_curves_are_drawn_once(rail_sumo, tmp_path, a_run):
    assert rail_sumo("plot", "mine", "--out", "curves.svg") == (0, "learning curves in curves.svg\n", "")
    assert (tmp_path / "curves.svg").read_text().startswith("<?xml")
    code, _, err = rail_sumo("plot", "mine", "--out", "curves.svg")
    assert code == 2
    assert err.startswith("rail-sumo: output file 'curves.svg' exists; choose another")


def test_interrupted_training_says_how_to_go_on(rail_sumo, monkeypatch, tmp_path):
    def interrupted(chosen, out, **named):
        out.mkdir(parents=True)
        (out / "config.toml").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "train", interrupted)
    code, _, err = rail_sumo("train", "--seed", "3")
    assert code == 130
    hint = "rail-sumo: interrupted; go on with: rail-sumo train --out runs/default-seed3 --resume"
    assert err.splitlines()[-1] == hint


def test_a_drivers_name_is_no_emoji(capsys):
    episode = {"policy": "sumo:truck", "end_reason": "standstill"} | dict.fromkeys(records.METRICS, 1.0)
    driven = report.episodes([episode | {"episode": number, "seed": number} for number in range(2)])
    progress.show(run.Tables(driven, report.summary(driven), pd.DataFrame()), None)
    said = capsys.readouterr().out
    assert "sumo:truck: 2 of 2 episodes ended at a standstill" in said
    assert said.count("sumo:truck") == 2


def ctrl_c():
    raise KeyboardInterrupt  # SIGINT itself is not heard in a process of pytest-xdist's


def sigterm():
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.parametrize(
    ("stop", "n_done", "rows"),
    [
        (ctrl_c, 3, [0, 3]),  # one episode of each: neither waits until the other has driven all, ...
        (sigterm, 4, [0, 1, 3, 4]),
        (ctrl_c, 1, [0]),  # ... and means are over the same episodes, if there are any that both have driven
    ],
)
def test_interrupted_evaluation_leaves_the_tables_of_what_all_have_done(
    rail_sumo, monkeypatch, tmp_path, stop, n_done, rows
):
    drive, driven = rollout.drive, []

    def drive_until(task):
        driven.append(task)
        if len(driven) == n_done + 1:
            stop()
        return drive(task)

    monkeypatch.setattr(rollout, "drive", drive_until)
    arguments = ("eval", "keep", "rule", "--episodes", "3", "--out", "out", *SHORT)
    code, out, err = rail_sumo(*arguments)
    after = f"after {len(rows)} of 6 episodes"
    assert (code, err.splitlines()[-1]) == (130, f"rail-sumo: interrupted {after}")
    assert "tables in out" in out
    about = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert about["interrupted"] == after
    kept = pd.read_csv(tmp_path / "out" / "episodes.csv")
    monkeypatch.setattr(rollout, "drive", drive)
    assert rail_sumo(*arguments, "--overwrite")[0] == 0
    whole = pd.read_csv(tmp_path / "out" / "episodes.csv")
    assert "interrupted" not in json.loads((tmp_path / "out" / "evaluation.json").read_text())
    pd.testing.assert_frame_equal(kept, whole.iloc[rows].reset_index(drop=True))


STUBBORN = """
import sys, time
from rail_sumo import cli

def stubborn(standalone_mode):
    for _ in range(2):
        try:
            print("at it", flush=True)
            time.sleep(60.0)
        except KeyboardInterrupt:
            pass

cli.app = stubborn
cli.main()
"""


@contextmanager
def running(*arguments, **options):
    with subprocess.Popen([sys.executable, *arguments], text=True, **options) as program:
        try:
            yield program
        finally:
            program.kill()


def test_a_second_interrupt_that_comes_later_ends_the_program_at_once():
    with running("-c", STUBBORN, stdout=subprocess.PIPE) as program:
        assert program.stdout.readline()
        for _ in range(2):  # as `timeout` sends it: both are the first
            program.send_signal(signal.SIGTERM)
        assert program.stdout.readline()
        time.sleep(1.1)
        assert program.poll() is None
        program.send_signal(signal.SIGTERM)
        assert program.wait(10.0) == 130


def test_a_sweep_that_is_told_twice_to_end_does(tmp_path):
    sweep = "sweep share 1 --driver keep --network highway2 --routes highway2 --seeds 500 --duration 5 --workers 2"
    command = ("-m", "rail_sumo", *sweep.split(), "--out", "share")
    with running(*command, cwd=tmp_path, stderr=subprocess.PIPE) as program:
        since = time.monotonic()
        while len(list(tmp_path.glob("share/cells/*"))) < 3:
            assert time.monotonic() < since + 60.0
            time.sleep(0.01)
        for _ in range(2):
            program.send_signal(signal.SIGTERM)
        _, told = program.communicate(timeout=60.0)
    assert program.returncode == 130
    assert "Traceback" not in told, told
    assert told.splitlines()[-1].startswith("rail-sumo: interrupted; the same command goes on")
    assert "Traceback" not in told


def test_networks_are_listed_with_their_length_and_lanes(rail_sumo):
    code, out, _ = rail_sumo("network", "list")
    assert code == 0
    assert "highway5: road of 8,200 m with 5 lanes" in out
    assert "ring5: loop of " in out


@pytest.mark.parametrize(
    ("command", "module", "function"),
    [
        ("eval keep", run, "evaluate"),
        ("train", run, "train"),
        ("expert record --out o.parquet", run, "demonstrate"),
        ("expert train", expert, "train"),
    ],
)
def test_the_seed_arrives(rail_sumo, monkeypatch, command, module, function):
    def look(*_, seed, **__):
        raise InputError(f"the seed is {seed}")

    monkeypatch.setattr(module, function, look)
    assert rail_sumo(*command.split(), "--seed", "5") == (2, "", "rail-sumo: the seed is 5\n")
    assert rail_sumo(*command.split()) == (2, "", "rail-sumo: the seed is 0\n")


def test_of_two_that_name_a_network_the_override_counts(world_of):
    world = world_of("eval", "keep", "--network", "highway3", "--set", "network.file=ring5")
    assert world.network.file == "ring5"


def test_the_configuration_printed_is_one_to_start_from(rail_sumo, tmp_path):
    code, printed, _ = rail_sumo("config", "--set", "policy.layers=1", "--network", "ring5")
    assert code == 0
    (tmp_path / "mine.toml").write_text(printed)
    assert config_file.load(tmp_path / "mine.toml") == config_file.load(None, ["policy.layers=1", "network.file=ring5"])
    assert rail_sumo("config", "mine.toml") == (0, printed, "")


def test_the_versions_are_told():
    told = subprocess.run([sys.executable, "-m", "rail_sumo", "--version"], check=True, capture_output=True, text=True)
    assert told.stdout == f"rail-sumo {version('rail-sumo')} with SUMO {version('libsumo')}\n"


def test_help_and_rollout_workers_import_nothing_slow():
    slow = "{'torch', 'pandas', 'libsumo', 'scipy', 'numba'} & set(sys.modules)"
    code = f"import sys; from rail_sumo import cli; sys.exit(bool({slow}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_where_nobody_watches_a_terminal_a_line_tells_how_far_work_is(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.0)
    with progress.progress_bars() as bars:
        bars.start("eval", 3)
        bars.advance({"speed_kmh": 71.26, "lane_changes": 12.0})
        bars.advance({})
    assert capsys.readouterr().err.splitlines() == [
        "rail-sumo: eval: 1 of 3 done, about 1 min left, 71.3 km/h, 12.0 changes",
        "rail-sumo: eval: 2 of 3 done, about 1 min left",
    ]
    monkeypatch.setattr(progress, "LINE_EVERY_S", 60.0)
    with progress.progress_bars() as bars:
        bars.start("eval", 3)
        bars.advance({})
    assert capsys.readouterr().err == ""


def test_who_was_told_how_far_work_is_is_told_that_it_is_done(capsys, monkeypatch):
    with progress.progress_bars() as bars:
        bars.start("eval", 3)
        for is_due in (True, False, False):
            monkeypatch.setattr(progress, "LINE_EVERY_S", 0.0 if is_due else 60.0)
            bars.advance({})
        bars.start("record", 1)
        bars.advance({})
    assert capsys.readouterr().err.splitlines() == [
        "rail-sumo: eval: 1 of 3 done, about 1 min left",
        "rail-sumo: eval: 3 of 3 done",
    ]


def test_the_time_left_is_told_by_the_pace_of_this_run_alone(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.0)
    clock = SimpleNamespace(now_s=0.0, monotonic=lambda: clock.now_s)
    monkeypatch.setattr(progress, "time", clock)
    with progress.progress_bars() as bars:
        bars.start("share", 130, done=100)
        for clock.now_s in (90.0, 100.0):
            bars.advance({})
    assert capsys.readouterr().err.splitlines() == [
        "rail-sumo: share: 101 of 130 done, about 44 min left",
        "rail-sumo: share: 102 of 130 done, about 24 min left",
    ]


@pytest.mark.parametrize(("is_needed", "code"), [(True, 1), (False, 0)])
def test_the_doctor_exits_with_1_where_something_needed_is_amiss(rail_sumo, monkeypatch, is_needed, code):
    found = doctor.Finding("numpy", "not installed", "pip install rail-sumo", is_needed)
    monkeypatch.setattr(doctor, "examine", lambda: iter([found]))
    closing = "" if is_needed else "Nothing is amiss; what is not installed is for extras alone.\n"
    told = f"{'numpy':32} not installed  -> pip install rail-sumo\n{closing}"
    assert rail_sumo("doctor") == (code, told, "")
