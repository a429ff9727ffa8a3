"""SUMO itself: what the adapter tells of it, and the acceptance of the ADAS layer with scripted vehicles around."""

import math
from dataclasses import dataclass
from pathlib import Path

import libsumo
import numpy as np
import pytest

from rail_sumo import assets, config
from rail_sumo.errors import InputError
from rail_sumo.highway.network import road
from rail_sumo.highway.network.demand import Demand
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.highway.vehicle.adas import SUMO_DECIDES, Adas
from rail_sumo.records import KMH, Command, MetaAction, Scene

STEP_S = 0.1
CAR_M = 5.0
START_M = 1000.0
"""Where the host's front bumper starts."""
HOST_LANE = 2
LANE_M = 3.2
DECIDES_EVERY_STEP = "DEFAULT_VEHTYPE"
"""SUMO's own type of vehicle: the made traffic's would obey a script every 0.5 s only."""

EXPRESSWAY = str(Path(__file__).with_name("expressway.net.xml"))
"""Five lanes and a limit of 130 km/h: highway5's 80 km/h is too slow for UN R157's cut-ins."""
FAST = config.Adas(max_speed_kmh=130.0, start_speed_kmh=60.0)


def simulate(network=EXPRESSWAY, adas=FAST, **changes):
    course = road.load(network)
    simulation = Simulation(course.net_file, seed=1, **changes)
    simulation.lay_course(course, adas, sees_m=300.0)
    return simulation


class Script:
    """A stretch of highway with the host and vehicles that do as they are told, whatever lies ahead of them."""

    def __init__(self, simulation, *, speed_mps, set_mps=None, adas=FAST):
        self.simulation = simulation
        self.adas = Adas(adas, start_mps=set_mps or speed_mps)
        self.names = [HOST]
        libsumo.route.add("along", ["highway"])
        simulation.add_host(["highway"], lane=HOST_LANE, front_m=START_M, speed_mps=speed_mps)

    def add(self, name, *, lane, speed_mps, gap_m=None, ahead_m=None):
        """A vehicle so many metres ahead of the host, bumper to bumper or centre to centre (negative: behind)."""
        front_m = START_M + (gap_m + CAR_M if ahead_m is None else ahead_m)
        libsumo.vehicle.add(
            name, "along", DECIDES_EVERY_STEP, departLane=str(lane), departPos=str(front_m), departSpeed=str(speed_mps)
        )
        self.names.append(name)
        libsumo.vehicle.setSpeedMode(name, 0)
        libsumo.vehicle.setLaneChangeMode(name, 0)
        libsumo.vehicle.setSpeed(name, speed_mps)

    def begin(self):
        self.simulation.wait_for_host()
        scene = self.simulation.scene()
        assert sorted(scene.ids) == sorted(self.names), "SUMO found no room for one of the vehicles"
        return scene

    def decide(self, action):
        self.adas.decide(action, self.simulation.host.state(), self.simulation.host.gaps)

    def step(self):
        command = self.adas.command(self.simulation.host.state(), self.simulation.host.gaps, steps=1)
        self.simulation.run(command)
        return self.simulation.scene()

    def steps(self, seconds):
        return [self.step() for _ in range(round(seconds / STEP_S))]

    @property
    def hardest_braking_mps2(self):
        return -np.diff(self.simulation.host.speeds_mps).min() / STEP_S


@pytest.fixture
def script():
    """Set scripts up, one after the other, each with a simulation of its own."""
    simulations = []

    def start(**arguments):
        for simulation in simulations:
            simulation.close()
        simulations.append(simulate())
        return Script(simulations[-1], **arguments)

    yield start
    for simulation in simulations:
        simulation.close()


def index(scene, name):
    return scene.ids.index(name)


def gap_to(scene, name):
    """Bumper to bumper along a road that runs east, negative where they overlap."""
    other = index(scene, name)
    return abs(scene.x_m[other] - scene.x_m[0]) - 0.5 * (scene.length_m[other] + scene.length_m[0])


# What the adapter tells.


