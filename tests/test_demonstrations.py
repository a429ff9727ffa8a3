import dataclasses
import json
import re

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from toy import episode

from rail_sumo import config, config_file
from rail_sumo.errors import InputError
from rail_sumo.imitation.demonstrations import METADATA_KEY, Demonstrations

FEATURES = ["distance_0_m", "relative_speed_0_mps"]
ALLOWED = {
    f"allowed_{action}": pa.array([True, True]) for action in ("keep", "accelerate", "decelerate", "left", "right")
}
COLUMNS = {
    "distance_0_m": pa.array([100.0, 7.5]),
    "relative_speed_0_mps": pa.array([0.0, -3.25]),
    "action": pa.array([0, 4]),
    "episode": pa.array([0, 0]),
}


def three_episodes():
    return Demonstrations.from_trajectories(
        [
            episode([[1.0, 10.0], [2.0, 20.0]], [0, 1]),
            episode([[3.0, 30.0]], [2]),
            episode([[4.0, 40.0], [5.0, 50.0], [6.0, 60.0]], [3, 4, 0]),
        ]
    )


def same(one, other):
    fields = ("observations", "actions", "episode", "allowed")
    return all(np.array_equal(getattr(one, field), getattr(other, field)) for field in fields)


def test_episodes_are_laid_end_to_end_and_numbered():
    demonstrations = three_episodes()
    assert demonstrations.observations[:, 1].tolist() == [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    assert demonstrations.actions.tolist() == [0, 1, 2, 3, 4, 0]
    assert demonstrations.episode.tolist() == [0, 0, 1, 2, 2, 2]
    assert demonstrations.n_episodes == 3


def test_what_is_demonstrated_is_what_was_carried_out():
    refused = episode([[1.0, 2.0], [3.0, 4.0]], [3, 1], carried_out=[0, 1])
    assert Demonstrations.from_trajectories([refused]).actions.tolist() == [0, 1]


def test_take_gives_the_first_episodes_whole():
    taken = three_episodes().take(2)
    assert taken.observations[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert taken.actions.tolist() == [0, 1, 2]
    assert same(three_episodes().take(3), three_episodes())


def test_fresh_and_stored_observations_are_the_same_numbers():
    fresh = Demonstrations.from_trajectories([episode([[1 / 3, 2 / 7]], [0])])
    assert fresh.observations.tolist() == [[float(np.float32(1 / 3)), float(np.float32(2 / 7))]]


def test_episodes_may_have_any_numbers():
    three = Demonstrations(np.zeros((3, 2)), np.array([1, 2, 3]), np.array([7, 3, 7]))
    assert three.n_episodes == 2
    assert three.take(1).actions.tolist() == [2]


@pytest.mark.parametrize("n_episodes", [0, 4])
def test_take_refuses_more_than_there_are(n_episodes):
    message = rf"{n_episodes} demonstrated trajectories wanted, and there are 3; set train.trajectories to 1\.\.3"
    with pytest.raises(InputError, match=message):
        three_episodes().take(n_episodes)


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 20), st.just(2)), elements=st.floats(-1e6, 1e6)),
    st.data(),
)
def test_saved_is_loaded_bit_for_bit(tmp_path_factory, observations, data):
    n = len(observations)
    actions = data.draw(hnp.arrays(np.int64, n, elements=st.integers(0, 4)))
    numbers = data.draw(hnp.arrays(np.int64, n, elements=st.integers(0, 99)))
    path = tmp_path_factory.mktemp("demonstrations") / "any.parquet"
    allowed = data.draw(hnp.arrays(np.bool_, (n, 5))) | np.eye(5, dtype=np.bool_)[actions]
    demonstrations = Demonstrations(observations, actions, numbers, allowed)
    demonstrations.save(path, features=FEATURES, about={})
    assert same(Demonstrations.load(path, features=FEATURES), demonstrations)


def test_the_file_names_its_columns_and_tells_where_it_is_from(tmp_path):
    path = tmp_path / "expert.parquet"
    path.write_bytes(b"an older file, to be replaced")
    three_episodes().save(path, features=FEATURES, about={"driver": "rule", "seed": 7})
    table = pq.read_table(path)
    assert {field.name: str(field.type) for field in table.schema} == {
        "distance_0_m": "float",
        "relative_speed_0_mps": "float",
        "action": "int8",
        "episode": "int32",
        "allowed_keep": "bool",
        "allowed_accelerate": "bool",
        "allowed_decelerate": "bool",
        "allowed_left": "bool",
        "allowed_right": "bool",
    }
    assert json.loads(table.schema.metadata[METADATA_KEY]) == {
        "features": FEATURES,
        "about": {"driver": "rule", "seed": 7},
    }
    assert pq.ParquetFile(path).metadata.row_group(0).column(0).compression == "ZSTD"
    assert [file.name for file in tmp_path.iterdir()] == ["expert.parquet"]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "lidar.max_range_m=60.0",
            "were recorded with lidar.max_range_m = 100.0, not 60.0; set it as it was, or record "
            "them again with: rail-sumo expert record --driver rule, who drives with any senses, or of an expert that",
        ),
        ("lidar.road_edges=false", "were recorded with lidar.road_edges = True, not False"),
        ("episode.decision_period_s=0.5", "were recorded with episode.decision_period_s = 1.0, not 0.5"),
    ],
)
def test_what_was_sensed_or_decided_otherwise_is_refused(tmp_path, override, message):
    path = tmp_path / "expert.parquet"
    three_episodes().save(path, features=FEATURES, about={"config": config_file.dumps(config.Config())})
    as_recorded = config_file.load(None, ["traffic.vehicles=3"]).demonstrating
    assert same(Demonstrations.load(path, features=FEATURES, demonstrating=as_recorded), three_episodes())
    with pytest.raises(InputError, match=re.escape(message)):
        Demonstrations.load(path, features=FEATURES, demonstrating=config_file.load(None, [override]).demonstrating)


