import math
from collections import Counter
from itertools import combinations

import libsumo
import numpy as np
import pytest

from rail_sumo import assets, config
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.traffic.moving_window import CLEAR_OF_ANOTHER_M, CLEAR_OF_HOST_M, START_GAP_M, MovingWindow
from rail_sumo.records import KMH, Command

START_M = 200.0
ADAS = config.Adas()
DENSE = {"vehicles": 20, "speed_low_kmh": 40.0, "speed_high_kmh": 70.0}


class Window:
    """A moving window around a host that drives straight on in the middle lane; looked at in SUMO itself."""

    def __init__(self, traffic, *, seed=0, network="highway5", host_kmh=60.0, outputs=()):
        self.config = traffic
        self.host_mps = host_kmh / KMH
        self.road = road.load(network)
        self.simulation = Simulation(self.road.net_file, seed=1, outputs=outputs)
        self.simulation.lay_course(self.road, ADAS, sees_m=120.0)
        self.simulation.add_host(self.road.laps(0, 20_000.0), lane=2, front_m=START_M, speed_mps=self.host_mps)
        self.window = MovingWindow(
            self.simulation,
            self.road,
            traffic,
            host_s_m=START_M,
            host_lane=2,
            farthest_m=20_000.0,
            rng=np.random.default_rng(seed),
        )
        self.simulation.wait_for_host()

    def drive(self, seconds=2.0, *, host_changing_lane=False):
        self.simulation.run(Command(self.host_mps, steps=round(seconds * 10)))
        self.window.update(elapsed_s=seconds, changing_lane=[HOST] if host_changing_lane else [])

    def others(self):
        return [name for name in libsumo.vehicle.getIDList() if name != HOST]

    def ahead_m(self):
        """How far each vehicle's front is ahead of the host's, on a straight road."""
        host_m = libsumo.vehicle.getPosition(HOST)[0]
        return {name: libsumo.vehicle.getPosition(name)[0] - host_m for name in self.others()}

    def lanes(self):
        return {name: libsumo.vehicle.getLaneIndex(name) for name in self.others()}

    def desired_kmh(self, name):
        return libsumo.vehicle.getMaxSpeed(name) * KMH


@pytest.fixture
def window():
    """Open windows, one after the other."""
    opened = []

    def open_one(seed=0, *, network="highway5", host_kmh=60.0, outputs=(), **traffic):
        for other in opened:
            other.simulation.close()
        opened.append(
            Window(config.Traffic(**DENSE | traffic), seed=seed, network=network, host_kmh=host_kmh, outputs=outputs)
        )
        return opened[-1]

    yield open_one
    for other in opened:
        other.simulation.close()


def test_the_window_begins_with_vehicles_all_over_it_clear_of_one_another_and_of_the_host(window):
    places, lanes, numbers = [], Counter(), []
    for seed in range(10):
        begun = window(seed)
        ahead, lane = {HOST: 0.0, **begun.ahead_m()}, {HOST: 2, **begun.lanes()}
        numbers.append(len(ahead) - 1)
        for one, other in combinations(ahead, 2):
            if lane[one] == lane[other]:
                assert abs(ahead[one] - ahead[other]) > START_GAP_M - 2.0  # the first step's travel
        places += [ahead[name] for name in begun.others()]
        lanes.update(lane[name] for name in begun.others())
    assert np.mean(numbers) > 17  # SUMO refuses a few that would have to brake
    assert max(numbers) == 20
    assert -152.0 < min(places) < -100.0
    assert 200.0 < max(places) < 252.0
    assert set(lanes) == {0, 1, 2, 3, 4}


def test_everyone_stands_in_the_centre_of_its_lane(window):
    begun = window()
    for name, lane in begun.lanes().items():
        assert libsumo.vehicle.getPosition(name)[1] == pytest.approx(3.2 * (lane - 2))