def test_a_demand_of_another_network_is_told_of_as_such():
    theirs = Demand(routes=(assets.routes("arterial"),))
    with pytest.raises(InputError, match=r"is not known\..* Does the demand belong to this network\?$"):
        Simulation(assets.network("highway3"), demand=theirs, seed=1)


def test_a_scene_holds_box_centres_and_directions_in_the_road_frame(script):
    drive = script(speed_mps=20.0)
    drive.add("lead", lane=4, gap_m=30.0, speed_mps=15.0)
    scene = drive.begin()
    front = libsumo.vehicle.getPosition(HOST)
    assert scene.ids == [HOST, "lead"]
    # SUMO tells front bumpers; the first step has moved each car to where its centre is half a length behind.
    assert (scene.x_m[0], scene.y_m[0]) == pytest.approx((front[0] - CAR_M / 2, 0.0))
    assert scene.y_m[1] == pytest.approx(2 * LANE_M)  # two lanes to the left
    assert scene.heading_rad == pytest.approx([0.0, 0.0])  # east
    assert scene.speed_mps == pytest.approx([20.0, 15.0])
    assert scene.length_m.tolist() == [CAR_M, CAR_M]
    assert scene.width_m.tolist() == [1.8, 1.8]


def test_on_the_ring_the_host_keeps_to_its_lanes_circle_and_looks_along_the_tangent():
    ring = road.load("ring5")
    with simulate("ring5") as simulation:
        simulation.add_host(ring.laps(0, 4000.0), lane=4, front_m=100.0, speed_mps=20.0)
        simulation.wait_for_host()
        headings = []
        for _ in range(40):
            simulation.run(Command(20.0, steps=10))
            scene = simulation.scene()
            # Lane 4 is the leftmost and the ring runs counter-clockwise: two lanes inside the middle one's 500 m.
            assert math.hypot(scene.x_m[0], scene.y_m[0]) == pytest.approx(500.0 - 2 * LANE_M, abs=0.15)
            tangent = math.atan2(scene.y_m[0], scene.x_m[0]) + math.pi / 2
            headings.append(math.remainder(scene.heading_rad[0] - tangent, 2 * math.pi))
        assert np.abs(headings).max() < math.radians(1.5)  # a chord of the polygon


def test_the_host_stands_among_all_lanes_of_its_edge(script):
    drive = script(speed_mps=20.0)
    scene = drive.begin()
    host = drive.simulation.host.state()
    assert (host.lane, host.rightmost_lane, host.leftmost_lane) == (HOST_LANE, 0, 4)
    assert host.lane_width_m == LANE_M
    assert host.to_edge_end_m == pytest.approx(8200.0 - (scene.x_m[0] + CAR_M / 2))
    assert host.speed_mps == pytest.approx(20.0)


@pytest.mark.parametrize(("side", "lane"), [(0, HOST_LANE), (1, HOST_LANE + 1), (-1, HOST_LANE - 1)])
def test_gaps_are_from_bumper_to_bumper_on_every_side(script, side, lane):
    drive = script(speed_mps=20.0)
    drive.add("lead", lane=lane, gap_m=45.0, speed_mps=18.0)
    drive.add("chaser", lane=lane, ahead_m=-70.0, speed_mps=21.0)
    scene = drive.begin()
    gaps = drive.simulation.host.gaps(side)
    assert gaps.ahead_m == pytest.approx(gap_to(scene, "lead"), abs=1e-6)
    assert gaps.behind_m == pytest.approx(gap_to(scene, "chaser"), abs=1e-6)
    assert (gaps.ahead_speed_mps, gaps.behind_speed_mps) == pytest.approx((18.0, 21.0))
    for other in {0, 1, -1} - {side}:
        empty = drive.simulation.host.gaps(other)
        assert (empty.ahead_m, empty.behind_m) == (math.inf, math.inf)


@pytest.mark.parametrize("offset_m", [-4.0, -1.0, 1.0, 4.0])
def test_a_vehicle_alongside_makes_a_gap_negative(script, offset_m):
    drive = script(speed_mps=20.0)
    drive.add("beside", lane=HOST_LANE + 1, ahead_m=offset_m, speed_mps=20.0)
    scene = drive.begin()
    assert abs(scene.x_m[1] - scene.x_m[0]) < CAR_M
    gaps = drive.simulation.host.gaps(1)
    assert min(gaps.ahead_m, gaps.behind_m) < 0.0


