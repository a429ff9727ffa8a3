import numpy as np

from rail_sumo import config
from rail_sumo.highway.observation import Layout, bounds, feature_names
from rail_sumo.records import KMH

LIDAR = config.Lidar(n_rays=3)
EVERYTHING = config.Observation(host_speed=True, speed_limit=True, lateral_state=True, frames=3)


def observe(layout, number):
    """The scan, speed and offset of the look with this number: every value tells which it is."""
    return layout.observe(
        np.array((number + np.array([0.1, 0.2, 0.3]), -number - np.array([0.1, 0.2, 0.3]))),
        speed_mps=number + 0.5,
        limit_mps=number + 0.6,
        lateral_m=number + 0.7,
    )


def named(layout, number, observation=EVERYTHING):
    return dict(zip(feature_names(LIDAR, observation), observe(layout, number).tolist(), strict=True))


def test_the_default_is_24_distances_then_24_relative_speeds_each_by_its_ray():
    names = feature_names(config.Lidar(), config.Observation())
    assert names[:2] == ["distance_0_m", "distance_1_m"]
    assert names[23:25] == ["distance_23_m", "relative_speed_0_mps"]
    assert names[-1] == "relative_speed_23_mps"
    values = Layout(config.Lidar(), config.Observation()).observe(
        np.array((np.arange(24.0), -np.arange(24.0))), speed_mps=99.0, limit_mps=99.0, lateral_m=99.0
    )
    assert values.tolist() == [*range(24), *(-ray for ray in range(24))]


def test_every_value_stands_under_its_name():
    assert named(Layout(LIDAR, config.Observation(host_speed=True)), 4, config.Observation(host_speed=True)) == {
        "distance_0_m": 4.1,
        "distance_1_m": 4.2,
        "distance_2_m": 4.3,
        "relative_speed_0_mps": -4.1,
        "relative_speed_1_mps": -4.2,
        "relative_speed_2_mps": -4.3,
        "host_speed_mps": 4.5,
    }
    only_limit = config.Observation(speed_limit=True)
    assert named(Layout(LIDAR, only_limit), 4, only_limit)["speed_limit_mps"] == 4.6
    only_lateral = config.Observation(lateral_state=True)
    assert named(Layout(LIDAR, only_lateral), 4, only_lateral)["lateral_m"] == 4.7


def test_what_no_car_can_drive_is_no_limit_and_reads_as_200_kmh():
    only_limit = config.Observation(speed_limit=True)
    assert named(Layout(LIDAR, only_limit), 900, only_limit)["speed_limit_mps"] == 200 / KMH


def test_the_first_look_of_an_episode_fills_every_frame():
    first = named(Layout(LIDAR, EVERYTHING), 5)
    for age in ("", "_1_ago", "_2_ago"):
        assert (first[f"distance_1_m{age}"], first[f"host_speed_mps{age}"], first[f"lateral_m{age}"]) == (5.2, 5.5, 5.7)


def test_frames_age_one_look_at_a_time_and_the_oldest_is_dropped():
    layout = Layout(LIDAR, EVERYTHING)
    for number in range(10, 14):
        seen = named(layout, number)
    assert [seen[f"host_speed_mps{age}"] for age in ("", "_1_ago", "_2_ago")] == [13.5, 12.5, 11.5]
    assert [seen[f"relative_speed_2_mps{age}"] for age in ("", "_1_ago", "_2_ago")] == [-13.3, -12.3, -11.3]
    assert feature_names(LIDAR, EVERYTHING)[-1] == "lateral_m_2_ago"


def test_after_a_reset_nothing_of_the_last_episode_is_left():
    layout = Layout(LIDAR, EVERYTHING)
    observe(layout, 1)
    layout.reset()
    assert observe(layout, 2).tolist() == observe(Layout(LIDAR, EVERYTHING), 2).tolist()


def test_an_observation_handed_out_is_not_changed_by_the_next():
    layout = Layout(LIDAR, EVERYTHING)
    first = observe(layout, 1)
    kept = first.copy()
    observe(layout, 2)
    assert first.tolist() == kept.tolist()


def test_n_features_is_the_length_of_what_is_observed():
    for frames, host_speed in ((1, False), (1, True), (4, True)):
        observation = config.Observation(host_speed=host_speed, frames=frames)
        layout = Layout(LIDAR, observation)
        assert layout.n_features == len(observe(layout, 0)) == frames * (6 + host_speed)


def test_bounds_hold_distances_between_nothing_and_the_range_and_the_rest_within_200():
    low, high = (
        dict(zip(feature_names(LIDAR, EVERYTHING), bound.tolist(), strict=True)) for bound in bounds(LIDAR, EVERYTHING)
    )
    for name in low:
        expected = (0.0, LIDAR.max_range_m) if name.startswith("distance") else (-200.0, 200.0)
        assert (low[name], high[name]) == expected
