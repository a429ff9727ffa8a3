import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rail_sumo import config
from rail_sumo.highway.vehicle.adas import Adas, HandsOff, slowed_for
from rail_sumo.highway.vehicle.lane_ends import LEFT as TO_LEFT
from rail_sumo.highway.vehicle.lane_ends import STANDS_BEFORE_M
from rail_sumo.records import KMH, SECONDS_PER_STEP, SUMO_DECIDES, Gaps, HostState, MetaAction

KEEP, ACCELERATE, DECELERATE, LEFT, RIGHT = MetaAction
LANE_M = 3.2
STRIDE_M = 0.17  # 1.7 m/s sideways in a step of 0.1 s
STEPS_PER_CHANGE = 19  # 3.2 / 0.17 = 18.8

MIDDLE = HostState(
    speed_mps=20.0,
    lane=2,
    rightmost_lane=0,
    leftmost_lane=4,
    to_edge_end_m=1000.0,
    lane_width_m=LANE_M,
    to_left_m=LANE_M,
    to_right_m=LANE_M,
    leads_on_m=(math.inf,) * 5,
    limit_mps=80.0 / KMH,
)
LEAVES_M = 20.0 * MIDDLE.limit_mps
"""How far before its end a lane is left."""
ENDING = (0.0, 0.0, 0.0, math.inf, math.inf)
"""The three right lanes lead nowhere; whoever drives there stays on the edge."""
FREE = Gaps(ahead_m=math.inf, ahead_speed_mps=0.0, behind_m=math.inf, behind_speed_mps=0.0)
CLOSED = FREE._replace(ahead_m=1.0)


def free(side):
    return FREE


def closed(side):
    return CLOSED


def closed_on(*sides):
    return lambda side: CLOSED if side in sides else FREE


def at(lane=2, host=MIDDLE, **changes):
    """The host on another lane of the five, or otherwise changed."""
    beside = {"to_left_m": LANE_M if lane < 4 else 0.0, "to_right_m": LANE_M if lane > 0 else 0.0}
    return host._replace(**beside | {"lane": lane} | changes)


def kmh(speed):
    return at(speed_mps=speed / KMH)


class Road:
    """Carries the layer's commands out to the letter, and keeps where the host is across the whole road."""

    def __init__(self, adas, host=MIDDLE):
        self.adas, self.host = adas, host
        self.gaps = free
        self.commands = []

    def decide(self, action):
        self.adas.decide(action, self.host, self.gaps)

    def step(self, steps=1):
        for _ in range(steps):
            command = self.adas.command(self.host, self.gaps, steps=1)
            self.adas.note(1)
            self.commands.append(command)
            self.host = at(self.host.lane + command.cross, self.host)

    def finish(self):
        """Drive the change under way to its end, whichever; returns where it passed, across the road."""
        passed = []
        while self.adas.changing_lane:
            assert len(passed) < 2 * STEPS_PER_CHANGE, "it never ends"
            self.step()
            passed.append(self.left_m)
        return passed

    @property
    def left_m(self):
        """Metres to the left of the centre of lane 0."""
        return self.host.lane * LANE_M + self.commands[-1].lateral_m

    @property
    def crossings(self):
        return [command.cross for command in self.commands if command.cross]

    @property
    def counts(self):
        return self.adas.lane_changes, self.adas.aborted_lane_changes, self.adas.refused_decisions


@pytest.fixture
def adas():
    return Adas(config.Adas(), start_mps=60.0 / KMH)


@pytest.fixture
def road(adas):
    return Road(adas)


# The set speed.


def test_the_host_starts_at_60_kmh(adas):
    assert adas.command(kmh(60), free, steps=1).speed_mps == pytest.approx(60 / KMH)


@pytest.mark.parametrize(
    ("action", "driven_kmh", "set_kmh"),
    [
        (ACCELERATE, 60, 65),
        (ACCELERATE, 78, 80),
        (ACCELERATE, 80, 80),
        (ACCELERATE, 20, 40),  # behind a slow leader: up to the lowest set speed
        (ACCELERATE, 50, 55),  # from the speed driven, not from the 60 that were set
        (DECELERATE, 60, 55),
        (DECELERATE, 42, 40),
        (DECELERATE, 30, 40),
        (KEEP, 50, 60),
    ],
)
def test_a_decision_sets_the_speed_driven_plus_or_minus_5_kmh_within_40_and_80(adas, action, driven_kmh, set_kmh):
    adas.decide(action, kmh(driven_kmh), free)
    crawling = kmh(1)  # below every set speed, where no ramp hides it
    assert adas.command(crawling, free, steps=1).speed_mps == pytest.approx(set_kmh / KMH)
    assert adas.refused_decisions == 0


def test_slower_is_reached_down_a_ramp_of_comfortable_braking(adas):
    adas.decide(DECELERATE, kmh(60), free)
    speeds = [60 / KMH]
    for _ in range(8):
        speeds.append(adas.command(at(speed_mps=speeds[-1]), free, steps=10).speed_mps)
    # 2 m/s² are 0.2 m/s a step: 5 km/h, 1.389 m/s, are six full steps and the rest.
    ramp = [faster - slower for faster, slower in pairwise(speeds)]
    assert ramp == pytest.approx([0.2] * 6 + [5 / KMH - 1.2, 0.0])
    assert speeds[-1] == pytest.approx(55 / KMH)


def test_the_ramp_needs_a_fresh_look_at_every_step_and_cruising_none(adas):
    adas.decide(DECELERATE, kmh(60), free)
    assert adas.command(kmh(60), free, steps=10).steps == 1
    assert adas.command(kmh(55), free, steps=10).steps == 10


def test_a_lane_change_needs_a_fresh_look_at_every_step(adas):
    adas.decide(LEFT, MIDDLE, free)
    assert adas.command(MIDDLE, free, steps=10).steps == 1


def test_speed_decisions_act_during_a_lane_change_and_the_change_goes_on(road):
    road.decide(LEFT)
    road.step(5)
    road.decide(ACCELERATE)
    road.step(STEPS_PER_CHANGE - 5)
    assert road.commands[-1].speed_mps == pytest.approx(20.0 + 5 / KMH)
    assert road.counts == (1, 0, 0)


# A lane change that is left to go on.


@pytest.mark.parametrize(("action", "side"), [(LEFT, 1), (RIGHT, -1)])
def test_a_lane_change_takes_19_steps_at_1_7_mps_and_ends_in_the_next_lanes_centre(road, action, side):
    road.decide(action)
    offsets = [side * (left_m - 2 * LANE_M) for left_m in road.finish()]
    assert offsets == pytest.approx([STRIDE_M * step for step in range(1, STEPS_PER_CHANGE)] + [LANE_M])
    assert (road.host.lane, road.commands[-1].lateral_m) == (2 + side, 0.0)
    assert road.crossings == [side]
    assert road.counts == (1, 0, 0)