def test_the_smallest_time_to_collision_is_gap_over_closing_speed(script):
    drive = script(speed_mps=20.0)
    drive.add("lead", lane=HOST_LANE, gap_m=90.0, speed_mps=10.0)
    drive.begin()
    seen = []
    for scene in drive.steps(20.0):
        closing = scene.speed_mps[0] - scene.speed_mps[1]
        seen.append(gap_to(scene, "lead") / closing if closing > 1e-9 else math.inf)
    assert drive.simulation.host.min_ttc_s == pytest.approx(min(seen), rel=1e-6)
    assert 0.0 < min(seen) < 9.0


def test_with_nobody_ahead_there_is_no_time_to_collision(script):
    drive = script(speed_mps=20.0)
    drive.begin()
    drive.steps(5.0)
    assert drive.simulation.host.min_ttc_s == math.inf


# One simulation a process.


def test_a_second_simulation_in_the_process_is_refused_and_the_first_goes_on(script):
    drive = script(speed_mps=20.0)
    drive.begin()
    message = (
        "^a simulation is already running in this process and libsumo holds only one; "
        "close it, make one environment with isolated=True, or drive episodes in worker processes$"
    )
    with pytest.raises(RuntimeError, match=message):
        simulate()
    assert drive.step().x_m[0] > START_M - CAR_M / 2


def test_closing_twice_is_harmless_even_to_the_simulation_after_it():
    first = simulate()
    first.close()
    with simulate() as second:
        first.close()
        second.add_host(["highway"], lane=0, front_m=500.0, speed_mps=20.0)
        second.wait_for_host()
        assert second.scene().ids == [HOST]


def test_demand_that_sumo_cannot_load_is_a_users_error_and_leaves_the_process_free(tmp_path, capfd):
    broken = tmp_path / "broken.rou.xml"
    broken.write_text('<routes><vehicle id="a" depart="0"><route edges="nowhere"/></vehicle></routes>')
    with pytest.raises(InputError, match=r"^SUMO cannot load the network or its demand: "):
        simulate(demand=Demand((broken,)))
    simulate().close()
    capfd.readouterr()


def test_a_host_that_finds_no_gap_is_a_users_error():
    with simulate() as simulation:
        libsumo.route.add("along", ["highway"])
        libsumo.vehicle.add("parked", "along", DECIDES_EVERY_STEP, departLane="0", departPos="500", departSpeed="0")
        libsumo.vehicle.setSpeed("parked", 0.0)
        simulation.run_without_host(1.0)
        simulation.add_host(["highway"], lane=0, front_m=498.0, speed_mps=20.0)
        with pytest.raises(
            InputError, match=r"^the host could not enter within 120 s, 498 m along lane 0 of edge 'high"
        ):
            simulation.wait_for_host()


def test_into_a_slow_queue_the_host_enters_slower_once_it_has_waited_for_a_gap(tmp_path):
    flows = "".join(
        f'<flow id="{lane}" type="tractor" begin="0" end="900" period="2" departLane="{lane}" departSpeed="max">'
        f'<route edges="highway"/></flow>'
        for lane in range(3)
    )
    (tmp_path / "queue.rou.xml").write_text(f'<routes><vType id="tractor" maxSpeed="5"/>{flows}</routes>')
    with simulate("highway3", demand=Demand((tmp_path / "queue.rou.xml",))) as simulation:
        simulation.run_without_host(60.0)
        simulation.add_host(["highway"], lane=1, front_m=10.0, speed_mps=20.0)
        simulation.wait_for_host()
        assert 90.0 < libsumo.simulation.getTime() < 180.0
        assert 0.0 < simulation.host.speeds_mps[0] < 5.0
        assert libsumo.vehicle.getMaxSpeed(HOST) == pytest.approx(FAST.max_speed_kmh / KMH)