@pytest.mark.parametrize(
    "said",
    [b"not json", b"[]", b'{"about": 3}', b'{"about": {"config": "x"}}', b'{"about": {"config": "lidar.m = 1"}}'],
)
def test_a_recording_whose_metadata_cannot_be_read_is_refused_in_one_line(tmp_path, said):
    path = tmp_path / "theirs.parquet"
    pq.write_table(pa.table(COLUMNS).replace_schema_metadata({METADATA_KEY: said}), path)
    wanted = config.Config().demonstrating
    with pytest.raises(InputError, match=r"tell of their recording what cannot be read \(.+\); record them") as raised:
        Demonstrations.load(path, features=FEATURES, demonstrating=wanted)
    assert str(raised.value).startswith(f"demonstrations '{path}'")
    assert "\n" not in str(raised.value)


def test_columns_are_found_by_name_not_by_place(tmp_path):
    path = tmp_path / "theirs.parquet"
    pq.write_table(pa.table(dict(reversed(COLUMNS.items()))), path)
    loaded = Demonstrations.load(path, features=FEATURES)
    assert loaded.observations.tolist() == [[100.0, 0.0], [7.5, -3.25]]
    assert loaded.actions.tolist() == [0, 4]
    assert loaded.allowed.all()  # a file need not tell


def without(name):
    return {column: values for column, values in COLUMNS.items() if column != name}


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (without("action"), "have no column 'action'"),
        (without("distance_0_m"), r"have 1 features \(no 'distance_0_m'\), the configuration wants 2"),
        (
            without("distance_0_m") | {"distance_1_m": pa.array([1.0, 1.0])},
            r"have 2 features \(no 'distance_0_m'\), the configuration wants 2, ",
        ),
        (
            COLUMNS | {"host_speed_mps": pa.array([1.0, 1.0])},
            r"have 3 features \(also 'host_speed_mps'\), the configuration wants 2, from 'distance_0_m' to "
            r"'relative_speed_0_mps'; add, rename or leave out columns, or set \[lidar\] and \[observation\] to what",
        ),
        (COLUMNS | {"distance_0_m": pa.array([1.0, np.nan])}, "'distance_0_m' must be finite, row 1 is nan"),
        (COLUMNS | {"distance_0_m": pa.array([np.inf, 1.0])}, "'distance_0_m' must be finite, row 0 is inf"),
        (COLUMNS | {"distance_0_m": pa.array([1.0, None])}, "'distance_0_m' must be finite, row 1 is nan"),
        (COLUMNS | {"distance_0_m": pa.array([1.0, 1e39])}, r"'distance_0_m' must be finite, row 1 is 1e\+39"),
        (COLUMNS | {"distance_0_m": pa.array(["far", "near"])}, "'distance_0_m' must hold floating-point numbers"),
        (COLUMNS | {"action": pa.array([0, 5])}, r"have an action 5; actions are 0\.\.4"),
        (COLUMNS | {"action": pa.array([-1, 0])}, r"have an action -1; actions are 0\.\.4"),
        (COLUMNS | {"action": pa.array([0.5, 0.0])}, "'action' must hold an integer in every row, not double"),
        (COLUMNS | {"episode": pa.array([0, None])}, "'episode' must hold an integer in every row, .* 1 missing"),
        ({name: values[:0] for name, values in COLUMNS.items()}, "hold no decision"),
        (COLUMNS | {"allowed_left": pa.array([True, True])}, "have no column 'allowed_keep', but others like it"),
        (COLUMNS | ALLOWED | {"allowed_right": pa.array([True, None])}, "'allowed_right' must hold true or false"),
        (COLUMNS | ALLOWED | {"allowed_left": pa.array([0, 1])}, "'allowed_left' must hold true or false"),
        (COLUMNS | ALLOWED | {"allowed_right": pa.array([True, False])}, "row 1 has an action that its columns"),
    ],
)
def test_a_file_with_something_wrong_is_refused_in_one_line(tmp_path, columns, message):
    path = tmp_path / "wrong.parquet"
    pq.write_table(pa.table(columns), path)
    with pytest.raises(InputError, match=message) as raised:
        Demonstrations.load(path, features=FEATURES)
    assert str(raised.value).startswith(f"demonstrations '{path}'")
    assert "\n" not in str(raised.value)
    assert str(raised.value).endswith("; docs/extending.md, 'Demonstrations of your own', describes the columns")


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ({}, "; docs/extending.md, 'Demonstrations of your own', describes"),
        ({"driver": "rule"}, "record them again with: rail-sumo expert"),
    ],
)
def test_only_what_was_recorded_is_to_be_recorded_again(tmp_path, about, told):
    path = tmp_path / "wrong.parquet"
    three_episodes().save(path, features=FEATURES, about=about)
    table = pq.read_table(path)
    for wrong in (
        table.slice(0, 0),
        table.drop_columns(["action"]),
        table.set_column(table.column_names.index("action"), "action", pa.array([9] * len(table))),
        table.append_column("host_speed_mps", pa.array([1.0] * len(table))),
        table.append_column("distance_0_m", table["distance_0_m"]),
    ):
        pq.write_table(wrong, path)
        with pytest.raises(InputError) as raised:
            Demonstrations.load(path, features=FEATURES)
        assert told in str(raised.value)


