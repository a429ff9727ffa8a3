import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rail_sumo import assets, config_file, origin, roster, run
from rail_sumo.config import OF_LEARNING
from rail_sumo.errors import InputError
from rail_sumo.pictures import plot_episodes, report_page
from rail_sumo.run_directory import RunDirectory
from rail_sumo.tables import report
from rail_sumo.tables.shares import DIFFERENCE_COLUMNS, HEADINGS, SUMMARY_COLUMNS, rates

BRIEF = ["episode.duration_s=10.0", "traffic.vehicles=30"]


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    """An evaluation's folder, one of its drivers with a name that is no innocent HTML."""
    folder = tmp_path_factory.mktemp("evaluations") / "mine"
    world = config_file.load(None, BRIEF)
    who = {"expert": roster.find_driver("expert", world), "<b>&random": "random"}
    tables = run.evaluate(who, world, episodes=3, seed=0)
    tables.write(folder)
    origin.describe(folder, world, "rail-sumo eval expert '<b>&random'", seed=0)
    return folder, tables


def rows_of(page, after):
    """The cells of the first table after a heading, row by row: (what sorting goes by, text)."""
    table = page[page.index(f"<h3>{after}</h3>") :].split("</table>")[0]
    return [
        [
            (sortable or text, text)
            for sortable, text in re.findall(r'<td(?: data-value="([^"]*)")?[^>]*>(.*?)</td>', row)
        ]
        for row in re.findall(r"<tr>(.*?)</tr>", table.split("<tbody>")[1], re.DOTALL)
    ]


def test_the_page_holds_every_mean_interval_and_ratio_of_the_summary(evaluation, tmp_path):
    folder, tables = evaluation
    report_page.write([folder], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    told = {row[0][0]: row[1:] for row in rows_of(page, "Evaluation")}
    for metric, by_policy in tables.summary.groupby("metric"):
        if metric in report.CONTACTS:
            continue
        by_policy = by_policy.set_index("policy")
        mean, other, ratio = told[metric][0], told[metric][1], told[metric][2]
        assert float(mean[0]) == by_policy.loc["expert", "mean"]
        assert float(other[0]) == by_policy.loc["<b>&random", "mean"]
        low, high = by_policy.loc["expert", ["low", "high"]]
        assert (f"{low:.4g} to {high:.4g}" in mean[1]) == (low < high)
        assert ("± 0, the same in all" in mean[1]) == (low == high)
        if np.isfinite(by_policy.loc["<b>&random", "ratio"]):
            assert float(ratio[0]) == by_policy.loc["<b>&random", "ratio"]
    assert html.escape("rail-sumo eval expert '<b>&random'") in page
    assert "<b>" not in page.replace("<body>", "")


def test_an_interval_without_width_is_told_as_such_and_a_narrow_one_has_two_ends(evaluation, tmp_path):
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes} | {"policy": "rule", "overtakes": 211}
    rows = [row | {"episode": k, "distance_m": 8200.125 + 0.001 * k} for k in range(3)]
    episodes = report.episodes(rows)
    report.write(tmp_path / "mine", episodes=episodes, summary=report.summary(episodes))
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    told = {row[0][0]: row[1] for row in rows_of(page, "Evaluation")}
    assert told["overtakes"] == ("211.0", "211<small>± 0, the same in all</small>")
    assert told["distance_m"][1] == "8200<small>8200.12 to 8200.13</small>"  # 8200.126 ± 0.002
    assert not re.search(r"<small>(\S+) to \1</small>", page)


def test_ratios_have_three_decimals_or_as_many_as_an_interval_without_1_takes(evaluation, tmp_path):
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes}
    speeds = {"a": [50.0, 60.0, 70.00001], "b": [50.00001, 60.0, 70.0], "c": [49.99, 59.985, 69.989]}
    rows = [
        row | {"policy": name, "episode": k, "speed_kmh": speed, "distance_m": 100.0 * (1 + (name == "c"))}
        for name, of_policy in speeds.items()
        for k, speed in enumerate(of_policy)
    ]
    episodes = report.episodes(rows)
    report.write(tmp_path / "mine", episodes=episodes, summary=report.summary(episodes, "a"))
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    told = {row[0][0]: row[1:] for row in rows_of((tmp_path / "page.html").read_text(), "Evaluation")}
    assert told["speed_kmh"][2][1] == "1.000<small>1.000 to 1.000</small>"
    assert told["speed_kmh"][4][1] == "0.9998<small>0.9996 to 0.9999</small>"
    assert told["distance_m"][4][1] == "2.000<small>± 0, the same in all</small>"