def test_the_host_crosses_over_at_most_a_quarter_metre_before_the_border_there_and_back(road):
    beyond_the_border = []
    road.decide(LEFT)
    for step in range(30):
        if step == 15:
            road.decide(RIGHT)
        road.step()
        if road.commands[-1].cross:
            beyond_the_border.append(road.left_m - 2.5 * LANE_M)
    there, back = beyond_the_border
    assert -0.25 <= there < 0.0
    assert 0.0 < back <= 0.25


def test_what_the_layer_says_of_a_change_under_way(road):
    assert (road.adas.changing_lane, road.adas.side, road.adas.lateral_m) == (False, None, 0.0)
    road.decide(RIGHT)
    road.step(12)  # beyond the border: still told from the centre of the lane it set out from
    assert (road.adas.changing_lane, road.adas.side) == (True, -1)
    assert road.adas.lateral_m == pytest.approx(-12 * STRIDE_M)
    road.step(7)
    assert (road.adas.changing_lane, road.adas.side, road.adas.lateral_m) == (False, None, 0.0)


# Speed limits.


def test_below_a_limit_that_binds_the_host_goes_no_faster(adas):
    assert adas.command(at(speed_mps=10.0, limit_mps=12.0), free, steps=10).speed_mps == 12.0
    assert adas.command(at(speed_mps=20.0, limit_mps=12.0), free, steps=10).speed_mps == pytest.approx(19.8)  # 2 m/s²


def test_it_brakes_comfortably_to_be_as_slow_as_a_limit_ahead_where_it_begins(adas):
    """From 60 km/h, its set speed, to 10 m/s: (16.67^2 - 10^2) / (2 * 2) = 44.4 m."""
    here = {"speed_mps": 60 / KMH, "limits_ahead": ((0.0, 25.0), (30.0, 10.0))}
    one_step_m = 6 / KMH
    braking_m = ((60 / KMH) ** 2 - 100.0) / 4.0
    assert adas.command(at(to_edge_end_m=braking_m - 29.9 + one_step_m, **here), free, steps=1).speed_mps == 60 / KMH
    near = adas.command(at(to_edge_end_m=braking_m - 30.1 + one_step_m, **here), free, steps=1).speed_mps
    assert 60 / KMH - 0.2 < near < 60 / KMH
    # Not soon, but within the ten steps of a decision: it looks again after one.
    assert adas.command(at(to_edge_end_m=braking_m + 300.0, **here), free, steps=10).steps == 10
    assert adas.command(at(to_edge_end_m=braking_m - 30.0 + 16.0, **here), free, steps=10).steps == 1
    # Too late for it: no harder than comfortable.
    late = adas.command(at(to_edge_end_m=0.0, **here), free, steps=10)
    assert (late.speed_mps, late.steps) == (pytest.approx(60 / KMH - 0.2), 1)


def test_that_it_will_be_faster_by_then_counts_too(adas):
    """At 10 m/s and on its way to 60 km/h, it is at 12 m/s by the next decision, and up to 12 m farther."""
    braking_m = ((60 / KMH) ** 2 - 10.0**2) / (2 * 2.0)
    near = {"speed_mps": 10.0, "limits_ahead": ((0.0, 10.0),)}
    assert adas.command(at(to_edge_end_m=braking_m + 11.0, **near), free, steps=10).steps == 1
    assert adas.command(at(to_edge_end_m=braking_m + 13.0, **near), free, steps=10).steps == 10


def test_for_a_stop_it_brakes_comfortably_while_it_can():
    """From 60 km/h: 69.4 m at 2 m/s²."""
    stopping_m = (60 / KMH) ** 2 / 4.0
    one_step_m = 6 / KMH
    here = {"speed_mps": 60 / KMH, "to_edge_end_m": 500.0}
    assert adas_at(here, stops_ahead=((stopping_m + one_step_m + 0.1, 0.0),)) == 60 / KMH
    assert 60 / KMH - 0.2 < adas_at(here, stops_ahead=((200.0, 0.0), (stopping_m + one_step_m - 0.1, 0.0))) < 60 / KMH


@pytest.mark.parametrize(("ahead_m", "braking_mps2"), [(50.0, 4.0), (25.0, 8.0), (20.0, 9.0), (0.0, 9.0), (-1.0, 9.0)])
def test_for_a_stop_it_brakes_as_hard_as_it_takes_and_may(ahead_m, braking_mps2):
    """From 20 m/s it takes 400 / (2 * 50) = 4 m/s² to stop within 50 m."""
    here = {"speed_mps": 20.0, "to_edge_end_m": 500.0}
    assert adas_at(here, stops_ahead=((ahead_m, 0.0),)) == pytest.approx(20.0 - 0.1 * braking_mps2)


def test_where_it_may_creep_it_need_not_stop():
    """From 20 m/s to 10 it takes 300 / (2 * 50) = 3 m/s² within 50 m."""
    assert adas_at({"speed_mps": 20.0, "to_edge_end_m": 500.0}, stops_ahead=((50.0, 10.0),)) == pytest.approx(19.7)
    assert adas_at({"speed_mps": 0.0, "to_edge_end_m": 500.0}, stops_ahead=((0.1, 0.2),)) > 0.5
    assert adas_at({"speed_mps": 0.2, "to_edge_end_m": 500.0}, stops_ahead=((-0.1, 0.2),)) == pytest.approx(0.2)


def test_braking_for_a_stop_is_even():
    """Step by step: 16.67 m/s, 50 m ahead, 2.78 m/s² to the end."""
    speed, ahead_m, braking = 60 / KMH, 50.0, []
    while speed > 3.0:
        slower = adas_at({"speed_mps": speed, "to_edge_end_m": 500.0}, stops_ahead=((ahead_m, 0.0),))
        braking.append((speed - slower) * 10)
        speed, ahead_m = slower, ahead_m - 0.1 * slower
    assert len(braking) > 40
    assert braking == pytest.approx([(60 / KMH) ** 2 / 100.0] * len(braking), rel=0.08)


def adas_at(here, **changes):
    return Adas(config.Adas(), start_mps=60.0 / KMH).command(at(**here, **changes), free, steps=1).speed_mps


def test_sumos_own_driver_decides_its_speed_but_for_limits():
    adas = HandsOff(config.Adas())
    assert adas.command(at(speed_mps=20.0), free, steps=10).speed_mps == SUMO_DECIDES
    assert adas.command(at(speed_mps=20.0, limits_ahead=((0.0, 10.0),)), free, steps=10).speed_mps == SUMO_DECIDES
    slow = at(speed_mps=20.0, to_edge_end_m=60.0, limits_ahead=((0.0, 10.0),))
    assert adas.command(slow, free, steps=10).speed_mps == pytest.approx(19.8)


