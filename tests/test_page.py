import base64
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from typing import get_args

import numpy as np
import pytest
from films import HOSTILE, drive, motorway, town
from hypothesis import given, settings
from hypothesis import strategies as st

from rail_sumo.errors import InputError
from rail_sumo.film import Film, Ground, Holding, Lane, MarkKind, Stays, Vehicle, Why
from rail_sumo.pictures import packed, page
from rail_sumo.pictures.packed import QUANTA
from rail_sumo.records import EndReason, MetaAction

NOWHERE = Ground((), (), (), "nowhere")


class Scripts(HTMLParser):
    """What a browser takes for elements: scripts by id, and the other tags."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.tags, self._at = {}, [], None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self._at = dict(attributes).get("id", f"script {len(self.scripts)}") if tag == "script" else None
        if self._at:
            self.scripts[self._at] = ""

    def handle_endtag(self, tag):
        self._at = None

    def handle_data(self, data):
        if self._at:
            self.scripts[self._at] += data


def varints(encoded, count):
    """Read as protocol buffers' documentation says, one by one."""
    values, value, shift = [], 0, 0
    for byte in encoded:
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            values.append((value >> 1) ^ -(value & 1))
            value, shift = 0, 0
    assert len(values) == count
    return values


def opened(blob):
    raw = zlib.decompress(blob)
    end = 4 + int.from_bytes(raw[:4], "little")
    header, streams = json.loads(raw[4:end]), {}
    for name, (count, size) in header["streams"].items():
        streams[name] = varints(raw[end : end + size], count)
        end += size
    assert end == len(raw)
    return header, streams


def unpacked(blob, origin):
    """Return a film's header, and {(vehicle, frame): (x, y, heading, speed)}."""
    header, streams = opened(blob)
    rows, vehicle, at = {}, 0, 0
    spans = zip(streams["span_vehicle"], streams["span_first"], streams["span_length"], strict=True)
    for step, first, length in spans:
        vehicle += step
        columns = {key: streams[key][at : at + length] for key in ("x", "y", "heading", "speed")}
        heading, speed = np.cumsum(columns["heading"]), np.cumsum(columns["speed"])
        x, y = (_twice(columns[key]) for key in "xy")
        for k in range(length):
            place = (origin[0] + x[k] * QUANTA["position_m"], origin[1] + y[k] * QUANTA["position_m"])
            rows[vehicle, first + k] = (*place, heading[k] * QUANTA["heading_rad"], speed[k] * QUANTA["speed_mps"])
        at += length
    return header, rows


def _twice(differences):
    found = list(differences[:1])
    step = 0
    for change in differences[1:]:
        step += change
        found.append(found[-1] + step)
    return found


def film(rows, **fields):
    """A film of (frame, vehicle, x, y, heading, speed)."""
    columns = np.array(rows, dtype=float).reshape(-1, 6).T
    n_vehicles = int(columns[1].max(initial=-1)) + 1
    return Film(
        **{
            "name": "film",
            "start_s": 0.0,
            "step_s": 0.1,
            "n_frames": int(columns[0].max(initial=0)) + 1,
            "vehicles": tuple(Vehicle(f"veh{who}", "passenger", 4.6, 1.8) for who in range(n_vehicles)),
            "frame": columns[0].astype(np.int32),
            "vehicle": columns[1].astype(np.int32),
            "x_m": columns[2],
            "y_m": columns[3],
            "heading_rad": columns[4],
            "speed_mps": columns[5],
        }
        | fields
    )


NUMBERS = st.floats(-1e5, 1e5)
ROWS = st.dictionaries(
    st.tuples(st.integers(0, 40), st.integers(0, 3)),
    st.tuples(NUMBERS, NUMBERS, st.floats(-20, 20), st.floats(0, 90)),
    max_size=60,
)


@given(ROWS)
@settings(deadline=None)
def test_a_film_is_packed_to_the_quantum(rows):
    shown = film([(*key, *values) for key, values in sorted(rows.items())])
    _, found = unpacked(packed.pack_film(shown, (-1e5, -1e5)), (-1e5, -1e5))
    assert set(found) == {(vehicle, frame) for frame, vehicle in rows}
    for (frame, vehicle), (x, y, heading, speed) in rows.items():
        there = found[vehicle, frame]
        assert there[:2] == pytest.approx((x, y), abs=0.5 * QUANTA["position_m"] + 1e-9)
        turn = (there[2] - heading + np.pi) % (2 * np.pi) - np.pi
        assert abs(turn) <= 0.5 * QUANTA["heading_rad"] + 1e-9
        assert there[3] == pytest.approx(speed, abs=0.5 * QUANTA["speed_mps"] + 1e-9)