def test_each_note_of_an_evaluation_is_on_its_page(evaluation, tmp_path):
    _, tables = evaluation
    tables.write(tmp_path / "mine")
    notes = ["all are as fast as each other", "<b>: 1 of 3 episodes"]
    origin.describe(tmp_path / "mine", config_file.load(None, BRIEF), "rail-sumo eval", notes=notes)
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    for note in notes:
        assert f'<tr><td class="words">note</td><td class="words">{html.escape(note)}</td></tr>' in page


def test_the_heading_says_what_each_folder_is(evaluation, tmp_path, monkeypatch):
    folder, _ = evaluation
    report_page.write([folder, assets.driver("road-rail")], tmp_path / "two.html")
    page = (tmp_path / "two.html").read_text()
    told = "Report on mine (evaluation) and road-rail (run)"
    assert f"<title>{told}</title>" in page
    assert f"<h1>{told}</h1>" in page
    assert re.findall("<h2>(.*?)</h2>", page) == ["mine (evaluation)", "road-rail (run)", "Configuration"]
    shutil.copytree(folder, tmp_path / "mine")
    monkeypatch.chdir(tmp_path / "mine")
    for folders, names in (([Path()], ["mine"]), ([Path(), folder], [".", str(folder)])):
        report_page.write(folders, tmp_path / "page.html", overwrite=True)
        headings = re.findall("<h2>(.*?)</h2>", (tmp_path / "page.html").read_text())
        assert headings == [*(f"{name} (evaluation)" for name in names), "Configuration"]


def test_of_contacts_the_page_tells_how_many_episodes_had_one_with_the_interval_of_their_share(evaluation, tmp_path):
    """As a mean of counts (here 5 in 10 episodes) would not go with an interval of a share (of 4 of 10)."""
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes} | {"policy": "rule", "struck": 0}
    rows = [row | {"episode": k, "collisions": count} for k, count in enumerate([0] * 6 + [1, 1, 1, 2])]
    episodes = report.episodes(rows)
    report.write(tmp_path / "mine", episodes=episodes, summary=report.summary(episodes))
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    told = {row[0][0]: row[1:] for row in rows_of(page, "Evaluation")}
    assert told["collisions"] == [("0.4", "4 of 10<small>17 to 69 %</small>")]  # Wilson's, of 4 of 10
    assert told["struck"] == [("0.0", "0 of 10<small>0 to 28 %</small>")]
    assert "Of collisions and struck: in how many episodes there was one, with the 95 % interval of that share." in page


def test_of_a_hundred_decisions_so_many_were_of_each_kind(evaluation, tmp_path):
    folder, tables = evaluation
    report_page.write([folder], tmp_path / "page.html")
    rows = rows_of((tmp_path / "page.html").read_text(), "Decisions")
    assert [row[0][0] for row in rows[:2]] == ["expert, asked", "expert, carried_out"]
    for row in rows:
        policy, how = html.unescape(row[0][0]).rsplit(", ", 1)
        own = tables.decisions[tables.decisions["policy"] == policy]
        for (share, _), action in zip(row[1:], ("keep", "accelerate", "decelerate", "left", "right"), strict=True):
            assert float(share) == pytest.approx(100 * (own[how] == action).mean(), abs=0.051)


