"""Output is there whole or not at all."""

import pytest

from rail_sumo.errors import InputError
from rail_sumo.files import whole_file, whole_folder


def stopped(destination, write, by):
    with destination as partial:
        write(partial)
        raise by


def test_a_file_takes_its_name_when_it_is_whole(tmp_path):
    file = tmp_path / "new folder" / "table.csv"
    with whole_file(file) as partial:
        partial.write_text("whole")
        assert not file.exists()
    assert [path.name for path in file.parent.iterdir()] == ["table.csv"]
    assert file.read_text() == "whole"


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError("broken")])
def test_what_stops_the_writing_leaves_the_old_file_and_no_other(tmp_path, stop):
    file = tmp_path / "table.csv"
    file.write_text("old")
    with pytest.raises((KeyboardInterrupt, ValueError)):
        stopped(whole_file(file), lambda partial: partial.write_text("half"), stop)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("table.csv", "old")]


def test_a_folder_takes_its_name_when_it_is_whole(tmp_path):
    with whole_folder(tmp_path / "run") as partial:
        (partial / "config.toml").touch()
        assert not (tmp_path / "run").exists()
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == ["run", "run/config.toml"]


def test_what_stops_the_writing_leaves_no_folder(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        stopped(whole_folder(tmp_path / "run"), lambda partial: (partial / "config.toml").touch(), KeyboardInterrupt)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_nothing_in_the_way(tmp_path):
    (tmp_path / "run").mkdir()
    with whole_folder(tmp_path / "run") as partial:
        (partial / "table.csv").touch()
        assert list((tmp_path / "run").glob("*.csv")) == []
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["run", "run/table.csv"]


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".mine").touch()
    with pytest.raises(InputError, match="exists; choose another"), whole_folder(tmp_path / "run"):
        pytest.fail("there was a place to write to")


def test_overwriting_merges(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    (tmp_path / "run" / "table.csv").write_text("old")
    (tmp_path / "run" / "parts").mkdir()
    (tmp_path / "run" / "parts" / "0").write_text("old")
    (tmp_path / "run" / "parts" / "1").write_text("old")
    with whole_folder(tmp_path / "run", overwrite=True) as partial:
        (partial / "table.csv").write_text("new")
        (partial / "parts").mkdir()
        (partial / "parts" / "0").write_text("new")
    there = {str(path.relative_to(tmp_path / "run")): path for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert {name: path.read_text() for name, path in there.items()} == {
        "notes.txt": "mine",
        "table.csv": "new",
        "parts/0": "new",  # a folder is replaced as a whole
    }


def test_a_file_where_a_folder_should_be_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write '.*table.csv': "), whole_file(tmp_path / "file" / "table.csv"):
        pytest.fail("there was a place to write to")
