import gzip
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sketch import cut_road, edge, leads_on

from rail_sumo import assets
from rail_sumo.errors import InputError
from rail_sumo.highway.network import borders, road

RING_RADIUS_M, RING_HALF_WIDTH_M = 500.0, 8.0


def course(file):
    return [edge.id for edge in road.load(file).edges]


@pytest.mark.parametrize(("name", "lanes", "half_width_m"), [("highway5", 5, 8.0), ("highway3", 3, 4.8)])
def test_the_highway_is_one_straight_edge_between_two_guard_rails(name, lanes, half_width_m):
    highway = road.load(name)
    (only,) = highway.edges
    assert (only.id, only.length_m, only.n_lanes, only.first_lane) == ("highway", 8200, lanes, 0)
    assert set(only.leads_on_m) == {math.inf}
    assert not highway.is_loop
    assert highway.boundaries == pytest.approx(
        np.array([[0, -half_width_m, 8200, -half_width_m], [0, half_width_m, 8200, half_width_m]])
    )


def test_the_ring_is_as_long_as_its_circle():
    ring = road.load("ring5")
    # 192 chords of angle h are shorter than the arc by h^2/24, here 0.14 m; SUMO rounds each length to 0.01 m.
    chords = 2 * RING_RADIUS_M * 192 * math.sin(math.pi / 192)
    assert ring.length_m == pytest.approx(chords, abs=0.1)
    assert ring.length_m == pytest.approx(2 * math.pi * RING_RADIUS_M, rel=1e-4)


def test_the_ring_runs_through_its_eight_edges_in_driving_order_and_closes():
    ring = road.load("ring5")
    assert [edge.id for edge in ring.edges] == [f"ring{k}" for k in range(8)]
    assert {edge.n_lanes for edge in ring.edges} == {5}
    assert {edge.leads_on_m for edge in ring.edges} == {(math.inf,) * 5}
    assert ring.is_loop


def test_how_far_drivers_see_is_told_for_the_lane_it_is_told_of(tmp_path):
    crossing = Path(__file__).with_name("crossing.net.xml").read_text()
    path = tmp_path / "crossing.net.xml"
    path.write_text(crossing.replace('via=":cross_0_1"', 'via=":cross_0_1" visibility="30.5"'))
    assert road.load(str(path)).sight_m == {":cross_0_1": 30.5}
    assert not road.load("ring5").sight_m


@pytest.mark.parametrize("state", ["m", "=", "s", "w", "o"])
def test_a_course_meets_others_where_it_has_no_priority_or_they_cross_its_way(tmp_path, state):
    crossing = Path(__file__).with_name("crossing.net.xml")
    path = tmp_path / "crossing.net.xml"
    alone = re.sub('foes="[01]+"', 'foes="000"', crossing.read_text())
    path.write_text(alone.replace('state="m"', f'state="{state}"'))
    assert road.load(str(path)).meets_others
    alone = alone.replace('state="M"', 'state="w"').replace('state="m"', 'state="M"')
    path.write_text(alone)
    assert not road.load(str(path)).meets_others  # the small letters are the other road's now
    path.write_text(alone.replace('index="0" response="100" foes="000"', 'index="0" response="000" foes="100"'))
    assert road.load(str(path)).meets_others
    assert not any(road.load(name).meets_others for name in ("highway5", "ring5", "onramp"))  # there others join


def test_the_rings_guard_rails_are_two_closed_circles_eight_metres_beside_the_middle():
    ring = road.load("ring5")
    start, end = ring.boundaries[:, :2], ring.boundaries[:, 2:]
    radius = np.hypot(*start.T)
    outer, inner = radius > RING_RADIUS_M, radius < RING_RADIUS_M
    assert radius[outer] == pytest.approx(RING_RADIUS_M + RING_HALF_WIDTH_M, abs=0.1)
    assert radius[inner] == pytest.approx(RING_RADIUS_M - RING_HALF_WIDTH_M, abs=0.1)
    for side in (outer, inner):
        assert np.array_equal(end[side], np.roll(start[side], -1, axis=0))
        angles = np.unwrap(np.arctan2(*start[side][:, ::-1].T))
        assert (np.diff(angles) > 0).all()
        assert np.hypot(*(end[side] - start[side]).T).max() < 20.0


