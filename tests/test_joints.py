"""Lane changes that go on from edge to edge, in SUMO, on roads that are cut into short ones."""

from pathlib import Path

import libsumo
import numpy as np
import pytest
from driving import EMPTY, KEEP, LANE_M, LEFT, MERGE, RIGHT, UNSEEN, Watched, at_random, drive, onlooker_account, world
from sketch import cut_road

from rail_sumo import config
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.records import Command

STRIDE_M = 0.17
INSIDE_M = [0.0, 0.1, 8.0]
"""How long junctions are within: as in networks without internal lanes, as netconvert cuts a road, and as it may be."""


@pytest.fixture
def cut(tmp_path):
    """Write a road cut into edges and return what a world knows of it."""

    def write(*lengths_m, **arguments):
        path = tmp_path / "cut.net.xml"
        path.write_text(cut_road(*lengths_m, **arguments))
        return {"file": str(path)}

    return write


def before_joint(make, network, lane_id, to_end_m, action, *then):
    """Have the host decide so many metres before the end of a lane; returns the trajectory and where it was."""
    env = make(world(network=network, traffic=EMPTY))
    env.reset(seed=1)
    libsumo.vehicle.moveTo(HOST, lane_id, libsumo.lane.getLength(lane_id) - to_end_m)
    for decision in (action, *then, KEEP, KEEP, KEEP):
        env.drive(decision)
    driven = env.trajectory()
    env.close()
    return driven, fronts_left_m(Watched.latest.scenes)


def fronts_left_m(scenes):
    """Where the middle of the host's front is: over a joint SUMO turns its box, whose back is on the lane behind."""
    return np.array([scene.y_m[0] + 0.5 * scene.length_m[0] * np.sin(scene.heading_rad[0]) for scene in scenes])


def of_host(outputs):
    return [(entry.get("from"), entry.get("to")) for entry in outputs("lanechange") if entry.get("id") == HOST]


@pytest.mark.parametrize("inside_m", INSIDE_M)
@pytest.mark.parametrize(("action", "lane", "side"), [(LEFT, 1, 1), (RIGHT, 1, -1)])
def test_a_lane_change_begun_10_m_before_a_joint_ends_on_the_next_edge_and_is_counted_once(
    make, outputs, cut, inside_m, action, lane, side
):
    network = cut(600, 600, inside_m=inside_m)
    driven, left_m = before_joint(make, network, f"part0_{lane}", 10.0, action)
    assert (driven.lane_changes, driven.aborted_lane_changes, driven.refused_decisions) == (1, 0, 0)
    path = side * (left_m - LANE_M)
    assert path[:19] == pytest.approx(np.minimum(STRIDE_M * np.arange(1, 20), LANE_M), abs=1e-6)
    assert path[19:] == pytest.approx(LANE_M)
    ((left, entered),) = of_host(outputs)
    assert left.rpartition("_")[0] == entered.rpartition("_")[0]
    assert int(entered[-1]) - int(left[-1]) == side


@pytest.mark.parametrize("inside_m", INSIDE_M)
def test_a_lane_change_is_reversed_over_a_joint(make, outputs, cut, inside_m):
    driven, left_m = before_joint(make, cut(600, 600, inside_m=inside_m), "part0_1", 20.0, LEFT, RIGHT)
    assert (driven.lane_changes, driven.aborted_lane_changes, driven.refused_decisions) == (0, 1, 0)
    assert left_m.max() == pytest.approx(LANE_M + 10 * STRIDE_M)  # after a second
    assert left_m[-1] == pytest.approx(LANE_M)
    assert len(of_host(outputs)) == 2


@pytest.mark.parametrize("to_end_m", np.arange(11.0, 17.0, 0.5).tolist())
def test_where_lanes_have_other_numbers_beyond_a_joint_the_host_enters_the_lane_that_it_should(
    make, outputs, tmp_path, to_end_m
):
    """Of `MERGE`'s three lanes the right one ends. Wherever the host is beside the border, it becomes the left lane's.

    It crosses over in its eighth step, 13.3 m on.
    """
    path = tmp_path / "merge.net.xml"
    path.write_text(MERGE)
    driven, left_m = before_joint(make, {"file": str(path)}, "wide_1", to_end_m, LEFT)
    assert (driven.lane_changes, driven.refused_decisions) == (1, 0)
    assert left_m[-1] == pytest.approx(-1.6)
    assert np.diff(left_m).max() <= STRIDE_M + 1e-6
    assert of_host(outputs) in ([("wide_1", "wide_2")], [(":b_0_0", ":b_0_1")], [("narrow_0", "narrow_1")])


