"""Speed limits, signals and right of way are kept, and braked for comfortably."""

import dataclasses
import re
from contextlib import contextmanager
from pathlib import Path

import libsumo
import numpy as np
import pytest
from driving import ACCELERATE, BY_THE_LIMIT, EMPTY, KEEP, LEFT, MERGE, RIGHT, UNSEEN, always, at_random, drive, world
from sketch import cut_road

from rail_sumo import config
from rail_sumo.errors import InputError
from rail_sumo.highway import trial
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.records import KMH, Command


@pytest.fixture
def town(tmp_path):
    """`MERGE`, but 50 km/h are allowed on the second kilometre, and 30 in the junction before it."""
    path = tmp_path / "town.net.xml"
    narrow = re.sub(r'(<lane id="narrow.*?speed=)"36.11"', r'\1"13.89"', MERGE)
    path.write_text(re.sub(r'(<lane id=":b.*?speed=)"36.11"', r'\1"8.33"', narrow))
    return {"file": str(path)}


@pytest.mark.parametrize("who", ["accelerating", "random", "sumo"])
@pytest.mark.parametrize("traffic", [EMPTY, {"vehicles": 10}])
def test_speed_limits_are_kept_and_braked_for_comfortably(make, watched, town, who, traffic):
    for seed in range(4):
        env = make(world(network=town, traffic=traffic, episode={"duration_s": 300.0}), hands_off=who == "sumo")
        driven = drive(env, at_random(seed) if who == "random" else always(ACCELERATE), UNSEEN + seed)
        fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
        speeds_kmh = driven.speed_mps[1:] * KMH
        assert (speeds_kmh <= np.select([fronts < 996.0, fronts < 1004.0], [80.0, 30.0], 50.0) + 0.1).all()
        if traffic == EMPTY:
            assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s², in every step of 0.1 s
            # Not sooner than it must: from 80 to 30 km/h in (22.2^2 - 8.3^2) / 4 = 106 m, and up to 50 again at once.
            if who != "random":
                assert speeds_kmh[fronts < 885.0].max() == pytest.approx(80.0)
                assert speeds_kmh[fronts < 885.0][-1] > 79.0
                assert speeds_kmh[fronts > 1060.0].min() == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize("who", ["accelerating", "sumo"])
def test_where_set_speeds_follow_the_limit_a_fast_road_gives_no_leave_to_be_fast_beyond_it(make, watched, town, who):
    """The host can drive 130 km/h, which the first kilometre allows, and the town does not."""
    env = make(world(network=town, traffic=EMPTY, adas=BY_THE_LIMIT), hands_off=who == "sumo")
    driven = drive(env, always(ACCELERATE), UNSEEN)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    speeds_kmh = driven.speed_mps[1:] * KMH
    assert speeds_kmh[fronts < 600.0].max() == pytest.approx(130.0, abs=0.1)
    assert speeds_kmh[fronts > 1004.0].max() == pytest.approx(50.0, abs=0.1)
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s², in every step of 0.1 s


@pytest.mark.parametrize("by_sumo", [True, False])
def test_who_is_added_just_before_a_lower_limit_enters_no_faster_than_it_can_slow_down_comfortably(
    make, tmp_path, by_sumo
):
    """On a ramp of others the host came at 19.5 m/s, 65 m before a bend for 6 m/s; SUMO's own driver braked by 9."""
    text = cut_road(220.0, 400.0, inside_m=8.0)
    text = re.sub(r'(<lane id="(?:part1|:cut0_0)_.*?speed=)"36.11"', r'\1"6.17"', text)
    (tmp_path / "bend.net.xml").write_text(text)
    sections = {"network": {"file": str(tmp_path / "bend.net.xml")}, "traffic": EMPTY, "episode": {"duration_s": 20.0}}
    env = make(world(adas=BY_THE_LIMIT, **sections), hands_off=by_sumo)
    driven = drive(env, always(KEEP), UNSEEN)
    assert 12.0 < driven.speed_mps[0] < 36.11 / 2
    assert driven.speed_mps[-1] <= 6.17 + 0.01
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6
    assert (driven.speed_mps[1:] <= driven.limit_mps + 0.05).all()