@given(st.floats(-1e5, 1e5))
def test_a_place_on_the_ring_is_the_same_after_a_lap_and_adds_up_to_where_it_came_from(s_m):
    ring = road.load("ring5")
    index, along_m = ring.place(s_m)
    before = math.fsum(edge.length_m for edge in ring.edges[:index]) + math.fsum(ring.junctions_m[:index])
    missed = (before + along_m - s_m) % ring.length_m
    # A place inside a junction snaps forward to the edge after it, by no more than the junction's length.
    assert min(missed, ring.length_m - missed) < max(ring.junctions_m) + 1e-6
    assert 0.0 <= along_m <= ring.edges[index].length_m


def test_places_on_the_ring_by_hand():
    ring = road.load("ring5")
    first, junction = ring.edges[0].length_m, ring.junctions_m[0]
    assert ring.place(0.0) == (0, 0.0)
    assert ring.place(first) == (0, first)
    assert ring.place(first + junction / 2) == (1, 0.0)
    assert ring.place(first + junction + 10.0) == (1, pytest.approx(10.0))
    assert ring.place(-ring.junctions_m[-1] - 5.0) == (7, pytest.approx(ring.edges[7].length_m - 5.0))
    assert ring.place(-ring.junctions_m[-1] / 2) == (0, 0.0)
    assert ring.place(3 * ring.length_m + 10.0) == (0, pytest.approx(10.0))


def test_a_file_that_was_edited_is_read_again(tmp_path):
    file = tmp_path / "mine.net.xml"
    for name, lanes in (("highway5", 5), ("highway3", 3)):
        file.write_bytes(assets.network(name).read_bytes())
        assert road.load(str(file)).edges[0].n_lanes == lanes


def test_beyond_the_ends_of_a_straight_road_there_is_no_place():
    highway = road.load("highway5")
    assert highway.place(0.0) == (0, 0.0)
    assert highway.place(8200.0) == (0, 8200.0)
    assert highway.place(-0.001) is None
    assert highway.place(8200.001) is None


@given(first=st.integers(0, 7), distance_m=st.floats(1.0, 20_000.0))
def test_laps_cover_the_distance_and_no_edge_too_many(first, distance_m):
    ring = road.load("ring5")
    ids = ring.laps(first, distance_m)
    assert ids == tuple(f"ring{(first + k) % 8}" for k in range(len(ids)))
    lengths = [edge.length_m for edge in ring.edges]
    covered = sum(lengths[(first + k) % 8] for k in range(len(ids)))
    assert covered - lengths[(first + len(ids) - 1) % 8] < distance_m <= covered


def test_laps_of_a_chain_stop_at_its_end(network):
    file = network(edge("a"), edge("b", x=(100.0, 200.0)), leads_on("a", "b", [0, 1]))
    chain = road.load(file)
    assert chain.laps(0, 50.0) == ("a",)
    assert chain.laps(0, 150.0) == ("a", "b")
    assert chain.laps(1, 1e6) == ("b",)


def test_a_chain_joins_its_edges_borders_without_a_gap(network):
    file = network(edge("a"), edge("b", x=(101.0, 200.0)), leads_on("a", "b", [0, 1]))
    # Two lanes of 3.2 m on y = 0 and y = 3.2: borders at -1.6 and 4.8, also where nothing says how they join.
    assert road.load(file).boundaries == pytest.approx(
        np.array(
            [
                [0, -1.6, 100, -1.6],
                [100, -1.6, 101, -1.6],
                [101, -1.6, 200, -1.6],
                [0, 4.8, 100, 4.8],
                [100, 4.8, 101, 4.8],
                [101, 4.8, 200, 4.8],
            ]
        )
    )


