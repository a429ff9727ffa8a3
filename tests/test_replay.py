import re
import shutil

import pandas as pd
import pytest
from driving import assert_same

from rail_sumo import assets, config_file, replay, roster
from rail_sumo.errors import InputError
from rail_sumo.pictures import page
from rail_sumo.rollout import EVALUATION, Task, drive, traffic_seed

BRIEF = ["episode.duration_s=15.0"]


@pytest.fixture
def shown(monkeypatch):
    """What pages are made of, in the order in which they are written."""
    pages = []
    write = page.write

    def keep(ground, films, file, **named):
        pages.append((ground, films, named))
        write(ground, films, file, **named)

    monkeypatch.setattr(page, "write", keep)
    return pages


def test_a_replay_is_of_the_very_episode_that_the_table_tells_of(tmp_path, shown):
    world = config_file.load(None, BRIEF)
    who = {name: roster.find_driver(name, world) for name in ("rail", "random")}
    driven = replay.write(who, world, tmp_path / "two.html", seed=3, episode=1, judges=roster.judges_of(who))
    for name, trajectory in zip(who, driven, strict=True):
        assert_same(trajectory, drive(Task(who[name], world, traffic_seed(3, EVALUATION, 1))))
    [(_, films, named)] = shown
    assert [film.name for film in films] == ["rail", "random"]
    assert named["about"]["traffic seed"] == str(driven[0].seed)
    judged = [one.judged for one in films[0].driven.decisions]
    assert len(judged) == len(driven[0].decisions)
    assert all(0.0 <= score <= 1.0 for score in judged)
    assert len(set(judged)) > 1
    assert {one.judged for one in films[1].driven.decisions} == {None}  # nobody judges chance
    assert "</html>" in (tmp_path / "two.html").read_text()


def test_where_worlds_vary_the_ground_is_of_the_network_that_was_drawn(tmp_path, shown):
    world = config_file.load(None, [*BRIEF, 'varied.networks=["highway2", "highway6"]'])
    for episode in range(6):
        [trajectory] = replay.write({"keep": "keep"}, world, tmp_path / f"{episode}.html", seed=0, episode=episode)
        assert shown[-1][0].name == trajectory.network
    assert {ground.name for ground, _, _ in shown} == {"highway2", "highway6"}


def test_three_side_by_side_are_too_many_and_a_page_that_exists_is_kept(tmp_path):
    world = config_file.load(None, BRIEF)
    with pytest.raises(InputError, match="shows one driver, or two side by side; got 3: keep, rule, random"):
        replay.write({name: name for name in ("keep", "rule", "random")}, world, tmp_path / "out.html", seed=0)
    kept = tmp_path / "kept.html"
    kept.write_text("mine")
    with pytest.raises(InputError, match=re.escape(f"output file '{kept}' exists")):
        replay.write({"keep": "keep"}, world, kept, seed=0)
    assert kept.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [kept]


def figures(**columns):
    even = {"collisions": 0, "struck": 0, "hardest_braking_mps2": 2.0, "speed_kmh": 70.0}
    rows = len(next(iter(columns.values())))
    return pd.DataFrame({"policy": ["a"] * rows, "episode": range(rows)} | even | columns)


def test_the_most_telling_episodes_are_contacts_then_hard_brakings_then_the_slowest_and_the_fastest():
    table = figures(
        struck=[0, 0, 1, 0, 0, 0],
        hardest_braking_mps2=[1.0, 9.0, 8.0, 2.0, 2.0, 2.0],
        speed_kmh=[70.0, 71.0, 72.0, 40.0, 80.0, 50.0],
    )
    order = [episode for _, episode in replay.most_telling(table, 6)]
    assert order == [2, 1, 3, 4, 5, 0]
    assert replay.most_telling(table, 2) == [("a", 2), ("a", 1)]
    assert replay.most_telling(table, 0) == []


def test_an_episode_that_nobody_drove_is_not_telling():
    table = figures(speed_kmh=[None, 60.0])
    assert replay.most_telling(table, 5) == [("a", 1)]


def test_pages_have_names_that_a_browser_opens_and_none_replaces_another(monkeypatch, tmp_path):
    monkeypatch.setattr(replay, "write", lambda policies, world, page, **named: page.touch())
    who = dict.fromkeys(("sumo:truck", "sumo-truck", "../runs/a b"), "keep")
    table = pd.concat([figures(speed_kmh=[60.0]).assign(policy=name) for name in who])
    pages = replay.write_most_telling(table, who, {}, config_file.load(None), tmp_path, seed=0, number=3)
    assert {page.name for page in pages} == {"sumo-truck-0.html", "sumo-truck-1-0.html", "runs-a-b-0.html"}