@pytest.mark.parametrize("by_sumo", [True, False])
def test_who_enters_faster_than_is_allowed_slows_down_comfortably(make, tmp_path, by_sumo):
    (tmp_path / "fast.rou.xml").write_text(
        '<routes><vType id="fast" speedFactor="1.5"/><route id="along" edges="highway"/>'
        '<vehicle id="one" type="fast" route="along" depart="70" departLane="0" departSpeed="33"/></routes>'
    )
    traffic = {"routes": [str(tmp_path / "fast.rou.xml")], "host": "one"}
    env = make(world(traffic=traffic, adas=BY_THE_LIMIT, episode={"duration_s": 30.0}), hands_off=by_sumo)
    driven = drive(env, always(KEEP), UNSEEN)
    assert driven.speed_mps[0] > 80 / KMH + 5.0
    assert driven.speed_mps[-1] <= 80 / KMH + 0.1
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6


@pytest.mark.parametrize("traffic", [{"vehicles": 10, "speed_low_kmh": 60.0}])
def test_the_windows_vehicles_keep_to_speed_limits_too(make, watched, town, traffic):
    drive(make(world(network=town, traffic=traffic, episode={"duration_s": 300.0})), always(ACCELERATE), UNSEEN)
    in_town = [
        speed
        for scene in watched().scenes
        for x, length, speed in zip(scene.x_m[1:], scene.length_m[1:], scene.speed_mps[1:], strict=True)
        if x - length > 1004.0
    ]
    assert len(in_town) > 100
    assert max(in_town) <= 13.89 + 0.01


def test_within_a_junction_the_limit_beyond_it_is_kept_in_mind(make, watched, tmp_path):
    path = tmp_path / "fast.net.xml"
    narrow = re.sub(r'(<lane id="narrow.*?speed=)"36.11"', r'\1"13.89"', MERGE)
    path.write_text(re.sub(r'(<lane id=":b.*?)length="8.00"', r'\1length="40.00"', narrow))  # and 130 km/h within
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 60.0}))
    driven = drive(env, always(ACCELERATE), 2)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    assert driven.speed_mps.max() * KMH == pytest.approx(80.0)
    assert (driven.speed_mps[1:] * KMH)[fronts >= 1004.0].max() == pytest.approx(50.0, abs=0.1)


def test_the_host_enters_no_faster_than_it_may(make, tmp_path):
    path = tmp_path / "zone30.net.xml"
    path.write_text(MERGE.replace("36.11", "8.33"))
    driven = drive(make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 5.0})), always(KEEP))
    assert driven.speed_mps == pytest.approx(np.full(51, 8.33))


@pytest.fixture
def signalled(tmp_path):
    """`MERGE` with a signal before the junction, which turns green after 80 s."""
    path = tmp_path / "signal.net.xml"
    logic = (
        '<tlLogic id="b" type="static" programID="0" offset="0">'
        '<phase duration="80" state="rr"/><phase duration="900" state="GG"/></tlLogic>'
    )
    text = MERGE.replace('id="b" type="priority"', 'id="b" type="traffic_light"')
    text = text.replace("<junction", logic + "<junction", 1)
    for lane in (0, 1):
        text = text.replace(f'via=":b_0_{lane}"', f'via=":b_0_{lane}" tl="b" linkIndex="{lane}"')
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("kind", "phases", "shows"),
    [
        ("static", {"rr": 80, "GG": 900}, ""),
        ("static", {"rr": 400, "GG": 9}, "shows red for 400 s on end"),
        ("static", {"rG": 400, "GG": 9}, "shows red for 400 s on end"),
        ("static", {"rr": 150, "GG": 9, "yy": 3, "ru": 200}, "shows red for 353 s on end"),  # round the cycle's end
        ("static", {"rg": 20, "yO": 20}, "never shows green"),
        ("actuated", {"rr": 400, "GG": 9}, ""),  # as long as nobody comes
        ("actuated", {"rG": 20, "rr": 20}, "never shows green"),
    ],
)
def test_the_check_tells_of_lights_that_keep_somebody_waiting_for_very_long(signalled, kind, phases, shows):
    told = "".join(f'<phase duration="{seconds}" state="{state}"/>' for state, seconds in phases.items())
    text = re.sub(r'<phase duration="80".*?(?=</tlLogic>)', told, signalled.read_text())
    signalled.write_text(text.replace('type="static"', f'type="{kind}"'))
    warnings = trial.check(world(network={"file": str(signalled)}, traffic=EMPTY)).warnings
    lights = [one for one in warnings if one.startswith("traffic light")]
    assert lights == ([f"traffic light 'b' {shows} to somebody on wide: vehicles may stand there"] if shows else [])