def test_a_joint_without_extent_leaves_the_border_straight(network):
    """netconvert writes internal lanes whose points coincide; in the middle of a lane they are no border."""
    inside = '<lane id=":j_0_0" index="0" speed="30" length="0.10" shape="100,0 100,0"/>'
    through = (
        '<connection from="a" to="b" fromLane="0" toLane="0" via=":j_0_0" dir="s" state="M"/>'
        '<connection from=":j_0" to="b" fromLane="0" toLane="0" dir="s" state="M"/>'
    )
    file = network(
        f'<edge id=":j_0" function="internal">{inside}</edge>',
        edge("a", lanes=1),
        edge("b", lanes=1, x=(100.0, 200.0)),
        through,
    )
    assert set(road.load(file).boundaries[:, [1, 3]].ravel()) == {-1.6, 1.6}


def test_the_way_through_a_junction_counts_and_has_borders(network):
    # Through the junction the road swerves to the left: along (3, 4) and back along (3, -4), 10 m of road over 6 m.
    inside = "".join(
        f'<lane id=":j_0_{k}" index="{k}" speed="30" length="10.00" shape="100,{y} 103,{y + 4} 106,{y}"/>'
        for k, y in enumerate((0.0, 3.2))
    )
    through = "".join(
        f'<connection from="a" to="b" fromLane="{k}" toLane="{k}" via=":j_0_{k}" dir="s" state="M"/>'
        f'<connection from=":j_0" to="b" fromLane="{k}" toLane="{k}" dir="s" state="M"/>'
        for k in (0, 1)
    )
    junction = '<junction id=":j" type="priority" x="0" y="0" incLanes="" intLanes="" shape="0,0"/>'
    way = f'<edge id=":j_0" function="internal">{inside}</edge>'
    swerving = road.load(network(edge("a"), edge("b", x=(106.0, 200.0)), way, junction, through))
    assert swerving.junctions_m == (10.0, 0.0)
    assert swerving.length_m == 100.0 + 10.0 + 94.0
    assert swerving.place(105.0) == (1, 0.0)
    # The right border's peak: the mitre at (103, 4) with the sides' normals (-0.8, 0.6) and (0.8, 0.6) is (0, 1 / 0.6).
    assert np.array([103.0, 4.0 - 1.6 / 0.6]) == pytest.approx(swerving.boundaries[2, 2:])
    assert np.array([103.0, 7.2 + 1.6 / 0.6]) == pytest.approx(swerving.boundaries[-3, :2])


def test_a_line_that_cars_may_not_cross_parts_the_lanes(network, tmp_path):
    file = Path(network(edge("a", lanes=4, width=3.0)))
    lines = {0: 'changeLeft="emergency"', 2: 'changeLeft="bus passenger" changeRight=""', 3: 'changeRight="all"'}
    text = file.read_text()
    for lane, line in lines.items():
        text = text.replace(f'index="{lane}"', f'index="{lane}" {line}')
    file.write_text(text)
    (lined,) = road.load(str(file)).edges
    assert lined.to_left_m == (0.0, 3.0, 3.0, 0.0)
    assert lined.to_right_m == (0.0, 3.0, 0.0, 3.0)
    assert list(road.warnings(road.load(str(file)))) == [
        "lines on edge 'a' forbid some lane changes; the host will not make them"
    ]


