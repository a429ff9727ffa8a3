"""The host in the place of one of the demand's cars."""

import libsumo
import pandas as pd
import pytest
from driving import ACCELERATE, KEEP, always, drive, world

from rail_sumo import assets, run
from rail_sumo.errors import InputError
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.vehicle.abilities import HOST_TYPE

CARS = 40
"""One every 10 s, every fourth of them a lorry."""


def demand(tmp_path, *rows, route="highway"):
    path = tmp_path / "cars.rou.xml"
    cars = "".join(
        f'<vehicle id="{"lorry" if k % 4 == 3 else "car"}{k}" type="{"lorry" if k % 4 == 3 else "car"}" '
        f'depart="{10 * k}" departLane="{k % 3}" departSpeed="20"><route edges="{route}"/></vehicle>'
        for k in range(CARS)
    )
    types = '<vType id="car" length="4.1" width="1.7" sigma="0"/><vType id="lorry" vClass="truck" sigma="0"/>'
    path.write_text(f"<routes>{types}{''.join(rows) or cars}</routes>")
    return {"routes": [str(path)], "host": "replaces"}


def on_highway3(traffic, **sections):
    return world(network={"file": "highway3"}, traffic=traffic, **sections)


def begun(make, traffic, seed=0, **sections):
    env = make(on_highway3(traffic, **sections))
    env.reset(seed=seed)
    return env


def test_the_host_is_a_car_of_the_demand_where_when_and_as_large_as_it_is(make, tmp_path):
    numbers = set()
    for seed in range(12):
        host = begun(make, demand(tmp_path), seed).host_name
        number = int(host.removeprefix("car"))  # no lorry
        assert libsumo.simulation.getTime() == pytest.approx(10 * number + 0.1, abs=0.101)
        assert libsumo.vehicle.getLaneIndex(host) == number % 3
        assert libsumo.vehicle.getSpeed(host) == pytest.approx(20.0, abs=0.5)
        assert (libsumo.vehicle.getLength(host), libsumo.vehicle.getWidth(host)) == (4.1, 1.7)
        assert libsumo.vehicle.getRoute(host) == ("highway",)
        numbers.add(number)
    assert min(numbers) >= 6  # after the warm-up of 60 s
    assert len(numbers) > 6
    assert max(numbers) - min(numbers) > 15  # all over the demand's time


def test_where_a_demand_ends_soon_any_of_its_cars_will_do_and_none_is_waited_for_in_vain(make, tmp_path):
    too_short = {"shortest_route_m": 1e5}  # all routes are
    late = {begun(make, demand(tmp_path) | too_short, seed).host_name for seed in range(12)}
    assert {f"car{k}" for k in range(33, CARS)} & late  # less than a minute before the last departure

    flow = '<flow id="f" type="car" begin="0" end="200" probability="0.05"><route edges="highway"/></flow>'
    by_chance = demand(tmp_path, flow) | too_short
    assert len({begun(make, by_chance, seed).host_name for seed in range(12)}) > 1


def test_every_driver_drives_the_same_car_of_a_seed(make, tmp_path):
    cars = []
    for hands_off in (False, True):
        env = make(on_highway3(demand(tmp_path)), hands_off=hands_off)
        env.reset(seed=5)
        cars.append((env.host_name, libsumo.simulation.getTime()))
    assert cars[0] == cars[1]


@pytest.mark.parametrize(("name", "at_s"), [("car2", 20.1), ("lorry7", 70.1)])
def test_a_vehicle_may_be_named(make, tmp_path, name, at_s):
    env = begun(make, demand(tmp_path) | {"host": name})  # one departs within the warm-up, one is a lorry
    assert (env.host_name, libsumo.simulation.getTime()) == (name, pytest.approx(at_s, abs=0.101))