def test_the_page_fetches_nothing_and_names_what_differs_from_the_default(evaluation, tmp_path):
    folder, _ = evaluation
    report_page.write([folder, assets.driver("road-rail")], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "://" not in page
    keys = re.findall(r'<td class="words">(\w+\.\w+)</td>', page)
    assert "episode.duration_s" in keys  # the evaluation's
    assert "varied.networks" in keys  # the run's
    assert "lidar.n_rays" not in keys
    assert page.count("<img") == 2 * 1 + 1 + 1  # episodes of both, where lanes were changed, and the run's training
    assert page.count("<section") == 3


def driven_along(x_m, y_m, policies=("rule",)):
    """Decisions along a way, each a lane change, to either side in turns."""
    x_m, y_m = np.asarray(x_m), np.asarray(y_m)
    way = {"distance_m": np.hypot(np.gradient(x_m), np.gradient(y_m)).cumsum(), "x_m": x_m, "y_m": y_m}
    sides = np.where(np.arange(len(x_m)) % 2, "left", "right")
    each = {"time_s": np.arange(len(x_m)) * 1.0, "speed_kmh": 80.0, "asked": sides, "carried_out": sides}
    return pd.concat([pd.DataFrame({"policy": name, "episode": 0, **way, **each}) for name in policies])


TURN = np.linspace(0.0, np.pi / 2, 50)
STRAIGHT = np.linspace(0.0, 1000.0, 50), np.linspace(0.0, 2000.0, 50)  # not along an axis, and 20 m wide below
STRAIGHT[0][::2] += 20.0


@pytest.mark.parametrize(
    ("way", "networks", "has_map"),
    [
        ((500.0 * np.cos(TURN), 500.0 * np.sin(TURN)), ["ring5"] * 2, True),
        (STRAIGHT, ["highway5"] * 2, False),  # it would be a line
        ((500.0 * np.cos(TURN), 500.0 * np.sin(TURN)), ["ring5", "onramp"], False),  # two roads on one map
        (([3.0, 4.0], [5.0, 6.0]), ["highway5"] * 2, False),
    ],
)
def test_lane_changes_are_drawn_on_a_map_where_there_is_one_road_that_is_no_line(
    evaluation, tmp_path, way, networks, has_map
):
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes} | {"policy": "rule"}
    episodes = report.episodes([row | {"episode": k, "network": name} for k, name in enumerate(networks)])
    report.write(tmp_path / "mine", episodes=episodes, summary=report.summary(episodes))
    driven_along(*way).to_parquet(tmp_path / "mine" / report.DECISIONS)
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Where lane changes were begun" in page
    assert ("The same lane changes on the network" in page) == has_map


def test_a_map_shows_every_lane_change_of_every_policy_where_it_began():
    decisions = driven_along(500.0 * np.cos(TURN), 500.0 * np.sin(TURN), policies=list("abcd"))
    drawn = plot_episodes.lane_change_map(decisions)
    maps = [axes for axes in drawn.axes if axes.lines]
    assert [axes.get_title(loc="left") for axes in maps] == list("abcd")
    for axes in maps:
        _, left, right = axes.lines
        assert left.get_xdata() == pytest.approx(500.0 * np.cos(TURN)[1::2])
        assert right.get_ydata() == pytest.approx(500.0 * np.sin(TURN)[::2])


def test_a_sweep_tells_by_type_and_where_vehicles_brake_hard(tmp_path):
    def row(driver, share, vehicles, kind, edge, vehkm, braked):
        about = {"driver": driver, "setting": "", "share": share, "seed": 0, "vehicles": vehicles, "type": kind}
        sums = {"vehicle_s": 40.0 * vehkm, "vehkm": vehkm, "time_loss_s": 3.0 * vehkm, "lane_changes": 0}
        return (
            about
            | {"edge": edge, "n_vehicles": 1}
            | sums
            | {"hard_brakings": braked, "ttc_below_1_5s": 0, "drac_above_3_4": 0, "stops": 0, "stuck": 0}
        )

    edges = pd.DataFrame([
        row("sumo", 0.0, "others", "car", "ramp", 2.0, 1),
        row("sumo", 0.0, "others", "van", "ramp", 2.0, 2),
        row("sumo", 0.5, "driven", "car", "ramp", 2.0, 1),  # the same vehicles once more
        row("rule", 0.5, "driven", "car", "ramp", 1.0, 0),
        row("rule", 0.5, "others", "car", "ramp", 1.0, 1),
        row("rule", 0.5, "others", "car", "calm", 1.0, 0),
    ])  # fmt: skip
    told = rates(edges, ["driver", "share", "type"]).set_index(["driver", "share", "type"])
    assert told["vehkm"].to_dict() == {("sumo", 0.0, "car"): 2.0, ("sumo", 0.0, "van"): 2.0, ("rule", 0.5, "car"): 3.0}
    assert told["speed_kmh"].tolist() == [90.0] * 3
    assert told["time_loss_s_per_km"].tolist() == [3.0] * 3
    assert told["hard_brakings_per_vehkm"].tolist() == pytest.approx([0.5, 1.0, 1 / 3])
    by_type, lost, slow, by_edge = report_page._edges(edges)
    assert by_type.count("<tr>") == 1 + 3
    assert re.findall(r'scope="col" class="\w+">(.*?)<', by_edge) == ["edge", "as they are", "rule at 50%"]
    assert re.findall(r'data-value="(.*?)"', by_edge) == ["0.75", "0.5"]  # on the ramp alone
    assert re.findall(r'data-value="(.*?)"', lost)[:2] == ["3.0", "3.0"]  # most is lost on the ramp
    assert re.findall(r'data-value="(.*?)"', slow)[:2] == ["90.0", "90.0"]
    assert len(list(report_page._edges(edges.assign(hard_brakings=0)))) == 3