def test_who_has_stored_the_index_of_a_pandas_table_is_told_how_to_leave_it_out(tmp_path):
    path = tmp_path / "theirs.parquet"
    theirs = pd.DataFrame({name: values.to_pylist() for name, values in COLUMNS.items()}, index=[3, 7])
    theirs.to_parquet(path)
    message = (
        r"have a column '__index_level_0__', in which pandas keeps .*; leave it out: to_parquet\(\.\.\., index=False\)$"
    )
    with pytest.raises(InputError, match=message):
        Demonstrations.load(path, features=FEATURES)
    theirs.to_parquet(path, index=False)
    assert Demonstrations.load(path, features=FEATURES).actions.tolist() == [0, 4]
    theirs.drop(columns="distance_0_m").to_parquet(path)
    with pytest.raises(InputError, match=r"have 2 features \(no 'distance_0_m'\)"):
        Demonstrations.load(path, features=FEATURES)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.parquet' not found"):
        Demonstrations.load(tmp_path / "nowhere.parquet", features=FEATURES)


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.99])
def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path, kept):
    path = tmp_path / "cut.parquet"
    three_episodes().save(path, features=FEATURES, about={})
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(InputError, match="not a Parquet file, or a damaged one") as raised:
        Demonstrations.load(path, features=FEATURES)
    assert "\n" not in str(raised.value)


def test_where_nothing_can_be_written_the_user_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write '"):
        three_episodes().save(tmp_path / "file" / "expert.parquet", features=FEATURES, about={})


def test_every_feature_needs_a_name(tmp_path):
    with pytest.raises(ValueError, match="features must name 2 columns; got 1 names"):
        three_episodes().save(tmp_path / "never.parquet", features=FEATURES[:1], about={})


def test_arrays_must_belong_together():
    with pytest.raises(ValueError, match=r"got \(3, 2\), \(2,\), \(3,\) and all"):
        Demonstrations(np.zeros((3, 2)), np.zeros(2, dtype=np.int64), np.zeros(3, dtype=np.int64))
    with pytest.raises(ValueError, match=r"got \(3, 2\), \(3,\), \(3,\) and \(3, 4\)"):
        Demonstrations(np.zeros((3, 2)), [0, 1, 2], [0, 0, 0], np.ones((3, 4), dtype=np.bool_))


def test_lists_are_demonstrations_too():
    listed = Demonstrations([[1.0, 2.0], [3.0, 4.0]], [0, 4], [0, 0])
    assert same(listed, Demonstrations.from_trajectories([episode([[1.0, 2.0], [3.0, 4.0]], [0, 4])]))


@pytest.mark.parametrize(
    ("observations", "actions", "allowed", "message"),
    [
        ([[1.0, np.nan]], [0], None, "observations must be finite"),
        ([[1.0, 1e39]], [0], None, "observations must be finite"),
        ([[1.0, 2.0]], [7], None, r"actions must lie in 0\.\.4; got 7"),
        ([[1.0, 2.0]], [-1], None, r"actions must lie in 0\.\.4; got -1"),
        ([[1.0, 2.0]], [0.5], None, "actions must be integers; got float64"),
        ([[1.0, 2.0]], [[0]], None, r"got \(1, 2\), \(1, 1\), \(1,\) and all"),
        ([[1.0, 2.0]], [3], [[True, True, True, False, True]], "an action that was not allowed"),
        ([[1.0, 2.0]], [3], [[1, 1, 1, 1, 1]], "allowed must be true or false; got int64"),
    ],
)
def test_what_nobody_could_have_decided_is_refused(observations, actions, allowed, message):
    with pytest.raises(ValueError, match=message):
        Demonstrations(observations, actions, [0], allowed)


def test_what_a_driver_did_against_what_it_was_told_counts_as_allowed():
    told = np.array([[True, False, False, True, True], [True, True, True, False, False]])
    driven = dataclasses.replace(episode([[1.0, 2.0], [3.0, 4.0]], [1, 0]), allowed=told)
    assert Demonstrations.from_trajectories([driven]).allowed.tolist() == [
        [True, True, False, True, True],
        [True, True, True, False, False],
    ]