@given(st.lists(st.integers(-(2**31), 2**31 - 1), max_size=50))
def test_integers_come_back_from_their_bytes(values):
    assert varints(packed._varints(np.array(values, dtype=np.int64)), len(values)) == values


def test_what_the_driver_saw_and_decided_is_packed_to_the_quantum():
    shown = drive(5, seconds=12.0, n_vehicles=8)
    driven = shown.driven
    header, streams = opened(packed.pack_film(shown, (0.0, 0.0)))
    rays = np.cumsum(np.reshape(streams["ray"], (-1, shown.n_frames)), axis=1).T * QUANTA["ray_m"]
    np.testing.assert_allclose(rays, driven.ray_m, atol=0.5 * QUANTA["ray_m"] + 1e-9)
    for name, quantum in (("set", "speed_mps"), ("limit", "speed_mps")):
        found = np.cumsum(streams[name]) * QUANTA[quantum]
        np.testing.assert_allclose(found, getattr(driven, f"{name}_mps"), atol=0.5 * QUANTA[quantum] + 1e-9)
    gap = np.where(np.cumsum(streams["has_gap"]), np.cumsum(streams["gap"]) * QUANTA["gap_m"], np.nan)
    np.testing.assert_allclose(gap, driven.gap_m, atol=0.5 * QUANTA["gap_m"] + 1e-9)
    np.testing.assert_array_equal(np.cumsum(streams["holding"]), driven.holding)
    assert len(header["driven"]["decisions"]) == len(driven.decisions) > 10
    for written, decision in zip(header["driven"]["decisions"], driven.decisions, strict=True):
        frame, asked, carried_out, why, is_open, shares, judged, stays = written
        assert (frame, asked, carried_out, why) == (decision.frame, decision.asked, decision.carried_out, decision.why)
        assert stays == decision.stays
        assert tuple(map(bool, is_open)) == decision.open
        np.testing.assert_allclose(np.array(shares) * 1e-4, decision.probabilities, atol=0.51e-4)
        assert judged * 1e-4 == pytest.approx(decision.judged, abs=0.51e-4)
    assert header["driven"]["marks"] == [[mark.frame, mark.kind, mark.text] for mark in driven.marks]
    assert header["driven"]["end_reason"] == driven.end_reason == "duration"
    assert header["signals"] == [[list(change) for change in line] for line in shown.signals]


def test_the_ground_is_packed_to_the_quantum():
    ground = motorway()
    header, streams = opened(packed.pack_ground(ground, (468_000.0, 5_539_000.0)))
    at = 0
    for shape, count in zip(
        [lane.points for lane in ground.lanes] + list(ground.junctions), streams["counts"], strict=True
    ):
        x, y = (np.cumsum(streams[key][at : at + count]) * QUANTA["position_m"] for key in "xy")
        np.testing.assert_allclose(np.column_stack([x + 468_000, y + 5_539_000]), shape, atol=0.0051)
        at += count
    assert [lane[0] for lane in header["lanes"]] == [lane.id for lane in ground.lanes]
    assert [lane[1:] for lane in header["lanes"][:2]] == [[350, 1, 0, "dashed"], [350, 1, 0, "dashed"]]
    ends = np.column_stack([streams["stop_x"], streams["stop_y"]]) * QUANTA["position_m"] + (468_000, 5_539_000)
    np.testing.assert_allclose(ends.reshape(-1, 4), [line.ends for line in ground.stop_lines], atol=0.0051)