@pytest.mark.parametrize("hands_off", [False, True])
def test_for_a_red_light_the_host_brakes_comfortably_and_no_sooner_than_it_must(make, watched, signalled, hands_off):
    world_of_its_own = world(network={"file": str(signalled)}, traffic=EMPTY, episode={"duration_s": 100.0})
    driven = drive(make(world_of_its_own, hands_off=hands_off), always(ACCELERATE), UNSEEN)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    times = np.array([scene.time_s for scene in watched().scenes])
    speeds = driven.speed_mps[1:]
    assert 990.0 < fronts[times <= 80.0].max() < 996.0
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s²
    assert speeds[fronts < 996.0 - 130.0][-1] * KMH == pytest.approx(80.0)  # 2.5 m + (80 / 3.6)^2 / 4 = 126 m
    assert speeds[times <= 80.0][-1] == pytest.approx(0.0, abs=0.01)
    assert fronts[-1] > 1050.0


@pytest.mark.parametrize("hands_off", [False, True])
def test_for_a_red_light_behind_a_green_one_the_host_brakes_comfortably(make, watched, hands_off):
    network = {"file": str(Path(__file__).with_name("two_signals.net.xml"))}
    env = make(world(network=network, traffic=EMPTY, episode={"duration_s": 100.0}), hands_off=hands_off)
    driven = drive(env, always(ACCELERATE), UNSEEN)
    fronts = np.array([scene.x_m[0] + 0.5 * scene.length_m[0] for scene in watched().scenes])
    times = np.array([scene.time_s for scene in watched().scenes])
    assert 1074.0 < fronts[times <= 80.0].max() < 1080.0
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6  # 2 m/s²
    assert fronts[-1] > 1100.0


def test_a_signal_that_blinks_or_is_switched_off_stops_nobody(make, watched, signalled):
    text, phases = signalled.read_text(), '<phase duration="80" state="rr"/><phase duration="900" state="GG"/>'
    blinking = 'type="actuated"', '<phase duration="9" minDur="5" maxDur="9" state="oo"/>'
    off = 'type="static"', '<phase duration="1" state="OO"/>'
    for kind, phase in (blinking, off):
        signalled.write_text(text.replace('type="static"', kind).replace(phases, phase))
        env = make(world(network={"file": str(signalled)}, traffic=EMPTY, episode={"duration_s": 60.0}))
        driven = drive(env, always(ACCELERATE), UNSEEN)
        assert driven.speed_mps.min() == pytest.approx(4.10 if phase is blinking[1] else 16.67, abs=0.05)
        assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6
        assert driven.speed_mps[-1] * KMH == pytest.approx(80.0)
        assert watched().scenes[-1].x_m[0] > 1000.0


@pytest.mark.parametrize(
    ("away_m", "yellow_s", "stops", "brakes_mps2"), [(40.0, 3, False, 0.1), (80.0, 3, True, 2.0), (60.0, 6, True, 2.6)]
)
@pytest.mark.parametrize("hands_off", [False, True])
def test_at_yellow_the_host_stops_if_it_can_comfortably_and_else_drives_on(
    make, watched, signalled, away_m, yellow_s, stops, brakes_mps2, hands_off
):
    # At 60 km/h it needs (60 / 3.6)^2 / 4 = 69 m by 2 m/s², and 46 m by 3; it gets 50 m far in 3 s, and 100 m in 6.
    turns_s = round((796.0 - away_m) / (60 / KMH), 1)  # it starts at 200 m
    red = '<phase duration="80" state="rr"/>'
    yellow = f'<phase duration="{turns_s}" state="GG"/><phase duration="{yellow_s}" state="yy"/>{red}'
    signalled.write_text(signalled.read_text().replace(red, yellow))
    episode = {"duration_s": turns_s + 20.0}
    adas = {"start_speed_kmh": 60.0, "max_speed_kmh": 60.1}
    world_of_its_own = world(network={"file": str(signalled)}, traffic=EMPTY, episode=episode, adas=adas)
    driven = drive(make(world_of_its_own, hands_off=hands_off), always(KEEP), UNSEEN)
    front = watched().scenes[-1].x_m[0] + 0.5 * watched().scenes[-1].length_m[0]
    assert driven.speed_mps[-1] * KMH == pytest.approx(0.0 if stops else 60.0, abs=0.2)
    assert (front < 996.0) == stops
    assert np.diff(driven.speed_mps).min() >= -brakes_mps2 / 10 - 1e-6