def test_desired_speeds_are_drawn_from_the_whole_range(window):
    desired = []
    for seed in range(10):
        begun = window(seed, speed_low_kmh=50.0, speed_high_kmh=90.0)
        desired += [begun.desired_kmh(name) for name in begun.others()]
    assert 50.0 <= min(desired) < 54.0
    assert 86.0 < max(desired) <= 90.0
    # The mean of n uniform draws is within four standard errors of the middle.
    assert np.mean(desired) == pytest.approx(70.0, abs=4 * 40 / math.sqrt(12 * len(desired)))


def test_whoever_is_alone_drives_as_fast_as_it_desires(window):
    begun = window(vehicles=1, lane_change_every_s=math.inf)
    (name,) = begun.others()
    begun.drive(4.0)
    # SUMO's Krauss model falls a little short of it at random (sigma 0.5).
    assert libsumo.vehicle.getSpeed(name) * KMH == pytest.approx(begun.desired_kmh(name), rel=0.1)


@pytest.mark.parametrize("host_kmh", [40.0, 60.0, 80.0])
def test_whoever_leaves_the_window_is_replaced_ahead_if_slower_and_behind_if_faster(window, host_kmh):
    begun = window(host_kmh=host_kmh, lane_change_every_s=math.inf)
    known, missing = set(begun.others()), []
    appeared = 0
    for _ in range(60):
        begun.drive()
        # What a vehicle of the window can move between two looks, relative to the host.
        reach_m = 2.0 * 40 / KMH + 1.0
        begun.simulation.run(Command(begun.host_mps))  # the new ones enter on this step
        ahead = begun.ahead_m()
        assert max(ahead.values()) < 250.0 + reach_m
        assert min(ahead.values()) > -150.0 - reach_m
        for name in set(ahead) - known:
            is_slower = begun.desired_kmh(name) / KMH < begun.simulation.host.speeds_mps[-2]
            assert ahead[name] == pytest.approx(249.0 if is_slower else -149.0, abs=4.0)
            appeared += 1
        known |= set(ahead)
        missing.append(20 - len(ahead))
    assert appeared >= 5
    assert np.mean(missing) < 2.0


def test_a_window_without_vehicles_stays_empty(window):
    begun = window(vehicles=0)
    begun.drive(10.0)
    assert begun.others() == []


def changes(begun, seconds, *, host_changing_lane=False):
    """Every lane change among the others: how far from the host it was made, and how long they were watched."""
    made, watched_s, lanes = [], 0.0, begun.lanes()
    for _ in range(round(seconds / 2.0)):
        begun.drive(host_changing_lane=host_changing_lane)
        before, lanes = lanes, begun.lanes()
        ahead = begun.ahead_m()
        made += [abs(ahead[name]) for name in lanes if name in before and lanes[name] != before[name]]
        watched_s += 2.0 * len(lanes)
    return made, watched_s


def test_lane_changes_come_as_often_as_configured_and_never_when_switched_off(window):
    # On average every 10 s a try; a fifth of them leads off the road, more find no gap, and some would meet another's.
    made, watched_s = changes(window(3, lane_change_every_s=10.0), 300.0)
    tries = watched_s / 10.0
    assert 0.35 * tries < len(made) < 0.8 * tries + 4 * math.sqrt(tries)
    rarely, watched_s = changes(window(3, lane_change_every_s=100.0), 300.0)
    assert len(rarely) < 0.8 * watched_s / 100.0 + 4 * math.sqrt(watched_s / 100.0)
    assert changes(window(3, lane_change_every_s=math.inf), 300.0)[0] == []


def test_however_often_they_try_they_change_to_both_sides(window):
    begun, lanes = window(3, lane_change_every_s=0.5), []
    for _ in range(60):
        begun.drive()
        lanes += begun.lanes().values()
    assert 1.5 < np.mean(lanes) < 2.5


