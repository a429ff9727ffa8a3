import resource
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from scipy.stats import bootstrap, trim_mean

from rail_sumo import report
from rail_sumo.errors import InputError
from rail_sumo.records import EPISODE_COLUMNS, METRICS, SUMMARY_COLUMNS


def rows(policy, speeds_kmh, **changes):
    """One row per speed; everything else is the same in each."""
    others = dict.fromkeys(METRICS, 1) | {"network": "highway5", "end_reason": "course", "min_ttc_s": 2.5} | changes
    return [
        {**others, "policy": policy, "episode": episode, "seed": 100 + episode, "speed_kmh": speed}
        for episode, speed in enumerate(speeds_kmh)
    ]


def summarised(episodes, policy, metric):
    summary = report.summary(episodes)
    return summary[(summary["policy"] == policy) & (summary["metric"] == metric)].iloc[0]


def test_interquartile_mean_matches_hand_computation():
    # Of eight episodes the two slowest and the two fastest go: (60 + 62 + 64 + 66) / 4 = 63; the mean is 70.25.
    episodes = report.episodes(rows("rule", [0, 10, 60, 62, 64, 66, 100, 200]))
    speed = summarised(episodes, "rule", "speed_kmh")
    assert (speed["iqm"], speed["mean"]) == (63.0, 70.25)


def test_interval_matches_scipys_own_bootstrap():
    speeds = np.random.default_rng(0).normal(68.0, 3.0, 16)
    speed = summarised(report.episodes(rows("rule", speeds)), "rule", "speed_kmh")
    independent = bootstrap(
        (speeds,), lambda x, axis: trim_mean(x, 0.25, axis=axis), method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    assert (speed["low"], speed["high"]) == pytest.approx(tuple(independent), abs=0.1)
    assert speed["low"] < speed["iqm"] < speed["high"]


def test_one_episode_is_its_own_interval():
    speed = summarised(report.episodes(rows("rule", [61.5])), "rule", "speed_kmh")
    assert (speed["low"], speed["iqm"], speed["high"]) == (61.5, 61.5, 61.5)


def test_ratio_is_of_the_means_and_only_beside_the_expert():
    rule, expert = rows("rule", [60.0, 66.0]), rows("expert", [70.0, 70.0])
    assert summarised(report.episodes(rule + expert), "rule", "speed_kmh")["ratio_to_expert"] == 0.9
    assert summarised(report.episodes(rule + expert), "expert", "speed_kmh")["ratio_to_expert"] == 1.0
    assert np.isnan(summarised(report.episodes(rule), "rule", "speed_kmh")["ratio_to_expert"])


def test_nothing_is_a_multiple_of_an_expert_without_collisions():
    beside = rows("rule", [60.0]) + rows("expert", [70.0], collisions=0)
    assert np.isnan(summarised(report.episodes(beside), "rule", "collisions")["ratio_to_expert"])


def test_a_policy_that_has_not_crashed_yet_may_crash():
    never = summarised(report.episodes(rows("rule", [60.0] * 16, collisions=0)), "rule", "collisions")
    assert never[["mean", "low"]].tolist() == [0.0, 0.0]
    assert never["high"] == pytest.approx(1.959964**2 / (16 + 1.959964**2), abs=1e-6)  # Wilson's, at 0 of 16


def test_time_to_collision_is_summarised_where_the_host_closed_in():
    episodes = report.episodes(rows("rule", [60.0], min_ttc_s=np.inf) + rows("rule", [60.0, 60.0], min_ttc_s=3.0))
    assert summarised(episodes, "rule", "min_ttc_s")["mean"] == 3.0
    never = summarised(report.episodes(rows("rule", [60.0], min_ttc_s=np.inf)), "rule", "min_ttc_s")
    assert never[["mean", "iqm", "low", "high"]].isna().all()


def test_an_expert_that_never_closed_in_leaves_the_ratio_to_the_rest():
    expert = rows("expert", [60.0], min_ttc_s=np.inf) + rows("expert", [60.0], min_ttc_s=2.0)
    beside = report.episodes(rows("rule", [60.0, 60.0], min_ttc_s=3.0) + expert)
    assert summarised(beside, "rule", "min_ttc_s")["ratio_to_expert"] == 1.5


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
    with pytest.raises(InputError, match=r"exists; choose another$"):
        report.write(tmp_path / "out", **tables)
    assert list(tmp_path.rglob("*")) == [tmp_path / "out"]


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


def test_the_terminal_shows_every_policy_with_its_ratio_within_100_columns():
    name = "runs/[dense] highway5-seed0"
    beside = report.episodes(rows(name, [63.0], collisions=0) + rows("expert", [70.0], collisions=0))
    console = Console(width=100)
    with console.capture() as shown:
        console.print(report.table(report.summary(beside)))
    lines = shown.get().splitlines()
    assert max(map(len, lines)) <= 100
    learned = next(number for number, line in enumerate(lines) if name in line)
    assert lines[learned].split()[-6:] == ["63.0", "1.0", "1.0", "1.0", "0.00", "1.00"]
    # Below: ratios, but none to an expert that never collided.
    assert lines[learned + 1].split() == ["0.90", "1.00", "1.00", "1.00", "1.00"]