@pytest.mark.parametrize("yellow_s", [3, 6])
@pytest.mark.parametrize("start_speed_kmh", [42.0, 60.0, 80.0])
@pytest.mark.parametrize("drives", ["keeping", "random"])
def test_however_late_a_light_turns_yellow_nobody_brakes_beyond_9_mps2_or_keeps_on_into_red(
    make, watched, signalled, yellow_s, start_speed_kmh, drives
):
    red, original = '<phase duration="80" state="rr"/>', signalled.read_text()
    adas = {"start_speed_kmh": start_speed_kmh, "max_speed_kmh": 80.1}
    for away_m in range(4, 140, 9):
        turns_s = round((796.0 - away_m) / (start_speed_kmh / KMH), 1)
        state = "y" if away_m % 2 else "Y"
        yellow = f'<phase duration="{turns_s}" state="GG"/><phase duration="{yellow_s}" state="{2 * state}"/>{red}'
        signalled.write_text(original.replace(red, yellow))
        episode = {"duration_s": turns_s + 30.0}
        env = make(world(network={"file": str(signalled)}, traffic=EMPTY, episode=episode, adas=adas))
        driven = drive(env, always(KEEP) if drives == "keeping" else at_random(away_m), UNSEEN)
        assert np.diff(driven.speed_mps).min() >= -0.9 - 1e-6
        passed = [scene.time_s for scene in watched().scenes if scene.x_m[0] + 0.5 * scene.length_m[0] > 996.0]
        if drives == "keeping" and passed:
            assert passed[0] <= turns_s + yellow_s + 0.2


@pytest.mark.parametrize("vehicles", [0, 16])
def test_close_to_a_red_light_the_host_starts_slower_and_is_none_the_slower_later(make, signalled, vehicles):
    signalled.write_text(re.sub(r'(<lane id="wide.*?)length="996.00"', r'\1length="204.00"', signalled.read_text()))
    network, traffic, episode = {"file": str(signalled)}, {"vehicles": vehicles}, {"duration_s": 120.0}
    for seed in range(3):  # it starts at 200 m
        env = make(world(network=network, traffic=traffic, episode=episode))
        driven = drive(env, always(ACCELERATE), UNSEEN + seed)
        assert 0.0 < driven.speed_mps[0] < 10.0  # of the 16.7 m/s that it was to
        if not vehicles:
            assert driven.speed_mps[10:700].max() < 1.0  # it waits
            assert driven.speed_mps.max() * KMH == pytest.approx(80.0)


@pytest.mark.parametrize("start_lane", [0, 1, 2])
def test_a_lanes_own_limit_holds_on_that_lane_alone(make, tmp_path, start_lane):
    path = tmp_path / "slow.net.xml"
    path.write_text(MERGE.replace('id="wide_0" index="0" speed="36.11"', 'id="wide_0" index="0" speed="13.89"'))
    env = make(world(network={"file": str(path)}, traffic=EMPTY, episode={"duration_s": 30.0}))
    env.reset(seed=1)
    libsumo.vehicle.moveTo(HOST, f"wide_{start_lane}", 10.0)
    for _ in range(25):
        env.drive(ACCELERATE)
    assert env.trajectory().speed_mps[-1] * KMH == pytest.approx(80.0 if start_lane else 50.0, abs=0.1)


def test_a_variable_speed_sign_holds_from_its_moment_on_and_is_braked_for_comfortably(make, tmp_path):
    path, sign = tmp_path / "open.net.xml", tmp_path / "sign.add.xml"
    path.write_text(MERGE)
    steps = '<step time="0" speed="36.11"/><step time="20" speed="13.89"/>'
    sign.write_text(
        f'<additional><variableSpeedSign id="vss" lanes="wide_0 wide_1 wide_2">{steps}</variableSpeedSign></additional>'
    )
    traffic = EMPTY | {"additional": [str(sign)]}
    driven = drive(
        make(world(network={"file": str(path)}, traffic=traffic, episode={"duration_s": 40.0})), always(ACCELERATE), 1
    )
    speeds_kmh = driven.speed_mps * KMH
    assert speeds_kmh.max() == pytest.approx(80.0)
    assert speeds_kmh[-1] == pytest.approx(50.0, abs=0.1)
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6


