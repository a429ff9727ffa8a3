import re
import resource
from contextlib import contextmanager
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from scipy.stats import ttest_1samp

from rail_sumo.errors import InputError
from rail_sumo.records import EPISODE_COLUMNS, METRICS, SUMMARY_COLUMNS, EndReason
from rail_sumo.tables import report


def rows(policy, speeds_kmh, **changes):
    """One row per speed; everything else is the same in each."""
    others = dict.fromkeys(METRICS, 1) | {"network": "highway5", "end_reason": "course", "min_ttc_s": 2.5} | changes
    return [
        {**others, "policy": policy, "episode": episode, "seed": 100 + episode, "speed_kmh": speed}
        for episode, speed in enumerate(speeds_kmh)
    ]


RATIO, DIFFERENCE = (["ratio", "ratio_low", "ratio_high"], ["difference", "difference_low", "difference_high"])
INTERVALS = ["low", "high", *RATIO[1:], *DIFFERENCE[1:]]


def summarised(episodes, policy, metric):
    summary = report.summary(episodes)
    return summary[(summary["policy"] == policy) & (summary["metric"] == metric)].iloc[0]


def test_mean_and_interval_by_hand():
    speed = summarised(report.episodes(rows("rule", [60.0, 64.0])), "rule", "speed_kmh")
    # Standard error 2, and 12.7062 is the 97.5 % point of Student's t with one degree of freedom.
    assert speed[["mean", "low", "high"]].tolist() == pytest.approx(
        [62.0, 62 - 2 * 12.7062, 62 + 2 * 12.7062], abs=1e-3
    )
    assert speed["episodes"] == 2


def test_the_interval_is_of_the_mean_of_episodes():
    speeds = np.random.default_rng(0).normal(68.0, 3.0, 16)
    speed = summarised(report.episodes(rows("rule", speeds)), "rule", "speed_kmh")
    expected = ttest_1samp(speeds, 0.0).confidence_interval(0.95)
    assert speed[["mean", "low", "high"]].tolist() == pytest.approx([speeds.mean(), *expected], abs=1e-6)


def test_one_episode_has_no_interval():
    speed = summarised(report.episodes(rows("rule", [61.5]) + rows("expert", [60.0])), "rule", "speed_kmh")
    assert speed[["mean", "ratio", "difference"]].tolist() == [61.5, 1.025, 1.5]
    assert speed[INTERVALS].isna().all()


def test_episodes_that_are_all_the_same_have_intervals_without_width():
    same = report.episodes(rows("rule", [61.5] * 16) + rows("expert", [60.0] * 16))
    speed = summarised(same, "rule", "speed_kmh")
    assert speed[["mean", "low", "high"]].tolist() == [61.5] * 3
    assert speed[RATIO].tolist() == [1.025] * 3
    assert speed[DIFFERENCE].tolist() == [1.5] * 3


def test_ratio_is_of_the_means_and_only_beside_the_expert():
    rule, expert = rows("rule", [60.0, 66.0]), rows("expert", [70.0, 70.0])
    assert summarised(report.episodes(rule + expert), "rule", "speed_kmh")["ratio"] == 0.9
    assert summarised(report.episodes(rule + expert), "expert", "speed_kmh")["ratio"] == 1.0
    alone = summarised(report.episodes(rule), "rule", "speed_kmh")
    assert alone["reference"] == "expert"
    assert alone[[*RATIO, *DIFFERENCE]].isna().all()


def test_differences_are_of_the_same_episode_by_hand():
    beside = rows("rule", [61.0, 73.0, 65.0]) + rows("expert", [60.0, 70.0, 60.0])
    speed = summarised(report.episodes(beside), "rule", "speed_kmh")
    # Differences 1, 3 and 5: standard error 2 / sqrt(3); 4.3027 is the 97.5 % point with two degrees of freedom.
    half = 4.3027 * 2 / np.sqrt(3)
    assert speed[DIFFERENCE].tolist() == pytest.approx([3.0, 3 - half, 3 + half], abs=1e-3)
    # The means' ratio is 199 / 190. At the ends of its interval what remains is 4.3027 standard errors from 0.
    assert speed["ratio"] == pytest.approx(199 / 190, abs=1e-6)
    for end in speed[["ratio_low", "ratio_high"]]:
        remains = np.array([61 - 60 * end, 73 - 70 * end, 65 - 60 * end])
        assert abs(remains.mean()) == pytest.approx(4.3027 * remains.std(ddof=1) / np.sqrt(3), rel=1e-3)
    assert speed["high"] - speed["low"] > 2 * (speed["difference_high"] - speed["difference_low"])