# Closed forms.


def test_two_seconds_at_20_mps_are_40_metres(script):
    drive = script(speed_mps=20.0)
    start = drive.begin().x_m[0]
    assert drive.steps(2.0)[-1].x_m[0] - start == pytest.approx(40.0, abs=1e-6)


def test_many_steps_in_one_command_are_as_many_single_ones(script):
    def driven(commands):
        drive = script(speed_mps=20.0)
        drive.add("lead", lane=HOST_LANE, gap_m=60.0, speed_mps=15.0)
        drive.begin()
        for command in commands:
            assert drive.simulation.run(command) == command.steps
        return drive.simulation.host.speeds_mps, drive.simulation.scene().x_m.tolist(), drive.simulation.host.min_ttc_s

    assert driven([Command(24.0, steps=50)]) == driven([Command(24.0)] * 50)


@pytest.mark.parametrize(("action", "sign"), [(MetaAction.ACCELERATE, 1), (MetaAction.DECELERATE, -1)])
def test_five_kmh_more_or_less_take_seven_tenths_of_a_second_at_2_mps2(script, action, sign):
    drive = script(speed_mps=20.0)
    drive.begin()
    drive.decide(action)
    drive.steps(1.0)
    change = np.abs(np.diff(drive.simulation.host.speeds_mps))
    # 5 km/h are 1.389 m/s: six steps of 0.2 m/s and the rest.
    assert change == pytest.approx([0.2] * 6 + [5 / KMH - 1.2] + [0.0] * 3, abs=1e-6)
    assert drive.simulation.host.speeds_mps[-1] == pytest.approx(20.0 + sign * 5 / KMH)


def test_behind_a_slower_car_the_host_settles_at_its_time_gap_and_standstill_gap(script):
    drive = script(speed_mps=20.0)
    drive.add("lead", lane=HOST_LANE, gap_m=60.0, speed_mps=12.0)
    drive.begin()
    scene = drive.steps(60.0)[-1]
    assert scene.speed_mps[0] == pytest.approx(12.0, abs=1e-3)
    # 1 s behind at 12 m/s and the 2 m that are left at standstill; within one step's travel.
    assert gap_to(scene, "lead") == pytest.approx(12.0 * 1.0 + 2.0, abs=1.2)


@pytest.mark.parametrize("standstill_gap_m", [1.0, 2.0, 5.0])
def test_behind_a_stopped_car_the_host_rests_at_its_standstill_gap(standstill_gap_m, touching):
    limits = config.Adas(max_speed_kmh=130.0, standstill_gap_m=standstill_gap_m)
    with simulate(adas=limits) as simulation:
        drive = Script(simulation, speed_mps=15.0, adas=limits)
        drive.add("stopped", lane=HOST_LANE, gap_m=100.0, speed_mps=0.0)
        drive.begin()
        scenes = drive.steps(40.0)
    assert not any(touching(scene) for scene in scenes)
    assert scenes[-1].speed_mps[0] == pytest.approx(0.0, abs=1e-3)
    assert gap_to(scenes[-1], "stopped") == pytest.approx(standstill_gap_m, abs=0.2)
    assert gap_to(scenes[-1], "stopped") == pytest.approx(gap_to(scenes[-50], "stopped"), abs=1e-3)


# Acceptance: nobody is touched, and nobody brakes beyond 9 m/s².


def stopping_vehicle(script, braking_mps2, *, until_mps=0.0):
    """The host 44 m behind a vehicle at 30 m/s that brakes; returns the scenes."""
    drive = script(speed_mps=30.0)
    drive.add("lead", lane=HOST_LANE, gap_m=44.0, speed_mps=30.0)
    scenes = [drive.begin()]
    scenes += drive.steps(1.0)
    assert gap_to(scenes[-1], "lead") == pytest.approx(44.0, abs=1e-3)
    assert scenes[-1].speed_mps == pytest.approx([30.0, 30.0])
    speed = 30.0
    for _ in range(400):
        speed = max(until_mps, speed - braking_mps2 * STEP_S)
        libsumo.vehicle.setSpeed("lead", speed)
        scenes.append(drive.step())
    return drive, scenes