FLOW = '<flow id="across" begin="0" end="80" period="1.5" departSpeed="max"><route edges="in out"/></flow>'
LINE_M = 592.8
"""Where others come first, from the start of `crossing`'s course."""


@pytest.fixture
def crossing(tmp_path):
    """A world where others come first: by a sign to give way (m) or stop (s, w), among equals (=), or by a signal."""

    def write(state, *cars, visibility=None):
        path, demand = tmp_path / "crossing.net.xml", tmp_path / "crossing.rou.xml"
        text = Path(__file__).with_name("crossing.net.xml").read_text()
        if state in "gGoO":  # such a signal, on connections that have priority by themselves
            logic = '<tlLogic id="cross" type="static" programID="0" offset="0"><phase duration="99" state="{}"/>'
            text = text.replace("<junction", logic.format(2 * state) + "</tlLogic><junction", 1)
            for lane in (0, 1):
                text = text.replace(f'via=":cross_0_{lane}"', f'via=":cross_0_{lane}" tl="cross" linkIndex="{lane}"')
            state = "M"
        sight = f' visibility="{visibility}"' if visibility else ""
        path.write_text(text.replace('state="m"', f'state="{state}"{sight}'))
        demand.write_text(f"<routes>{''.join(cars)}</routes>")
        traffic = {"routes": [str(demand)], "warm_up_s": 0.0} if cars else EMPTY
        return world(network={"file": str(path)}, traffic=traffic, episode={"duration_s": 150.0})

    return write


def past(simulation, line_m=LINE_M):
    """After every step: how far the host's front is beyond a line, on `crossing`'s way north, which begins at -600."""
    return np.array([scene.y_m[0] + 0.5 * scene.length_m[0] for scene in simulation.scenes]) + 600.0 - line_m


@pytest.mark.parametrize("hands_off", [False, True])
@pytest.mark.parametrize("state", "m=sw" + "go" + "MG")
def test_where_others_come_first_the_host_slows_down_comfortably_as_far_as_it_must(
    make, watched, crossing, hands_off, state
):
    driven = drive(make(crossing(state), hands_off=hands_off), always(ACCELERATE), UNSEEN)
    beyond_m, speeds = past(watched()), driven.speed_mps[1:]
    must_stop, must_see = state in "sw", state in "m=go"
    slowest = 0.0 if must_stop else 4.10 if must_see else speeds[0]  # from 4.10 m/s it takes 4.2 m to stop at 2 m/s²
    assert speeds.min() == pytest.approx(slowest, abs=0.05)
    assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6
    assert speeds[beyond_m < -132.0][-1] * KMH == pytest.approx(80.0, abs=0.1)  # from 80 km/h to 0 it takes 123 m
    if must_stop or must_see:
        assert -5.0 < beyond_m[speeds.argmin()] < 0.0
    assert ((beyond_m > -5.0) & (beyond_m < 0.0)).sum() < (45 if must_stop else 15)  # 4.5 s, and 1.5 s
    assert beyond_m[-1] > 100.0


@pytest.mark.parametrize("hands_off", [False, True])
@pytest.mark.parametrize("state", "m=swg")
def test_the_host_waits_for_who_comes_first_and_brakes_comfortably_until_it_sees_them(
    make, watched, crossing, state, hands_off
):
    for seed in range(3):
        driven = drive(make(crossing(state, FLOW), hands_off=hands_off), at_random(seed), UNSEEN + seed)
        beyond_m = past(watched())
        times = np.array([scene.time_s for scene in watched().scenes])
        assert not watched().host.contact
        if state != "=":  # where they come from the left, they wait
            assert -0.5 < beyond_m[times < 80.0].max() < 0.0
        assert np.diff(driven.speed_mps)[beyond_m < -4.5].min() >= -0.2 - 1e-6
        assert beyond_m[-1] > 50.0


def test_where_drivers_see_far_the_host_need_not_slow_down_to_give_way(make, watched, crossing):
    driven = drive(make(crossing("m", visibility=150)), always(ACCELERATE), UNSEEN)
    assert driven.speed_mps[-1] * KMH == driven.speed_mps.max() * KMH == pytest.approx(79.99, abs=0.01)
    assert np.diff(driven.speed_mps).min() > -0.01
    drive(make(crossing("m", FLOW, visibility=150)), always(ACCELERATE), UNSEEN)
    assert not watched().host.contact
    assert past(watched())[-1] > 50.0