def test_episodes_are_compared_by_number_in_whatever_order_they_are_told():
    rule, expert = rows("rule", [61.0, 73.0, 65.0]), rows("expert", [60.0, 70.0, 60.0])
    in_order, shuffled = report.episodes(rule + expert), report.episodes([*expert[::-1], rule[1], rule[0], rule[2]])
    for metric in METRICS:
        one, other = (summarised(episodes, "rule", metric) for episodes in (in_order, shuffled))
        pd.testing.assert_series_equal(one, other, check_names=False)


def test_an_episode_that_the_reference_did_not_drive_counts_for_the_mean_alone():
    beside = rows("rule", [61.0, 73.0, 200.0]) + rows("expert", [60.0, 70.0])
    speed = summarised(report.episodes(beside), "rule", "speed_kmh")
    assert speed["mean"] == pytest.approx(334 / 3, abs=1e-6)
    assert (speed["ratio"], speed["difference"]) == (pytest.approx(134 / 130, abs=1e-6), 2.0)


def test_another_policy_may_be_the_reference():
    three = report.episodes(rows("rule", [60.0, 66.0]) + rows("expert", [70.0, 70.0]) + rows("mine", [80.0, 60.0]))
    by_rule = report.summary(three, reference="rule")
    assert (by_rule["reference"] == "rule").all()
    speeds = by_rule[by_rule["metric"] == "speed_kmh"].set_index("policy")
    assert speeds["difference"].to_dict() == {"rule": 0.0, "expert": 7.0, "mine": 7.0}
    assert speeds.loc["mine", "ratio"] == pytest.approx(140 / 126, abs=1e-6)
    same = ["policy", "metric", "episodes", "mean", "low", "high"]
    pd.testing.assert_frame_equal(by_rule[same], report.summary(three)[same])


def test_nothing_is_a_multiple_of_an_expert_without_collisions():
    beside = rows("rule", [60.0, 61.0]) + rows("expert", [70.0, 71.0], collisions=0)
    collisions = summarised(report.episodes(beside), "rule", "collisions")
    assert np.isnan(collisions["ratio"])
    assert collisions["difference"] == 1.0


@pytest.mark.parametrize("metric", report.CONTACTS)
def test_of_contacts_the_share_of_episodes_is_told_and_their_comparison_has_no_interval(metric):
    rule = rows("rule", [60.0] * 4)
    for row, contacts in zip(rule, (0, 2, 0, 0), strict=True):
        row[metric] = contacts
    contacts = summarised(report.episodes(rule + rows("expert", [70.0] * 4)), "rule", metric)
    # Wilson's, at 1 of 4: its centre is (1 + z^2 / 2) / (4 + z^2), and both ends solve (p - 1/4)^2 = z^2 p (1 - p) / 4.
    assert contacts["mean"] == 0.25
    for end in contacts[["low", "high"]]:
        assert (end - 0.25) ** 2 == pytest.approx(1.959964**2 * end * (1 - end) / 4, abs=1e-5)
    assert contacts["low"] < 0.25 < contacts["high"]
    assert contacts[["ratio_low", "ratio_high", "difference_low", "difference_high"]].isna().all()


def test_a_policy_that_has_not_crashed_yet_may_crash():
    never = summarised(report.episodes(rows("rule", [60.0] * 16, collisions=0)), "rule", "collisions")
    assert never[["mean", "low"]].tolist() == [0.0, 0.0]
    assert never["high"] == pytest.approx(1.959964**2 / (16 + 1.959964**2), abs=1e-6)  # Wilson's, at 0 of 16


def test_time_to_collision_is_summarised_where_the_host_closed_in():
    rule = rows("rule", [60.0] * 4)
    for row, min_ttc_s in zip(rule, (np.inf, 2.0, 4.0, np.inf), strict=True):
        row["min_ttc_s"] = min_ttc_s
    some = summarised(report.episodes(rule), "rule", "min_ttc_s")
    assert some[["episodes", "mean"]].tolist() == [2, 3.0]
    assert some["high"] == pytest.approx(3 + 12.7062, abs=1e-3)  # two are left, with a standard error of 1
    never = summarised(report.episodes(rows("rule", [60.0], min_ttc_s=np.inf)), "rule", "min_ttc_s")
    assert never["episodes"] == 0
    assert never[["mean", "low", "high"]].isna().all()