def test_limits_ahead_are_those_of_the_edges_that_follow_as_far_as_one_can_see(network):
    def limited(*kmh_by_edge, x=(0.0, 200.0)):
        return [
            edge(name, x=x).replace('speed="30"', f'speed="{v}"') for name, v in zip("abcd", kmh_by_edge, strict=True)
        ]

    ways = [leads_on(*way, [0, 1]) for way in ("ab", "bc", "cd")]
    chain = road.load(network(*limited(30, 20, 10, 5), *ways))
    assert chain.edges[0].limits_ahead == (((0.0, 20.0), (200.0, 10.0), (400.0, 5.0)),) * 2
    assert chain.edges[3].limits_ahead == ((), ())
    loop = road.load(network(*limited(30, 20, 10, 5), *ways, leads_on("d", "a", [0, 1])))
    assert loop.edges[3].limits_ahead == (((0.0, 30.0), (200.0, 20.0), (400.0, 10.0)),) * 2
    far = road.load(network(*limited(30, 20, 10, 5, x=(0.0, 600.0)), *ways))
    assert far.edges[0].limits_ahead == (((0.0, 20.0),),) * 2


def test_a_limit_ahead_is_the_fastest_lanes_and_begins_where_its_edge_does(network):
    def limited(name, x, *lanes_mps):
        row = edge(name, x=x)
        for lane, limit in enumerate(lanes_mps):
            row = row.replace(f'index="{lane}" disallow="pedestrian" speed="30"', f'index="{lane}" speed="{limit}"')
        return row

    edges = limited("a", (0.0, 70.0), 30, 30), limited("b", (70.0, 200.0), 10, 20), limited("c", (200.0, 900.0), 15, 5)
    chain = road.load(network(*edges, *(leads_on(*way, [0, 1]) for way in ("ab", "bc"))))
    assert chain.edges[0].limits_ahead == (((0.0, 20.0), (130.0, 15.0)),) * 2


def test_on_a_loop_a_lane_that_ends_after_the_first_edge_leads_on_no_farther(network):
    ways = leads_on("a", "b", [1, 2]), leads_on("b", "a", [0, 1, 2])
    loop = road.load(network(edge("a", lanes=3), edge("b", lanes=3, x=(100.0, 250.0)), *ways))
    assert {edge.id: edge.leads_on_m for edge in loop.edges} == {
        "a": (0.0, math.inf, math.inf),
        "b": (100.0, math.inf, math.inf),
    }


def test_of_two_ways_on_from_a_lane_the_longer_counts(network):
    # From a's only way to the right, lane 0 of b ends with b, lane 1 leads on.
    ways = leads_on("a", "b", [0, 1], to=[1, 1]), leads_on("a", "b", [1], to=[0]), leads_on("b", "c", [1])
    chain = road.load(network(edge("a"), edge("b", x=(100.0, 250.0)), edge("c", x=(250.0, 400.0)), *ways))
    assert chain.edges[0].leads_on_m == (math.inf, math.inf)


def test_a_line_that_turns_back_on_itself_has_borders_all_the_same():
    assert np.isfinite(borders.offset(np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 0.0]]), 1.6)).all()


def test_lanes_of_different_widths_are_half_of_either_apart(network):
    file = Path(network(edge("a", lanes=3, width=3.0)))
    right, left = file.read_text().split('id="a_1"')
    file.write_text(right + 'id="a_1"' + left.replace('width="3.0"', 'width="4.0"', 1))
    (mixed,) = road.load(str(file)).edges
    assert mixed.to_left_m == (3.5, 3.5, 0.0)
    assert mixed.to_right_m == (0.0, 3.5, 3.5)


def test_a_lane_leads_on_over_as_many_edges_as_it_does(network):
    file = network(
        edge("a", lanes=3),
        edge("b", lanes=3, x=(100.0, 250.0)),
        edge("c", lanes=2, x=(250.0, 350.0)),
        leads_on("a", "b", [0, 1, 2]),
        leads_on("b", "c", [1, 2], to=[0, 1]),
    )
    assert [edge.leads_on_m for edge in road.load(file).edges] == [
        (150.0, math.inf, math.inf),
        (0.0, math.inf, math.inf),
        (math.inf, math.inf),
    ]