def test_a_run_that_was_interrupted_is_told_of(tmp_path):
    done = assets.driver("rail")
    report_page.write([done], tmp_path / "done.html")
    assert "go on with --resume" not in (tmp_path / "done.html").read_text()
    shutil.copytree(done, tmp_path / "run", ignore=shutil.ignore_patterns("manifest.json"))
    config = tmp_path / "run" / "config.toml"
    config.write_text(config.read_text().replace("iterations = 160\n", "iterations = 170\n"))
    report_page.write([tmp_path / "run"], tmp_path / "page.html")
    told = html.escape(f"'{tmp_path / 'run'}' has done 160 of 170 iterations; go on with --resume")
    assert f'<td class="words">{told}</td>' in (tmp_path / "page.html").read_text()


def test_a_sweep_and_a_study_show_their_tables_and_figures(tmp_path):
    sweep, study = tmp_path / "sweep", tmp_path / "study"
    (sweep / "figures").mkdir(parents=True)
    study.mkdir()
    svg = '<svg xmlns="http://www.w3.org/2000/svg"/>'
    for measure in ("co2_g_per_vehkm", "flow_vehph"):
        (sweep / "figures" / f"{measure}.svg").write_text(svg)
    (study / "figure_speed.svg").write_text(svg)
    pd.DataFrame({"share": [0.5]}).to_parquet(sweep / "traffic.parquet")
    (sweep / "sweep.md").write_text("# mine\n\ncaption\n\n| who | flow |\n| --- | ---: |\n| a 50 % | 1,234 ± 5 |\n")
    arm = {"setting": "", "share": 0.5, "measure": "flow_vehph", "seeds": 3}
    mean = {"driver": "rule", "vehicles": "all", "mean": 12.5, "low": 11.0, "high": 14.0}
    report.typed([arm | mean], SUMMARY_COLUMNS).to_parquet(sweep / "summary.parquet")
    relative = {"relative": 0.05, "relative_low": -0.01, "relative_high": 0.11}
    differences = [
        arm | relative | {"driver": driver, "vehicles": kind, "difference": value}
        for driver, kind, value in (("rule", "all", 3.25), ("rule", "driven", 77.75))
    ]
    report.typed(differences, DIFFERENCE_COLUMNS).to_parquet(sweep / "differences.parquet")
    figures = {name: [1.0, 3.0] for name in ("speed_kmh", "overtakes", "lane_changes", "refused_decisions")}
    pd.DataFrame({"system": ["rail-2"] * 2, "seed": [0, 0]} | figures).to_parquet(study / "cells.parquet")
    pd.DataFrame({"system": ["rail-2"], "ratio": [0.99]}).to_csv(study / "table1.csv", index=False)
    table = "|  | speed |\n| --- | ---: |\n| RAIL | 70.1 |\n| &emsp;of the expert's | 0.99 |\n"
    (study / "table1.md").write_text(f"{table}\nOver trainings.\n\n**Fewer than 5 trainings**: wide.\n")
    report_page.write([sweep, study], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert rows_of(page, "All vehicles") == [[("a 50 %", "a 50 %"), ("1,234 ± 5", "1,234 ± 5")]]
    _, of_differences, of_means, *_ = re.findall(r"<table.*?</table>", page, re.DOTALL)
    heads = re.findall(r'scope="col" class="\w+">(.*?)<', of_differences)
    assert heads == ["driver", "share", "measure", "seeds", "difference", "relative", "seeds_to_tell"]
    cells = '<td data-value="3.25">3.25</td><td data-value="0.05">0.05<small>-0.01 to 0.11</small></td><td></td>'
    assert of_differences.count("<tr>") == 1 + 1  # of all vehicles, not of those driven
    assert cells in of_differences
    assert '<td data-value="12.5">12.5<small>11 to 14</small></td>' in of_means
    assert "<caption><span>mine. caption</span></caption>" in page
    [of_sweep, of_study] = re.findall(r'<div class="figures">(.*?)</div>', page)
    assert re.findall(r'alt="(.*?)"', of_sweep) == [HEADINGS["flow_vehph"], HEADINGS["co2_g_per_vehkm"]]
    assert re.findall(r'alt="(.*?)"', of_study) == ["speed"]
    assert [[told for _, told in row] for row in rows_of(page, "Table 1")] == [
        ["RAIL", "70.1"],
        ["\u2003of the expert&#x27;s", "0.99"],
    ]
    assert "<caption><span>Over trainings. Fewer than 5 trainings: wide.</span></caption>" in page
    assert 'data-value="0.99"' in page  # of all figures
    assert 'data-value="2.0"' in page  # the training's mean


def test_what_is_no_folder_of_ours_or_is_damaged_is_told_in_one_line(tmp_path, rail_sumo):
    empty, damaged, begun = (tmp_path / name for name in ("empty", "damaged", "begun"))
    for folder in (empty, damaged, begun / "cells"):
        folder.mkdir(parents=True)
    for name in ("episodes.parquet", "summary.parquet"):
        (damaged / name).write_bytes(b"PAR1 and no more")
    for words, says in {
        "report nowhere": "'nowhere' is no folder; name one that train, eval, sweep or reproduce has written",
        "report empty": "'empty' is no run, evaluation, sweep or study: it has none of config.toml, episodes.parquet",
        "report begun": "'begun' has no tables yet, only what is finished of a sweep or study; its command writes them",
        "report damaged": "'damaged/episodes.parquet' is damaged",
        "report damaged --out page.pdf": "a report is a page, FILE.html; got 'page.pdf'",
    }.items():
        code, out, err = rail_sumo(*words.split())
        assert (code, out) == (2, "")
        assert err.startswith(f"rail-sumo: {says}")
        assert err.count("\n") == 1
    (damaged / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"manifest.json' is damaged"):
        report_page.write([damaged], tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_an_evaluation_keeps_what_made_it_to_be_driven_again_from_any_folder(rail_sumo, tmp_path):
    (tmp_path / "my.net.xml").write_bytes(assets.network("highway3").read_bytes())
    words = ["eval", "keep", "rail", "--network", "my.net.xml", "--episodes", "1", "--seed", "5", "--out", "my out"]
    assert rail_sumo(*words)[0] == 0
    about = json.loads((tmp_path / "my out" / "evaluation.json").read_text())
    assert about["command"] == "rail-sumo eval keep rail --network my.net.xml --episodes 1 --seed 5 --out 'my out'"
    assert about["seed"] == 5
    assert about["drivers"] == {"keep": "", "rail": assets.sha256(assets.driver("rail") / "policy.safetensors")}
    assert about["modes"] == {"rail": "argmax"}
    kept = config_file.load(tmp_path / "my out" / "world.toml")
    assert kept.network.file == str(tmp_path / "my.net.xml")


def test_an_evaluation_tells_how_each_learned_driver_acts_and_nothing_of_the_first_ones_training(rail_sumo, tmp_path):
    whole = RunDirectory(assets.driver("rail"))
    config = whole.config.changed(train={"learner": "bc", "trajectories": 2, "iterations": 0})
    for name, mode in {"bc": "sampled", "rail": "argmax"}.items():
        RunDirectory.create(tmp_path / name, config, 0, {}, whole.policy().acting(mode))
    words = ("--episodes", "1", "--set", "episode.duration_s=5")
    code, _, err = rail_sumo("eval", "bc", "rail", "keep", *words, "--out", "unlike")
    assert code == 0
    told = "learned drivers act as they were trained, and not all alike: 'rail' by argmax, 'bc' sampled; to compare"
    assert told in err
    about = json.loads((tmp_path / "unlike" / "evaluation.json").read_text())
    assert about["modes"] == {"bc": "sampled", "rail": "argmax"}
    assert [line for line in about["notes"] if line.startswith(told)]
    for of_learning in OF_LEARNING:
        assert f"[{of_learning}]" not in (tmp_path / "unlike" / "world.toml").read_text()
    page = tmp_path / "page.html"
    report_page.write([tmp_path / "unlike"], page)
    assert "bc: sampled" in page.read_text()
    assert "train.trajectories" not in page.read_text()
    report_page.write([tmp_path / "unlike", tmp_path / "rail"], page, overwrite=True)
    row = re.search(r"<tr>(?:(?!<tr>).)*train.trajectories.*?</tr>", page.read_text(), re.DOTALL)
    assert re.findall(r"<td[^>]*>(.*?)</td>", row[0])[-2:] == ["", "2"]  # nobody was trained there
    assert "not all alike" not in rail_sumo("eval", "bc:argmax", "rail", *words)[2]


@pytest.mark.parametrize(("ttc_s", "drawn_at"), [(np.inf, 60.0), (12.0, 12.0)])
def test_where_all_episodes_are_equal_the_axis_leaves_room_also_for_one_that_was_not_driven(
    evaluation, ttc_s, drawn_at
):
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes} | {"policy": "rule"}
    undriven = {"policy": "rule", "episode": 0, "seed": 1, "network": row["network"], "end_reason": "not begun"}
    episodes = report.episodes([undriven] + [row | {"episode": k, "min_ttc_s": ttc_s} for k in (1, 2)])
    axes = plot_episodes.points(episodes, ["rule"]).axes[-1]
    assert axes.get_xlim() == (drawn_at - 1.0, drawn_at + 1.0)


def test_a_line_is_the_mean_of_the_table_and_there_is_none_where_points_are_not_at_their_values(evaluation, tmp_path):
    _, tables = evaluation
    row = {name: tables.episodes[name].iloc[0] for name in tables.episodes}
    undriven = {"policy": "near", "episode": 3, "seed": 1, "network": row["network"], "end_reason": "not begun"}
    times_s = {"near": (10.0, 32.0, 60.0), "apart": (10.0, 32.0, 61.0), "alone": (10.0, 32.0, np.inf)}
    rows = [
        row | {"policy": policy, "episode": k, "min_ttc_s": time_s, "speed_kmh": 2.0 * k}
        for policy, of_policy in times_s.items()
        for k, time_s in enumerate(of_policy)
    ]
    episodes = report.episodes([*rows, undriven])
    panels = plot_episodes.points(episodes, list(times_s)).axes

    def lines(metric):
        """The values at which lines stand, by policy; points have a marker."""
        axes = panels[list(plot_episodes.POINTS).index(metric)]
        upright = [line for line in axes.lines if line.get_marker() == "None"]
        return {list(times_s)[round(np.mean(line.get_ydata()))]: line.get_xdata()[0] for line in upright}

    summary = report.summary(episodes)
    means = summary.set_index(["metric", "policy"])["mean"]
    assert lines("speed_kmh") == means["speed_kmh"].to_dict() == dict.fromkeys(times_s, 2.0)
    assert lines("min_ttc_s") == {"near": means["min_ttc_s", "near"]}
    report.write(tmp_path / "mine", episodes=episodes, summary=summary)
    report_page.write([tmp_path / "mine"], tmp_path / "page.html")
    assert "above 60 s are drawn at 60 s, and a policy that has one has no line" in (tmp_path / "page.html").read_text()