def test_behind_another_junction_too_the_host_gives_way_comfortably(make, watched, crossing):
    """The road is cut 60 m before the line, by a junction where nobody else comes."""
    config = crossing("m")
    network = Path(config.network.file)
    text = network.read_text()
    up = text[text.index('<edge id="up"') : text.index("</edge>", text.index('<edge id="up"')) + len("</edge>")]
    near = up.replace("up", "near").replace('from="south"', 'from="cut"').replace("592.80", "60.00")
    far = up.replace('to="cross"', 'to="cut"').replace("592.80", "524.80").replace("-7.20", "-75.20")
    inside = '<edge id=":cut_0" function="internal">' + "".join(
        f'<lane id=":cut_0_{lane}" index="{lane}" speed="22.22" length="8.00" shape="{x},-75.20 {x},-67.20"/>'
        for lane, x in enumerate(("4.80", "1.60"))
    )
    near = near.replace("-600.00", "-67.20")
    junction = (
        '<junction id="cut" type="priority" x="0" y="-67" incLanes="up_0 up_1" intLanes=":cut_0_0 :cut_0_1" '
        'shape="0,-67 6,-67 6,-75 0,-75"><request index="0" response="00" foes="00" cont="0"/>'
        '<request index="1" response="00" foes="00" cont="0"/></junction>'
    )
    text = text.replace(up, f"{inside}</edge>{far}{near}").replace('incLanes="up_0 up_1', 'incLanes="near_0 near_1')
    text = text.replace('from="up"', 'from="near"').replace('<junction id="east"', f'{junction}<junction id="east"')
    joined = "".join(
        f'<connection from="up" to="near" fromLane="{lane}" toLane="{lane}" via=":cut_0_{lane}" dir="s" state="M"/>'
        f'<connection from=":cut_0" to="near" fromLane="{lane}" toLane="{lane}" dir="s" state="M"/>'
        for lane in (0, 1)
    )
    network.write_text(text.replace("</net>", f"{joined}</net>"))
    for hands_off in (False, True):
        driven = drive(make(config, hands_off=hands_off), always(ACCELERATE), UNSEEN)
        assert past(watched())[driven.speed_mps[1:].argmin()] == pytest.approx(-4.5, abs=0.5)
        assert driven.speed_mps.min() == pytest.approx(4.10, abs=0.05)
        assert np.diff(driven.speed_mps).min() >= -0.2 - 1e-6
        braking = np.flatnonzero(np.diff(driven.speed_mps) < -0.01)
        assert (np.diff(braking) == 1).all()  # once, and all the way through the other junction


@pytest.mark.parametrize("state", "ms")
def test_where_the_host_waits_no_lane_change_begins_that_could_reach_into_the_junction(make, watched, crossing, state):
    def restless(env):
        host = env.surroundings()[0]
        return KEEP if host.speed_mps > 0.1 or host.to_edge_end_m == 0.0 else LEFT if host.lane == 0 else RIGHT

    for seed in range(5):
        driven = drive(make(crossing(state, FLOW)), restless, UNSEEN + seed)
        scenes = watched().scenes
        front_m = [scene.x_m[0] + 0.5 * scene.length_m[0] * np.cos(scene.heading_rad[0]) for scene in scenes]
        assert np.abs(np.diff(front_m)).max() <= 0.17 + 1e-6  # 1.7 m/s
        assert past(watched())[-1] > 50.0
        assert driven.refused_decisions > 5


@contextmanager
def coming(crossing, across_mps):
    """Open a simulation in which the host comes at 14 m/s to a crossing that another vehicle drives across."""
    course = road.load(str(crossing("G").network.file), ("in", "out"))
    with Simulation(course.net_file, seed=1) as simulation:
        simulation.lay_course(course, config.Adas(), sees_m=300.0)
        simulation.add_host(["in", "out"], lane=0, front_m=100.0, speed_mps=14.0)
        libsumo.route.add("across", ["up", "on"])
        libsumo.vehicle.add("stuck", "across", departLane="0", departPos="585", departSpeed=f"{across_mps}")
        simulation.wait_for_host()
        libsumo.vehicle.setSpeedMode("stuck", 0)
        yield simulation


