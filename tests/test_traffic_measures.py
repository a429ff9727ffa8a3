"""The measures of a run: on reports that are made up, and beside SUMO's own of the same run."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pandas as pd
import pytest
from driving import UNSEEN

from rail_sumo import config_file
from rail_sumo.highway.traffic.fleet import Fleet
from rail_sumo.records import Lane
from rail_sumo.tables import traffic
from rail_sumo.tables.traffic import Reports, Run, Vehicle

LIMIT_MPS = 20.0
LANES = {
    "a_0": Lane(1000.0, LIMIT_MPS, has_priority=True),
    "a_1": Lane(1000.0, LIMIT_MPS),
    "b_0": Lane(500.0, LIMIT_MPS),
}


def written(
    folder,
    samples,
    *,
    trips="",
    changes="",
    collisions="",
    vehicles=None,
    until_s=10.0,
    edges=frozenset("a"),
    teleported=(),
):
    """Reports as SUMO writes them; samples are (time, vehicle, speed, lane, leader's gap, leader's speed).

    Each vehicle begins at the beginning of its lane, and drives on from sample to sample.
    """
    columns = ["time", "id", "speed", "lane", "leaderGap", "leaderSpeed"]
    frame = pd.DataFrame(samples, columns=columns)
    frame["pos"] = 0.5 * (frame.groupby("id")["speed"].cumsum() - frame["speed"])
    frame = frame.rename(columns={"time": "timestep_time"} | {
        name: f"vehicle_{name}" for name in [*columns[1:], "pos"]
    })  # fmt: skip
    frame.to_csv(folder / "fcd.csv", sep=";", index=False)
    for name, rows in (("trips", trips), ("changes", changes), ("collisions", collisions)):
        (folder / f"{name}.xml").write_text(f"<all>{rows}</all>")
    names = {name for _, name, *_ in samples}
    vehicles = {name: Vehicle("car", 1.0, 50.0) for name in names} | (vehicles or {})
    return Reports(Run(folder, 0.0, until_s, vehicles, LANES, edges, tuple(teleported)))


def drives(name, speeds, lane="a_0", *, gaps=None, leaders=None, from_s=0.0):
    gaps, leaders = gaps or [-1.0] * len(speeds), leaders or [-1.0] * len(speeds)
    return [
        (from_s + 0.5 * k, name, *row)
        for k, row in enumerate(zip(speeds, [lane] * len(speeds), gaps, leaders, strict=True))
    ]


def of(reports, *driven):
    return {row.pop("vehicles"): row for row in reports.measures(set(driven))}


def test_flow_density_and_speed_are_edies(tmp_path):
    # 10 m/s and 20 m/s for 10 s each, on 1,000 m with two lanes: 300 m and 20 s.
    told = of(written(tmp_path, drives("slow", [10.0] * 20) + drives("fast", [20.0] * 20, "a_1")), "fast")
    assert told["all"]["vehkm"] == pytest.approx(0.3)
    assert told["all"]["flow_vehph"] == pytest.approx(3600 * 300 / (1000 * 10))
    assert told["all"]["density_vehpkm_lane"] == pytest.approx(1000 * 20 / (2000 * 10))
    assert told["all"]["speed_kmh"] == pytest.approx(54.0)
    assert (told["driven"]["speed_kmh"], told["others"]["speed_kmh"]) == pytest.approx((72.0, 36.0))
    assert told["driven"]["flow_vehph"] + told["others"]["flow_vehph"] == pytest.approx(told["all"]["flow_vehph"])
    assert [told[kind]["n_vehicles"] for kind in ("all", "driven", "others")] == [2, 1, 1]


def test_flow_and_density_are_of_the_edges_named_whether_anybody_gets_there_or_not(tmp_path):
    samples = (
        drives("one", [10.0] * 20) + drives("aside", [10.0] * 10, ":j_0") + drives("late", [10.0] * 4, from_s=10.0)
    )
    for edges, road_m, lanes_m in (("a", 1000, 2000), ("ab", 1500, 2500)):
        told = of(written(tmp_path, samples, edges=frozenset(edges)))["all"]
        assert told["flow_vehph"] == pytest.approx(3600 * 100 / (road_m * 10))
        assert told["density_vehpkm_lane"] == pytest.approx(1000 * 10 / (lanes_m * 10))
        assert told["vehkm"] == pytest.approx(0.15)  # of everywhere


def test_a_vehicle_loses_time_to_what_it_is_meant_to_drive(tmp_path):
    samples = drives("eager", [20.0] * 20) + drives("calm", [10.0] * 20) + drives("lorry", [20.0] * 20)
    vehicles = {
        "eager": Vehicle("car", 1.2, 50.0),
        "calm": Vehicle("car", 0.5, 50.0),
        "lorry": Vehicle("lorry", 1.5, 25.0),
    }
    told = of(written(tmp_path, samples, vehicles=vehicles), "calm")
    assert told["driven"]["time_loss_s_per_km"] == 0.0
    lost_s = 10 * (1 - 20 / 24) + 10 * (1 - 20 / 25)
    assert told["others"]["time_loss_s_per_km"] == pytest.approx(lost_s / 0.4)


def test_speeds_vary_about_each_vehicles_own_mean(tmp_path):
    samples = drives("steady", [30.0] * 20) + drives("swings", [8.0, 12.0] * 10)
    told = of(written(tmp_path, samples), "swings")
    assert told["driven"]["speed_std_kmh"] == pytest.approx(2.0 * 3.6)
    assert told["all"]["speed_std_kmh"] == pytest.approx(np.sqrt(2.0) * 3.6)


def test_what_a_place_asks_of_everybody_is_no_variation_at_that_place(tmp_path):
    entry = [10.0, 20.0, 30.0, 40.0, 40.0]  # everybody speeds up there, at 0, 5, 15, 30 and 50 m
    alike = [row for k in range(3) for row in drives(f"car{k}", entry, from_s=10.0 * k)]
    told = of(written(tmp_path, alike, until_s=100.0))["all"]
    assert told["speed_std_kmh"] == pytest.approx(np.std(entry) * 3.6)
    # The first three samples lie on the first 20 m, where the mean is 20 m/s: 10 less, as much, 10 more.
    assert told["speed_std_at_place_kmh"] == pytest.approx(np.sqrt(200 / 5) * 3.6)


def test_who_is_faster_than_others_everywhere_does_not_vary_at_a_place_and_who_meets_a_wave_does(tmp_path):
    steady = drives("slow", [20.0] * 8) + drives("fast", [40.0] * 4)  # both over the same four times 20 m
    reports = written(tmp_path, steady + drives("other", [20.0] * 8, from_s=5.0), until_s=100.0)
    assert of(reports)["all"]["speed_std_at_place_kmh"] == pytest.approx(0.0)
    (tmp_path / "wave").mkdir()
    meets = drives("slow", [20.0] * 8) + drives("meets", [20.0] * 4 + [10.0] * 4 + [20.0] * 2, from_s=5.0)
    told = of(written(tmp_path / "wave", meets, until_s=100.0), "meets")
    # At 40 m, where one of them drives 20 m/s twice and the other 10 four times, the mean is 13.3 m/s.
    theirs, wave = (
        np.array([0.0] * 4 + [20 - 40 / 3] * 2 + [0.0] * 2),
        np.array([0.0] * 4 + [10 - 40 / 3] * 4 + [0.0] * 2),
    )
    assert told["driven"]["speed_std_at_place_kmh"] == pytest.approx(np.std(wave) * 3.6)
    assert told["others"]["speed_std_at_place_kmh"] == pytest.approx(np.std(theirs) * 3.6)


@pytest.mark.parametrize(
    ("speeds", "count"),
    [
        ([20.0, 18.3, 18.3], 0),  # 3.4 m/s²
        ([20.0, 18.2, 18.2], 1),  # 3.6
        ([20.0, 18.2, 16.4, 15.4, 13.0, 13.0], 1),  # it eases to 2, not to an end
        ([20.0, 18.2, 18.2, 16.4], 2),
    ],
)
def test_a_hard_braking_counts_once_until_it_is_over(tmp_path, speeds, count):
    km = sum(speeds) * 0.5 / 1000
    samples = drives("one", speeds) + drives("two", [5.0, 1.0][:1], from_s=0.0)  # who begins slowly has not braked
    told = of(written(tmp_path, samples), "one")
    assert told["driven"]["hard_brakings_per_vehkm"] == pytest.approx(count / km)
    assert told["others"]["hard_brakings_per_vehkm"] == 0.0


def test_a_conflict_counts_when_it_begins(tmp_path):
    # Closing by 10 m/s: 1.4 s to the contact at 14 m; 3.57 m/s² to avoid it. At 16 m 1.6 s and 3.1 m/s².
    gaps, n = [16.0, 14.0, 12.0, 16.0, 14.0, -1.0], 6
    told = of(written(tmp_path, drives("one", [20.0] * n, gaps=gaps, leaders=[10.0] * n)))["all"]
    assert told["ttc_below_1_5s_per_vehkm"] == pytest.approx(2 / 0.06)
    assert told["drac_above_3_4_per_vehkm"] == pytest.approx(2 / 0.06)
    (tmp_path / "away").mkdir()
    away = of(written(tmp_path / "away", drives("one", [10.0] * n, gaps=[3.0] * n, leaders=[10.0] * n)))["all"]
    assert (away["ttc_below_1_5s_per_vehkm"], away["drac_above_3_4_per_vehkm"]) == (0.0, 0.0)


def trip(name, depart, delay, arrival, metres=1000.0, co2_mg=0.0, fuel_mg=0.0):
    return (
        f'<tripinfo id="{name}" depart="{depart}" departDelay="{delay}" arrival="{arrival}" routeLength="{metres}">'
        f'<emissions CO2_abs="{co2_mg}" fuel_abs="{fuel_mg}"/></tripinfo>'
    )


def test_who_comes_goes_and_waits(tmp_path):
    trips = (
        trip("gone", 1.0, 0.5, 9.0, 2000.0, 300_000.0, 148_400.0)
        + trip("here", 4.0, 1.5, -1.0, 1000.0, 150_000.0, 74_200.0)
        + trip("outside", -1, 4.0, -1.0, 0.0)
    )
    told = of(written(tmp_path, drives("gone", [10.0]) + drives("here", [10.0]), trips=trips), "gone")
    counts = ("inserted", "arrived", "unfinished", "waiting")
    assert [told["all"][name] for name in counts] == [2, 1, 1, 1]
    assert [told["driven"][name] for name in counts] == [1, 1, 0, 0]
    assert told["all"]["depart_delay_s"] == pytest.approx((0.5 + 1.5 + 4.0) / 3)
    assert told["all"]["travel_time_s"] == 9.0 - 1.0  # of the one that has arrived
    assert np.isnan(told["others"]["travel_time_s"])
    assert told["all"]["co2_g_per_vehkm"] == pytest.approx(450 / 3)
    assert told["all"]["fuel_ml_per_vehkm"] == pytest.approx(222.6 / 0.742 / 3)


def test_contacts_lane_changes_and_teleports_belong_to_who_takes_part(tmp_path):
    told = of(
        written(
            tmp_path,
            drives("one", [10.0] * 20) + drives("two", [10.0] * 20),
            changes='<change id="one" time="1"/><change id="one" time="2"/><change id="two" time="20"/>',
            collisions='<collision time="1" collider="two" victim="one"/>',
            teleported=[(3.0, "two"), (11.0, "two")],
        ),
        "one",
    )
    assert [told[kind]["collisions"] for kind in ("all", "driven", "others")] == [1, 1, 1]
    assert [told[kind]["teleports"] for kind in ("all", "driven", "others")] == [1, 0, 1]
    assert told["driven"]["lane_changes_per_vehkm"] == pytest.approx(20.0)
    assert told["others"]["lane_changes_per_vehkm"] == 0.0


@pytest.mark.parametrize(
    ("samples", "stuck"),
    [
        (drives("one", [0.0] * 59), 0),
        (drives("one", [0.0] * 60), 1),
        (drives("one", [0.0] * 200), 1),
        (drives("one", [0.0] * 60 + [1.0] + [0.0] * 60), 2),
        (drives("one", [0.0] * 40 + [1.0] + [0.0] * 40), 0),
        (drives("one", [0.0] * 40) + drives("one", [0.0] * 40, from_s=25.0), 0),  # it was away in between
        (drives("one", [0.0] * 40) + drives("two", [0.0] * 40), 0),
        (drives("one", [0.0] * 60, gaps=[16.0] * 60), 1),
        (drives("one", [0.0] * 60, gaps=[14.0] * 60), 0),  # in a queue
        (drives("one", [0.0] * 60, "a_1"), 0),  # where others come first
        (drives("one", [0.5] * 60), 0),
    ],
)
def test_who_stands_for_30_s_on_a_free_road_where_it_has_priority_is_stuck(tmp_path, samples, stuck):
    reports = written(tmp_path, samples, until_s=200.0)
    assert of(reports)["all"]["stuck"] == reports.edges(set())["stuck"].sum() == stuck


def test_a_contact_is_told_once_on_the_edge_where_it_happened_of_who_ran_into_the_other(tmp_path):
    one = drives("one", [10.0] * 4) + drives("one", [10.0] * 4, ":j_0", from_s=2.0)
    touch = '<collision time="{}" collider="{}" victim="{}" lane="{}"/>'.format
    reports = written(
        tmp_path,
        one + drives("two", [10.0] * 8) + drives("three", [10.0] * 8),
        collisions=touch(1, "two", "one", "a_1")
        + touch(2, "one", "two", ":j_0")
        + touch(3, "one", "three", ":j_0")
        + touch(3, "two", "three", "a_0")
        + touch(10, "one", "two", ":j_0"),  # after the period
    )
    told = reports.edges({"one"}).set_index(["vehicles", "edge"])["collisions"]
    assert told.to_dict() == {("driven", "a"): 0, ("driven", ":j"): 2, ("others", "a"): 2}
    whole = of(reports, "one")
    assert [whole[kind]["collisions"] for kind in ("all", "driven", "others")] == [4, 3, 4]


@pytest.mark.parametrize(
    ("samples", "stops"),
    [
        (drives("one", [1.0, 0.2, 0.0, 0.0, 0.2, 0.0]), 2),
        (drives("one", [0.0] * 9), 1),  # it stood when the period began
        (drives("one", [0.2] * 9), 0),
        (drives("one", [1.0, 0.0]) + drives("two", [0.0, 1.0]), 2),
    ],
)
def test_a_stop_is_where_a_vehicle_begins_to_stand(tmp_path, samples, stops):
    assert written(tmp_path, samples).edges(set())["stops"].sum() == stops


def test_sumo_counts_as_many_stops(tmp_path):
    reports, _ = driven_with_edge_data(tmp_path, "arterial")
    trips = ElementTree.parse(tmp_path / "trips.xml").getroot()
    theirs = sum(int(trip.get("waitingCount")) for trip in trips if float(trip.get("depart")) >= 0)
    assert theirs > 50
    assert reports.edges(set())["stops"].sum() == pytest.approx(theirs, rel=0.03)


def test_sumo_tells_where_nobody_need_wait():
    ends = {}
    for network in ("onramp", "arterial"):
        run = Fleet(
            config_file.validate({"network": {"file": network}, "traffic": {"routes": [network]}}), 0.0, UNSEEN, "sumo"
        )
        run.drive(1.0)
        ends |= {name: lane.has_priority for name, lane in run.lanes.items()}
    assert [ends[f"merge1_{k}"] for k in range(4)] == [False, True, True, True], "the acceleration lane leads nowhere"
    assert not ends["off_0"], "the road ends"
    assert not ends["east1_pocket_0"], "at a signal"


def test_an_edge_has_what_happened_on_it_by_type_and_by_whether_driven(tmp_path):
    one = drives("one", [20.0, 18.2, 18.2], "a_1") + drives("one", [18.2] * 2, "b_0", from_s=1.5)
    two = drives("two", [10.0] * 4, "a_0", gaps=[5.0] * 4, leaders=[5.0] * 4)
    reports = written(
        tmp_path,
        one + two + drives("three", [20.0] * 2),
        vehicles={"two": Vehicle("lorry", 1.0, 20.0)},
        changes='<change id="one" time="1" from="a_0"/><change id="one" time="99" from="a_0"/>',
    )
    told = reports.edges({"one"}).set_index(["vehicles", "type", "edge"])
    assert list(told.columns) == [*traffic.SUMS, "n_vehicles"]
    loss_s = 0.5 * (0 + 0.09 + 0.09)
    assert told.loc[("driven", "car", "a")].tolist() == pytest.approx([1.5, 0.0282, loss_s, 1, 1, 0, 0, 0, 0, 0, 1])
    assert told.loc[("driven", "car", "b")].tolist() == pytest.approx([1.0, 0.0182, 0.09, 0, 0, 0, 0, 0, 0, 0, 1])
    assert told.loc[("others", "lorry", "a")].tolist() == pytest.approx([2.0, 0.02, 1.0, 0, 0, 1, 0, 0, 0, 0, 1])
    assert told.loc[("others", "car", "a")].tolist() == pytest.approx([1.0, 0.02, 0, 0, 0, 0, 0, 0, 0, 0, 1])
    assert len(told) == 4


def driven_with_edge_data(folder, network):
    edges = folder / "edges.xml"
    world = config_file.validate({"network": {"file": network}, "traffic": {"routes": [network]}})
    driven = Fleet(world, 0.0, UNSEEN, "nothing", (*traffic.options(folder), "--edgedata-output", str(edges)))
    driven.drive(240.0)
    vehicles = {name: Vehicle(car.kind, car.speed_factor, car.fastest_mps) for name, car in driven.inserted.items()}
    reports = Reports(Run(folder, 0.0, 240.0, vehicles, driven.lanes, driven.edges))
    return reports, [edge.attrib for edge in ElementTree.parse(edges).getroot().iter("edge")]


@pytest.mark.parametrize("network", ["highway3", "onramp"])
def test_flow_density_time_loss_and_counts_are_those_of_sumos_own_outputs(tmp_path, network):
    reports, theirs = driven_with_edge_data(tmp_path, network)
    ours = of(reports)["all"]
    driven_s = sum(float(edge["sampledSeconds"]) for edge in theirs)
    driven_m = sum(float(edge["sampledSeconds"]) * float(edge["speed"]) for edge in theirs if "speed" in edge)
    lost_s = sum(float(edge["timeLoss"]) for edge in theirs)
    changes = sum(int(edge["laneChangedFrom"]) for edge in theirs)
    arrived = sum(int(edge["arrived"]) for edge in theirs)
    inserted = sum(int(edge["departed"]) for edge in theirs)
    assert ours["vehkm"] == pytest.approx(driven_m / 1000, rel=0.01)
    assert ours["speed_kmh"] == pytest.approx(3.6 * driven_m / driven_s, rel=0.005)
    assert ours["time_loss_s_per_km"] * ours["vehkm"] == pytest.approx(lost_s, rel=0.05)
    from_edges = [change.get("from") for change in ElementTree.parse(tmp_path / "changes.xml").getroot()]
    assert ours["lane_changes_per_vehkm"] * ours["vehkm"] == pytest.approx(len(from_edges))
    assert sum(not lane.startswith(":") for lane in from_edges) == changes
    assert (ours["arrived"], ours["inserted"]) == (arrived, inserted)
    trips = ElementTree.parse(tmp_path / "trips.xml").getroot()
    durations_s = [float(trip.get("duration")) for trip in trips if float(trip.get("arrival")) >= 0]
    mean_s = np.mean(durations_s) if durations_s else np.nan
    assert ours["travel_time_s"] == pytest.approx(mean_s, nan_ok=True)
    by_edge = reports.edges(set()).groupby("edge").sum(numeric_only=True)
    for edge in theirs:
        sampled_s = float(edge["sampledSeconds"])
        if sampled_s > 100.0:
            own = by_edge.loc[edge["id"]]
            assert own["vehicle_s"] == pytest.approx(sampled_s, rel=0.03)
            assert own["time_loss_s"] == pytest.approx(float(edge["timeLoss"]), rel=0.05, abs=0.01 * sampled_s)
            assert own["lane_changes"] == int(edge["laneChangedFrom"])


def test_edge_data_has_a_vehicle_on_two_edges_while_it_straddles_them(tmp_path):
    reports, theirs = driven_with_edge_data(tmp_path, "arterial")
    metres = [
        float(trip.get("routeLength"))
        for trip in ElementTree.parse(tmp_path / "trips.xml").getroot()
        if float(trip.get("depart")) >= 0
    ]
    assert of(reports)["all"]["vehkm"] == pytest.approx(sum(metres) / 1000, rel=0.002)
    ours = reports.edges(set()).groupby("edge")["vehkm"].sum()
    ours_m = 1000 * ours[~ours.index.str.startswith(":")].sum()
    theirs_m = sum(float(edge["sampledSeconds"]) * float(edge["speed"]) for edge in theirs if "speed" in edge)
    length_m = 0.6 * 4.5 + 0.14 * 3.7 + 0.13 * 6.0 + 0.06 * 12.0 + 0.07 * 16.5  # the mean of the demand's types
    # Of each vehicle that leaves an edge they have its own length more.
    assert theirs_m - ours_m == pytest.approx(length_m * sum(int(edge["left"]) for edge in theirs), rel=0.15)