def test_an_expert_that_never_closed_in_leaves_the_ratio_to_the_rest():
    expert = rows("expert", [60.0, 60.0], min_ttc_s=2.0)
    expert[0]["min_ttc_s"] = np.inf
    rule = rows("rule", [60.0, 60.0], min_ttc_s=3.0)
    rule[0]["min_ttc_s"] = 9.0
    compared = summarised(report.episodes(rule + expert), "rule", "min_ttc_s")
    assert compared[["mean", "ratio", "difference"]].tolist() == [6.0, 1.5, 1.0]


def test_the_same_episodes_give_the_same_summary():
    episodes = report.episodes(rows("rule", [60.1, 62.3, 70.7]))
    pd.testing.assert_frame_equal(report.summary(episodes), report.summary(episodes))


@pytest.fixture
def tables():
    speeds = [200 / 3, 70.123456789, 1e-7, 65.0]
    episodes = report.episodes(rows("runs/a b, c", speeds, min_ttc_s=np.inf) + rows("expert", speeds))
    return {"episodes": episodes, "summary": report.summary(episodes)}


def test_csv_and_parquet_hold_the_same(tables, tmp_path):
    report.write(tmp_path / "out", **tables)
    for (name, table), columns in zip(tables.items(), (EPISODE_COLUMNS, SUMMARY_COLUMNS), strict=True):
        from_csv = pd.read_csv(tmp_path / "out" / f"{name}.csv", dtype=columns)
        from_parquet = pd.read_parquet(tmp_path / "out" / f"{name}.parquet")
        pd.testing.assert_frame_equal(from_csv, from_parquet, check_exact=True)
        pd.testing.assert_frame_equal(from_csv, table, check_exact=True)
        assert {column: str(kind) for column, kind in from_parquet.dtypes.items()} == columns


def test_an_existing_folder_is_refused_and_left_as_it_was(tables, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"exists; choose another$"):
        report.write(tmp_path / "out", **tables)
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "notes.txt"]