def test_nobody_near_begins_a_lane_change_while_the_host_is_changing_lanes(window):
    reach_m = 2.0 * 40 / KMH
    near = CLEAR_OF_HOST_M - reach_m
    while_it_keeps, _ = changes(window(4, lane_change_every_s=4.0), 300.0)
    while_it_changes, _ = changes(window(4, lane_change_every_s=4.0), 300.0, host_changing_lane=True)
    assert sum(distance < near for distance in while_it_keeps) >= 5  # so the next line can fail
    assert not any(distance < near for distance in while_it_changes)
    assert len(while_it_changes) > 100  # the others go on changing lanes


def test_the_same_generator_makes_the_same_traffic_and_another_does_not(window):
    def history(seed):
        begun = window(seed)
        for _ in range(20):
            begun.drive()
        return [(name, *libsumo.vehicle.getPosition(name)) for name in sorted(begun.others())]

    assert history(5) == history(5)
    assert history(5) != history(6)


def test_round_a_ring_the_window_goes_on_for_laps(window):
    begun = window(network="ring5", host_kmh=80.0)
    lap_m = begun.road.length_m
    counts = []
    while begun.simulation.host.travelled_m < 1.5 * lap_m:
        begun.drive(5.0)
        counts.append(len(begun.others()))
        host = np.array(libsumo.vehicle.getPosition(HOST))
        chords = [np.hypot(*(np.array(libsumo.vehicle.getPosition(name)) - host)) for name in begun.others()]
        assert max(chords) < 250.0 + 5.0 * 40 / KMH
    assert np.mean(counts) > 17.0


def test_beyond_the_end_of_the_road_nobody_is_placed(window):
    begun = window(host_kmh=80.0)
    end_m = begun.road.length_m
    while (host_m := libsumo.vehicle.getPosition(HOST)[0]) < end_m - 100.0:
        begun.drive()
    assert host_m > end_m - 200.0
    assert begun.others()  # those behind are still there
    assert max(begun.ahead_m().values()) < 200.0


@pytest.mark.slow
def test_the_vehicles_of_a_window_never_touch_one_another(window, tmp_path):
    # Twice as many that change lanes six times as often as by default.
    output = tmp_path / "collisions.xml"
    for seed in range(20):
        begun = window(
            seed, vehicles=40, lane_change_every_s=5.0, outputs=("--collision-output", str(output)), host_kmh=50.0
        )
        for _ in range(150):
            begun.drive()
        begun.simulation.close()
        assert "<collision " not in output.read_text(), seed


def test_a_vehicle_ordered_off_the_road_or_into_another_stays_where_it_is():
    with Simulation(assets.network("highway5"), seed=1) as simulation:
        simulation.lay_course(road.load("highway5"), ADAS, sees_m=120.0)
        simulation.add_host(["highway"], lane=4, front_m=100.0, speed_mps=20.0)
        for name, lane in (("right", 0), ("left", 4), ("beside", 3), ("free", 1)):
            simulation.add_vehicle(
                name, ["highway"], lane=lane, front_m=400.0, desired_speed_mps=20.0, car_following="Krauss"
            )
        simulation.wait_for_host()
        for name, side in (("right", -1), ("left", 1), ("beside", 1), ("free", 1)):
            lane = simulation.lane_beside(name, side)
            if lane is not None:
                simulation.order_lane_change(name, lane)
        simulation.run(Command(20.0, steps=50))
        lanes = {name: libsumo.vehicle.getLaneIndex(name) for name in ("right", "left", "beside", "free")}
        assert lanes == {"right": 0, "left": 4, "beside": 3, "free": 2}


def test_those_far_behind_the_host_change_lanes_while_it_does(window, monkeypatch):
    begun = window(vehicles=40, lane_change_every_s=2.0)
    ordered = []
    monkeypatch.setattr(begun.simulation, "order_lane_change", lambda name, lane: ordered.append(begun.ahead_m()[name]))
    for _ in range(10):
        begun.drive(host_changing_lane=True)
    assert min(ordered) < -CLEAR_OF_HOST_M - 10.0
    assert max(ordered) > CLEAR_OF_HOST_M + 10.0
    assert np.abs(ordered).min() >= CLEAR_OF_HOST_M - 1.0


