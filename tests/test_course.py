import math
import sys

import numpy as np
import pytest
from sketch import edge, leads_on

from rail_sumo.errors import InputError
from rail_sumo.highway.network import road


def course(file, *wanted):
    return [edge.id for edge in road.load(file, wanted).edges]


def test_straight_on_is_preferred_to_more_lanes_round_the_corner(network):
    file = network(
        edge("main", lanes=3),
        edge("exit", y=-20.0, lanes=2, x=(0.0, 900.0)),
        edge("on", lanes=2, x=(100.0, 200.0)),
        leads_on("main", "exit", [0, 1], direction="r"),
        leads_on("main", "on", [2], to=[1]),
    )
    assert course(file) == ["exit"]  # 900 m alone beats main and on, 200 m
    file = network(
        edge("main", lanes=3, x=(0.0, 1000.0)),
        edge("exit", y=-20.0, lanes=2, x=(0.0, 900.0)),
        edge("on", lanes=2, x=(1000.0, 1100.0)),
        leads_on("main", "exit", [0, 1], direction="r"),
        leads_on("main", "on", [2], to=[1]),
    )
    assert course(file) == ["main", "on"]


def test_among_ways_straight_on_the_one_with_most_lanes_is_the_course(network):
    file = network(
        edge("a", lanes=5),
        edge("b", lanes=2, x=(100.0, 200.0)),
        edge("c", lanes=3, x=(100.0, 200.0)),
        leads_on("a", "b", [0, 1]),
        leads_on("a", "c", [2, 3, 4], to=[0, 1, 2]),
    )
    chosen = road.load(file)
    assert [edge.id for edge in chosen.edges] == ["a", "c"]
    assert chosen.edges[0].leads_on_m == (0.0, 0.0, math.inf, math.inf, math.inf)


@pytest.mark.parametrize("access", ['allow="bus"', 'disallow="passenger"'])
def test_where_a_connection_is_closed_to_cars_the_course_goes_round(network, access):
    bus_only = leads_on("a", "b", [0, 1], access=access)
    file = network(edge("a"), edge("b", x=(200.0, 300.0)), edge("c", x=(100.0, 200.0)), bus_only)
    assert len(course(file)) == 1
    with pytest.raises(InputError, match="no way for cars leads from edge 'a' to edge 'b'"):
        course(file, "a", "b")
    detour = leads_on("a", "c", [0, 1]) + leads_on("c", "b", [0, 1])
    file = network(edge("a"), edge("b", x=(200.0, 300.0)), edge("c", x=(100.0, 200.0)), bus_only, detour)
    assert course(file, "a", "b") == course(file) == ["a", "c", "b"]
    half = leads_on("a", "b", [0]) + leads_on("a", "b", [1], access=access)
    file = network(edge("a"), edge("b", x=(100.0, 200.0)), half)
    assert road.load(file).edges[0].leads_on_m == (math.inf, 0.0)


def test_equal_chains_are_told_apart_by_id(network):
    assert course(network(edge("z"), edge("k"), edge("q"))) == ["k"]


def test_a_loop_starts_at_its_first_id_though_rounded_sums_differ_with_the_start(network):
    # In floating point 0.2 + 0.3 + 0.1, from b on, is less than 0.1 + 0.2 + 0.3 and 0.3 + 0.1 + 0.2.
    edges = [edge("d", x=(0.0, 0.1)), edge("b", x=(0.0, 0.2)), edge("c", x=(0.0, 0.3))]
    ways = ("db", "bc", "cd")
    assert course(network(*edges, *(leads_on(*way, [0, 1]) for way in ways))) == ["b", "c", "d"]


def test_a_loop_wins_over_a_longer_chain_that_runs_into_it(network):
    loop = leads_on("b", "c", [0, 1]) + leads_on("c", "b", [0, 1])
    file = network(edge("a"), edge("b"), edge("c"), leads_on("a", "b", [0, 1]), loop)
    chosen = road.load(file)
    assert [edge.id for edge in chosen.edges] == ["b", "c"]
    assert chosen.is_loop


def test_a_roundabout_at_the_end_does_not_take_the_highways_place(network):
    roundabout = leads_on("b", "c", [0, 1]) + leads_on("c", "b", [0, 1])
    short = {"x": (0.0, 20.0)}
    file = network(edge("a"), edge("b", **short), edge("c", **short), leads_on("a", "b", [0, 1]), roundabout)
    assert course(file) == ["a", "b", "c"]


@pytest.mark.parametrize("seed", range(12))
def test_no_way_straight_on_is_longer_wherever_it_begins(network, seed):
    rng = np.random.default_rng(seed)
    names = "abcdefg"
    length = dict(zip(names, rng.integers(1, 5, len(names)) * 100.0, strict=True))
    ahead = dict(zip(names, rng.choice([*names, ""], len(names)), strict=True))
    ways = []  # a loop twice as long as it is, and what leads into one only to where it closes
    for first in names:
        way, at = [], first
        while at and at not in way:
            way.append(at)
            at = ahead[at]
        ways.append((-sum(map(length.get, way)) * (2 if at == first else 1), way, at == first))
    _, way, is_loop = min(ways)
    joints = [leads_on(here, there, [0, 1]) for here, there in ahead.items() if there]
    file = network(*(edge(name, x=(0.0, length[name])) for name in names), *joints)
    assert (course(file), road.load(file).is_loop) == (way, is_loop)