def test_on_a_loop_too_a_lane_ends_where_it_leads_off(network):
    file = network(
        edge("a", lanes=3),
        edge("b", lanes=3, x=(100.0, 250.0)),
        leads_on("a", "b", [0, 1, 2]),
        leads_on("b", "a", [1, 2]),
    )
    assert dict(zip(course(file), (edge.leads_on_m for edge in road.load(file).edges), strict=True)) == {
        "a": (150.0, math.inf, math.inf),
        "b": (0.0, math.inf, math.inf),
    }


# Where lanes go on side by side beyond their edge.


@pytest.fixture
def cut(tmp_path):
    """A road of 100, 50 and 200 m, or another, with replacements in its network's text."""

    def load(*replacements, lengths_m=(100, 50, 200), **arguments):
        path = tmp_path / "cut.net.xml"
        text = cut_road(*lengths_m, **arguments)
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text)
        return road.load(str(path))

    return load


@pytest.mark.parametrize("inside_m", [0.0, 0.1, 8.0])
def test_over_a_joint_lanes_go_on_side_by_side_to_the_end_of_the_course(cut, inside_m):
    first, second, third = cut(inside_m=inside_m).edges
    whole, half = 50 + 200 + 2 * inside_m, 200 + inside_m
    assert first.left_goes_on_m == pytest.approx((whole, whole, 0.0))
    assert first.right_goes_on_m == pytest.approx((0.0, whole, whole))
    assert (second.left_goes_on_m, second.right_goes_on_m) == (
        pytest.approx((half, half, 0.0)),
        pytest.approx((0.0, half, half)),
    )
    assert third.left_goes_on_m == third.right_goes_on_m == (0.0, 0.0, 0.0)


def test_round_a_loop_lanes_go_on_side_by_side_for_ever():
    for part in road.load("ring5").edges:
        assert part.left_goes_on_m == (math.inf,) * 4 + (0.0,)
        assert part.right_goes_on_m == (0.0,) + (math.inf,) * 4


FIRST = 'part1" fromLane="{0}" toLane="{0}" via=":cut0_0_{0}" dir="s" state="M"'
"""The connection from a lane at the first joint."""


@pytest.mark.parametrize(
    ("old", "new", "left", "right"),
    [
        # Lane 2 meets somebody, at both joints.
        ('index="2" response="000" foes="000"', 'index="2" response="000" foes="100"', (1, 0, 0), (0, 1, 0)),
        (FIRST.format(2), FIRST.format(2).replace('dir="s"', 'dir="r"'), (1, 0, 0), (0, 1, 0)),
        (FIRST.format(0), FIRST.format(0).replace('state="M"', 'state="m"'), (0, 0, 0), (0, 0, 0)),
        (FIRST.format(0), FIRST.format(0).replace("via", 'tl="cut0" linkIndex="0" via'), (0, 0, 0), (0, 0, 0)),
        # Lines, within the junction and on the edge behind it, that are crossed one way only.
        ('id=":cut0_0_0"', 'id=":cut0_0_0" changeLeft="bus"', (0, 1, 0), (0, 1, 1)),
        ('id="part1_2"', 'id="part1_2" changeRight="bus"', (1, 1, 0), (0, 1, 0)),
        # A lane that is wider behind the joint, and one that leads to two.
        ('id="part1_2" index="2" speed="36.11" length="50.00" width="3.2"', "WIDE", (1, 0, 0), (0, 1, 0)),
    ],
)
def test_what_parts_lanes_at_a_joint(cut, old, new, left, right):
    wide = 'id="part1_2" index="2" speed="36.11" length="50.00" width="3.5"'
    first = cut((old, wide if new == "WIDE" else new), inside_m=8.0).edges[0]
    assert [bool(metres) for metres in first.left_goes_on_m] == list(map(bool, left))
    assert [bool(metres) for metres in first.right_goes_on_m] == list(map(bool, right))