@pytest.mark.parametrize("braking_mps2", [4.5, 6.0, 8.0, 9.0])
@pytest.mark.parametrize("until_mps", [0.0, 10.0])
def test_a_lead_vehicle_that_brakes_from_30_mps_is_not_touched(script, touching, braking_mps2, until_mps):
    drive, scenes = stopping_vehicle(script, braking_mps2, until_mps=until_mps)
    lead_braking = -np.diff([scene.speed_mps[index(scene, "lead")] for scene in scenes]) / STEP_S
    full_steps = int((30.0 - until_mps) / (braking_mps2 * STEP_S) + 1e-9)
    assert (np.abs(lead_braking - braking_mps2) < 1e-6).sum() == full_steps  # it really brakes as hard as it should
    assert not any(touching(scene) for scene in scenes)
    assert drive.hardest_braking_mps2 <= 9.0 + 1e-6
    assert not drive.simulation.host.contact
    assert scenes[-1].speed_mps[0] == pytest.approx(until_mps, abs=0.1)


def cut_in(script, *, host_mps, gap_m, slower_mps, seconds=8.0):
    """A vehicle moves over into the host's lane at once, then drives on more slowly; returns the scenes since."""
    drive = script(speed_mps=host_mps)
    drive.add("intruder", lane=HOST_LANE + 1, gap_m=gap_m + slower_mps * 5 * STEP_S, speed_mps=host_mps - slower_mps)
    drive.begin()
    drive.steps(0.4)
    libsumo.vehicle.changeLane("intruder", HOST_LANE, 0.0)
    scenes = drive.steps(STEP_S)
    assert scenes[0].y_m == pytest.approx([0.0, 0.0])
    assert gap_to(scenes[0], "intruder") == pytest.approx(gap_m, abs=1e-3)
    return drive, scenes + drive.steps(seconds)


def must_be_mastered(gap_m, slower_mps):
    """UN R157: the time to collision at the intrusion exceeds v_rel / (2 * 6 m/s²) + 0.35 s."""
    return gap_m / slower_mps > slower_mps / (2 * 6.0) + 0.35


@pytest.mark.parametrize("host_mps", [22.0, 30.0])
@pytest.mark.parametrize("slower_mps", range(3, 11))
def test_no_cut_in_that_un_r157_wants_mastered_ends_in_contact(script, touching, host_mps, slower_mps):
    gaps_m = [gap_m for gap_m in range(8, 31) if must_be_mastered(gap_m, slower_mps)]
    assert len(gaps_m) >= 19
    for gap_m in gaps_m:
        drive, scenes = cut_in(script, host_mps=host_mps, gap_m=gap_m, slower_mps=slower_mps)
        assert not any(touching(scene) for scene in scenes), gap_m
        assert drive.hardest_braking_mps2 <= 9.0 + 1e-6, gap_m
        assert not drive.simulation.host.contact, gap_m


def test_a_cut_in_that_nobody_could_master_is_a_contact_in_which_the_host_strikes(script, touching):
    # 10 m/s faster over a gap of 3 m; braking at 9 m/s² takes 5.6 m. So the tests above can fail.
    drive, scenes = cut_in(script, host_mps=22.0, gap_m=3.0, slower_mps=10.0, seconds=1.5)
    assert any("intruder" in touching(scene) for scene in scenes)
    assert drive.simulation.host.collisions >= 1
    assert drive.simulation.host.struck == 0
    assert drive.hardest_braking_mps2 == pytest.approx(9.0, abs=1e-6)


def test_a_vehicle_that_runs_into_the_host_strikes_it(script, touching):
    drive = script(speed_mps=20.0)
    drive.add("chaser", lane=HOST_LANE, ahead_m=-70.0, speed_mps=20.0)
    drive.begin()
    libsumo.vehicle.setSpeed("chaser", 36.0)
    scenes = drive.steps(5.0)
    first = next(number for number, scene in enumerate(scenes) if touching(scene))
    assert drive.simulation.host.collisions == 0
    assert drive.simulation.host.struck >= 1
    assert gap_to(scenes[first - 1], "chaser") > 0.0


