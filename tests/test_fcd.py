import gzip
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rail_sumo import assets
from rail_sumo.config import Traffic
from rail_sumo.errors import InputError
from rail_sumo.highway.network import demand, ground
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.pictures import fcd

HEADER = "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_speed\n"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What SUMO writes of one minute on the arterial, by suffix."""
    folder = tmp_path_factory.mktemp("fcd")
    files = {}
    for suffix in (".xml", ".csv", ".parquet", ".xml.gz"):
        files[suffix] = folder / f"fcd{suffix}"
        own = demand.read(Traffic(routes=(str(assets.routes("arterial")),)))
        outputs = ("--fcd-output", str(files[suffix]))
        with Simulation(assets.network("arterial"), demand=own, seed=1, outputs=outputs) as simulation:
            simulation.run_until(60.0)
    return files


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".xml.gz"])
def test_every_format_gives_the_same_film(written, suffix):
    one, other = fcd.read(written[".xml"]), fcd.read(written[suffix])
    assert one.vehicles == other.vehicles
    assert (one.start_s, one.step_s, one.n_frames) == (other.start_s, other.step_s, other.n_frames)
    assert np.array_equal(one.frame, other.frame)
    assert np.array_equal(one.vehicle, other.vehicle)
    for column in ("x_m", "y_m", "heading_rad", "speed_mps"):
        assert getattr(one, column) == pytest.approx(getattr(other, column), abs=0.01)


def test_a_vehicle_is_where_sumo_says_its_front_is(written):
    film, table = fcd.read(written[".csv"]), pd.read_csv(written[".csv"], sep=";").dropna(subset="vehicle_id")
    assert len(film.frame) == len(table) > 1000
    half_m = np.array([film.vehicles[k].length_m for k in film.vehicle]) / 2
    assert film.x_m + half_m * np.cos(film.heading_rad) == pytest.approx(table["vehicle_x"].to_numpy(), abs=1e-9)
    assert film.y_m + half_m * np.sin(film.heading_rad) == pytest.approx(table["vehicle_y"].to_numpy(), abs=1e-9)
    east = film.heading_rad[np.flatnonzero(table["vehicle_angle"] == 90.0)]
    assert east == pytest.approx(np.zeros(len(east)))
    times = film.start_s + film.step_s * film.frame
    assert times == pytest.approx(table["timestep_time"].to_numpy())
    assert [film.vehicles[k].id for k in film.vehicle] == table["vehicle_id"].tolist()


def test_a_part_of_the_time(written):
    film = fcd.read(written[".parquet"], begin_s=20.0, end_s=30.0)
    assert (film.start_s, film.n_frames) == (20.0, 101)
    with pytest.raises(InputError, match=re.escape("has no vehicles from 100 to 200 s; it is of ")):
        fcd.read(written[".parquet"], begin_s=100.0, end_s=200.0)


def test_of_long_data_every_so_many_moments_are_shown_and_the_film_says_so(written, monkeypatch):
    whole = fcd.read(written[".parquet"])
    monkeypatch.setattr(fcd, "MOST_ROWS", len(whole.frame) // 4 + 1)
    film = fcd.read(written[".parquet"])
    assert film.step_s == pytest.approx(0.4)
    assert film.left_out == f"One moment of 4 is shown, {len(film.frame)} positions in all."
    kept = whole.frame % 4 == 0
    assert np.array_equal(film.frame, whole.frame[kept] // 4)
    assert np.array_equal(film.x_m, whole.x_m[kept])
    assert not whole.left_out


def test_sizes_go_by_what_types_are_called(tmp_path):
    file = tmp_path / "fcd.csv"
    file.write_text(
        "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_speed;vehicle_type\n"
        "0;a;0;0;90;1;my_Truck_40t\n0;b;0;5;90;1;DEFAULT_VEHTYPE\n0;7;0;9;0;1;citybus\n0;c;0;9;0;1;business_car\n"
        "0;d;0;9;0;1;DEFAULT_BIKETYPE\n0;e;0;9;0;1;rail_sumo_host@e\n"
    )
    vehicles = fcd.read(file).vehicles
    assert [(one.id, one.vclass, one.length_m) for one in vehicles] == [
        ("a", "truck", 7.1),
        ("b", "passenger", 5.0),
        ("7", "bus", 12.0),
        ("c", "passenger", 5.0),
        ("d", "bicycle", 1.6),
        ("e", "driven car", 5.0),
    ]


def read_rows(tmp_path, *rows):
    file = tmp_path / "fcd.csv"
    file.write_text(HEADER + "".join(f"{row}\n" for row in rows))
    return fcd.read(file)


def test_an_id_may_look_like_a_missing_value(tmp_path):
    film = read_rows(tmp_path, "0;NA;0;0;90;1", "0;null;9;0;90;1", "0;;;;;")
    assert [one.id for one in film.vehicles] == ["NA", "null"]


def test_rows_without_a_place_or_speed_are_left_out_and_a_row_that_is_there_twice_counts_once(tmp_path):
    film = read_rows(tmp_path, "0;a;0;0;90;1", "0;a;0;0;90;1", "1;a;5;0;90;", "2;a;9;0;90;1", "2;b;inf;0;90;1")
    assert film.frame.tolist() == [0, 1]
    assert film.step_s == 2.0
    assert [one.id for one in film.vehicles] == ["a"]


def test_uneven_times_are_shown_one_after_the_other(tmp_path):
    film = read_rows(tmp_path, "0;a;0;0;90;1", "3;a;5;0;90;1", "5;a;9;0;90;1")
    assert film.frame.tolist() == [0, 1, 2]
    assert film.step_s == 2.5


def test_a_gap_in_time_stays_one(tmp_path):
    film = read_rows(tmp_path, "100;a;0;0;90;1", "100.5;a;5;0;90;1", "102;a;9;0;90;1")
    assert (film.start_s, film.step_s, film.frame.tolist()) == (100.0, 0.5, [0, 1, 4])


def test_too_long_a_time_is_to_be_cut(tmp_path):
    says = "'fcd.csv' lasts from 0 to 5e\\+09 s, 5000000000 steps of 1 s; cut out a part with --begin and --end"
    with pytest.raises(InputError, match=says):
        read_rows(tmp_path, "0;a;0;0;90;1", "1;a;5;0;90;1", "5e9;a;9;0;90;1")


@pytest.mark.parametrize("left_out", ["x", "angle", "speed"])
def test_xml_without_what_is_needed_is_told_so(tmp_path, left_out):
    given = {"id": "a", "x": "1", "y": "2", "angle": "90", "speed": "3"}
    del given[left_out]
    row = " ".join(f'{name}="{value}"' for name, value in given.items())
    file = tmp_path / "fcd.xml"
    file.write_text(f'<fcd-export><timestep time="0"><vehicle {row}/></timestep></fcd-export>')
    says = "has no vehicles in it" if left_out == "x" else f"it has no vehicle_{left_out}; write them with"
    with pytest.raises(InputError, match=says):
        fcd.read(file)


def test_compressed_csv_is_read_too(tmp_path):
    file = tmp_path / "fcd.csv.gz"
    file.write_bytes(gzip.compress(f"{HEADER}0;a;0;0;90;1\n".encode()))
    assert fcd.read(file).vehicles[0].id == "a"


def test_data_of_another_network_are_refused(written):
    film = fcd.read(written[".xml"])
    fcd.require_same_network(film, ground.near("arterial", film.x_m, film.y_m))
    with pytest.raises(InputError, match=r"is of another network than 'ring5': 1[89].. of 2000 positions are far"):
        fcd.require_same_network(film, ground.near("ring5", film.x_m, film.y_m))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is no floating-car data of SUMO's, or is damaged"),
        (b"PAR1 and nothing that follows", "is no floating-car data of SUMO's, or is damaged"),
        (b"<fcd-export><timestep time='0'><vehicle id='a' x='1'", "is no floating-car data of SUMO's, or is damaged"),
        (b"<fcd-export><timestep time='soon'/></fcd-export>", "is no floating-car data of SUMO's, or is damaged"),
        (b"<net><edge id='a'/></net>", "is no floating-car data of SUMO's, or is damaged: it has no <timestep>"),
        (b"\x1f\x8b\x08\x00 not gzip", "is no floating-car data of SUMO's, or is damaged"),
        (b"\x7fELF\x02\x01\x01\x00\xd0\xff", "is no floating-car data of SUMO's"),
        (b"a,b\n1,2\n", "it has no timestep_time, vehicle_id, vehicle_x, vehicle_y, vehicle_angle, vehicle_speed;"),
        (HEADER.replace("_speed", "_pos").encode(), "it has no vehicle_speed; write them with --fcd-output.attributes"),
        (HEADER.encode(), "has no vehicles in it"),
        ((HEADER + "0;a;here;0;90;1\n").encode(), "is no floating-car data of SUMO's, or is damaged"),
    ],
)
def test_what_is_no_floating_car_data_is_told_in_one_line(tmp_path, content, says):
    file = tmp_path / "odd.dat"
    file.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(says)) as told:
        fcd.read(file)
    assert "\n" not in str(told.value)


def test_a_folder_and_a_file_that_is_not_there(tmp_path):
    for path in (tmp_path, Path("nowhere.xml")):
        with pytest.raises(InputError, match="cannot read floating-car data"):
            fcd.read(path)