def test_a_lane_that_leads_to_two_goes_on_beside_neither(cut):
    """The middle lane leads to the right one as well, so that it is open to where the host drives on."""
    more = '<connection from="part0" to="part1" fromLane="1" toLane="0" dir="s" state="M"/></net>'
    first = cut(("</net>", more)).edges[0]
    assert first.left_goes_on_m == first.right_goes_on_m == (0.0, 0.0, 0.0)


def test_lanes_may_go_on_under_other_numbers(network):
    requests = "".join(f'<request index="{k}" response="00" foes="00"/>' for k in (0, 1))
    joint = f'<junction id="a+" type="priority" x="0" y="0" incLanes="a_0 a_1" intLanes="" shape="0,0">{requests}'
    ways = leads_on("a", "b", [0, 1], to=[1, 2])
    first, second = road.load(
        network(edge("a"), edge("b", lanes=3, x=(100.0, 250.0)), ways, f"{joint}</junction>")
    ).edges
    assert (first.left_goes_on_m, first.right_goes_on_m) == ((150.0, 0.0), (0.0, 150.0))
    assert second.left_goes_on_m == (0.0, 0.0, 0.0)


def test_where_lanes_go_on_side_by_side_the_inside_of_a_junction_is_told_as_an_edge(cut):
    one_way = ('id="part1_2"', 'id="part1_2" changeRight="bus"')
    slow = cut(one_way, inside_m=8.0)
    assert set(slow.joints) == {":cut0_0", ":cut1_0"}
    inside = slow.joints[":cut0_0"]
    assert (inside.length_m, inside.limit_mps, inside.lane_widths_m) == (8.0, 36.11, (3.2, 3.2, 3.2))
    assert (inside.to_left_m, inside.to_right_m) == ((3.2, 3.2, 0.0), (0.0, 3.2, 0.0))  # as on the edge behind it
    assert inside.left_goes_on_m == (258.0, 258.0, 0.0)
    assert inside.right_goes_on_m == (0.0, 258.0, 0.0)
    assert inside.limits_ahead == (((0.0, 36.11), (50.0, 36.11), (58.0, 36.11)),) * 3
    assert set(inside.leads_on_m) == {math.inf}
    assert not cut().joints


def test_a_limit_within_a_junction_is_that_of_the_lane_that_leads_there(cut):
    inside = 'id=":cut0_0_2" index="2" speed="36.11"'
    bend = cut((inside, inside.replace("36.11", "7.00")), inside_m=8.0)
    here = bend.edges[0]
    assert [limits[0] for limits in here.limits_ahead] == [(0.0, 36.11), (0.0, 36.11), (0.0, 7.0)]
    assert [limits[1:] for limits in here.limits_ahead] == [here.limits_ahead[0][1:]] * 3


def test_each_lane_tells_the_lanes_it_leads_to_and_those_before_it(cut):
    chain = cut(inside_m=8.0, lengths_m=(100, 50), lanes=1)
    assert chain.next_lanes == {"part0_0": (":cut0_0_0",), ":cut0_0_0": ("part1_0",)}
    assert chain.lanes_before == {":cut0_0_0": ("part0_0",), "part1_0": (":cut0_0_0",)}
    assert cut(lengths_m=(100, 50), lanes=1).next_lanes == {"part0_0": ("part1_0",)}


def test_lanes_closed_to_cars_belong_to_the_verge(network):
    beside_a_pavement = road.load(network(edge("a", lanes=4, closed=(0,)))).edges[0]
    assert (beside_a_pavement.first_lane, beside_a_pavement.n_lanes) == (1, 3)
    split = road.load(network(edge("a", lanes=6, closed=(1,)))).edges[0]
    assert (split.first_lane, split.n_lanes) == (2, 4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"^network 'bad\.net\.xml' is not a complete XML file: no element found in line 1$"),
        ("once upon a time", "is not a complete XML file: syntax error in line 1$"),
        ('<net version="1.20"><edge id="a">', "is not a complete XML file: no element found"),
        ("<routes/>", r"has no edges; rail-sumo reads SUMO's \.net\.xml, and by --network a \.sumocfg$"),
        ('<net version="1.20"/>', "has no edges"),
        ("<net/>", r"is not a SUMO network: .*version"),
        ('<net version="1.20"><edge id="a" from="x" to="y"><lane/></edge></net>', "is not a SUMO network: KeyError"),
    ],
)
def test_what_is_not_a_network_is_refused_in_one_line(tmp_path, content, message):
    bad = tmp_path / "bad.net.xml"
    bad.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        road.load(str(bad))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.999])
