"""Files that are damaged, of another kind, or meant to do harm: one clear line each, at once."""

import gzip

import pytest
from driving import EMPTY, world

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway import trial
from rail_sumo.highway.network import demand, road, sumocfg

NETWORK = assets.network("highway3").read_text()
BOMB = (
    '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 30}">' for k in range(9))
    + "]>"
)
XXE = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
NO_XML = {
    "empty": b"",
    "binary": bytes(range(256)) * 20,
    "prose": b"once upon a time",
    "json": b'{"a": 1}',
    "a page of the web": b"<html><body>404 not found</body></html>",
    "another kind of XML": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
    "cut": NETWORK.encode()[:1000],
    "cut while compressed": gzip.compress(NETWORK.encode())[:300],
    "compressed rubbish": b"\x1f\x8b" + bytes(range(200)),
    "a strange encoding": b'<?xml version="1.0" encoding="klingon"?><net/>',
    "bytes of another encoding": b"<net><!-- \xff\xfe\xfa --></net>",
    "a bomb": f'{BOMB}<net a="&j;">&j;</net>'.encode(),
    "another file as an entity": f"{XXE}<net>&e;</net>".encode(),
    "an attribute twice": b"<net a='1' a='2'/>",
}


def refused(given):
    with pytest.raises(InputError) as error:
        given()
    said = str(error.value)
    assert "\n" not in said
    assert len(said) < 500
    assert "root:" not in said  # of /etc/passwd


@pytest.mark.parametrize("content", NO_XML)
@pytest.mark.parametrize("key", ["network.file", "traffic.routes", "traffic.additional"])
def test_what_is_no_such_file_is_refused_in_one_line(tmp_path, content, key):
    path = tmp_path / "bad.net.xml"
    path.write_bytes(NO_XML[content])
    section, name = key.split(".")
    refused(lambda: trial.check(world(**{section: {name: str(path) if name == "file" else [str(path)]}})))


@pytest.mark.parametrize("content", NO_XML)
def test_what_is_no_configuration_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "bad.sumocfg"
    path.write_bytes(NO_XML[content])
    refused(lambda: sumocfg.read(path))


@pytest.mark.parametrize(
    ("name", "root"),
    [
        ("deep.net.xml", "net"),
        ("deep.rou.xml", "routes"),
        ("deep.add.xml", "additional"),
        ("deep.sumocfg", "configuration"),
    ],
)
def test_what_nests_so_deep_that_sumo_would_never_end_is_refused_in_one_line(tmp_path, name, root):
    path = tmp_path / name
    path.write_text(f'<{root} version="1.20">{"<a>" * 100_000}{"</a>" * 100_000}</{root}>')
    read = {
        "net": lambda: road.load(str(path)),
        "routes": lambda: demand.read(world(traffic={"routes": [str(path)]}).traffic),
        "additional": lambda: demand.read(world(traffic={"additional": [str(path)]}).traffic),
        "configuration": lambda: sumocfg.read(path),
    }[root]
    with pytest.raises(InputError, match=r"^'.*' has elements within one another, more than 100 deep"):
        read()


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ('speed="22.2222"', 'speed="-5"'),
        ('speed="22.2222"', 'speed="nan"'),
        ('speed="22.2222"', 'speed="fast"'),
        ('length="8200.0000"', 'length="-1"'),
        ('length="8200.0000"', 'length="nan"'),
        (' shape="0.0000,-3.2000 8200.0000,-3.2000"', ""),
        ('shape="0.0000,-3.2000 8200.0000,-3.2000"', 'shape="a,b c,d"'),
        ('id="highway_1"', 'id="highway_0"'),
        ('<junction id="east"', '<junction id="elsewhere"'),
    ],
)
def test_a_network_of_nonsense_is_refused_in_one_line(tmp_path, was, becomes):
    assert was in NETWORK
    path = tmp_path / "odd.net.xml"
    path.write_text(NETWORK.replace(was, becomes))
    refused(lambda: trial.check(world(network={"file": str(path)}, traffic=EMPTY)))


@pytest.mark.parametrize("speed", ["1e308", "inf"])
def test_a_limit_beyond_all_measure_is_none(tmp_path, speed):
    path = tmp_path / "fast.net.xml"
    path.write_text(NETWORK.replace('speed="22.2222"', f'speed="{speed}"'))
    assert trial.check(world(network={"file": str(path)}, traffic=EMPTY)).limits_kmh == (200, 200)


@pytest.mark.parametrize(
    "row",
    [
        '<vehicle id="a" depart="0"><route edges="nowhere"/></vehicle>',
        '<vehicle id="a" depart="noon"><route edges="highway"/></vehicle>',
        '<vehicle id="a" type="x" depart="0"><route edges="highway"/></vehicle>',
        '<flow id="f" begin="0" end="10" period="-1"><route edges="highway"/></flow>',
        '<flow id="f" begin="0" end="3600" number="2000000000"><route edges="highway"/></flow>',
        '<flow id="f" begin="0" end="3600" period="0.0001"><route edges="highway"/></flow>',
        '<vehicle id="a" depart="0"/>',
        '<vType id="t" length="-5"/><vehicle id="a" type="t" depart="0"><route edges="highway"/></vehicle>',
        '<trip id="t" depart="0" fromTaz="x" toTaz="y"/>',
        '<include href="."/>',
        '<include href="/etc/passwd"/>',
        "<include/>",
    ],
)
def test_demand_that_makes_no_sense_is_refused_in_one_line(tmp_path, row):
    path = tmp_path / "odd.rou.xml"
    path.write_text(f"<routes>{row}</routes>")
    refused(lambda: trial.check(world(traffic={"routes": [str(path)], "host": "replaces"})))