# Refusals and the gate.


@pytest.mark.parametrize(
    ("action", "host", "gaps", "why"),
    [
        (LEFT, at(lane=4), free, "no lane"),
        (RIGHT, at(lane=0), free, "no lane"),
        (LEFT, at(to_left_m=0.0), free, "line"),
        (RIGHT, at(to_right_m=0.0), free, "line"),
        # 20 m/s for 3.2 / 1.7 s are 37.65 m, and at 2 m/s² 3.54 m more.
        (LEFT, at(to_edge_end_m=41.1), free, "room"),
        (LEFT, at(speed_mps=0.0, to_edge_end_m=3.5), free, "room"),
        (LEFT, at(to_edge_end_m=37.6, leads_on_m=ENDING), free, "room"),
        # Beyond the edge 0.2 s more, since it may have to wait beside the border: 41.65 m, and at 2 m/s² 4.34 m more.
        (LEFT, at(to_edge_end_m=10.0, left_goes_on_m=35.9), free, "room"),
        (LEFT, at(to_edge_end_m=10.0, right_goes_on_m=100.0), free, "room"),
        (RIGHT, at(to_edge_end_m=10.0, left_goes_on_m=100.0), free, "room"),
        (LEFT, at(to_edge_end_m=0.0, to_left_m=0.0, left_goes_on_m=100.0), free, "line"),
        (RIGHT, at(lane=3, to_edge_end_m=200.0, leads_on_m=ENDING), free, "lane ends"),
        (LEFT, MIDDLE, closed_on(1), "gap"),
        (RIGHT, MIDDLE, closed_on(-1), "gap"),
    ],
)
def test_a_change_without_lane_or_road_or_gap_is_refused_counted_and_not_begun(adas, action, host, gaps, why):
    assert not adas.allowed(host, gaps)[action]
    adas.decide(action, host, gaps)
    assert (adas.refused_decisions, adas.why) == (1, why)
    assert not adas.changing_lane
    command = adas.command(host, gaps, steps=1)
    assert (command.lateral_m, command.cross) == (0.0, 0)


def test_why_a_decision_was_not_carried_out_is_of_the_last_one_alone(adas):
    for action, gaps, why in ((LEFT, closed, "gap"), (LEFT, free, ""), (LEFT, free, "under way"), (KEEP, free, "")):
        adas.decide(action, MIDDLE, gaps)
        assert adas.why == why


@pytest.mark.parametrize(
    ("host", "what"),
    [
        (at(limit_mps=15.0), "limit"),
        (at(to_edge_end_m=20.0, limits_ahead=((0.0, 10.0),)), "limit"),
        (at(stops_ahead=((40.0, 0.0),)), "stop"),
        (at(to_edge_end_m=40.0, leads_on_m=(0.0,) * 5), "lane end"),
        (at(to_edge_end_m=80.0, leads_on_m=(0.0,) * 5, stops_ahead=((40.0, 0.0),)), "stop"),
        (at(to_edge_end_m=40.0, leads_on_m=(0.0,) * 5, stops_ahead=((80.0, 0.0),)), "lane end"),
    ],
)
def test_what_the_set_speed_is_lowered_for(host, what):
    assert slowed_for(host, config.Adas(), 20.0) == what


@pytest.mark.parametrize(
    ("action", "host", "gaps"),
    [
        (LEFT, at(lane=3), closed_on(-1, 0)),
        (RIGHT, at(lane=1), closed_on(1, 0)),
        (LEFT, at(to_edge_end_m=41.3), free),
        (LEFT, at(speed_mps=0.0, to_edge_end_m=3.6), free),
        (LEFT, at(speed_mps=80 / KMH, to_edge_end_m=41.9), free),  # it gets no faster
        (LEFT, at(to_edge_end_m=37.7, leads_on_m=ENDING), free),
        (LEFT, at(speed_mps=0.0, to_edge_end_m=0.1, leads_on_m=ENDING), free),
        (LEFT, at(to_edge_end_m=10.0, left_goes_on_m=36.1), free),
        (RIGHT, at(to_edge_end_m=10.0, right_goes_on_m=36.1), free),
        (LEFT, at(to_edge_end_m=10.0, left_goes_on_m=math.inf), free),
    ],
)
def test_a_change_into_a_free_lane_is_allowed_whatever_the_other_lanes_hold(adas, action, host, gaps):
    assert adas.allowed(host, gaps)[action]
    adas.decide(action, host, gaps)
    assert (adas.changing_lane, adas.refused_decisions) == (True, 0)


@pytest.mark.parametrize(
    ("which", "speed_mps", "least_m"),
    [
        # Standstill gap 2 m, the time gap at the slower speed (1 s for the host, half a second for the one behind), and
        # the way to the leader's speed at 3.5 m/s².
        ("ahead", 20.0, 2 + 20),
        ("ahead", 30.0, 2 + 20),
        ("ahead", 10.0, 2 + 10 + (20**2 - 10**2) / (2 * 3.5)),
        ("ahead", 0.0, 2 + 20**2 / (2 * 3.5)),
        ("behind", 20.0, 2 + 10),
        ("behind", 10.0, 2 + 5),  # a slower one needs less time, never less than nothing
        ("behind", 25.0, 2 + 10 + (25**2 - 20**2) / (2 * 3.5)),
    ],
)
def test_the_gate_opens_where_nobody_need_brake_beyond_3_5_mps2_and_not_a_hair_before(which, speed_mps, least_m):
    def allows(gap_m):
        gap = FREE._replace(**{f"{which}_m": gap_m, f"{which}_speed_mps": speed_mps})
        return Adas(config.Adas(), start_mps=60.0 / KMH).allowed(MIDDLE, lambda side: gap)[LEFT]

    assert allows(least_m + 1e-6)
    assert not allows(least_m - 1e-6)