def test_a_run_ends_in_the_step_of_the_contact(script, touching):
    drive = script(speed_mps=20.0)
    drive.add("chaser", lane=HOST_LANE, ahead_m=-70.0, speed_mps=20.0)
    drive.begin()
    libsumo.vehicle.setSpeed("chaser", 36.0)
    driven = drive.simulation.run(Command(20.0, steps=100))
    assert driven == len(drive.simulation.host.speeds_mps) - 1 < 100
    assert touching(drive.simulation.scene()) == ["chaser"]
    assert gap_to(drive.simulation.scene(), "chaser") > -1.7  # at 16 m/s faster, one step's travel


def test_a_stationary_obstacle_120_m_ahead_is_stopped_short_of_from_80_kmh(script, touching):
    drive = script(speed_mps=80 / KMH)
    drive.add("obstacle", lane=HOST_LANE, gap_m=120.0, speed_mps=0.0)
    scenes = [drive.begin(), *drive.steps(25.0)]
    assert gap_to(scenes[0], "obstacle") == pytest.approx(120.0 - 80 / KMH * STEP_S, abs=3.0)
    assert not any(touching(scene) for scene in scenes)
    assert drive.hardest_braking_mps2 <= 9.0 + 1e-6
    assert scenes[-1].speed_mps[0] == pytest.approx(0.0, abs=1e-3)
    assert 0.0 < gap_to(scenes[-1], "obstacle") < 5.0


# Comfort: what is in sight in time is braked for gently.


@pytest.mark.parametrize("kmh", [50, 80, 100, 130])
def test_a_standing_queue_in_sight_for_250_m_is_stopped_behind_gently(script, touching, kmh):
    drive = script(speed_mps=kmh / KMH)
    for car in range(5):
        drive.add(f"queue{car}", lane=HOST_LANE, gap_m=250.0 + 7.5 * car, speed_mps=0.0)
    scenes = [drive.begin(), *drive.steps(50.0)]
    assert not any(touching(scene) for scene in scenes)
    assert 1.9 < drive.hardest_braking_mps2 <= 3.0
    assert scenes[-1].speed_mps[0] == pytest.approx(0.0, abs=1e-3)
    assert gap_to(scenes[-1], "queue0") == pytest.approx(2.0, abs=0.5)


@pytest.mark.parametrize("period_s", [10, 30, 60])
def test_behind_a_leader_that_swings_by_10_kmh_the_host_swings_no_more(script, period_s):
    drive = script(speed_mps=20.0, set_mps=30.0)
    drive.add("lead", lane=HOST_LANE, gap_m=22.0, speed_mps=20.0)
    drive.begin()
    led = []
    for step in range(round(3 * period_s / STEP_S)):
        libsumo.vehicle.setSpeed("lead", 20.0 + 10 / KMH * math.sin(2 * math.pi * step * STEP_S / period_s))
        led.append(drive.step().speed_mps[1])
    last_period = slice(-round(period_s / STEP_S), None)
    swing = np.ptp(drive.simulation.host.speeds_mps[last_period])
    assert 0.8 * 20 / KMH < swing <= np.ptp(led[last_period])


def test_a_vehicle_that_the_host_moves_in_front_of_is_watched_for_hard_braking(script):
    def brakes_behind(name, after_s=0.0):
        drive = script(speed_mps=20.0)
        drive.add("follower", lane=HOST_LANE + 1, ahead_m=-30.0, speed_mps=20.0)
        drive.add("bystander", lane=HOST_LANE, ahead_m=-60.0, speed_mps=20.0)
        drive.begin()
        drive.decide(MetaAction.LEFT)
        drive.steps(2.0 + after_s)
        for step in range(1, 11):
            libsumo.vehicle.setSpeed(name, 20.0 - 4.0 * STEP_S * step)
            drive.step()
        drive.steps(5.0)
        return drive.simulation.host.hard_brakings_behind

    assert brakes_behind("follower") == 1
    assert brakes_behind("bystander") == 0  # it is behind in the lane that the host has left
    assert brakes_behind("follower", after_s=5.0) == 0  # too late to be the host's doing


