"""The documents' figures are those of the cells in docs/data."""

import re
from pathlib import Path

import claims
import pandas as pd

from rail_sumo.studies import reproduce
from rail_sumo.studies.experiment import SYSTEMS
from rail_sumo.tables import report, shares

ROOT = Path(__file__).parent.parent
CELLS = ROOT / "docs" / "data" / "cells.parquet"


def test_the_table_kept_is_what_the_cells_come_to(tmp_path):
    reproduce.table1_of(CELLS, tmp_path)
    assert (tmp_path / "table1.md").read_text() == (ROOT / "docs" / "data" / "table1.md").read_text()


def test_the_table_of_results_is_that_of_the_cells():
    measured = claims.ratios(reproduce.read_cells(CELLS)).set_index(["", "mode", "shown"])
    told = re.findall(r"^\| ([^|]+) \| (argmax|sampled|)\s*\| (\d+) \| (\d+) \| (.*) \|$", results(), re.MULTILINE)
    assert len(told) > 5
    for label, mode, shown, trainings, figures in told:
        row = measured.loc[(label, mode, int(shown))]
        names = ["speed_kmh", "overtakes", "lane_changes", "refused", "told apart"]
        assert figures.split(" | ") == [row[name] for name in names], (label, mode)
        assert row["seeds"] == int(trainings)


def test_the_tables_of_few_trajectories_are_those_of_the_cells():
    measured = claims.ratios(reproduce.read_cells(CELLS)).set_index(["", "mode", "shown"])
    whom = {
        "RAIL, two layers": ("RAIL, two layers", "argmax"),
        "RAIL, one layer": ("RAIL, one layer", "argmax"),
        "GAIL, sampled": ("GAIL, two layers", "sampled"),
        "clone, argmax": ("behaviour cloning, two layers", "argmax"),
        "clone, sampled": ("behaviour cloning, two layers", "sampled"),
    }
    metrics = {
        "speed": "speed_kmh",
        "overtakes": "overtakes",
        "lane changes": "lane_changes",
        "lateral penalty": "lateral_reward",
        "told apart": "told apart",
    }
    text = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| ([^|;]+); shown \| (.*) \|\n.*\n((?:\| \d+ \|.*\n)+)", text, re.MULTILINE)
    assert [name for name, *_ in told] == list(metrics)
    for name, learners, rows in told:
        for row in rows.splitlines():
            shown, *figures = row.strip("| ").split(" | ")
            keys = [(*whom[learner], int(shown)) for learner in learners.split(" | ")]
            assert figures == [measured.loc[key, metrics[name]] for key in keys], (name, shown)


def results():
    text = (ROOT / "docs" / "learners.md").read_text(encoding="utf-8")
    return text.partition("## Results")[2].partition("\n## ")[0]


def test_no_driver_but_sumos_own_hit_anything_or_was_hit_and_who_is_masked_is_never_refused():
    cells = reproduce.read_cells(CELLS)
    ours = cells[cells["system"] != "sumo"]
    assert not ours[["collisions", "struck", "hard_brakings"]].any(axis=None)
    masked = ours[[not SYSTEMS[name].label.endswith("unmasked") for name in ours["system"]]]
    assert len(masked) > 1000
    assert not masked["refused_decisions"].any()


def test_the_table_of_the_study_of_shares_is_what_its_runs_come_to():
    kept = pd.read_parquet(CELLS.with_name("share.parquet"))
    table = report.typed(kept, shares.TRAFFIC_COLUMNS)
    text = (ROOT / "docs" / "share.md").read_text(encoding="utf-8")
    rows = shares.told_rows(table, shares.compared(table))
    assert len(rows) == 1 + 3 * 4
    for row in rows:
        told = [row.driver, row.share, *(cell.on_one_line for cell in row.cells.values())]
        assert f"| {' | '.join(told)} |" in text