@pytest.mark.parametrize("everybody_changes", [False, True])
def test_nobody_is_put_beside_a_vehicle_that_changes_lanes(window, everybody_changes):
    begun, apart_m = window(5), []
    known = set(begun.others())
    for _ in range(60):
        begun.simulation.run(Command(begun.host_mps, steps=19))
        there_m = begun.ahead_m()
        begun.window.update(elapsed_s=2.0, changing_lane=begun.others() if everybody_changes else [])
        begun.simulation.run(Command(begun.host_mps))  # the new ones enter on this step
        now_m = begun.ahead_m()
        stayed_m = [there_m[name] for name in there_m.keys() & now_m.keys()]
        apart_m += [min(abs(now_m[name] - m) for m in stayed_m) for name in now_m.keys() - known]
        known |= now_m.keys()
    assert len(apart_m) >= 8
    assert (min(apart_m) > CLEAR_OF_HOST_M - 4.0) == everybody_changes


def test_of_two_that_would_move_into_one_lane_side_by_side_one_is_told_to(window, monkeypatch):
    begun = window(3, lane_change_every_s=2.0, vehicles=40)
    lanes_ordered = []
    order = begun.simulation.order_lane_change
    monkeypatch.setattr(
        begun.simulation,
        "order_lane_change",
        lambda name, lane: (lanes_ordered.append((lane, begun.ahead_m()[name])), order(name, lane)),
    )
    n_orders = 0
    for _ in range(20):
        lanes_ordered.clear()
        begun.drive()
        n_orders += len(lanes_ordered)
        for lane in range(5):
            places = sorted(ahead for other, ahead in lanes_ordered if other == lane)
            assert np.diff(places).min(initial=math.inf) >= CLEAR_OF_ANOTHER_M
    assert n_orders > 100


def test_nobody_who_soon_leaves_its_edge_is_told_to_change_lanes():
    # SUMO crashes over an order that still holds on the next edge.
    with Simulation(assets.network("ring5"), seed=1) as simulation:
        simulation.lay_course(road.load("ring5"), ADAS, sees_m=120.0)
        edges = road.load("ring5").laps(0, 2000.0)
        simulation.add_host(edges, lane=4, front_m=50.0, speed_mps=15.0)
        length_m = road.load("ring5").edges[0].length_m
        for name, front_m in (("near", length_m - 25.0), ("far", length_m - 100.0)):
            simulation.add_vehicle(name, edges, lane=1, front_m=front_m, desired_speed_mps=10.0, car_following="Krauss")
        simulation.wait_for_host()
        assert simulation.lane_beside("near", 1) is None
        assert simulation.lane_beside("far", 1) == 2


@pytest.mark.parametrize("model", ["Krauss", "IDM", "EIDM", "W99"])
def test_the_car_following_model_is_what_is_configured_and_decides_every_half_second(window, model):
    begun = window(3, car_following=model)
    assert {libsumo.vehicle.getTypeID(name).partition("@")[0] for name in begun.others()} == {
        f"rail_sumo_traffic_{model}"
    }
    assert {libsumo.vehicle.getActionStepLength(name) for name in begun.others()} == {0.5}
    # The acceleration is the same for the five steps between two decisions.
    names, accelerations = begun.others(), []
    for _ in range(50):
        begun.drive(0.1)
        accelerations.append([libsumo.vehicle.getAcceleration(name) for name in names])
    n_different = [len(set(of_one)) for of_one in np.round(accelerations, 6).T.tolist()]
    assert 2 < max(n_different) <= 11


def test_desired_speeds_are_shares_of_the_limit_unless_they_are_numbers():
    assert config.Traffic().desired_kmh(80.0) == (56.0, 70.0)  # the paper's world, to the last bit
    assert config.Traffic(speed_low_kmh="limit*.5", speed_high_kmh=90.0).desired_kmh(120.0) == (60.0, 90.0)
    assert config.Traffic(speed_low_kmh="limit*1", speed_high_kmh="limit*1").desired_kmh(120.0) == (120.0, 120.0)