def test_who_drives_ahead_of_it_drives_as_without_it(make, tmp_path):
    env = make(on_highway3(demand(tmp_path) | {"host": "car20"}))
    drive(env, always(KEEP), seed=3)
    ahead, at_s = ("car17", "car18", "lorry19"), libsumo.simulation.getTime()
    with_host = [libsumo.vehicle.getDistance(name) for name in ahead]
    env.close()
    with Simulation(env.stretch.road.net_file, demand=env.demand, seed=3) as alone:
        alone.run_until(at_s)
        assert [libsumo.vehicle.getDistance(name) for name in ahead] == pytest.approx(with_host, abs=1e-6)


def rows(*routes):
    return [f'<vehicle id="v{k}" depart="{5 * k}"><route edges="{route}"/></vehicle>' for k, route in enumerate(routes)]


def test_cars_with_little_to_drive_are_left_out_unless_there_are_no_others(make, tmp_path):
    path = two_roads_file(tmp_path)
    long_and_short = demand(tmp_path, *rows(*["short", "highway"] * 30))
    for seed in range(8):
        env = make(world(network={"file": path}, traffic=long_and_short))
        env.reset(seed=seed)
        assert libsumo.vehicle.getRoute(env.host_name) == ("highway",)
    only_short = demand(tmp_path, *rows(*["short"] * 60))
    env = make(world(network={"file": path}, traffic=only_short))
    env.reset(seed=0)
    assert libsumo.vehicle.getRoute(env.host_name) == ("short",)


def test_a_car_is_the_host_though_a_queue_waits_to_enter_behind_it(make, tmp_path):
    """Where it would not be let in a second time."""
    flow = '<flow id="f" begin="0" end="500" period="0.5" type="car" departLane="1"><route edges="highway"/></flow>'
    assert begun(make, demand(tmp_path, flow)).host_name.startswith("f.")


def test_floating_car_data_follow_hosts_whose_names_are_not_known_before(tmp_path):
    world = on_highway3(demand(tmp_path), episode={"duration_s": 5.0})
    run.evaluate({"keep": "keep"}, world, episodes=3, seed=0, fcd=tmp_path / "fcd")
    fcd = pd.read_parquet(tmp_path / "fcd")
    hosts = fcd[fcd["vehicle_type"] == HOST_TYPE].groupby("episode", observed=False)["vehicle_id"]
    assert hosts.nunique().tolist() == [1, 1, 1]
    assert hosts.size().min() >= 50
    assert hosts.first().nunique() > 1


def two_roads_file(tmp_path):
    text = assets.network("highway3").read_text()
    short = (
        '<edge id="short" from="x" to="y"><lane id="short_0" index="0" speed="20" length="300.00" '
        'shape="0,-90 300,-90"/></edge>'
        '<junction id="x" type="dead_end" x="0" y="-90" incLanes="" intLanes="" shape="0,-90"/>'
        '<junction id="y" type="dead_end" x="300" y="-90" incLanes="short_0" intLanes="" shape="300,-90"/>'
    )
    path = tmp_path / "two.net.xml"
    path.write_text(text.replace("<junction", short + "<junction", 1))
    return str(path)


def test_with_a_course_only_cars_that_drive_along_it_are_replaced(make, tmp_path):
    path = two_roads_file(tmp_path)
    traffic = demand(tmp_path, *rows(*["highway", "short"] * 30))
    for seed in range(4):
        env = make(world(network={"file": path, "course": ["short"]}, traffic=traffic))
        env.reset(seed=seed)
        assert libsumo.vehicle.getRoute(env.host_name) == ("short",)


def test_a_course_may_name_the_ends_alone_and_is_driven_in_its_order(make, tmp_path):
    flows = [
        f'<flow id="{"".join(way)}" begin="0" end="300" period="9" from="{way[0]}" to="{way[1]}" departLane="free"/>'
        for way in (("main1", "main4"), ("on1", "main4"), ("main1", "off"))
    ]
    path = tmp_path / "onramp.rou.xml"
    path.write_text(f"<routes>{''.join(flows)}</routes>")
    for course in (("on1", "main4"), ("main1", "off")):
        env = make(
            world(network={"file": "onramp", "course": course}, traffic={"routes": [str(path)], "host": "replaces"})
        )
        env.reset(seed=0)
        assert env.host_name.startswith("".join(course))
    env = make(
        world(
            network={"file": "onramp", "course": ("off", "main1")}, traffic={"routes": [str(path)], "host": "replaces"}
        )
    )
    with pytest.raises(InputError, match=r"over the edges of network\.course in their order|no way for cars leads"):
        env.reset(seed=0)