@pytest.mark.parametrize(
    ("which", "speed_mps", "least_m"),
    [
        ("ahead", 20.0, 2 + 20),  # the time gap, 1 s
        ("ahead", 21.0, 2 + 20 - 4),  # within 4 s it opens to that
        ("ahead", 30.0, 2 + 10),  # half a second at least
        ("ahead", 18.0, 2 + 18 + (20 - 18) ** 2 / (2 * 3.5)),  # who is ahead drives on meanwhile
        ("ahead", 10.0, 2 + 10 + (20**2 - 10**2) / (2 * 9)),  # and emergency braking, half a second, does not begin
        ("ahead", 0.0, 2 + 20**2 / (2 * 3.5)),
        ("behind", 20.0, 2 + 10),
        ("behind", 19.0, 2 + 9.5 - 4),
        ("behind", 15.0, 2),
        ("behind", 25.0, 2 + 12.5 + (25**2 - 20**2) / (2 * 9)),
    ],
)
def test_where_the_host_must_leave_its_lane_it_takes_gaps_that_nobody_has_to_brake_hard_for(which, speed_mps, least_m):
    """On a lane of 227 m three of 90 stood at its end, and 23 cars beside slowed down to less than 43 km/h for them.

    Of 26 that joined cars at 120 km/h ten came down below 8 m/s while who is ahead was taken for one that stops.
    """
    must = at(to_edge_end_m=200.0, leads_on_m=ENDING)

    def allows(host, gap_m):
        gap = FREE._replace(**{f"{which}_m": gap_m, f"{which}_speed_mps": speed_mps})
        return Adas(config.Adas(), start_mps=60.0 / KMH).allowed(host, lambda side: gap)[LEFT]

    assert allows(must, least_m + 1e-6)
    assert not allows(must, least_m - 1e-6)
    as_elsewhere = speed_mps in (0.0, 20.0)
    assert allows(MIDDLE, least_m + 1e-6) == as_elsewhere


def test_the_gate_counts_with_the_hosts_own_time_gap_and_standstill_gap():
    gap = FREE._replace(ahead_m=5 + 1.5 * 10 + (20**2 - 10**2) / (2 * 3.5) + 1e-6, ahead_speed_mps=10.0)
    careful = config.Adas(time_gap_s=1.5, standstill_gap_m=5.0)
    nearer = gap._replace(ahead_m=gap.ahead_m - 2e-6)
    assert Adas(careful, start_mps=20.0).allowed(MIDDLE, lambda side: gap)[LEFT]
    assert not Adas(careful, start_mps=20.0).allowed(MIDDLE, lambda side: nearer)[LEFT]


def test_a_vehicle_alongside_closes_the_gate(adas):
    alongside = FREE._replace(behind_m=-3.0, behind_speed_mps=20.0)
    assert adas.allowed(MIDDLE, lambda side: alongside) == [True, True, True, False, False]


# Reversal.


@pytest.mark.parametrize(("action", "back", "side"), [(LEFT, RIGHT, 1), (RIGHT, LEFT, -1)])
@pytest.mark.parametrize(("part", "crosses"), [(0.25, 0), (0.5, 2), (0.75, 2)])
def test_a_reversed_change_returns_to_the_centre_it_left_and_is_counted_as_aborted(
    road, action, back, side, part, crosses
):
    there = math.ceil(part * LANE_M / STRIDE_M)
    road.decide(action)
    road.step(there)
    assert side * road.adas.lateral_m == pytest.approx(there * STRIDE_M)
    road.decide(back)
    passed = road.finish()
    assert len(passed) == there  # as long as it took to get there
    assert (road.host.lane, road.commands[-1].lateral_m) == (2, 0.0)
    assert road.crossings == [side, -side][:crosses]
    assert road.counts == (0, 1, 0)


def test_over_a_line_that_may_be_crossed_one_way_only_nobody_turns_back(road):
    road.decide(LEFT)
    while road.host.lane == 2:
        road.step()
    road.host = at(3, to_right_m=0.0)
    assert not road.adas.allowed(road.host, free)[RIGHT]
    road.decide(RIGHT)
    while road.adas.changing_lane:
        assert road.adas.command(road.host, closed_on(-1, 0, 1), steps=1).cross == 0
    assert road.counts == (1, 0, 1)


def test_a_reversed_change_runs_to_its_end(road):
    road.decide(LEFT)
    road.step(14)
    road.decide(RIGHT)
    road.step(2)
    road.decide(LEFT)
    assert road.adas.refused_decisions == 1
    road.finish()
    assert road.host.lane == 2
    assert road.counts == (0, 1, 1)


def test_once_across_the_way_back_needs_a_gap_in_the_lane_it_came_from(road):
    road.decide(LEFT)
    road.step(12)
    road.gaps = closed_on(-1)  # to its right, now that it is a vehicle of the lane to the left
    assert not road.adas.allowed(road.host, road.gaps)[RIGHT]
    road.decide(RIGHT)
    road.step(STEPS_PER_CHANGE - 12)
    assert road.host.lane == 3
    assert road.counts == (1, 0, 1)


def test_once_across_the_way_back_needs_road_enough(road):
    road.decide(LEFT)
    road.step(12)
    road.host = road.host._replace(to_edge_end_m=30.0)
    assert not road.adas.allowed(road.host, road.gaps)[RIGHT]
    road.decide(RIGHT)
    assert road.adas.refused_decisions == 1


def test_before_the_border_the_layer_turns_back_when_the_gap_closes(road):
    road.decide(LEFT)
    road.step(5)
    road.gaps = closed_on(1)
    assert max(road.finish()) - 2 * LANE_M < 5 * STRIDE_M
    assert road.host.lane == 2
    assert road.crossings == []
    assert road.counts == (0, 1, 0)


def test_the_gap_is_looked_at_in_the_very_step_of_the_crossing(road):
    road.decide(LEFT)
    road.step(7)  # 1.19 m; the next step would cross
    road.gaps = closed_on(1)
    road.step()
    assert road.crossings == []
    road.step(7)
    assert road.counts == (0, 1, 0)


def test_beyond_the_border_a_closing_gap_no_longer_turns_it_back(road):
    road.decide(LEFT)
    road.step(9)
    road.gaps = closed_on(1, -1)
    road.step(10)
    assert road.host.lane == 3
    assert road.counts == (1, 0, 0)


def test_a_gap_that_closes_on_the_way_back_is_not_crossed_into(road):
    road.decide(LEFT)
    road.step(17)
    road.decide(RIGHT)  # a metre to go until it crosses back
    road.step(2)
    road.gaps = closed_on(-1)
    road.finish()
    assert road.host.lane == 3
    assert road.crossings == [1]


def test_during_a_change_only_holding_or_turning_back_is_allowed(road):
    road.decide(LEFT)
    road.step(3)
    assert road.adas.allowed(road.host, free) == [True, False, False, False, True]
    road.decide(RIGHT)
    assert road.adas.allowed(road.host, free) == [True, False, False, False, False]


# Settling in a lane.

CROSSED_STEPS = 8
"""After so many steps of a change the host is a vehicle of the next lane: 1.6 m - 0.25 m at 0.17 m a step."""
SETTLED_STEPS = CROSSED_STEPS - 1 + 50
"""... and after so many it has been crossing into it, or there, for 5 s."""