def test_a_truncated_network_is_refused_plain_and_compressed(tmp_path, share):
    whole = assets.network("ring5").read_bytes()
    plain, packed = tmp_path / "cut.net.xml", tmp_path / "cut.net.xml.gz"
    plain.write_bytes(whole[: int(share * len(whole))])
    compressed = gzip.compress(whole)
    packed.write_bytes(compressed[: int(share * len(compressed))])
    for path in (plain, packed):
        with pytest.raises(InputError, match="is not a complete XML file"):
            road.load(str(path))


def test_a_compressed_network_is_the_network(tmp_path):
    packed = tmp_path / "ring5.net.xml.gz"
    packed.write_bytes(gzip.compress(assets.network("ring5").read_bytes()))
    ring = road.load(str(packed))
    assert ring.name == "ring5"
    assert np.array_equal(ring.boundaries, road.load("ring5").boundaries)


def test_rubbish_in_a_compressed_file_is_refused(tmp_path):
    packed = tmp_path / "x.net.xml.gz"
    packed.write_bytes(b"no gzip")
    with pytest.raises(InputError, match="is not a complete XML file: syntax error"):
        road.load(str(packed))
    whole = bytearray(gzip.compress(assets.network("ring5").read_bytes()))
    whole[200:260] = bytes(60)
    packed.write_bytes(whole)
    with pytest.raises(InputError, match="is not a complete XML file"):
        road.load(str(packed))


def test_a_road_is_read_once_and_cannot_be_changed():
    highway = road.load("highway5")
    assert road.load("highway5") is highway
    with pytest.raises(ValueError, match="read-only"):
        highway.boundaries[0, 0] = 1.0


def test_the_shipped_networks_pass_their_check_without_a_warning():
    assert not [told for name in assets.network_names() for told in road.warnings(road.load(name))]


def test_it_warns_where_nobody_can_change_lanes(network):
    (told,) = road.warnings(road.load(network(edge("a", lanes=1))))
    assert told.startswith("every edge has one lane: nobody can change lanes or overtake")


def test_it_warns_of_narrow_lanes(network):
    (narrow,) = road.warnings(road.load(network(edge("b", lanes=2, width=2.3))))
    assert "edge 'b' has a lane of 2.30 m" in narrow


def test_a_road_driven_on_the_left_has_the_borders_of_its_mirror_image(network, tmp_path):
    left, right = tmp_path / "left.net.xml", Path(network(edge("a", lanes=3)))
    text = right.read_text()
    for k in range(3):  # the kerb is on the left
        text = text.replace(f'shape="0.0,{k * 3.2} 100.0,{k * 3.2}"', f'shape="0.0,{-k * 3.2} 100.0,{-k * 3.2}"')
    left.write_text(text.replace("<net ", '<net lefthand="true" '))
    mirrored, plain = road.load(str(left)), road.load(str(right))
    assert (mirrored.is_left_hand, plain.is_left_hand) == (True, False)
    assert mirrored.boundaries == pytest.approx(plain.boundaries)