def test_a_demand_that_ends_within_the_warm_up_is_entered_while_it_departs(make, tmp_path):
    env = make(on_highway3(demand(tmp_path, *rows(*["highway"] * 4))))
    env.reset(seed=0)
    assert libsumo.simulation.getTime() == pytest.approx(15.1, abs=0.2)


@pytest.mark.parametrize(
    ("kinds", "hosts"),
    [
        (("truck", "motorcycle"), {"truck", "motorcycle"}),
        (("truck", "passenger"), {"passenger"}),
        (("bicycle", "bus"), {"bus"}),
    ],
)
def test_where_the_demand_has_no_cars_the_host_is_another_motor_vehicle(make, tmp_path, kinds, hosts):
    types = "".join(f'<vType id="a_{kind}" vClass="{kind}" sigma="0"/>' for kind in kinds)
    vehicles = "".join(
        f'<vehicle id="{k}" type="a_{kinds[k % 2]}" depart="{10 * k}"><route edges="highway"/></vehicle>'
        for k in range(CARS)
    )
    chosen = set()
    for seed in range(8):
        host = begun(make, demand(tmp_path, types, vehicles), seed).host_name
        chosen.add(libsumo.vehicle.getVehicleClass(host))
        assert libsumo.vehicle.getVehicleClass(host) == kinds[int(host) % 2]
    assert chosen == hosts


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"host": "car4", "begin_s": 200.0},
            "^vehicle 'car4', which traffic.host names, has not departed by .* depart from 0 s to 390 s: change ",
        ),
        ({"warm_up_s": 395.0}, "^no car that the host could replace departed by .* depart from 0 s to 390 s: change "),
        ({"begin_s": 5000.0}, "^no car that the host could replace departed by .* depart from 0 s to 390 s: change "),
    ],
)
def test_where_no_car_departs_it_is_told_when_they_do(make, tmp_path, changes, said):
    with pytest.raises(InputError, match=said):
        make(on_highway3(demand(tmp_path) | changes)).reset(seed=0)


def test_a_named_vehicle_whose_route_cannot_be_driven_or_that_never_comes_is_told(make, tmp_path):
    path = two_roads_file(tmp_path)
    traffic = demand(tmp_path, *rows("short", "highway")) | {"host": "v0"}
    with pytest.raises(InputError, match=r"^vehicle 'v0' does not drive over the edges of network\.course in their "):
        make(world(network={"file": path, "course": ["highway"]}, traffic=traffic)).reset(seed=0)
    endless = '<flow id="f" begin="0" period="600"><route edges="highway"/></flow>'
    with pytest.raises(
        InputError, match=r"^vehicle 'f\.99', which traffic\.host names, has not departed by 72.. s; .* from 0 s on: "
    ):
        make(on_highway3(demand(tmp_path, endless) | {"host": "f.99"})).reset(seed=0)


def test_where_no_car_that_departs_can_be_driven_it_is_told_why(make, tmp_path):
    slow = on_highway3(
        demand(tmp_path), adas={"min_speed_kmh": "limit/2", "start_speed_kmh": 35.0, "max_speed_kmh": 35.0}
    )
    said = (
        r"^none of the \d+ cars that departed by \d+ s can be the host; 'car\d+': network 'highway3': "
        r"the lowest set speed, 40 km/h \(adas\.min_speed_kmh = limit/2\), is not below the highest, 35 km/h"
    )
    with pytest.raises(InputError, match=said):
        make(slow).reset(seed=0)