def settling(host=MIDDLE, settle_s=5.0):
    return Road(Adas(config.Adas(), start_mps=60.0 / KMH, settle_s=settle_s), host)


@pytest.mark.parametrize(("there", "back"), [(LEFT, RIGHT), (RIGHT, LEFT)])
def test_no_decision_takes_the_host_back_until_it_has_settled_in_its_lane(there, back):
    road = settling()
    road.decide(there)
    road.step(CROSSED_STEPS)
    assert road.host.lane != 2
    road.decide(back)
    road.finish()
    assert road.counts == (1, 0, 1), "once over the border it is not turned round"
    road.step(SETTLED_STEPS - 1 - len(road.commands))
    assert not road.adas.allowed(road.host, free)[back]
    road.decide(back)
    assert (road.counts, road.adas.why) == ((1, 0, 2), "just left")
    assert road.adas.allowed(road.host, free)[there], "farther on it may go"
    road.step()
    assert road.adas.allowed(road.host, free)[back]
    road.decide(back)
    road.finish()
    assert road.counts == (2, 0, 2)


def test_before_the_border_a_decision_turns_a_host_round_that_settles_later():
    road = settling()
    road.decide(LEFT)
    road.step(CROSSED_STEPS - 1)
    assert road.adas.allowed(road.host, free)[RIGHT]
    road.decide(RIGHT)
    road.finish()
    assert (road.crossings, road.counts) == ([], (0, 1, 0))
    assert road.adas.allowed(road.host, free)[LEFT], "it has not been there"


def test_out_of_a_lane_that_ends_soon_the_host_goes_back_at_once():
    road = settling(at(lane=3, to_edge_end_m=2000.0, leads_on_m=ENDING))
    road.decide(RIGHT)
    road.finish()
    road.host = road.host._replace(to_edge_end_m=200.0)
    assert road.adas.allowed(road.host, free)[LEFT]
    road.step()
    assert road.adas.side == TO_LEFT, "of its own accord"


def test_in_several_steps_at_once_it_settles_as_long():
    road = settling()
    road.decide(LEFT)
    road.step(CROSSED_STEPS)
    road.finish()
    road.adas.note(SETTLED_STEPS - 1 - len(road.commands))
    assert not road.adas.allowed(road.host, free)[RIGHT]
    road.adas.note(1)
    assert road.adas.allowed(road.host, free)[RIGHT]


def test_between_lanes_of_unequal_width_the_host_crosses_before_the_border_and_ends_in_the_centre(adas):
    wide = at(lane_width_m=4.5, to_left_m=3.85)
    adas.decide(LEFT, wide, free)
    commands = []
    while adas.changing_lane:
        commands.append(adas.command(wide, free, steps=1))
    crossed = next(number for number, command in enumerate(commands, 1) if command.cross)
    assert crossed == 12  # the first stride beyond 2.25 - 0.25 m
    assert commands[crossed - 1].lateral_m == pytest.approx(12 * STRIDE_M - 3.85)
    assert len(commands) == 23  # 3.85 / 0.17 = 22.6
    assert commands[-1].lateral_m == pytest.approx(0.0)


# A change that gains nothing.

GAIN_S = 5.0


def behind(ahead_m, ahead_kmh):
    return FREE._replace(ahead_m=ahead_m, ahead_speed_mps=ahead_kmh / KMH)


@pytest.fixture
def gaining():
    return Adas(config.Adas(), start_mps=60.0 / KMH, gain_s=GAIN_S)


# At 72 km/h where 80 are allowed. Behind one of 44 km/h, 36 less, it comes to 2 m + 1 s * 20 m/s within 5 s from 72 m.
@pytest.mark.parametrize(
    ("here", "there", "why"),
    [
        (FREE, FREE, "no gain"),
        (behind(71.9, 44.0), FREE, ""),
        (behind(72.1, 44.0), FREE, "no gain"),
        (behind(30.0, 80.0), FREE, "no gain"),
        (behind(24.0, 79.0), FREE, "no gain"),
        (behind(23.0, 79.0), FREE, ""),
        (behind(60.0, 44.0), behind(59.0, 44.0), "no gain"),
        (behind(60.0, 44.0), behind(61.0, 44.0), ""),
        (behind(36.0, 54.0), behind(60.0, 36.0), "no gain"),
        (behind(40.0, 54.0), behind(40.0, 60.0), ""),
        (behind(50.0, 44.0), CLOSED, "gap"),
    ],
)
@pytest.mark.parametrize(("action", "other"), [(LEFT, RIGHT), (RIGHT, LEFT)])
def test_in_a_demand_lanes_are_changed_for_who_is_ahead_and_where_it_gets_the_host_farther(
    gaining, adas, action, other, here, there, why
):
    def gaps(side):
        return there if side == (1 if action is LEFT else -1) else here

    assert gaining.allowed(MIDDLE, gaps)[action] == (not why)
    assert not gaining.allowed(MIDDLE, gaps)[other], "the lane there is as this one"
    assert gaining.decide(action, MIDDLE, gaps) is (KEEP if why else action)
    assert (gaining.why, gaining.refused_decisions) == (why, bool(why))
    assert adas.allowed(MIDDLE, gaps)[action] == (why != "gap"), "in made traffic, as in the paper"


def test_towards_a_lane_that_leads_on_it_need_not_gain(gaining):
    host = at(lane=2, to_edge_end_m=2000.0, leads_on_m=ENDING)
    assert gaining.allowed(host, free)[LEFT]
    assert gaining.decide(LEFT, host, free) is LEFT


def test_of_its_own_accord_the_layer_leaves_a_lane_that_ends_without_gain(gaining):
    road = Road(gaining, at(lane=2, to_edge_end_m=200.0, leads_on_m=ENDING))
    road.step()
    assert road.adas.side == TO_LEFT


# Changes that go on over the end of an edge.


def test_in_the_step_that_takes_it_on_to_the_next_edge_the_host_waits_beside_the_border(road):
    """There its lane may have another number, and SUMO would take the order for another lane."""
    road.decide(LEFT)
    road.step(7)  # 1.19 m; the next step would cross
    road.host = road.host._replace(to_edge_end_m=2.0, left_goes_on_m=100.0)  # a step's travel
    road.step()
    assert (road.crossings, road.commands[-1].lateral_m) == ([], pytest.approx(7 * STRIDE_M))
    road.host = at(1, to_edge_end_m=100.0)  # the same lane, one number lower
    road.step()
    assert (road.crossings, road.host.lane) == ([1], 2)
    assert road.commands[-1].lateral_m == pytest.approx(8 * STRIDE_M - LANE_M)
    road.finish()
    assert road.counts == (1, 0, 0)