def test_names_from_a_users_files_end_no_element_of_the_page():
    hostile = drive(1, name=HOSTILE, seconds=2.0, n_vehicles=3, ids=[f"{HOSTILE}{who}" for who in range(3)])
    usual = drive(1, seconds=2.0, n_vehicles=3)
    lane = replace(motorway().lanes[0], id=HOSTILE)
    with_hostile = page.whole_page(
        Ground((lane,), (), (), HOSTILE), [replace(hostile, signals=())], title=HOSTILE, about={HOSTILE: HOSTILE}
    )
    without = page.whole_page(
        Ground((lane,), (), (), "road"), [replace(usual, signals=())], title="title", about={"a": "b"}
    )
    found = Scripts(with_hostile)
    assert found.tags == Scripts(without).tags
    head = json.loads(found.scripts["head"])
    assert (head["title"], head["about"]) == (HOSTILE, {HOSTILE: HOSTILE})
    header, _ = opened(base64.b64decode(found.scripts["film-0"]))
    assert [vehicle[0] for vehicle in header["vehicles"]] == [f"{HOSTILE}{who}" for who in range(3)]


def test_a_name_that_looks_like_a_part_of_the_page_is_not_taken_for_it():
    text = page.whole_page(NOWHERE, [film([(0, 0, 0, 0, 0, 0)])], title="<!-- data --> \\1", about={})
    assert text.count('id="head"') == 1
    assert "&lt;!-- data --&gt; \\1</title>" in text


def test_the_page_names_nothing_to_fetch():
    text = page.whole_page(motorway(), [drive(1, seconds=2.0, n_vehicles=2)], title="t", about={})
    found = Scripts(text)
    assert "link" not in found.tags
    assert not re.search(r"""\s(src|href)\s*=\s*["']""", text)
    assert "default-src 'none'" in text
    assert "url(" not in text


def test_five_minutes_of_noisy_driving_stay_below_a_megabyte_and_a_half():
    shown = drive(1, seconds=300.0, n_vehicles=20)
    rng = np.random.default_rng(0)
    everywhere = np.arange(20 * shown.n_frames)
    rows = {
        "frame": (everywhere // 20).astype(np.int32),
        "vehicle": (everywhere % 20).astype(np.int32),
        "x_m": everywhere // 20 * 2.5 + rng.normal(0, 0.03, len(everywhere)),
        "y_m": rng.normal(0, 0.03, len(everywhere)),
        "heading_rad": rng.normal(0, 0.005, len(everywhere)),
        "speed_mps": 25 + rng.normal(0, 0.3, len(everywhere)),
    }
    driven = replace(
        shown.driven, ray_m=np.clip(shown.driven.ray_m + rng.normal(0, 1, shown.driven.ray_m.shape), 0, 100)
    )
    text = page.whole_page(motorway(), [replace(shown, driven=driven, **rows)], title="noise", about={})
    assert len(text.encode()) < 1_500_000


def test_a_thousand_vehicles_for_ten_minutes_fit_into_four_megabytes():
    ground, crowd = town(1, n_vehicles=1_000)
    assert len(page.whole_page(ground, [crowd], title="town", about={}).encode()) < 4_000_000


def test_a_page_is_not_replaced_unless_told_so(tmp_path):
    file = tmp_path / "new" / "page.html"
    films = [film([(0, 0, 1, 2, 0, 0)])]
    page.write(NOWHERE, films, file, title="first", about={})
    with pytest.raises(InputError, match="exists"):
        page.write(NOWHERE, films, file, title="second", about={})
    assert "<title>first</title>" in file.read_text(encoding="utf-8")
    page.write(NOWHERE, films, file, title="second", about={}, overwrite=True)
    assert "<title>second</title>" in file.read_text(encoding="utf-8")
    assert [path.name for path in file.parent.iterdir()] == ["page.html"]


def test_a_film_without_anybody_and_a_ground_without_lanes_make_a_page():
    text = page.whole_page(NOWHERE, [film([], n_frames=3)], title="empty", about={})
    header, rows = unpacked(base64.b64decode(Scripts(text).scripts["film-0"]), (0, 0))
    assert (header["n_frames"], rows) == (3, {})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"x_m": np.array([np.nan, 0.0])}, "not a number"),
        ({"frame": np.array([0, 0], dtype=np.int32)}, "twice"),
        ({"frame": np.array([0, 9], dtype=np.int32)}, "a frame outside"),
        ({"vehicle": np.array([0, 3], dtype=np.int32)}, "a vehicle outside"),
        ({"y_m": np.zeros(3)}, "differ in shape"),
        ({"step_s": 0.0}, "frames of"),
        ({"signals": (((0, "r"),),)}, "stop lines"),
    ],
)
def test_a_film_that_contradicts_itself_is_refused(change, told):
    good = film([(0, 0, 0, 0, 0, 0), (1, 0, 1, 0, 0, 0)])
    packed.check_film(good, NOWHERE)
    with pytest.raises(ValueError, match=told):
        packed.check_film(replace(good, **change), NOWHERE)