def test_turning_back_is_no_way_to_lengthen_the_course(network):
    file = network(edge("there"), edge("back"), leads_on("there", "back", [0, 1], direction="t"))
    assert course(file) == ["back"]


@pytest.mark.parametrize("way", ["out of it", "into it"])
def test_a_connection_of_a_closed_lane_leads_nobody_on(network, way):
    closed = {"out of it": [(0,), ()], "into it": [(), (0,)]}[way]
    edges = [
        edge(name, lanes=3, x=x, closed=c) for name, x, c in zip("ab", [(0, 100), (100, 200)], closed, strict=True)
    ]
    course = road.load(network(*edges, leads_on("a", "b", [0, 1, 2])))
    assert [edge.id for edge in course.edges] == ["a", "b"]
    out_of_open_lanes = {"out of it": (math.inf, math.inf), "into it": (0.0, math.inf, math.inf)}[way]
    assert course.edges[0].leads_on_m == out_of_open_lanes


def test_where_no_lane_is_open_to_cars_there_is_no_course(network):
    with pytest.raises(
        InputError,
        match=r"^network 'own0\.net\.xml' has no edge that is open to cars; rail-sumo drives a passenger car$",
    ):
        road.load(network(edge("a", lanes=2, closed=(0, 1))))


def test_one_open_lane_is_a_course_with_nothing_beside_it(network):
    (only,) = road.load(network(edge("a", lanes=2, closed=(1,)))).edges
    assert (only.n_lanes, only.to_left_m, only.to_right_m) == (1, (0.0,), (0.0,))


def test_a_way_on_several_lanes_goes_before_a_longer_one_on_one_and_takes_in_what_leads_to_it(network):
    edges = [edge("a", lanes=1), edge("b", x=(100.0, 200.0)), edge("c", lanes=1, x=(0.0, 900.0))]
    assert course(network(*edges, leads_on("a", "b", [0]))) == ["a", "b"]


def test_a_very_long_chain_is_chosen_without_recursion(network):
    n = 2 * sys.getrecursionlimit()
    edges = [edge(f"e{k:05d}") for k in range(n)]
    joints = [leads_on(f"e{k:05d}", f"e{k + 1:05d}", [0, 1]) for k in range(n - 1)]
    assert len(course(network(*edges, *joints))) == n


@pytest.fixture
def fork(network):
    """From a over b or, longer, over c to d; e leads on from d, and back to a; f has one lane."""
    ways = ("ab", "bd", "ac", "cd", "de", "ea", "af", "fd")
    lengths = {"a": 100.0, "b": 100.0, "c": 300.0, "d": 100.0, "e": 100.0, "f": 400.0}
    edges = [edge(name, x=(0.0, length), lanes=1 if name == "f" else 2) for name, length in lengths.items()]
    return network(*edges, *(leads_on(*way, [0] if "f" in way else [0, 1]) for way in ways))


@pytest.mark.parametrize(
    ("wanted", "edges"),
    [
        ("b", "b"),
        ("ab", "ab"),
        ("ad", "abd"),
        ("acd", "acd"),
        ("ce", "cde"),
        ("db", "deab"),
        ("afd", "afd"),
    ],
)
def test_the_course_leads_over_the_edges_wanted_and_the_shortest_way_between(fork, wanted, edges):
    assert course(fork, *wanted) == list(edges)
    assert not road.load(fork, tuple(wanted)).is_loop


@pytest.mark.parametrize(("wanted", "edges"), [("ada", "abde"), ("dcd", "deac"), ("aca", "acde"), ("aa", "abde")])
def test_with_the_first_edge_again_at_the_end_it_goes_round(fork, wanted, edges):
    assert course(fork, *wanted) == list(edges)
    assert road.load(fork, tuple(wanted)).is_loop


def test_one_edge_that_leads_into_itself_is_a_loop(network):
    assert road.load(network(edge("a"), leads_on("a", "a", [0, 1])), ("a", "a")).is_loop


def test_without_any_wanted_it_is_the_longest_way_as_ever(fork):
    assert set(course(fork)) in ({"a", "b", "d", "e"}, {"a", "c", "d", "e"})


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (["a", "x"], r"has no edge 'x', which network\.course names \(available: a, b, c, d, e, f\)$"),
        (["a", "d", "b"], r"the course runs twice over edge 'a'; lead network\.course so that it does not, or name "),
    ],
)
def test_a_course_that_cannot_be_is_refused_in_one_line(fork, wanted, message):
    with pytest.raises(InputError, match=r"^network 'own0\.net\.xml'(:)? " + message):
        road.load(fork, tuple(wanted))


def test_no_way_from_one_edge_to_the_next_is_told(network):
    file = network(edge("a"), edge("b"), edge("c"), leads_on("a", "b", [0, 1]))
    for wanted, pair in ((("b", "a"), "'b' to edge 'a'"), (("a", "b", "c"), "'b' to edge 'c'"), (("a", "a"), "'a' to")):
        with pytest.raises(InputError, match=f"no way for cars leads from edge {pair}"):
            road.load(file, wanted)


def test_of_many_edges_a_message_tells_some(network):
    with pytest.raises(InputError, match=r"names; did you mean 'e10'\? \(available: e10, .*, e29, and 4 more\)$"):
        road.load(network(*(edge(f"e{k}") for k in range(10, 34))), ("e100",))