def test_from_a_lane_that_leads_nowhere_it_crosses_over_though_it_stands_at_the_very_end(road):
    """Nothing takes it on to the next edge; it waited there for ever."""
    road.host = at(2, speed_mps=0.0, to_edge_end_m=0.0, leads_on_m=ENDING)
    road.step()
    assert road.adas.changing_lane
    road.finish()
    assert (road.crossings, road.host.lane, road.counts) == ([1], 3, (1, 0, 0))


def test_on_its_way_back_too_it_waits_there(road):
    road.decide(LEFT)
    road.step(12)
    road.decide(RIGHT)
    road.step(1)  # 1.87 m; the next step would cross back
    road.host = road.host._replace(to_edge_end_m=2.0, right_goes_on_m=100.0)
    road.step()
    assert (road.crossings, road.adas.lateral_m) == ([1], pytest.approx(11 * STRIDE_M))
    road.host = road.host._replace(to_edge_end_m=100.0)
    road.finish()
    assert (road.crossings, road.host.lane, road.counts) == ([1, -1], 2, (0, 1, 0))


def test_away_from_the_border_nothing_waits_for_the_next_edge(road):
    road.decide(LEFT)
    road.host = road.host._replace(to_edge_end_m=1.0, left_goes_on_m=100.0)
    road.step(7)
    assert road.adas.lateral_m == pytest.approx(7 * STRIDE_M)


def test_where_there_is_no_lane_beside_any_more_the_host_turns_back(road):
    road.decide(LEFT)
    road.step(5)
    road.host = at(2, to_left_m=0.0)
    road.finish()
    assert (road.crossings, road.counts) == ([], (0, 1, 0))


@pytest.mark.parametrize(("goes_on_m", "turns_back"), [(46.1, True), (45.9, False)])
def test_once_across_the_way_back_may_lead_over_the_end_of_the_edge(road, goes_on_m, turns_back):
    road.decide(LEFT)
    road.step(12)
    road.host = road.host._replace(to_edge_end_m=0.0, left_goes_on_m=100.0, right_goes_on_m=goes_on_m)
    assert road.adas.allowed(road.host, free)[RIGHT] == turns_back


# Lanes that end.


def ending(*lanes, after_m=0.0):
    return tuple(after_m if lane in lanes else math.inf for lane in range(5))


def go_on(adas, host, gaps=free, action=KEEP):
    """Decide, and drive one step of it."""
    adas.decide(action, host, gaps)
    return adas.command(host, gaps, steps=10)


@pytest.mark.parametrize("action", [KEEP, ACCELERATE, DECELERATE, RIGHT])
@pytest.mark.parametrize("lanes", [(0,), (0, 1)])
@pytest.mark.parametrize(("kmh", "a_lane_m"), [(80, LEAVES_M), (50, 300.0), (130, 722.2), (math.inf, 1111.1)])
def test_20_s_or_300_m_for_each_lane_to_cross_before_its_end_the_host_leaves_a_lane_whatever_is_decided(
    adas, action, lanes, kmh, a_lane_m
):
    """Where there is no limit, as far as the fastest car drives in that time."""
    leaves_m = a_lane_m * len(lanes)
    before = at(lane=0, to_edge_end_m=leaves_m + 1.0, leads_on_m=ending(*lanes), limit_mps=kmh / KMH)
    go_on(adas, before, action=action)
    assert not adas.changing_lane
    go_on(adas, before._replace(to_edge_end_m=leaves_m - 1.0), action=action)
    assert adas.side == 1
    assert adas.lateral_m == pytest.approx(STRIDE_M)


@pytest.mark.parametrize(("sooner_m", "why"), [(10.0, "lane ends"), (-10.0, "")])
def test_a_lane_from_which_two_more_have_to_be_crossed_is_not_open_10_s_before_it_must_be_left(adas, sooner_m, why):
    """At 20 m/s."""
    host = at(lane=2, to_edge_end_m=2 * LEAVES_M + 200.0 - sooner_m, leads_on_m=ending(0, 1, 2, 3))
    adas.decide(RIGHT, host._replace(lane=3), free)
    assert adas.why == why


def beside(ahead_m, ahead_mps, behind_m=math.inf):
    """Free road, and somebody in the lane to the left."""
    return lambda side: Gaps(ahead_m, ahead_mps, behind_m, 0.0) if side == 1 else free(side)


def test_who_must_leave_its_lane_falls_in_comfortably_behind_the_vehicle_beside(adas):
    host = at(lane=0, speed_mps=16.0, to_edge_end_m=150.0, leads_on_m=ending(0))
    command = go_on(adas, host, beside(3.0, 16.0))
    assert adas.falls_in
    assert command.speed_mps == pytest.approx(16.0 - config.Adas().comfort_braking_mps2 * SECONDS_PER_STEP)
    assert command.asks == 1


def test_nobody_falls_in_where_the_lane_leads_on_or_the_change_is_over_the_border(adas):
    host = at(lane=0, speed_mps=16.0, to_edge_end_m=150.0)
    assert go_on(adas, host, beside(3.0, 16.0)).speed_mps >= 16.0
    assert not adas.falls_in
    ends = host._replace(leads_on_m=ending(0))
    crossed = False
    for _ in range(20):
        command = adas.command(ends._replace(lane=int(crossed)), free if not crossed else beside(3.0, 16.0), steps=1)
        crossed |= bool(command.cross)
    assert crossed
    assert not adas.falls_in


def test_far_from_its_lanes_end_the_host_does_not_wait_beside_a_queue(adas):
    """It would hold up those behind it; sqrt(2 * 0.2 * 280) is 10.6 m/s."""
    far = at(lane=0, speed_mps=10.0, to_edge_end_m=280.0 + STANDS_BEFORE_M[TO_LEFT], leads_on_m=ending(0))
    near = far._replace(to_edge_end_m=60.0)
    assert go_on(adas, far, beside(2.0, 0.0)).speed_mps > 10.0
    assert go_on(adas, near, beside(2.0, 0.0)).speed_mps < 10.0


def test_a_lane_change_of_its_own_accord_is_begun_once(adas):
    host = at(lane=0, to_edge_end_m=200.0, leads_on_m=ending(0))
    adas.decide(KEEP, host, free)
    for _ in range(5):
        adas.command(host, free, steps=1)
    assert adas.lateral_m == pytest.approx(5 * STRIDE_M)
    adas.decide(KEEP, host, free)
    assert adas.lateral_m == pytest.approx(5 * STRIDE_M)


@pytest.mark.parametrize(("lane", "side"), [(1, -1), (2, 1)])
def test_a_lane_that_ends_is_left_towards_the_nearer_one_that_leads_on(adas, lane, side):
    go_on(adas, at(lane=lane, to_edge_end_m=200.0, leads_on_m=ending(1, 2)))
    assert adas.side == side


