import math
from pathlib import Path

import libsumo
import pytest

from rail_sumo import assets, config
from rail_sumo.errors import InputError
from rail_sumo.highway.network import demand

AS_USUAL = config.Traffic()


def written(tmp_path, content, name="own.rou.xml"):
    path = tmp_path / name
    path.write_text(content)
    return str(path)


def read(routes=(), additional=(), options=()):
    return demand.read(config.Traffic(routes=tuple(routes), additional=tuple(additional), options=tuple(options)))


@pytest.mark.parametrize("element", ["vehicle", "flow", "trip"])
def test_demand_with_traffic_passes_though_it_lies_in_another_file_than_the_types(tmp_path, element):
    types = written(tmp_path, '<routes><vType id="car"/></routes>', "types.rou.xml")
    traffic = written(tmp_path, f'<routes><{element} id="0"/></routes>')
    assert [str(path) for path in read([types, traffic]).routes] == [types, traffic]
    assert read([types, traffic]).has_traffic
    assert not read([types]).has_traffic
    (told,) = demand.warnings(read([types]), AS_USUAL)
    assert told.endswith("types.rou.xml' has no <vehicle>, <flow> or <trip>: traffic is made for the host")


def test_a_network_is_no_demand_though_it_has_elements_of_an_additional_file(tmp_path):
    network = written(tmp_path, '<net><type id="road"/><tlLogic id="light"/></net>', "my.net.xml")
    with pytest.raises(InputError, match=r"holds <net>, which is no traffic of SUMO's; give it to --network$"):
        read([network])


def test_shipped_demand_passes_and_no_demand_is_no_mistake():
    names = assets.network_names()
    assert [path.name for path in read(names).routes] == [f"{name}.rou.xml" for name in names]
    assert read(names).has_traffic
    assert not read().has_traffic


def test_broken_or_missing_demand_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"^routes 'higway5' not found; did you mean 'highway5'\?"):
        read(["higway5"])
    with pytest.raises(InputError, match="is not a complete XML file: no element found"):
        read([written(tmp_path, '<routes><vehicle id="0"/>')])
    with pytest.raises(InputError, match="is not a complete XML file: multi-byte encodings are not supported"):
        read([written(tmp_path, '<?xml version="1.0" encoding="GBK"?><routes/>')])


def test_additional_files_are_read_too_and_told_in_the_place_of_routes(tmp_path):
    traffic = written(tmp_path, '<routes><vehicle id="0"/></routes>')
    stops = written(tmp_path, '<additional><busStop id="s"/></additional>', "stops.add.xml")
    assert [str(path) for path in read([traffic], [stops]).additional] == [stops]
    assert not list(demand.warnings(read([traffic], [stops]), AS_USUAL))
    (told,) = demand.warnings(read([traffic, stops]), AS_USUAL)
    assert "has <busStop>, which SUMO reads from additional files only; move it to a file of its own, and " in told
    with pytest.raises(InputError, match=r"^additional file 'none\.add\.xml' does not exist"):
        read([traffic], ["none.add.xml"])
    with pytest.raises(InputError, match=r"no element found"):
        read([traffic], [written(tmp_path, "<additional>", "cut.add.xml")])


def test_vehicles_in_an_additional_file_are_a_demand_too(tmp_path):
    trips = written(tmp_path, '<additional><trip id="0" depart="30"/></additional>', "trips.add.xml")
    assert read([], [trips]).has_traffic
    assert read([], [trips]).departs_s == (30.0, 30.0)


def test_included_files_are_read_in_the_place_of_their_names(tmp_path):
    (tmp_path / "parts").mkdir()
    written(tmp_path, '<routes><include href="flows.xml"/></routes>', "parts/all.xml")
    written(tmp_path, '<routes><flow id="f" begin="10" end="20"/></routes>', "parts/flows.xml")
    found = read([written(tmp_path, '<routes><include href="parts/all.xml"/></routes>')])
    assert [path.relative_to(tmp_path).as_posix() for path in found.files] == [
        *("own.rou.xml", "parts/all.xml", "parts/flows.xml")
    ]
    assert found.has_traffic