@pytest.mark.parametrize("stuck_at_m", [600.5, 590.0])
def test_before_a_junction_the_host_stops_comfortably_for_who_is_stuck_across_its_way(crossing, stuck_at_m):
    """Not for who waits at the line. It looked within the junction alone before, and came to that at 50 km/h."""
    with coming(crossing, 5.0) as simulation:
        while libsumo.vehicle.getDistance("stuck") + 585.0 < stuck_at_m:
            libsumo.vehicle.setSpeed("stuck", 5.0)
            simulation.run(Command(14.0))
        libsumo.vehicle.setSpeed("stuck", 0.0)
        simulation.run(Command(14.0, steps=200))
        host, is_stuck = simulation.host, stuck_at_m > LINE_M
        assert not host.contact
        assert min(np.diff(host.speeds_mps)) > -0.21
        assert (host.speeds_mps[-1] < 0.1) == is_stuck
        assert libsumo.vehicle.getRoadID(host.name) == ("in" if is_stuck else "out")
        libsumo.vehicle.setSpeed("stuck", 5.0)
        simulation.run(Command(14.0, steps=80))
        assert not host.contact
        assert libsumo.vehicle.getRoadID(host.name) == "out"


def test_for_who_stops_across_its_way_late_the_host_brakes_no_harder_than_it_takes(crossing):
    """From 14 m/s within 28 m, by 3.5 m/s². It braked by 9 m/s² at first."""
    with coming(crossing, 1.3) as simulation:
        host = simulation.host
        while libsumo.vehicle.getLanePosition(host.name) < 296.0 - 28.0:
            libsumo.vehicle.setSpeed("stuck", 1.3)
            simulation.run(Command(14.0))
        libsumo.vehicle.setSpeed("stuck", 0.0)
        simulation.run(Command(14.0, steps=100))
        assert (host.contact, libsumo.vehicle.getRoadID(host.name)) == (False, "in")
        assert host.speeds_mps[-1] < 0.1
        assert -0.45 < min(np.diff(host.speeds_mps)) < -0.3


def test_what_sumo_says_while_the_host_enters_more_slowly_is_not_the_users_to_read(make, tmp_path, capfd):
    """Ten metres before a way without priority SUMO lets nobody start at 80 km/h, and calls that an error."""
    path = tmp_path / "crossing.net.xml"
    path.write_text(Path(__file__).with_name("crossing.net.xml").read_text())
    env = make(world(network={"file": str(path)}, traffic=EMPTY, adas={"start_speed_kmh": 80.0}))
    env.stretch = dataclasses.replace(env.stretch, start_m=582.0)
    env.reset(seed=1)
    assert env.agent.host.speeds_mps[0] < 70.0 / KMH
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("by_sumo", [True, False])
def test_where_nobody_may_drive_for_a_while_the_host_stands(make, tmp_path, by_sumo):
    (tmp_path / "one.rou.xml").write_text(
        '<routes><vType id="car"/><route id="along" edges="highway"/>'
        '<vehicle id="one" type="car" route="along" depart="70" departLane="0" departSpeed="20"/></routes>'
    )
    lanes = " ".join(f"highway_{lane}" for lane in range(5))
    (tmp_path / "closed.add.xml").write_text(
        f'<additional><variableSpeedSign id="v" lanes="{lanes}"><step time="0" speed="22"/><step time="80" speed="0"/>'
        '<step time="110" speed="22"/></variableSpeedSign></additional>'
    )
    traffic = {
        "routes": [str(tmp_path / "one.rou.xml")],
        "additional": [str(tmp_path / "closed.add.xml")],
        "host": "one",
    }
    env = make(world(traffic=traffic, adas=BY_THE_LIMIT, episode={"duration_s": 60.0}), hands_off=by_sumo)
    driven = drive(env, always(ACCELERATE), UNSEEN)
    assert driven.speed_mps[350] == pytest.approx(0.0, abs=0.01)
    assert driven.speed_mps[-1] > 10.0


def test_a_host_that_parks_is_told(make, tmp_path):
    (tmp_path / "one.rou.xml").write_text(
        '<routes><vType id="car"/><route id="along" edges="highway"/>'
        '<vehicle id="one" type="car" route="along" depart="70">'
        '<stop lane="highway_0" startPos="700" endPos="800" duration="60" parking="true"/></vehicle></routes>'
    )
    env = make(world(traffic={"routes": [str(tmp_path / "one.rou.xml")], "host": "one"}))
    with pytest.raises(InputError, match=r"^vehicle 'one' parks beside the road, and can be driven no further as the "):
        drive(env, always(KEEP), UNSEEN)