def test_a_lane_that_ends_beyond_the_next_edges_is_left_as_early(adas):
    before = at(lane=0, to_edge_end_m=60.0, leads_on_m=ending(0, after_m=LEAVES_M - 59.0))
    go_on(adas, before)
    assert not adas.changing_lane
    go_on(adas, before._replace(to_edge_end_m=58.0))
    assert adas.side == 1


def test_where_all_lanes_end_soon_the_host_makes_for_those_that_lead_on_farthest(adas):
    go_on(adas, at(lane=0, to_edge_end_m=100.0, leads_on_m=(0.0, 50.0, 150.0, 150.0, 50.0)))
    assert adas.side == 1
    stays = Adas(config.Adas(), start_mps=60.0 / KMH)
    go_on(stays, at(lane=3, to_edge_end_m=100.0, leads_on_m=(0.0, 50.0, 150.0, 150.0, 50.0)))
    assert not stays.changing_lane


def test_the_end_of_a_lane_opens_no_gate_but_the_host_looks_at_every_step_for_a_gap_and_asks_for_one(adas):
    near = at(lane=0, to_edge_end_m=200.0, leads_on_m=ending(0))
    waits = go_on(adas, near, closed_on(1))
    assert (waits.asks, waits.steps, adas.changing_lane, adas.refused_decisions) == (1, 1, False, 0)
    begins = adas.command(near, free, steps=9)
    assert (begins.asks, begins.cross, adas.side) == (1, 0, 1)
    commands = [adas.command(near, free, steps=1) for _ in range(7)]
    assert [(one.asks, one.cross) for one in commands] == [(1, 0)] * 6 + [(0, 1)]


@pytest.mark.parametrize(("lane", "asks"), [(1, -1), (2, 1), (3, 0)])
def test_it_asks_on_the_side_of_the_nearer_lane_that_leads_on_and_not_where_its_own_does(adas, lane, asks):
    host = at(lane=lane, to_edge_end_m=200.0, leads_on_m=ending(1, 2))
    assert go_on(adas, host, closed).asks == asks


@pytest.mark.parametrize(("queued", "leaves"), [((0, 150.0), True), ((150.0, 0), True), ((0, 0, 150.0), False)])
def test_the_longer_the_queue_the_earlier_the_host_leaves_its_lane_for_it(adas, queued, leaves):
    """In the lane that it makes for, or in its own; a third does not matter. It takes 100 m to brake from 20 m/s."""
    host = at(
        lane=0, to_edge_end_m=LEAVES_M + 251.0, leads_on_m=ending(0), queued_m=(*queued, *(0,) * (5 - len(queued)))
    )
    go_on(adas, host)
    assert not adas.changing_lane
    go_on(adas, host._replace(to_edge_end_m=LEAVES_M + 249.0))
    assert adas.changing_lane == leaves


def test_beside_a_queue_the_host_falls_in_as_slowly_as_at_its_lanes_end(adas):
    """Or it would pass those who wait, and stand beside them."""
    host = at(lane=0, speed_mps=10.0, to_edge_end_m=280.0, leads_on_m=ending(0))
    queued = host._replace(queued_m=(0, 260.0, 0, 0, 0))
    assert go_on(adas, host, beside(2.0, 0.0)).speed_mps > 10.0
    assert go_on(adas, queued, beside(2.0, 0.0)).speed_mps < 10.0


@pytest.mark.parametrize(("sooner_m", "why"), [(1.0, "lane ends"), (-1.0, "")])
def test_nobody_is_overtaken_in_a_lane_that_must_be_left_within_10_s(adas, sooner_m, why):
    """At 20 m/s."""
    adas.decide(LEFT, at(lane=2, to_edge_end_m=LEAVES_M + 200.0 - sooner_m, leads_on_m=ending(3, 4)), free)
    assert adas.why == why


def test_towards_those_that_lead_on_a_lane_is_entered_however_soon_it_must_be_left(adas):
    adas.decide(RIGHT, at(lane=4, to_edge_end_m=650.0, leads_on_m=ending(3, 4)), free)
    assert adas.side == -1


@pytest.mark.parametrize(
    ("lane", "leads_on_m", "side"),
    [
        (0, ending(0, 1), 1),
        (2, ending(0, 1), 0),
        (4, ending(3, 4), -1),
        (0, ending(0, 1, 2, 3, 4), 0),
        (3, ending(), 0),
    ],
)
@pytest.mark.parametrize("to_edge_end_m", [100.0, 5000.0])
def test_from_however_far_the_layer_says_on_which_side_lanes_lead_on_farther(
    adas, lane, leads_on_m, side, to_edge_end_m
):
    command = go_on(adas, at(lane=lane, to_edge_end_m=to_edge_end_m, leads_on_m=leads_on_m), closed)
    assert command.must_leave == side


def test_where_every_lane_ends_or_none_the_host_stays(adas):
    for lanes in ((0, 1, 2, 3, 4), ()):
        assert go_on(adas, at(to_edge_end_m=200.0, leads_on_m=ending(*lanes))).asks == 0
        assert not adas.changing_lane


def test_near_its_end_nobody_changes_into_a_lane_that_ends(adas):
    beside = at(lane=1, to_edge_end_m=LEAVES_M + 201.0, leads_on_m=ending(0))
    assert adas.allowed(beside, free)[RIGHT]
    near = beside._replace(to_edge_end_m=299.0)
    assert adas.allowed(near, free) == [True, True, True, True, False]
    adas.decide(RIGHT, near, free)
    assert (adas.changing_lane, adas.refused_decisions) == (False, 1)


@pytest.mark.parametrize("steps", [5, 12])
def test_a_change_out_of_a_lane_that_ends_is_not_taken_back_by_a_decision_but_when_the_gap_closes(adas, steps):
    """It crosses over in its ninth step."""
    host = at(lane=0, to_edge_end_m=100.0, leads_on_m=ending(0))
    adas.decide(KEEP, host, free)
    for _ in range(steps):
        crossed = adas.command(host, free, steps=1).cross
        host = host._replace(lane=host.lane + crossed, to_right_m=3.2 if host.lane + crossed else 0.0)
    assert adas.allowed(host, free) == [True, False, False, False, False]
    adas.decide(RIGHT, host, free)
    assert (adas.side, adas.refused_decisions) == (1, 1)
    far = host._replace(to_edge_end_m=700.0)
    assert adas.allowed(far, free)[RIGHT]
    if steps == 5:
        for _ in range(10):
            adas.command(host, closed_on(1), steps=1)
        assert (adas.changing_lane, adas.aborted_lane_changes) == (False, 1)