@pytest.mark.parametrize(
    ("href", "said"),
    [
        ("own.rou.xml", "includes 'own.rou.xml', which includes it in turn"),
        ("round.xml", "round.xml' includes 'own.rou.xml', which includes it in turn"),
        ("none.xml", "includes 'none.xml', which does not exist; correct its <include>"),
    ],
)
def test_a_file_that_includes_itself_or_nothing_is_refused(tmp_path, href, said):
    written(tmp_path, '<routes><include href="own.rou.xml"/></routes>', "round.xml")
    with pytest.raises(InputError, match=said):
        read([written(tmp_path, f'<routes><include href="{href}"/></routes>')])


@pytest.mark.parametrize(
    ("element", "span_s"),
    [
        ('<vehicle id="v" depart="0:01:30"/>', (90.0, 90.0)),
        ('<flow id="f" begin="10" end="70" number="3"/><trip id="t" depart="90"/>', (10.0, 90.0)),
        ('<flow id="f" end="70" period="3"/>', (0.0, 70.0)),
        ('<flow id="f" begin="5" vehsPerHour="60"/>', (5.0, float("inf"))),
    ],
)
def test_when_the_first_and_the_last_depart_is_known(tmp_path, element, span_s):
    assert read([written(tmp_path, f"<routes>{element}</routes>")]).departs_s == span_s