def test_overwriting_replaces_the_tables_and_nothing_else(tables, tmp_path):
    report.write(tmp_path, **tables, overwrite=True)
    (tmp_path / "notes.txt").write_text("mine")
    episodes = report.episodes(rows("keep", [60.0]))
    report.write(tmp_path, episodes=episodes, summary=report.summary(episodes), overwrite=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert set(pd.read_csv(tmp_path / "summary.csv")["policy"]) == {"keep"}
    assert len(list(tmp_path.iterdir())) == 5


def test_a_file_in_the_way_is_one_clear_line(tables, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write to '.*out': '.*file' is not a writable folder"):
        report.write(tmp_path / "file" / "out", **tables)


@contextmanager
def full_disk():
    """No file of this process may grow beyond 300 bytes: not pytest's own output either, so leave it soon."""
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, unlimited[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)


def test_a_full_disk_leaves_nothing_behind(tables, tmp_path):
    with full_disk(), pytest.raises(InputError, match=r"cannot write '.*out': File too large"):
        report.write(tmp_path / "out", **tables)
    assert list(tmp_path.iterdir()) == []


def printed(summary):
    console = Console(width=100)
    with console.capture() as shown:
        console.print(report.table(summary))
    return shown.get().splitlines()


def line_of(name, lines):
    return next(number for number, line in enumerate(lines) if name in line)


def test_the_terminal_shows_every_policy_with_its_ratio_within_100_columns():
    name = "runs/[dense] highway5-seed0"
    beside = rows(name, [63.0, 65.0], collisions=0) + rows("expert", [70.0, 70.0], collisions=0)
    lines = printed(report.summary(report.episodes(beside)))
    assert max(map(len, lines)) <= 100
    learned, expert = line_of("runs/[dense]", lines), line_of("expert  ", lines)
    # Half an interval of two episodes is 12.706 standard errors: of the mean 1, of the ratio 1 / 70. In both episodes
    # it was struck.
    equal = ["1.0", "±", "0.0"]
    means = ["64.0", "±", "12.7", *equal, *equal, "1.0", "1.0", "1.00", "2"]
    assert lines[learned].split()[-len(means) :] == means
    ratios = [
        f"{low}\N{EN DASH}{high}" for low, high in [("0.73", "1.10"), ("1.00", "1.00"), ("1.00", "1.00")]
    ]  # their intervals; of no other
    assert lines[learned + 1].split()[-len(ratios) :] == ratios
    named = " ".join(re.split(r"  +", line.strip())[0] for line in lines[learned:expert])
    assert named == name  # whole, on however many lines
    assert lines[expert].split() == ["expert", "70.0", "±", "0.0", *equal, *equal, "1.0", "1.0", "1.00", "2"]
    assert not lines[expert + 1].strip()  # of itself it is no ratio
    told = (
        "means over 2 episodes of 0.0 km ± 95 % interval (fewer than 5 tell little); below, 95 % intervals of ratios to"
    )
    assert f"{told} expert" in " ".join(" ".join(lines).split())


def test_the_terminal_shows_usual_figures_and_who_drove_within_100_columns():
    rng = np.random.default_rng(0)
    usual = {"overtakes": (45, 9), "overtaken": (8, 4), "lane_changes": (14, 4), "hard_brakings": (1, 1)}
    usual["refused_decisions"] = (120, 20)  # the random driver's
    driven = [row for name in ("random", "expert") for row in rows(name, rng.normal(69.0, 3.0, 16))]
    for row in driven:
        row |= {metric: max(0, round(rng.normal(*spread))) for metric, spread in usual.items()}
    summary = report.summary(report.episodes(driven))
    lines = printed(summary)
    assert not any("…" in line for line in lines)
    of = summary.set_index(["policy", "metric"])
    for name in ("random", "expert"):
        shown = []
        for metric in ("speed_kmh", "overtakes", "lane_changes"):
            mean, _, high = of.loc[(name, metric), ["mean", "low", "high"]]
            shown.append(f"{mean:.1f} ± {high - mean:.1f}")
        shown += [f"{of.loc[(name, metric), 'mean']:.1f}" for metric in ("refused_decisions", "overtaken")]
        shown.append(f"{of.loc[(name, 'hard_brakings'), 'mean']:.2f}")
        assert re.split(r"  +", lines[line_of(name, lines)].strip()) == [name, *shown, "32"]


@pytest.mark.parametrize(
    ("low", "high", "shown"),
    [
        (0.9930, 0.9996, "0.9930\N{EN DASH}0.9996"),
        (0.99, 0.996, "0.990\N{EN DASH}0.996"),
        (1.004, 1.02, "1.004\N{EN DASH}1.020"),
        (0.97, 0.994, "0.97\N{EN DASH}0.99"),
        (0.97, 1.0004, "0.97\N{EN DASH}1.00"),
        (0.9996, 1.02, "1.00\N{EN DASH}1.02"),
        (1.0, 1.0, "1.00\N{EN DASH}1.00"),
        (0.99, 0.999999, "0.990000\N{EN DASH}0.999999"),
    ],
)
def test_an_interval_without_1_never_looks_as_if_it_held_1_within_100_columns(low, high, shown):
    summary = report.summary(report.episodes(rows("rule", [63.0, 65.0]) + rows("expert", [70.0, 70.0])))
    summary.loc[summary["policy"] == "rule", ["ratio_low", "ratio_high"]] = low, high
    lines = printed(summary)
    assert max(map(len, lines)) <= 100
    assert lines[line_of("rule", lines) + 1].split() == [shown] * 3
    ends = [float(end) for end in shown.split("\N{EN DASH}")]
    assert (ends[0] <= 1.0 <= ends[1]) == (low <= 1.0 <= high)


def test_a_narrow_terminal_is_shown_less_and_every_name():
    driven = report.episodes(rows("runs/first", [63.0, 65.0]) + rows("expert", [70.0, 71.0]))
    console = Console(width=80)
    with console.capture() as shown:
        console.print(report.table(report.summary(driven), width=80))
    lines = shown.get().splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)
    assert lines[line_of("runs/first", lines)].split()[-2:] == ["1.0", "4"]  # refused, contacts


def test_that_all_drove_alike_is_told_and_not_that_one_drove_its_episodes_alike():
    alike = rows("rule", [100.0, 60.0]) + rows("mine", [100.9, 59.9])
    (line,) = report.alike(report.episodes(alike))
    assert line.startswith("in each episode all of them are as fast as each other, to within 1 %: one may have learned")
    another = rows("other", [102.5, 60.0])
    (line,) = report.alike(report.episodes(alike + another + rows("sumo", [80.0, 60.0]) + rows("keep", [100.2, 60.1])))
    assert line.startswith(
        "in each episode 'rule', 'mine', 'keep' are as fast as each other"
    )  # though two others do not
    assert not report.alike(report.episodes(alike + another))  # two of three may have learned the same
    apart = rows("rule", [100.0, 60.0]) + rows("mine", [101.5, 60.0])
    assert report.alike(report.episodes(apart)) == report.alike(report.episodes(rows("rule", [100.0]))) == []


def test_the_terminal_tells_which_policy_is_the_reference():
    # One episode tells no interval, which is told.
    three = report.episodes([*rows("rule", [60.0]), *rows("mine", [66.0]), *rows("expert", [72.0])])
    lines = printed(report.summary(three, reference="rule"))
    assert "one episode of 0.0 km: no interval; below, ratios to rule" in " ".join(lines)
    assert not any("±" in line for line in lines)
    assert [lines[line_of(name, lines) + 1].split()[:1] for name in ("mine", "expert  ")] == [["1.10"], ["1.20"]]


@pytest.mark.parametrize("names", [["rule"], ["rule", "mine"]])
def test_the_terminal_shows_no_ratios_to_one_who_did_not_drive(names):
    lines = printed(report.summary(report.episodes([row for name in names for row in rows(name, [60.0])])))
    assert "ratios" not in " ".join(lines)
    first, last = line_of(names[0], lines), line_of(names[-1], lines)
    assert last - first == len(names) - 1  # nothing between them
    assert not lines[last + 1].strip()


def test_the_terminal_counts_the_episodes_with_a_contact():
    rule = rows("rule", [60.0] * 16, collisions=0, struck=0)
    rule[3]["struck"], rule[5]["collisions"] = 2, 1
    lines = printed(report.summary(report.episodes(rule)))
    assert "contacts" in " ".join(lines)
    assert lines[line_of("rule", lines)].split()[-1] == "2"


@pytest.mark.parametrize(("n", "is_told"), [(1, False), (2, True), (4, True), (5, False)])
def test_few_episodes_are_said_to_tell_little(n, is_told):
    said = " ".join(printed(report.summary(report.episodes(rows("rule", [60.0 + k for k in range(n)])))))
    assert ("fewer than 5 tell little" in said) is is_told


def test_episodes_that_were_cut_short_are_counted_by_policy_and_why():
    rule, mine, usual = (rows(name, [60.0] * 16) for name in ("rule", "mine", "usual"))
    rule[3]["end_reason"] = rule[5]["end_reason"] = "standstill"
    mine[0]["end_reason"], mine[1]["end_reason"] = "SUMO stopped", "standstill"
    for row, end in zip(usual, get_args(EndReason)[:4], strict=False):
        row["end_reason"] = end  # these are ordinary, and contacts are in the table
    assert report.cut_short(report.episodes([*rule, *mine, *usual])) == [
        "rule: 2 of 16 episodes ended at a standstill",
        "mine: 1 of 16 episodes ended at a standstill; "
        "1 of 16 episodes ended because SUMO stopped (left out of the means)",
    ]


def test_every_end_is_ordinary_or_told():
    assert {"course", "duration", "end of road", "collision", *report._CUT_SHORT} == set(get_args(EndReason))


@pytest.mark.parametrize(("least", "has_intervals"), [(100.0, True), (1e9, False)])
def test_however_long_the_figures_are_the_contacts_are_shown(least, has_intervals):
    driven = report.episodes(rows("runs/mine-first-try", [6.0, 195.5]) + rows("expert", [70.0, 171.0]))
    for metric in ("speed_kmh", "overtakes", "lane_changes"):
        driven[metric] = [least, 19.0 * least, 2.0 * least, 18.0 * least]
    lines = printed(report.summary(driven))
    assert max(map(len, lines)) <= 100
    assert not any("…" in line for line in lines)
    assert "contacts" in " ".join(lines)
    assert lines[line_of("expert ", lines)].split()[-1] == "4"
    assert ("±" in " ".join(lines)) == has_intervals


@pytest.mark.parametrize(
    ("policies", "reference"),
    [
        (["rule", "expert", "sumo"], "expert"),
        (["road-rail", "road-expert", "sumo"], "road-expert"),
        (["road-rail", "sumo"], "sumo"),
        (["rule"], "expert"),
    ],
)
def test_whom_ratios_refer_to_where_nobody_is_named(policies, reference):
    assert report.reference_among(policies) == reference


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("rail", ["rail"]),
        ("runs/rail-seed0", ["runs/", "rail-seed0"]),
        ("runs/rail:sampled", ["runs/rail", ":sampled"]),
        ("runs/2026/rail", ["runs/2026/rail"]),
        ("runs/[dense] highway5", ["runs/[dense] ", "highway5"]),
        ("a_name_without_any_place_to_fold", ["a_name_without", "_any_place_to_", "fold"]),
        (":sampled_and_more_than_14", [":sampled_and_m", "ore_than_14"]),
    ],
)
def test_long_names_are_folded_where_their_parts_end(name, lines):
    assert list(report.Name(name).lines(report.NAME_WIDTH)) == lines