def test_a_vehicle_that_is_not_in_the_demand_is_told_before_anybody_drives(make, tmp_path):
    said = r"^the demand has no vehicle 'car7', which traffic\.host names; did you mean 'car37'\? \(available: car0"
    with pytest.raises(InputError, match=said):
        make(on_highway3(demand(tmp_path) | {"host": "car7"}))


def test_a_replaced_cars_route_is_the_course_to_its_end(make, tmp_path):
    env = make(on_highway3(demand(tmp_path), episode={"duration_s": 600.0}))
    driven = drive(env, always(KEEP), seed=1)
    assert driven.end_reason == "end of road"
    assert driven.distance_m == pytest.approx(env.stretch.drivable_m, abs=25.0)
    assert env.stretch.start_m == pytest.approx(4.2, abs=3.0)


def test_the_host_is_never_teleported(make, tmp_path):
    """It waits behind cars that stand on all lanes, as another does that is teleported."""
    standing = [
        f'<vehicle id="jam{k}" depart="0" departLane="{k}"><route edges="highway"/>'
        f'<stop lane="highway_{k}" endPos="400" duration="1000"/></vehicle>'
        for k in range(3)
    ]
    late = [f'<vehicle id="late{k}" depart="40" departLane="{k}"><route edges="highway"/></vehicle>' for k in range(2)]
    traffic = demand(tmp_path, *standing, *late) | {"options": ["time-to-teleport=20"], "host": "late1"}
    env = make(on_highway3(traffic, episode={"duration_s": 100.0}))
    env.reset(seed=0)
    while not env.is_over:
        env.drive(KEEP)
    assert "late0" not in libsumo.vehicle.getIDList()  # it had no other edge to go on with
    assert 350.0 < libsumo.vehicle.getLanePosition("late1") < 400.0


@pytest.mark.parametrize(("arrival", "end"), [('arrivalPos="500"', "end of road"), ("", "duration")])
def test_an_episode_ends_where_the_hosts_trip_does(make, tmp_path, arrival, end):
    trip = f'depart="5" departLane="0" departPos="100" departSpeed="20" {arrival}'
    car = f'<vehicle id="v" {trip}><route edges="highway"/></vehicle>'
    env = make(on_highway3(demand(tmp_path, car) | {"host": "v"}, episode={"duration_s": 60.0}))
    driven = drive(env, always(ACCELERATE))
    assert driven.end_reason == end
    assert (driven.distance_m == pytest.approx(400.0, abs=3.0)) == bool(arrival)
    assert driven.distance_m == pytest.approx(0.1 * driven.speed_mps[1:].sum(), abs=0.1)
    assert len(driven.speed_mps) == len(driven.limit_mps) + 1 == len(driven.lane_changing) + 1
    assert env.action_masks()[1:] != [True] * 4
    with pytest.raises(RuntimeError, match="the episode is over"):
        env.step(KEEP)


@pytest.mark.parametrize("own_mps", [14.0, 50.0])
def test_a_car_that_is_replaced_drives_no_faster_than_it_can_itself(make, tmp_path, own_mps):
    kind = f'<vType id="own" maxSpeed="{own_mps}"/>'
    car = f'{kind}<vehicle id="v" type="own" depart="5"><route edges="highway"/></vehicle>'
    env = make(on_highway3(demand(tmp_path, car) | {"host": "v"}))
    fastest_mps = drive(env, always(ACCELERATE)).speed_mps.max()
    assert fastest_mps == pytest.approx(min(own_mps, 80.0 / 3.6), abs=0.05)


def test_a_course_over_an_edge_that_is_not_there_is_told_before_anybody_drives(make, tmp_path):
    env = make(world(network={"file": "highway3", "course": ("highwaz",)}, traffic=demand(tmp_path)))
    with pytest.raises(InputError, match=r"has no edge 'highwaz', which network.course names; did you mean"):
        env.reset(seed=0)