def test_eval_writes_them_beside_its_tables(rail_sumo, tmp_path):
    short = ["--set", "episode.duration_s=5.0"]
    code, _, err = rail_sumo("eval", "keep", "rule", "--episodes", "2", "--out", "out", "--replay", "3", *short)
    assert code == 0, err
    pages = sorted((tmp_path / "out" / "replays").iterdir())
    assert len(pages) == 3
    assert all(re.fullmatch(r"(keep|rule)-[01]\.html", one.name) for one in pages)
    code, _, err = rail_sumo("eval", "keep", "--episodes", "1", "--out", "out", "--overwrite", *short)
    assert (code, err) == (
        2,
        "rail-sumo: 'out/replays' is of other drives than these; replace it by --replay, or choose another --out\n",
    )


def test_a_driver_may_go_by_any_name_on_the_page(tmp_path, shown):
    world = config_file.load(None, BRIEF)
    replay.write({"my driver": roster.find_driver("rail", world)}, world, tmp_path / "page.html", seed=0)
    assert shown[0][1][0].name == "my driver"


@pytest.mark.parametrize("trouble", [KeyboardInterrupt, InputError("SUMO stopped")])
def test_whatever_happens_while_pages_are_made_the_tables_are_kept(rail_sumo, tmp_path, monkeypatch, trouble):
    def stops(task):
        raise trouble

    monkeypatch.setattr("rail_sumo.rollout.film", stops)
    words = ["eval", "keep", "--episodes", "2", "--out", "out", "--replay", "1", "--set", "episode.duration_s=5.0"]
    code, _, err = rail_sumo(*words)
    assert (code, err.count("\n")) == ((130, 1) if trouble is KeyboardInterrupt else (2, 1))
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"episodes.csv", "summary.csv", "decisions.parquet", "evaluation.json"} <= written
    assert "replays" not in written


def test_pages_of_earlier_drives_do_not_stay_beside_new_tables(rail_sumo, tmp_path, monkeypatch):
    words = ["eval", "keep", "--episodes", "1", "--out", "out", "--replay", "1", "--set", "episode.duration_s=5.0"]
    assert rail_sumo(*words)[0] == 0
    assert len(list((tmp_path / "out" / "replays").iterdir())) == 1

    def stops(task):
        raise KeyboardInterrupt

    monkeypatch.setattr("rail_sumo.rollout.film", stops)
    assert rail_sumo(*words, "--seed", "7", "--overwrite")[0] == 130
    assert not (tmp_path / "out" / "replays").exists()


def test_an_evaluation_may_be_written_beside_an_expert_without_harm(rail_sumo, tmp_path):
    shutil.copytree(assets.expert_folder("shipped"), tmp_path / "exp")
    words = ["eval", "exp", "--episodes", "1", "--set", "episode.duration_s=5.0"]
    assert rail_sumo(*words, "--out", "exp", "--overwrite")[0] == 0
    assert rail_sumo(*words)[0] == 0  # it still drives


MISTAKES = {
    "replay keep --out page.txt": "a replay is a page, FILE.html; got 'page.txt'",
    "replay nobody": "policy 'nobody' is neither a run directory nor a driver",
    "replay keep rule random": "a replay shows one driver, or two side by side; got 3",
    "replay keep --begin 5": "--begin and --end cut floating-car data",
    "replay fcd.csv": "floating-car data do not hold the road; name their network by --network",
    "replay fcd.csv --network highway5 --routes highway5": "floating-car data are shown as they are",
    "replay fcd.csv --network highway5": "'fcd.csv' has no vehicles in it",
    "replay lost.parquet --network highway5": "floating-car data 'lost.parquet' do not exist",
    "replay fcd.csv fcd.csv --network highway5": "one file of floating-car data is shown at a time",
    "replay keep keep": "each policy is driven once; named twice: keep",
    "eval rule keep rule": "each policy is driven once; named twice: rule",
    "eval keep --replay 2": "--replay writes into the folder of --out; name one",
}


@pytest.mark.parametrize("command", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(rail_sumo, tmp_path, command):
    (tmp_path / "fcd.csv").write_text(
        "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_speed\n0;;;;;\n"
    )
    code, out, err = rail_sumo(*command.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"rail-sumo: {MISTAKES[command]}")
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["fcd.csv"]


def test_any_sumo_run_becomes_a_page(rail_sumo, tmp_path, shown):
    rows = "".join(f"{t};a;{500 + 25 * t};0;90;25\n" for t in range(4))
    (tmp_path / "fcd.csv").write_text(
        f"timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_speed\n{rows}"
    )
    code, out, err = rail_sumo("replay", "fcd.csv", "--network", "highway5", "--begin", "1", "--out", "own.html")
    assert (code, err) == (0, "")
    assert "own.html" in out
    [(ground, [film], _)] = shown
    assert (film.n_frames, film.start_s, ground.name) == (3, 1.0, "highway5")
    assert (tmp_path / "own.html").stat().st_size > 10_000
