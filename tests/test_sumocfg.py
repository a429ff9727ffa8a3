"""What is read of a .sumocfg."""

import pytest

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway.network import sumocfg
from rail_sumo.highway.network.sumo_xml import seconds

FULL = """<sumoConfiguration>
    <input>
        <net-file value=" in/my.net.xml"/>
        <route-files value="cars.rou.xml, in/lorries.rou.xml.gz,"/>
        <additional-files value="stops.add.xml"/>
    </input>
    <time><begin value="7:00:00"/><end value=""/></time>
    <processing><lateral-resolution value="0.8"/></processing>
    <output><fcd-output v="fcd.xml"/></output>
</sumoConfiguration>"""
KEYS = {
    "network.file": "{}/in/my.net.xml",
    "traffic.routes": ["{}/cars.rou.xml", "{}/in/lorries.rou.xml.gz"],
    "traffic.additional": ["{}/stops.add.xml"],
    "traffic.begin_s": 25200.0,
}


def written(tmp_path, text):
    path = tmp_path / "my.sumocfg"
    path.write_text(text)
    return path


def below(folder, value):
    return [name.format(folder) for name in value] if isinstance(value, list) else value.format(folder)


def test_network_demand_and_time_are_read_and_the_rest_is_told(tmp_path):
    keys, unread = sumocfg.read(written(tmp_path, FULL))
    assert keys == {key: value if key == "traffic.begin_s" else below(tmp_path, value) for key, value in KEYS.items()}
    assert unread == ["lateral-resolution", "fcd-output"]
    assert keys.keys() <= config.Config().flat().keys()


def test_sumos_other_names_for_its_options_are_read_too(tmp_path):
    other = FULL.replace("net-file", "n").replace("route-files", "routes").replace("additional-files", "additional")
    assert sumocfg.read(written(tmp_path, other.replace("begin", "b"))) == sumocfg.read(written(tmp_path, FULL))


def test_an_option_may_be_written_as_text(tmp_path):
    keys, _ = sumocfg.read(written(tmp_path, "<configuration><net-file> my.net.xml </net-file></configuration>"))
    assert keys == {"network.file": str(tmp_path / "my.net.xml")}


def test_a_network_alone_leaves_the_rest_as_it_is(tmp_path):
    keys, unread = sumocfg.read(written(tmp_path, '<configuration><net-file v="my.net.xml"/></configuration>'))
    assert keys == {"network.file": str(tmp_path / "my.net.xml")}
    assert unread == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<configuration>", r"^cannot read '.*my\.sumocfg': no element found"),
        (
            '<?xml version="1.0" encoding="Shift-JIS"?><c/>',
            r"^cannot read '.*my\.sumocfg': multi-byte encodings are not",
        ),
        ('<?xml version="1.0" encoding="latin-99"?><c/>', r"^cannot read '.*my\.sumocfg': unknown encoding"),
        ("<configuration/>", r"my\.sumocfg' names no net-file; rail-sumo needs a network to drive on$"),
        ('<c><net-file value=""/></c>', r"names no net-file"),
        (FULL.replace("7:00:00", "dawn"), r"my\.sumocfg' begins at 'dawn', which is no time$"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        sumocfg.read(written(tmp_path, text))


@pytest.mark.parametrize(
    ("time", "expected"), [("90", 90.0), ("90.5", 90.5), ("0:01:30", 90.0), ("7:00:00", 25200.0), ("1:0:0:1", 86401.0)]
)
def test_times_are_read_as_sumo_writes_them(time, expected):
    assert seconds(time) == expected


@pytest.mark.parametrize("time", ["", "triggered", "1:2:3:4:5", "1:x:3"])
def test_what_is_no_time_is_refused(time):
    with pytest.raises(ValueError, match=r"."):
        seconds(time)