@given(
    st.lists(st.tuples(st.floats(1.0, 50.0), st.floats(-1.5, 1.5)), min_size=1, max_size=8),
    st.floats(-5.0, 5.0),
)
def test_moving_a_line_sideways_mirrors_with_it_and_keeps_its_distance(legs, leftwards_m):
    lengths, turns = np.array(legs).T
    headings = np.cumsum(turns)
    steps = lengths[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    line = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    moved = borders.offset(line, leftwards_m)
    mirror = np.array([1.0, -1.0])
    assert borders.offset(line * mirror, -leftwards_m) == pytest.approx(moved * mirror)
    # Each moved corner lies at the offset from both of the lines that meet there.
    left = np.column_stack([-np.sin(headings), np.cos(headings)])
    for points in (moved[:-1] - line[:-1], moved[1:] - line[1:]):
        assert (points * left).sum(axis=1) == pytest.approx(leftwards_m)


def test_a_line_that_stands_still_has_no_side():
    assert borders.offset(np.array([[3.0, 4.0], [3.0, 4.0]]), 1.6).tolist() == [[3.0, 4.0]]


# Lanes that are closed for a time.


@pytest.mark.parametrize("inside_m", [0.0, 20.0])
def test_a_lane_that_is_closed_leads_nowhere_and_may_be_left_but_not_entered(tmp_path, inside_m):
    file = tmp_path / "three.net.xml"
    file.write_text(cut_road(600.0, 400.0, 600.0, inside_m=inside_m))
    course, half = ("part0", "part1", "part2"), pytest.approx(3.2)
    as_built = road.load(str(file), course)
    works = road.load(str(file), course, closed=frozenset({"part1_1", "part2_0"}))
    assert works.boundaries == pytest.approx(as_built.boundaries), "it is no guard rail"
    first, second, third = works.edges
    assert first.leads_on_m == (400.0, 0.0, math.inf)
    assert second.leads_on_m == (0.0, 0.0, math.inf)
    assert second.to_left_m == (0.0, half, 0.0)
    assert second.to_right_m == (0.0, half, 0.0)
    assert third.to_left_m == (half, half, 0.0)
    assert third.to_right_m == (0.0, 0.0, half)
    assert first.left_goes_on_m[0] == first.right_goes_on_m[1] == 0.0, "side by side no longer"
    assert "part1_1" not in {ahead for lanes in works.next_lanes.values() for ahead in lanes}
    assert {edge.leads_on_m for edge in as_built.edges} == {(math.inf,) * 3}


def test_a_course_all_of_whose_lanes_are_closed_ends_before_them(tmp_path):
    file = tmp_path / "three.net.xml"
    file.write_text(cut_road(600.0, 400.0))
    works = road.load(str(file), ("part0", "part1"), closed=frozenset({f"part1_{k}" for k in range(3)}))
    assert works.edges[0].leads_on_m == (0.0, 0.0, 0.0)


# Edges that are not drawn to scale.


@pytest.mark.parametrize(("says_m", "is_told"), [("34.00", False), ("50.00", True), ("12.00", True)])
def test_short_edges_are_told_of_where_they_are_far_off_and_all_by_name(tmp_path, says_m, is_told):
    file = tmp_path / "three.net.xml"
    file.write_text(cut_road(600.0, 30.0, 30.0).replace('length="30.00"', f'length="{says_m}"'))
    told = list(road.misdrawn(str(file)))
    assert len(told) == is_told
    for line in told:
        assert "long and drawn 30 m (and so are 'part2'): vehicles" in line


@pytest.mark.parametrize(
    ("says_m", "is_told"), [("400.00", False), ("480.00", False), ("640.00", True), ("90.00", True)]
)
def test_an_edge_that_is_drawn_much_longer_or_shorter_than_it_is_is_told_of(tmp_path, says_m, is_told):
    file = tmp_path / "three.net.xml"
    file.write_text(cut_road(600.0, 400.0).replace('length="400.00"', f'length="{says_m}"'))
    told = list(road.misdrawn(str(file)))
    assert len(told) == is_told
    for line in told:
        assert line.startswith(
            f"edge 'part1' is {float(says_m):.0f} m long and drawn 400 m: vehicles move by the length"
        )
    assert [line in road.warnings(road.load(str(file))) for line in told] == [True] * is_told
