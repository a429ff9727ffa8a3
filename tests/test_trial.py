"""What `rail-sumo network check` tells before anybody drives."""

import json
import re
from pathlib import Path

import pytest
from driving import EMPTY, on_ramp, world

from rail_sumo.errors import InputError
from rail_sumo.highway import trial
from rail_sumo.highway.network import road


def test_the_check_tells_of_a_demand_that_never_comes_along_the_course(two_roads):
    assert trial.check(two_roads("beside")).warnings == ()
    (told,) = trial.check(two_roads("highway")).warnings
    assert told.startswith(
        "when the host enters, no vehicle of the demand is on its course or on the way to it; lead netw"
    )


def test_the_check_tries_the_demand(tmp_path):
    lost = tmp_path / "lost.rou.xml"
    lost.write_text('<routes><vehicle id="v" depart="0"><route edges="nowhere"/></vehicle></routes>')
    with pytest.raises(InputError, match=r"SUMO .*nowhere"):
        trial.check(world(traffic={"routes": (str(lost),)}))


def test_a_check_that_fails_leaves_no_simulation_open(tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text('<routes><vehicle id="v" depart="500"><route edges="highway"/></vehicle></routes>')
    for _ in range(2):
        with pytest.raises(InputError, match="no vehicle of the demand is on the road at 60 s"):
            trial.check(world(traffic={"routes": (str(late),)}))


def test_the_check_tells_of_a_demand_out_of_order(tmp_path):
    path = tmp_path / "late.rou.xml"
    vehicles = "".join(f'<vehicle id="v{at}" depart="{at}"><route edges="highway"/></vehicle>' for at in (0, 50, 40))
    path.write_text(f"<routes>{vehicles}</routes>")
    (told,) = trial.check(world(traffic={"routes": (str(path),)})).warnings
    assert "is not in order of departure: 'v40' may enter late" in told


def test_a_check_that_fails_tells_what_is_wrong_with_the_demand(tmp_path):
    path = tmp_path / "typo.rou.xml"
    flows = "".join(
        f'<flow id="{name}" {begin} end="9600" vehsPerHour="600"><route edges="highway"/></flow>'
        for name, begin in (("late", 'begin="9000"'), ("typo", 'beginn="9100"'))
    )
    path.write_text(f"<routes>{flows}</routes>")
    with pytest.raises(
        InputError, match=r"on the road at 60 s; .*; also, demand .* is not in order of departure: 'typo' may"
    ):
        trial.check(world(traffic={"routes": (str(path),)}))


def test_signals_limits_and_lanes_that_end_are_told(soon_narrow):
    signals = str(Path(__file__).with_name("two_signals.net.xml"))
    assert trial.check(world(network={"file": signals}, traffic=EMPTY)).n_signals == 2
    found = trial.check(world(network=soon_narrow, traffic=EMPTY))
    assert found.n_signals == 0
    assert found.ending_lanes == {"wide": [0]}
    assert found.limits_kmh == (130, 130)
    assert not [one for one in found.warnings if "m/s" in one]


def test_a_limit_that_may_have_been_meant_in_kmh_is_told(soon_narrow):
    network = Path(soon_narrow["file"])
    network.write_text(network.read_text().replace("36.11", "70.00"))
    found = trial.check(world(network={"file": str(network)}, traffic=EMPTY))
    assert found.limits_kmh == (252, 252)
    (told,) = [one for one in found.warnings if "m/s" in one]
    assert told.startswith("the limit is up to 252 km/h (70 m/s): networks tell speeds in m/s; the host takes")


def test_the_host_is_told_if_it_is_one_of_the_demand(tmp_path):
    path = tmp_path / "cars.rou.xml"
    path.write_text('<routes><vehicle id="mine" depart="70"><route edges="highway"/></vehicle></routes>')
    found = trial.check(world(traffic={"routes": [str(path)], "host": "replaces"}))
    assert (found.host, found.enters_s) == ("mine", pytest.approx(70.1, abs=0.11))
    assert trial.check(world()).host == ""


def test_all_of_it_is_plain_json(soon_narrow):
    told = json.loads(json.dumps(trial.check(world(network=soon_narrow, traffic=EMPTY)).as_json))
    first = told["edges"][0]
    assert (first["id"], first["lanes"], first["ending_lanes"]) == ("wide", 3, [0])
    assert (told["host"], told["signals"], told["is_loop"], told["is_left_hand"]) == (None, 0, False, False)
    assert any(text.startswith("the road ends") for text in told["warnings"])


@pytest.mark.parametrize(("top_mps", "is_told"), [(14.0, True), (50.0, False)])
def test_a_host_whose_vehicle_is_slower_than_the_limit_is_told(tmp_path, top_mps, is_told):
    path = tmp_path / "one.rou.xml"
    car = '<vehicle id="v" type="own" depart="5"><route edges="highway"/></vehicle>'
    path.write_text(f'<routes><vType id="own" maxSpeed="{top_mps}"/>{car}</routes>')
    found = trial.check(
        world(network={"file": "highway3"}, traffic={"routes": [str(path)], "host": "v", "warm_up_s": 0.0})
    )
    told = [
        text for text in found.warnings if "no faster than 50 km/h (its maxSpeed), and the course allows 80" in text
    ]
    assert bool(told) is is_told


def test_the_flow_along_the_course_is_the_demands(tmp_path):
    """A vehicle every 5 s, each as fast as the other, is 720 an hour wherever the road is full of them."""
    path = tmp_path / "even.rou.xml"
    path.write_text(
        '<routes><vType id="even" sigma="0" speedDev="0" carFollowModel="Krauss"/>'
        '<flow id="f" type="even" begin="0" end="2000" period="5" departSpeed="max">'
        '<route edges="highway"/></flow></routes>'
    )
    found = trial.check(
        world(network={"file": "highway3"}, traffic={"routes": [str(path)], "begin_s": 0.0, "warm_up_s": 500.0})
    )
    assert found.flows_vehph == {"highway": pytest.approx(720.0, rel=0.02)}
    assert found.as_json["edges"][0]["flow_vehph"] == round(found.flows_vehph["highway"])
    assert found.watched_s == found.as_json["flows_watched_s"] == pytest.approx(60.0, abs=3.0)
    assert trial.check(world()).flows_vehph == {}


def test_the_check_tells_of_routes_that_are_too_short_for_a_host(tmp_path):
    cars = "".join(
        f'<flow id="{route}" type="car" route="{route}" begin="0" end="300" period="5" departLane="best"/>'
        for route in ("through", "off")
    )
    routes = on_ramp(tmp_path, cars)

    def told(shortest_m, host="replaces"):
        traffic = {"routes": routes, "host": host, "shortest_route_m": shortest_m}
        there = world(network={"file": "onramp", "course": ["main1"]}, traffic=traffic)
        return [one for one in trial.check(there).warnings if one.startswith("no car on")]

    whole_m = road.load("onramp", ("main1", "main3")).length_m
    (only,) = told(whole_m - 100.0)
    assert only.startswith(
        "no car on 1 of the 2 routes that are driven when the host enters is ever the host: they are"
    )
    assert told(500.0) == told(whole_m + 1000.0) == told(whole_m - 100.0, "through.0") == []


def test_the_check_tells_of_more_vehicles_than_the_road_takes(tmp_path):
    path = tmp_path / "many.rou.xml"
    flow = '<flow id="f" begin="0" end="90" period="0.25" departLane="0"><route edges="highway"/></flow>'
    path.write_text(f"<routes>{flow}</routes>")
    (told,) = trial.check(world(traffic={"routes": (str(path),), "host": "replaces"})).warnings
    assert re.match(r"when the host enters, \d\d+ vehicles of the demand wait for room to enter: ", told)
