"""What SUMO's configurations say, as SUMO reads them."""

import pytest

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway.network import sumocfg
from rail_sumo.highway.network.sumo_xml import is_configuration, seconds

FULL = """<configuration>
    <input>
        <net-file value="in/my.net.xml"/>
        <route-files value="cars.rou.xml, in/lorries.rou.xml.gz,"/>
        <additional-files value="stops.add.xml"/>
        <weight-files value="in/weights.xml"/>
    </input>
    <time><begin value="7:00:00"/><end value="9:00:00"/></time>
    <processing><lateral-resolution value="0.8"/><scale value="1.5"/><time-to-teleport value="120"/></processing>
    <output><fcd-output value="fcd.xml"/></output>
    <report><verbose value="true"/><log value="all.log"/></report>
    <gui_only><start value="true"/></gui_only>
</configuration>"""
KEYS = {
    "network.file": "{}/in/my.net.xml",
    "traffic.routes": ["{}/cars.rou.xml", "{}/in/lorries.rou.xml.gz"],
    "traffic.additional": ["{}/stops.add.xml"],
    "traffic.begin_s": 25200.0,
    "traffic.options": ["weight-files={}/in/weights.xml", "scale=1.5", "time-to-teleport=120"],
}


def written(tmp_path, text, name="my.sumocfg"):
    path = tmp_path / name
    path.write_text(text)
    return path


def below(folder, value):
    if isinstance(value, float):
        return value
    return [name.format(folder) for name in value] if isinstance(value, list) else value.format(folder)


@pytest.mark.parametrize(
    ("end", "entry"),
    [
        ("7:03:00", (45.0, 90.0)),  # of 180 s a quarter to warm up, the host enters in the half after it
        ("7:10:00", (60.0, 480.0)),
        ("9:00:00", None),
        ("-1", None),  # none
        ("6:00:00", None),
    ],
)
def test_the_host_enters_well_before_the_end_of_a_configuration(tmp_path, end, entry):
    keys, _ = sumocfg.read(written(tmp_path, FULL.replace("9:00:00", end)))
    told = (keys.get("traffic.warm_up_s"), keys.get("traffic.entry_within_s"))
    assert told == (entry or (None, None))


def test_all_holds_but_what_must_be_ours_which_is_told_where_it_matters(tmp_path, capfd):
    keys, told = sumocfg.read(written(tmp_path, FULL))
    assert keys == {key: below(tmp_path, value) for key, value in KEYS.items()}
    usual = {"step-length": "1 s by default"}
    assert told == {"fcd-output": str(tmp_path / "fcd.xml"), "end": "9:00:00", "lateral-resolution": "0.8"} | usual
    as_ours = FULL.replace("<processing>", '<processing><step-length value="0.1"/>')
    assert "step-length" not in sumocfg.read(written(tmp_path, as_ours))[1]
    assert keys.keys() <= config.Config().flat().keys()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my.sumocfg"]  # no log, no output
    assert capfd.readouterr() == ("", "")


def test_sumos_short_and_old_names_and_any_section_will_do(tmp_path):
    other = FULL.replace("net-file", "n").replace("route-files", "routes").replace("additional-files", "a")
    other = (
        other.replace("<processing>", "").replace("</processing>", "").replace('begin value="7:00:00"', 'b v="25200"')
    )
    assert sumocfg.read(written(tmp_path, other)) == sumocfg.read(written(tmp_path, FULL))


def test_paths_are_read_as_sumo_reads_them(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for name in ("a.rou.xml", "b.rou.xml", "ring road.rou.xml"):
        (tmp_path / "in" / name).touch()
    monkeypatch.setenv("DEMAND", "in")
    monkeypatch.setenv("NETWORKS", "/somewhere")
    keys, _ = sumocfg.read(
        written(
            tmp_path,
            '<configuration><net-file value="${NETWORKS}/m.net.xml"/><route-files value="in\\..\\in/ring%20road.rou.xml'
            ',${DEMAND}/a.rou.xml,in/a.rou.xml in/b.rou.xml"/></configuration>',
        )
    )
    assert keys["network.file"] == "/somewhere/m.net.xml"
    folder = tmp_path / "in"
    assert keys["traffic.routes"] == [
        *(f"{folder}/ring road.rou.xml", f"{folder}/a.rou.xml", f"{folder}/a.rou.xml", f"{folder}/b.rou.xml")
    ]


def test_names_may_lead_out_of_the_configurations_folder(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    text = '<configuration><n v="../there/m.net.xml"/><r v="./d.rou.xml"/></configuration>'
    keys, _ = sumocfg.read(written(tmp_path / "here", text).relative_to(tmp_path / "here"))
    assert (keys["network.file"], keys["traffic.routes"]) == ("../there/m.net.xml", ["d.rou.xml"])


def test_a_path_of_another_computer_is_told_as_it_stands_in_the_configuration(tmp_path):
    text = '<configuration><n v="C:\\roads\\m.net.xml"/><r v="d:/demand.rou.xml"/></configuration>'
    keys, _ = sumocfg.read(written(tmp_path, text))
    assert (keys["network.file"], keys["traffic.routes"]) == ("C:/roads/m.net.xml", ["d:/demand.rou.xml"])


def test_a_network_alone_leaves_the_rest_as_it_is(tmp_path):
    keys, told = sumocfg.read(written(tmp_path, '<configuration><net-file v="my.net.xml"/></configuration>'))
    assert keys == {"network.file": str(tmp_path / "my.net.xml")}
    assert told == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<configuration>", r"^'.*my\.sumocfg' is not a complete XML file: no element found: line 1"),
        ("<configuration/>", r"my\.sumocfg' names no net-file; rail-sumo needs a network to drive on$"),
        ('<c><net-file value=""/></c>', r"names no net-file"),
        (
            '<c><n v="m.net.xml"/><no-such value="1"/></c>',
            r"^cannot read '.*': No option with the name 'no-such' exists",
        ),
        (FULL.replace("7:00:00", "dawn"), r"dawn"),
    ],
)
def test_what_sumo_cannot_read_is_refused_in_its_words(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        sumocfg.read(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        (FULL, True),
        ('<sumoConfiguration xmlns:x="y"><n v="m"/></sumoConfiguration>', True),
        ("<net/>", False),
        ("<routes/>", False),
        ("<configuration", False),
        ("", False),
    ],
)
@pytest.mark.parametrize("name", ["my.sumocfg", "x.sumo.cfg", "x.net.xml"])
def test_a_configuration_is_told_by_its_content(tmp_path, text, is_one, name):
    assert is_configuration(written(tmp_path, text, name)) == is_one


@pytest.mark.parametrize(
    ("time", "expected"), [("90", 90.0), ("90.5", 90.5), ("0:01:30", 90.0), ("7:00:00", 25200.0), ("1:0:0:1", 86401.0)]
)
def test_times_are_read_as_sumo_writes_them(time, expected):
    assert seconds(time) == expected


@pytest.mark.parametrize("time", ["", "triggered", "1:2:3:4:5", "1:x:3"])
def test_what_is_no_time_is_refused(time):
    with pytest.raises(ValueError, match=r"."):
        seconds(time)
