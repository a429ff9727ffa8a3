from pathlib import Path

import pytest

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway.network import demand


def written(tmp_path, content, name="own.rou.xml"):
    path = tmp_path / name
    path.write_text(content)
    return str(path)


@pytest.mark.parametrize("element", ["vehicle", "flow", "trip"])
def test_demand_with_traffic_passes_though_it_lies_in_another_file_than_the_types(tmp_path, element):
    types = written(tmp_path, '<routes><vType id="car"/></routes>', "types.rou.xml")
    traffic = written(tmp_path, f'<routes><{element} id="0"/></routes>')
    assert [str(path) for path in demand.check([types, traffic])[0]] == [types, traffic]
    with pytest.raises(InputError, match="has no <vehicle>, <flow> or <trip>"):
        demand.check([types])


def test_shipped_demand_passes_and_no_demand_is_no_mistake():
    names = assets.network_names()
    assert [path.name for path in demand.check(names)[0]] == [f"{name}.rou.xml" for name in names]
    assert demand.check([]) == ((), ())


def test_broken_or_missing_demand_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"^routes 'higway5' not found; did you mean 'highway5'\?"):
        demand.check(["higway5"])
    with pytest.raises(InputError, match="is not a complete XML file: no element found"):
        demand.check([written(tmp_path, '<routes><vehicle id="0"/>')])
    with pytest.raises(InputError, match="is not a complete XML file: multi-byte encodings are not supported"):
        demand.check([written(tmp_path, '<?xml version="1.0" encoding="GBK"?><routes/>')])


def test_additional_files_are_read_too_and_refused_in_the_place_of_routes(tmp_path):
    traffic = written(tmp_path, '<routes><vehicle id="0"/></routes>')
    stops = written(tmp_path, '<additional><busStop id="s"/></additional>', "stops.add.xml")
    assert [str(path) for path in demand.check([traffic], [stops])[1]] == [stops]
    with pytest.raises(
        InputError, match=r"has <busStop>, which .* move it to a file of its own, and name that in traffic\.additional$"
    ):
        demand.check([traffic, stops])
    with pytest.raises(InputError, match=r"^additional file 'none\.add\.xml' does not exist"):
        demand.check([traffic], ["none.add.xml"])
    with pytest.raises(InputError, match=r"no element found"):
        demand.check([traffic], [written(tmp_path, "<additional>", "cut.add.xml")])


def test_vehicles_in_an_additional_file_are_refused_beside_made_traffic_alone(tmp_path):
    trips = written(tmp_path, '<additional><trip id="0"/></additional>', "trips.add.xml")
    with pytest.raises(
        InputError, match=r"trips\.add\.xml' puts vehicles on the road.* traffic\.routes \(--routes\), "
    ):
        demand.check([], [trips])
    traffic = written(tmp_path, '<routes><vehicle id="1"/></routes>')
    assert [str(path) for path in demand.check([traffic], [trips])[1]] == [trips]


def test_an_included_file_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"own\.rou\.xml' includes 'more\.rou\.xml', .*; name that file itself$"):
        demand.check([written(tmp_path, '<routes><include href="more.rou.xml"/></routes>')])


def test_the_folders_that_detectors_write_into_are_known(tmp_path):
    detectors = '<e1Detector id="d" file="e1.xml"/><calibrator id="c" output="sub/c.xml"/><edgeData file="/dev/null"/>'
    path = Path(written(tmp_path, f"<additional>{detectors}</additional>", "d.add.xml"))
    assert demand.folders_written([path]) == {tmp_path, tmp_path / "sub", Path("/dev")}


@pytest.mark.parametrize("element", ['<vType id="rail_sumo_host"/>', '<vehicle id="rail_sumo_host" depart="90"/>'])
def test_our_own_ids_are_refused(tmp_path, element):
    with pytest.raises(InputError, match=r"has the id 'rail_sumo_host'; ids that begin with rail_sumo_ are"):
        demand.check([written(tmp_path, f'<routes>{element}<vehicle id="0"/></routes>')])


def test_a_comma_in_a_path_is_refused(tmp_path):
    with pytest.raises(InputError, match="has a comma in its path, where SUMO would split it in two; rename it"):
        demand.check([written(tmp_path, '<routes><vehicle id="0"/></routes>', "a,b.rou.xml")])


@pytest.mark.parametrize(
    ("departures", "late"),
    [
        (["0", "5", "5.0", "7"], None),
        (["0", "100", "90", "95", "110"], "'v2' and 1 more"),
        (["0:00:50", "1:00", "70", "0:01:09"], "'v3'"),
        (["0", "triggered", "3"], None),
        (["0", "100", "triggered", "110"], None),
        (["0", "100", "triggered", "90"], "'v3'"),
    ],
)
def test_departures_out_of_order_are_told(tmp_path, departures, late):
    vehicles = "".join(f'<vehicle id="v{k}" depart="{at}"/>' for k, at in enumerate(departures))
    path = written(tmp_path, f'<routes>{vehicles}<flow id="f" begin="1000"/></routes>')
    told = list(demand.warnings(demand.check([path])[0]))
    assert len(told) == (late is not None)
    assert all(f"is not in order of departure: {late} may enter late" in one for one in told)


def test_a_flow_departs_when_it_begins(tmp_path):
    path = written(tmp_path, '<routes><flow id="f" begin="1000"/><vehicle id="v" depart="90"/></routes>')
    (told,) = demand.warnings(demand.check([path])[0])
    assert "is not in order of departure: 'v' may enter late" in told