gap = st.builds(
    Gaps,
    ahead_m=st.sampled_from([-2.0, 10.0, 12.5, 22.5, 35.0, math.inf]),
    ahead_speed_mps=st.sampled_from([0.0, 15.0, 25.0]),
    behind_m=st.sampled_from([-2.0, 10.0, 12.5, 22.5, 35.0, math.inf]),
    behind_speed_mps=st.sampled_from([0.0, 15.0, 25.0]),
)
turns = st.lists(
    st.tuples(
        st.sampled_from(MetaAction),
        st.integers(1, 8),  # steps until the next decision
        st.one_of(st.just((FREE, FREE)), st.tuples(gap, gap)),  # the gaps to the left and to the right from now on
    ),
    max_size=25,
)


def drive(turns, lane=2, settle_s=0.0):
    """Yield the road after every step of a drive through any decisions and any gaps."""
    road = settling(at(lane=lane), settle_s)
    for action, steps, (left, right) in turns:
        road.gaps = {1: left, -1: right}.__getitem__
        road.decide(action)
        for _ in range(steps):
            road.step()
            yield road


@given(turns, st.integers(0, 4))
def test_whatever_happens_the_host_moves_sideways_steadily_and_stays_on_the_road(turns, lane):
    before = lane * LANE_M
    for road in drive(turns, lane):
        assert 0.0 <= road.left_m <= 4 * LANE_M
        assert abs(road.left_m - before) <= STRIDE_M + 1e-9
        before = road.left_m


@given(turns, st.sampled_from([0.5, 1.0, 3.0]))
def test_whatever_happens_nobody_is_back_before_it_has_settled(turns, settle_s):
    last, at_step = 0, -math.inf
    for step, road in enumerate(drive(turns, settle_s=settle_s)):
        cross = road.commands[-1].cross
        if cross:
            assert cross != -last or step - at_step >= round(settle_s / SECONDS_PER_STEP)
            last, at_step = cross, step


@given(turns)
def test_whatever_happens_a_change_stays_within_its_two_lanes_and_crosses_there_and_back_in_turn(turns):
    start, crossings = 2, []
    for road in drive(turns):
        crossings += [road.commands[-1].cross] if road.commands[-1].cross else []
        side = road.adas.side
        if side is not None:
            assert -1e-9 <= side * (road.left_m - start * LANE_M) <= LANE_M + 1e-9
        assert crossings in ([], [1], [-1], [1, -1], [-1, 1])
        if not road.adas.changing_lane:
            assert road.commands[-1].lateral_m == 0.0
            assert road.host.lane - start == sum(crossings)
            start, crossings = road.host.lane, []


@given(turns)
def test_whatever_happens_changes_are_counted_as_a_bystander_would(turns):
    settled, was_away, changes, aborted = 2, False, 0, 0
    for road in drive(turns):
        is_away = road.commands[-1].lateral_m != 0.0 or road.adas.changing_lane
        if was_away and not is_away:
            changes += road.host.lane != settled
            aborted += road.host.lane == settled
            settled = road.host.lane
        was_away = is_away
        assert road.counts[:2] == (changes, aborted)


@given(turns)
def test_whatever_happens_the_host_crosses_only_into_a_gap_that_is_safe_in_that_step(turns):
    for road in drive(turns):
        cross = road.commands[-1].cross
        if cross:
            assert Adas(config.Adas(), start_mps=60.0 / KMH).allowed(
                MIDDLE, lambda side, cross=cross, road=road: road.gaps(cross)
            )[LEFT]


@given(turns, st.sampled_from(MetaAction))
def test_what_the_mask_allows_is_never_refused_and_a_forbidden_start_always_is(turns, action):
    road = Road(Adas(config.Adas(), start_mps=60.0 / KMH))
    for road in drive(turns):  # noqa: B007  the last one counts
        pass
    allowed, changing, refused = road.adas.allowed(road.host, road.gaps), road.adas.changing_lane, road.counts[2]
    road.decide(action)
    if allowed[action]:
        assert road.counts[2] == refused
    elif not changing:
        assert road.counts[2] == refused + 1


# SUMO's own driver.


def test_hands_off_leaves_the_speed_to_sumo_and_counts_its_lane_changes():
    adas = HandsOff(config.Adas())
    under_way = []
    for changes in (0, 0, 1, 1, 2, 2):
        adas.decide(LEFT, MIDDLE, free)
        command = adas.command(MIDDLE._replace(sumos_lane_changes=changes), free, steps=10)
        assert (command.speed_mps, command.cross, command.steps) == (SUMO_DECIDES, 0, 1)
        under_way.append(adas.changing_lane)
    assert under_way == [False, False, True, False, True, False]
    assert (adas.lane_changes, adas.refused_decisions) == (2, 0)


# A lane that ends.


@pytest.mark.parametrize(
    ("lane", "is_dead_end", "stands_m", "braking_mps2"),
    [(4, False, 2.5, 2.0), (0, False, 20.0, 2.0), (0, True, 2.5, 3.0)],
)
def test_how_hard_the_end_of_a_lane_is_braked_for_and_where_the_host_stands(
    road, lane, is_dead_end, stands_m, braking_mps2
):
    """Where lanes part, who is to go left stands back, so that one in the next lane who is to go right passes it."""
    road.gaps = lambda side: FREE._replace(behind_m=1.0)
    blocked = at(lane=lane, to_edge_end_m=150.0, leads_on_m=ending(0, 4), dead_ends=(is_dead_end,) * 5)
    speed, ahead_m, hardest_mps2 = 20.0, 150.0, 0.0
    while speed > 0.05 and ahead_m > 0.0:
        command = road.adas.command(blocked._replace(speed_mps=speed, to_edge_end_m=ahead_m), road.gaps, steps=1)
        hardest_mps2 = max(hardest_mps2, (speed - command.speed_mps) / SECONDS_PER_STEP)
        speed = command.speed_mps
        ahead_m -= speed * SECONDS_PER_STEP
    assert ahead_m == pytest.approx(stands_m, abs=0.3)
    assert hardest_mps2 == pytest.approx(braking_mps2, abs=1e-6)


def test_where_sumo_takes_the_gap_that_the_host_asks_for_the_change_is_counted_and_over(road):
    road.adas.decide(LEFT, road.host, free)
    road.adas.command(road.host, free, steps=1)
    assert road.adas.changing_lane
    moved = at(lane=3, sumos_lane_changes=1)
    command = road.adas.command(moved, free, steps=5)
    assert (road.adas.lane_changes, road.adas.changing_lane) == (1, False)
    assert (command.lateral_m, command.cross) == (0.0, 0)
    road.adas.command(moved, free, steps=5)
    assert road.adas.lane_changes == 1