def test_a_vehicle_that_the_host_moves_in_front_of_twice_is_watched_once(script):
    drive = script(speed_mps=20.0)
    drive.add("follower", lane=HOST_LANE + 1, ahead_m=-30.0, speed_mps=20.0)
    drive.begin()
    for action, seconds in ((MetaAction.LEFT, 1.0), (MetaAction.RIGHT, 1.2), (MetaAction.LEFT, 1.0)):
        drive.decide(action)
        drive.steps(seconds)
    for step in range(1, 11):
        libsumo.vehicle.setSpeed("follower", 20.0 - 4.0 * STEP_S * step)
        drive.step()
    drive.steps(3.0)
    assert drive.simulation.host.hard_brakings_behind == 1


def test_a_watched_vehicle_may_leave_the_road(script):
    drive = script(speed_mps=20.0)
    drive.add("follower", lane=HOST_LANE + 1, ahead_m=-30.0, speed_mps=20.0)
    drive.begin()
    drive.decide(MetaAction.LEFT)
    drive.steps(2.0)
    drive.simulation.remove_vehicle("follower")
    drive.steps(2.0)
    assert drive.simulation.host.hard_brakings_behind == 0


@pytest.mark.parametrize("time_gap_s", [1.0, 2.0])
def test_sumos_own_driver_keeps_the_time_gap_too(time_gap_s):
    limits = config.Adas(max_speed_kmh=130.0, time_gap_s=time_gap_s)
    with simulate(adas=limits) as simulation:
        drive = Script(simulation, speed_mps=20.0, adas=limits)
        drive.add("lead", lane=HOST_LANE, gap_m=60.0, speed_mps=18.0)
        drive.begin()
        simulation.host.hand_over()
        libsumo.vehicle.setLaneChangeMode(HOST, 0)
        simulation.run(Command(SUMO_DECIDES, steps=600))
        assert gap_to(simulation.scene(), "lead") == pytest.approx(2.0 + time_gap_s * 18.0, abs=2.0)


def test_with_weak_brakes_no_lane_change_leads_up_to_a_standing_car(touching):
    weak = config.Adas(max_speed_kmh=130.0, emergency_braking_mps2=2.0)
    with simulate(adas=weak) as simulation:
        drive = Script(simulation, speed_mps=80 / KMH, adas=weak)
        drive.add("standing", lane=HOST_LANE + 1, gap_m=95.0, speed_mps=0.0)
        drive.begin()
        drive.decide(MetaAction.LEFT)
        scenes = drive.steps(8.0)
        assert drive.adas.refused_decisions == 1
        assert not any(touching(scene) for scene in scenes)


# Lane changes.


@dataclass
class Change:
    scenes: list[Scene]
    drive: Script

    @property
    def left_m(self):
        return [scene.y_m[0] for scene in self.scenes]


def change(script, action, *, back_at=None):
    """Begin a change; decide for the other side once this part of the way is made; drive on for 4 s."""
    side = 1 if action is MetaAction.LEFT else -1
    drive = script(speed_mps=20.0)
    for lane in (HOST_LANE, HOST_LANE + side):
        for ahead_m in (45.0, -75.0):
            drive.add(f"{lane}{ahead_m}", lane=lane, ahead_m=ahead_m, speed_mps=20.0)
    scenes = [drive.begin()]
    drive.decide(action)
    for _ in range(40):
        if back_at is not None and abs(scenes[-1].y_m[0]) >= back_at * LANE_M - 1e-9:
            drive.decide(MetaAction.RIGHT if side > 0 else MetaAction.LEFT)
            back_at = None
        scenes.append(drive.step())
    return Change(scenes, drive)


@pytest.mark.parametrize(("action", "side"), [(MetaAction.LEFT, 1), (MetaAction.RIGHT, -1)])
def test_a_lane_change_in_sumo_follows_its_path_and_ends_in_the_next_lane(script, touching, action, side):
    made = change(script, action)
    path = side * np.array(made.left_m)
    assert path == pytest.approx(np.minimum(0.17 * np.arange(41), LANE_M), abs=1e-6)
    assert made.drive.simulation.host.state().lane == HOST_LANE + side
    assert not any(touching(scene) for scene in made.scenes)
    assert (made.drive.adas.lane_changes, made.drive.adas.aborted_lane_changes) == (1, 0)