@pytest.mark.parametrize("state", "mM")
def test_before_a_crossing_a_lane_change_is_refused(make, tmp_path, watched, state):
    path = tmp_path / "crossing.net.xml"
    text = Path(__file__).with_name("crossing.net.xml").read_text()
    path.write_text(text.replace('state="m"', f'state="{state}"'))
    env = make(world(network={"file": str(path)}, traffic=EMPTY))
    env.reset(seed=1)
    libsumo.vehicle.moveTo(HOST, "up_0", 592.8 - 10.0)
    env.agent.note(0)  # it is elsewhere now
    assert not env.action_masks()[LEFT]
    env.drive(LEFT)
    assert env.trajectory().refused_decisions == 1
    assert np.ptp([scene.x_m[0] for scene in watched().scenes]) == pytest.approx(0.0, abs=1e-6)


# Who is beyond a joint.


@pytest.mark.parametrize("inside_m", [0.0, 0.1])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("gap_m", [110.0, 100.0, 30.0, 8.0, -2.0, -8.0, -40.0, -110.0])
def test_gaps_beside_the_host_are_seen_over_joints(cut, inside_m, side, gap_m):
    """SUMO tells of a leader beyond the edge's end only within the distance of emergency braking: 22 m from 20 m/s."""
    course = road.load(cut(*[20.0] * 30, inside_m=inside_m)["file"])
    host_m, car_m = 205.0, 5.0
    with Simulation(course.net_file, seed=1) as simulation:
        simulation.lay_course(course, config.Adas(max_speed_kmh=100.0), sees_m=300.0)
        index, along_m = course.place(host_m + gap_m + (car_m if gap_m > 0 else -car_m))
        libsumo.route.add("along", course.laps(index, 1e6))
        libsumo.vehicle.add("car", "along", departLane=str(1 + side), departPos=str(along_m), departSpeed="20")
        libsumo.vehicle.setSpeedMode("car", 0)
        libsumo.vehicle.setSpeed("car", 20.0)
        index, along_m = course.place(host_m)
        simulation.add_host(course.laps(index, 1e6), lane=1, front_m=along_m, speed_mps=20.0)
        simulation.wait_for_host()
        for _ in range(12):  # on the edge, over its end, and on the next
            x_m, gaps = simulation.scene().x_m, simulation.host.gaps(side)
            apart_m = abs(x_m[1] - x_m[0]) - car_m
            expected = (apart_m, np.inf) if gap_m > 0 else (np.inf, apart_m)
            assert (gaps.ahead_m, gaps.behind_m) == pytest.approx(expected, abs=1e-6)
            other = simulation.host.gaps(-side)
            assert (other.ahead_m, other.behind_m) == (np.inf, np.inf)
            simulation.run(Command(20.0))


# Any decisions.


@pytest.mark.parametrize("inside_m", INSIDE_M)
@pytest.mark.parametrize("who", ["random", "sumo"])
def test_on_short_edges_lane_changes_are_those_of_sumos_own_output_and_nobody_is_touched(
    make, outputs, cut, touching, inside_m, who
):
    network = cut(*[30.0, 55.0, 80.0, 40.0] * 12, lanes=4, inside_m=inside_m)
    for seed in range(UNSEEN, UNSEEN + 3):
        env = make(world(network=network, traffic={"vehicles": 15}), hands_off=who == "sumo")
        driven = drive(env, at_random(seed), seed=seed)
        env.close()
        scenes = Watched.latest.scenes
        changes, aborted, entries = onlooker_account(fronts_left_m(scenes))
        assert (driven.lane_changes, driven.aborted_lane_changes) == (changes, aborted)
        assert len(of_host(outputs)) == entries
        assert not any(touching(scene) for scene in scenes)
        assert outputs("collision") == []