def test_what_the_driver_saw_fits_the_film_or_is_refused():
    good = drive(2, seconds=3.0, n_vehicles=2)
    packed.check_film(good, motorway())
    n = good.n_frames
    bad = {
        "one row per frame": {"ray_m": good.driven.ray_m[:-1]},
        "limit is not a number": {"limit_mps": np.full(n, np.nan)},
        "the host is vehicle 7": {"vehicle": 7},
        "outside 0 to": {"holding": np.full(n, len(get_args(Holding)), dtype=np.int8)},
        "outside the film": {"marks": (replace(good.driven.marks[0], frame=n),)},
        "unknown kind": {"marks": (replace(good.driven.marks[0], kind="nap"),)},
        "ended for an unknown reason": {"end_reason": "boredom"},
        "with an unknown reason": {"decisions": (replace(good.driven.decisions[0], why="mood"),)},
        "at an unknown place": {"decisions": (replace(good.driven.decisions[0], stays="put"),)},
    }
    for told, change in bad.items():
        with pytest.raises(ValueError, match=told):
            packed.check_film(replace(good, driven=replace(good.driven, **change)), motorway())


def test_one_film_or_two():
    one = film([(0, 0, 0, 0, 0, 0)])
    for films in ([], [one] * 3):
        with pytest.raises(ValueError, match="one or two"):
            page.whole_page(NOWHERE, films, title="t", about={})


def test_what_lies_too_far_apart_to_be_packed_is_refused():
    far = film([(0, 0, 0, 0, 0, 0), (1, 0, 1e8, 0, 0, 0)])
    with pytest.raises(ValueError, match="too large"):
        page.whole_page(NOWHERE, [far], title="t", about={})


def test_modules_are_joined_in_the_order_of_what_they_import():
    folder = page._FOLDER
    assert sorted(path.stem for path in folder.glob("*.js")) == sorted(page.MODULES)
    for place, name in enumerate(page.MODULES):
        source = (folder / f"{name}.js").read_text(encoding="utf-8")
        imported = re.findall(r'from "\./(\w+)\.js"', source)
        assert set(imported) <= set(page.MODULES[:place]), name
    joined = page.joined_modules()
    assert not re.search(r"^(import|export)\b", joined, re.MULTILINE)
    assert "<!--" not in joined
    assert "</script" not in joined
    names = re.findall(r"^(?:async )?(?:function|class|const|let) (\w+)", joined, re.MULTILINE)
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize(
    ("table", "kinds"),
    [
        ("ENDS", get_args(EndReason)),
        ("HOLDINGS", get_args(Holding)),
        ("REFUSALS", set(get_args(Why)) - {""}),
        ("STAYS", set(get_args(Stays)) - {""}),
        ("MARKS", get_args(MarkKind)),
        ("ACTION_LABELS", [action.name.lower() for action in MetaAction]),
    ],
)
def test_the_page_has_words_for_everything_that_a_film_may_hold(table, kinds):
    words = (page._FOLDER / "words.js").read_text(encoding="utf-8")
    body = re.search(rf"const {table} = {{(.*?)}};", words, re.DOTALL)[1]
    assert set(re.findall(r'(?:^|[,{])\s*"?([A-Za-z][A-Za-z ]*)"?: ["{]', body)) - {"label"} >= set(kinds)


def test_every_lane_of_two_points_or_more_and_their_lines():
    lane = Lane("a_0", np.array([[0.0, 0.0], [3.0, 4.0]]), 3.2, True, False, "none")
    header, streams = opened(packed.pack_ground(Ground((lane,), (), (), "g"), (0.0, 0.0)))
    assert (streams["counts"], streams["x"], streams["y"]) == ([2], [0, 300], [0, 400])
    assert header["lanes"] == [["a_0", 320, 1, 0, "none"]]