@pytest.mark.parametrize("part", [0.25, 0.5, 0.75])
@pytest.mark.parametrize(("action", "side"), [(MetaAction.LEFT, 1), (MetaAction.RIGHT, -1)])
def test_a_reversed_lane_change_in_sumo_returns_to_the_lane_centre(script, touching, action, side, part):
    made = change(script, action, back_at=part)
    path = side * np.array(made.left_m)
    there = math.ceil(part * LANE_M / 0.17)
    back = np.maximum(0.0, 0.17 * (2 * there - np.arange(41)))
    assert path == pytest.approx(np.minimum(0.17 * np.arange(41), back), abs=1e-6)
    assert made.drive.simulation.host.state().lane == HOST_LANE
    assert not any(touching(scene) for scene in made.scenes)
    assert (made.drive.adas.lane_changes, made.drive.adas.aborted_lane_changes) == (0, 1)
    assert made.drive.hardest_braking_mps2 <= 9.0 + 1e-6


@pytest.mark.parametrize("after_s", np.arange(0.1, 2.0, 0.2).round(1).tolist())
def test_a_vehicle_that_shoots_into_the_gap_is_not_touched_whenever_it_comes(script, touching, after_s):
    # From two lanes away into the lane the host moves to, 8 m behind it: the layer turns back, or is across by then.
    drive = script(speed_mps=20.0)
    drive.add("rival", lane=HOST_LANE + 2, ahead_m=-8.0 - CAR_M, speed_mps=20.0)
    scenes = [drive.begin()]
    drive.decide(MetaAction.LEFT)
    scenes += drive.steps(after_s)
    libsumo.vehicle.changeLane("rival", HOST_LANE + 1, 0.0)
    libsumo.vehicle.setSpeedMode("rival", 31)  # it looks ahead, for whom it can see
    scenes += drive.steps(4.0)
    assert not any(touching(scene) for scene in scenes)
    assert scenes[-1].y_m[0] == pytest.approx(LANE_M if drive.adas.lane_changes else 0.0)
    assert drive.adas.lane_changes + drive.adas.aborted_lane_changes == 1
    assert drive.adas.aborted_lane_changes == (after_s < 0.65)  # in the eighth step the host crosses itself


# The oracle itself.


def two_boxes(x_m, y_m, heading_rad):
    return Scene(
        time_s=0.0,
        ids=[HOST, "other"],
        boxes=np.array(
            (
                np.array([0.0, x_m]),
                np.array([0.0, y_m]),
                np.array([0.0, heading_rad]),
                np.zeros(2),
                np.full(2, CAR_M),
                np.full(2, 1.8),
            )
        ),
    )


@pytest.mark.parametrize(
    ("x_m", "y_m", "heading_rad", "touches"),
    [
        (4.99, 0.0, 0.0, True),
        (5.01, 0.0, 0.0, False),
        (0.0, 1.79, 0.0, True),
        (0.0, 1.81, 0.0, False),
        (3.39, 0.0, math.pi / 2, True),  # 2.5 + 0.9
        (3.41, 0.0, math.pi / 2, False),
        # A corner of the other, turned by 45 degrees, points at the host's corner (2.5, 0.9): its nearest point lies
        # 0.9 m from its centre, across its long side.
        (2.5 + 0.89 / math.sqrt(2), 0.9 + 0.89 / math.sqrt(2), -math.pi / 4, True),
        (2.5 + 0.91 / math.sqrt(2), 0.9 + 0.91 / math.sqrt(2), -math.pi / 4, False),
    ],
)
def test_the_rectangle_test_knows_contact_from_a_hairs_breadth(touching, x_m, y_m, heading_rad, touches):
    assert bool(touching(two_boxes(x_m, y_m, heading_rad))) is touches