def test_what_a_demand_has_sumo_write_is_known(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    detectors = '<e1Detector id="d" file="e1.xml"/><calibrator id="c" output="sub/c.xml"/><edgeData file="/dev/null"/>'
    path = written(tmp_path, f"<additional>{detectors}</additional>", "d.add.xml")
    assert read([], [path]).written == {tmp_path / "e1.xml", tmp_path / "sub" / "c.xml", Path("/dev/null")}
    device = '<vType id="t"><param key="device.ssm.file" value="ssm/all.xml"/></vType><trip id="0"/>'
    assert read([written(tmp_path, f"<routes>{device}</routes>")]).written == {tmp_path / "ssm" / "all.xml"}
    assert not read().written


def test_options_of_sumos_are_names_and_values_and_not_ours():
    assert read(options=["scale=2", "default.speeddev=0.1"]).options == {"scale": "2", "default.speeddev": "0.1"}
    with pytest.raises(InputError, match="takes SUMO's options as name=value, for example scale=2; got 'scale'"):
        read(options=["scale"])
    for ours in ("step-length", "end", "seed", "fcd-output", "collision.action", "begin", "device.ssm.file"):
        with pytest.raises(InputError, match=f"SUMO's option '{ours}' is rail-sumo's to set; leave it out"):
            read(options=[f"{ours}=1"])


@pytest.mark.parametrize("element", ['<vType id="rail_sumo_host"/>', '<vehicle id="rail_sumo_host" depart="90"/>'])
def test_our_own_ids_are_refused(tmp_path, element):
    with pytest.raises(InputError, match=r"has the id 'rail_sumo_host'; ids that begin with rail_sumo_ are"):
        read([written(tmp_path, f'<routes>{element}<vehicle id="0"/></routes>')])


def test_a_comma_in_a_path_is_refused(tmp_path):
    with pytest.raises(InputError, match="has a comma in its path, where SUMO would split it in two; rename it"):
        read([written(tmp_path, '<routes><vehicle id="0"/></routes>', "a,b.rou.xml")])


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
    told = list(demand.warnings(read([path]), AS_USUAL))
    assert len(told) == (late is not None)
    assert all(f"is not in order of departure: {late} may enter late" in one for one in told)


def test_lanes_that_rerouters_close_are_known(tmp_path):
    def closing(lane):
        return f'<interval begin="0" end="9"><closingLaneReroute id="{lane}" disallow="truck"/></interval>'

    routes = written(tmp_path, '<routes><vehicle id="v" depart="0"/></routes>')
    one, other = (
        written(tmp_path, f'<additional><rerouter id="{name}" edges="a">{what}</rerouter></additional>', f"{name}.xml")
        for name, what in (("r", closing("a_0") + closing("a_0")), ("s", closing("b_1")))
    )
    found = read([routes], [one, other])
    assert found.lanes_closed == {"a_0", "b_1"}
    assert not list(demand.warnings(found, AS_USUAL))


def test_a_flow_departs_when_it_begins(tmp_path):
    path = written(tmp_path, '<routes><flow id="f" begin="1000"/><vehicle id="v" depart="90"/></routes>')
    (told,) = demand.warnings(read([path]), AS_USUAL)
    assert "is not in order of departure: 'v' may enter late" in told


NAMED = (
    '<routes><vehicle id="taxi7" depart="0"/><trip id="42" depart="1"/><flow id="in.east" begin="0" end="9"/></routes>'
)


def is_refused(require, given, name):
    try:
        require(given, name)
    except InputError:
        return True
    return False


@pytest.mark.parametrize("name", ["taxi7", "42", "in.east.3", "taxi7.1", "late"])
def test_a_vehicle_that_may_depart_is_not_refused(tmp_path, name):
    """That of an included and of an additional file, a flow's, and one that an option has multiplied."""
    written(tmp_path, NAMED, "named.xml")
    late = written(tmp_path, '<additional><vehicle id="late" depart="9"/></additional>', "late.add.xml")
    given = read([written(tmp_path, '<routes><include href="named.xml"/></routes>')], [late])
    assert not is_refused(demand.require_vehicle, given, name)


@pytest.mark.parametrize(
    ("name", "near"),
    [("taxi8", "taxi7"), ("in.east", "in.east.0"), ("in.east.x", "in.east.0"), ("aded", "added"), ("rail.0", "")],
)
def test_a_vehicle_that_certainly_does_not_depart_is_refused(tmp_path, name, near):
    meant = f"; did you mean '{near}'?" if near else ""
    with pytest.raises(InputError) as refused:
        demand.require_vehicle(read([written(tmp_path, NAMED)]), name)
    assert str(refused.value) == (
        f"the demand has no vehicle '{name}', which traffic.host names{meant} (available: 42, in.east.0, taxi7)"
    )


FLOWS = """<routes>
    <flow id="ten" begin="0" end="900" number="10"/>
    <flow id="regular" begin="0" end="100" period="2"/>
    <flow id="hourly" begin="0:00:00" end="0:30:00" vehsPerHour="100"/>
    <flow id="endless" begin="0" period="2"/>
    <flow id="by_chance" begin="0" end="100" probability="0.5"/>
    <flow id="poisson" begin="0" end="100" period="exp(0.5)"/>
</routes>"""


HOW_MANY = {"number": 'number="10"', "regular": 'period="2"', "hourly": 'vehsPerHour="700"', "few": 'period="80"'}


@pytest.mark.parametrize(
    ("name", "scale", "most"),
    [
        ("ten", "1", 10),
        ("ten", "2.5", 25),
        ("ten", "0.3", 3),
        ("regular", "1", 50),
        ("hourly", "1", 50),
        ("endless", "1", math.inf),
        ("by_chance", "1", math.inf),
        ("poisson", "1", math.inf),
    ],
)
def test_of_a_flow_the_host_is_one_of_those_that_it_has(tmp_path, name, scale, most):
    given = read([written(tmp_path, FLOWS)], options=[f"scale={scale}"])
    last = 10**6 if most == math.inf else most - 1
    assert not is_refused(demand.require_vehicle, given, f"{name}.{last}")
    if most < math.inf:
        with pytest.raises(InputError) as refused:
            demand.require_vehicle(given, f"{name}.{most}")
        said = f"the flow '{name}' ends with '{name}.{most - 1}'; name one up to that"
        assert str(refused.value) == f"traffic.host names '{name}.{most}', and {said}"


@pytest.mark.parametrize("scale", ["1", "2.5", "0.3"])
def test_a_flow_has_as_many_vehicles_as_sumo_makes_of_it(tmp_path, scale):
    flows = [f'<flow id="{name}" route="r" begin="0" end="99" {how}/>' for name, how in HOW_MANY.items()]
    path = written(tmp_path, f'<routes><route id="r" edges="highway"/>{"".join(flows)}</routes>')
    made = set()
    libsumo.start(["sumo", "-n", str(assets.network("highway5")), "-r", str(path), "--scale", scale, "--no-step-log"])
    try:
        while libsumo.simulation.getMinExpectedNumber():
            libsumo.simulationStep()
            made |= set(libsumo.simulation.getDepartedIDList())
    finally:
        libsumo.close()
    given = read([path], options=[f"scale={scale}"])
    for name in HOW_MANY:
        last = max(int(one.removeprefix(f"{name}.")) for one in made if one.startswith(f"{name}."))
        assert not is_refused(demand.require_vehicle, given, f"{name}.{last}")
        beyond = last + 1 + math.ceil(float(scale))  # SUMO makes one less where the last would depart at the end
        assert is_refused(demand.require_vehicle, given, f"{name}.{beyond}")


def test_a_type_that_multiplies_its_vehicles_makes_more_than_a_flow_says(tmp_path):
    doubled = written(tmp_path, FLOWS.replace("<routes>", '<routes><vType id="car" scale="2"/>'))
    assert not is_refused(demand.require_vehicle, read([doubled]), "ten.15")


@pytest.mark.parametrize("element", ['<person id="p" depart="0"/>', '<personFlow id="p"/>', '<calibrator id="c"/>'])
def test_where_sumo_makes_vehicles_with_ids_of_its_own_nobody_is_refused(tmp_path, element):
    given = read([written(tmp_path, NAMED)], [written(tmp_path, element, "own.add.xml")])
    assert not is_refused(demand.require_vehicle, given, "p_0")


def test_with_a_state_that_is_loaded_nobody_and_no_type_is_refused(tmp_path):
    given = read([written(tmp_path, NAMED)], options=["load-state=state.xml"])
    assert not is_refused(demand.require_vehicle, given, "c.0")
    assert not is_refused(demand.require_type, given, "car")


@pytest.mark.parametrize(
    ("rows", "may_have"),
    [
        ('<vType id="a" vClass="truck"/><trip id="0" type="a" depart="0"/>', False),
        ('<vType id="a" vClass="taxi"/><trip id="0" type="a" depart="0"/>', True),
        ('<vType id="a"/><trip id="0" type="a" depart="0"/>', True),
        ('<trip id="0" depart="0"/>', True),
        ('<vType id="DEFAULT_VEHTYPE" vClass="bus"/><trip id="0" depart="0"/>', False),
        ('<vType id="a" vClass="truck"/><vType id="b"/><flow id="0" type="a" period="5"/>', False),  # nobody is of b
        ('<vType id="a" vClass="truck"/><trip id="0" type="elsewhere" depart="0"/>', True),
        ('<vTypeDistribution id="a" vTypes="b c"/><trip id="0" type="a" depart="0"/>', True),
        ('<vType id="a" vClass="truck"/><trip id="0" type="a" depart="0"/><person id="p" depart="0"/>', True),
    ],
)
def test_whether_a_demand_may_have_cars_follows_from_the_types_of_its_vehicles(tmp_path, rows, may_have):
    given = read([written(tmp_path, f"<routes>{rows}</routes>")])
    assert given.may_have_cars == may_have
    assert any("no cars" in warning for warning in demand.warnings(given, AS_USUAL)) != may_have


def test_types_may_lie_in_any_file_of_a_demand_and_in_a_distribution(tmp_path):
    written(tmp_path, '<additional><vType id="van"/></additional>', "van.add.xml")
    drawn = '<vTypeDistribution id="any"><vType id="bus"/></vTypeDistribution>'
    own = written(tmp_path, f'<additional><include href="van.add.xml"/>{drawn}</additional>', "types.add.xml")
    given = read([written(tmp_path, NAMED)], [own])
    assert not any(is_refused(demand.require_type, given, kind) for kind in ("van", "any", "bus"))
    with pytest.raises(InputError, match=r"'sumo:car' not found.* \(available: DEFAULT_VEHTYPE, any, bus, van\)"):
        demand.require_type(given, "car")


def test_a_lorry_that_has_no_class_is_told_to_count_as_a_car(tmp_path):
    types = '<vType id="truck" length="12"/><vType id="bus" length="12" vClass="bus"/><vType id="van" length="6"/>'
    given = read([written(tmp_path, f'<routes>{types}<vehicle id="a" type="truck" depart="0"/></routes>')])
    (told,) = demand.warnings(given, AS_USUAL)
    assert told.startswith(
        "vehicle type 'truck' is 12 m long and has no vClass: it counts, and may be driven, as a car"
    )


def test_keys_of_made_traffic_are_told_to_have_no_effect_on_a_demand():
    with_cars = read(["highway3"])
    (told,) = demand.warnings(with_cars, config.Traffic(lorries=0.5, car_following="IDM"))
    assert told == "traffic.lorries, traffic.car_following: of made traffic, without effect on a demand"
    assert not list(demand.warnings(with_cars, config.Traffic(scale=0.5)))
    assert not list(demand.warnings(read(), config.Traffic(lorries=0.5)))
