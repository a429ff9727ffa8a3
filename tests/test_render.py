"""What an episode looks like: the drawing against places computed by hand, and what researchers' tools do with it."""

import importlib.util
import math

import gymnasium
import numpy as np
import pytest
from driving import registered
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from matplotlib.colors import to_rgb
from stable_baselines3.common.env_checker import check_env as check_env_by_stable_baselines

import rail_sumo  # noqa: F401  registers the environment
from rail_sumo.errors import InputError
from rail_sumo.highway import drawing, window
from rail_sumo.highway.drawing import Moment, Picture, View
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import markings, road
from rail_sumo.records import Scene

ID = "RailSumo/Highway-v0"
BRIEF = {"episode": {"duration_s": 5.0}}
VIEW = View(behind_m=40.0, ahead_m=60.0, right_m=16.4, left_m=16.4)
PX_PER_M = 10.0


@pytest.fixture(autouse=True)
def without_a_screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def make():
    with registered(BRIEF) as make_one:
        yield make_one


# The drawing.


def moment(boxes, distances, *, network="highway5", **further):
    scene = Scene(0.0, [str(k) for k in range(len(boxes))], np.array(boxes, dtype=float).T.copy())
    course = road.load(network)
    return Moment(scene, np.array(distances, dtype=float), markings.of(course), course.boundaries, **further)


def drawn(one):
    picture = Picture(1000, VIEW, (0.0, 80.0))
    picture.draw(one, "title", "note")
    return picture.pixels()


def colour_at(pixels, ahead_m, left_m, middle_m=0.0):
    """The colour of a place ahead of the host and to its left, where the course's middle is so far to its left."""
    row = (VIEW.left_m + drawing.BAND_M - left_m + middle_m) * PX_PER_M
    return pixels[round(row), round((ahead_m + VIEW.behind_m) * PX_PER_M)] / 255.0


def is_colour(found, colour, within=0.02):
    return np.allclose(found, to_rgb(colour), atol=within)


AT_THE_MIDDLE = (1000.0, 0.0, 0.0, 20.0, 5.0, 1.8)
"""x, y, heading, speed, length and width of a host in the middle lane of highway5."""


def test_vehicles_the_road_and_the_ground_are_where_they_are():
    ahead, left = (1020.0, 3.2, 0.0, 0.0, 5.0, 1.8), (1000.0 - 24.0, 6.4, 0.0, 22.2, 5.0, 1.8)
    one = moment([AT_THE_MIDDLE, ahead, left], [100.0, 6.4, 100.0, 100.0])
    pixels = drawn(one)
    assert pixels.shape == (400, 1000, 3)
    assert one.middle_m == pytest.approx(0.0, abs=1e-9)
    assert is_colour(colour_at(pixels, -2.0, 0.6), drawing.HOST)
    assert is_colour(colour_at(pixels, 30.0, -2.2), drawing.ASPHALT)
    assert is_colour(colour_at(pixels, 30.0, 11.0), drawing.GROUND)
    assert is_colour(colour_at(pixels, 30.0, 8.0), drawing.BORDER)
    # Nobody is seen: the ray to the left ends 1.6 m beside a vehicle. So both have white bodies.
    assert list(one.seen) == [True, False, False]
    assert is_colour(colour_at(pixels, 18.3, 3.2 + 0.5), "white")
    assert is_colour(colour_at(pixels, -24.0 + 1.8, 6.4), "white")


def test_vehicles_that_a_ray_ends_on_are_filled_by_their_speed_and_the_ray_is_drawn_to_them():
    ahead, left = (1020.0, 0.0, 0.0, 0.0, 5.0, 1.8), (1000.0, 3.2, 0.0, 80.0 / 3.6, 5.0, 1.8)
    one = moment([AT_THE_MIDDLE, ahead, left], [17.5, 2.3, 100.0, 100.0])
    assert list(one.on_vehicle) == [True, True, False, False]
    assert list(one.seen) == [True, True, True]
    pixels = drawn(one)
    slow, fast = (Picture(1000, VIEW, (0.0, 80.0)).colour_of(kmh) for kmh in (0.0, 80.0))
    assert is_colour(colour_at(pixels, 18.3, 0.5), slow[:3])
    assert is_colour(colour_at(pixels, 1.8, 3.2), fast[:3])
    assert is_colour(colour_at(pixels, 10.0, 0.0), drawing.ON_VEHICLE, within=0.1)
    assert is_colour(colour_at(pixels, 0.0, -6.0), drawing.ON_BORDER, within=0.1)


@pytest.mark.parametrize("turn", [0.4, 2.0, -1.2])
def test_it_turns_with_the_host(turn):
    cos, sin = math.cos(turn), math.sin(turn)
    ahead = (1000.0 + 20.0 * cos - 3.2 * sin, 20.0 * sin + 3.2 * cos, turn, 10.0, 5.0, 1.8)
    one = moment([(1000.0, 0.0, turn, 20.0, 5.0, 1.8), ahead], [100.0] * 4)
    np.testing.assert_allclose(one.centres_m, [[0.0, 0.0], [20.0, 3.2]], atol=1e-9)
    np.testing.assert_allclose(one.headings_rad, 0.0)
    np.testing.assert_allclose(one.ends_m, [[100.0, 0.0], [0.0, 100.0], [-100.0, 0.0], [0.0, -100.0]], atol=1e-9)


def test_the_road_is_across_the_middle_wherever_on_it_the_host_drives():
    for lane, y in enumerate((-6.4, -3.2, 0.0, 3.2, 6.4)):
        one = moment([(1000.0, y, 0.0, 20.0, 5.0, 1.8)], [100.0])
        assert one.middle_m == pytest.approx(6.4 - 3.2 * lane)
        pixels = drawn(one)
        assert is_colour(colour_at(pixels, -2.0, 0.6, one.middle_m), drawing.HOST)
        assert is_colour(pixels[200 + 30, 900] / 255.0, drawing.ASPHALT)


def test_what_is_told_in_the_mirror_is_shown_as_it_is():
    """On the left: the host's left is away from the kerb, in the picture below."""
    boxes, distances = [AT_THE_MIDDLE, (1020.0, 3.2, 0.3, 10.0, 5.0, 1.8)], [100.0, 50.0, 100.0, 100.0]
    as_told, mirrored = moment(boxes, distances), moment(boxes, distances, is_left_hand=True)
    np.testing.assert_allclose(mirrored.centres_m, as_told.centres_m * [1, -1])
    np.testing.assert_allclose(mirrored.ends_m, as_told.ends_m * [1, -1], atol=1e-9)
    np.testing.assert_allclose(mirrored.headings_rad, -as_told.headings_rad)


def test_the_markings_of_a_straight_road_are_its_lanes():
    drawn = markings.of(road.load("highway5"))
    length = road.load("highway5").length_m
    assert drawn.asphalt[:, :, 1].min() == pytest.approx(-8.0)
    areas = np.ptp(drawn.asphalt[:, :, 0], axis=1) * np.ptp(drawn.asphalt[:, :, 1], axis=1)
    assert areas.sum() == pytest.approx(16.0 * length)
    assert np.unique(drawn.borders[:, :, 1].round(6)).tolist() == [-8.0, 8.0]
    assert np.unique(drawn.dashes[:, :, 1].round(6)).tolist() == [-4.8, -1.6, 1.6, 4.8]
    np.testing.assert_allclose(np.diff(drawn.dashes[:100, :, 0], axis=1), 3.0)
    assert np.ptp(drawn.asphalt[:, :, 0], axis=1).max() <= 20.0


# Frames of an episode.


@pytest.mark.parametrize("network", ["highway5", "ring5", "onramp", "arterial"])
def test_a_frame_shows_the_host_its_rays_and_its_road(make, network):
    env = make(render_mode="rgb_array", config=BRIEF | {"network": {"file": network}})
    with pytest.raises(RuntimeError, match="call reset"):
        env.unwrapped.render()
    env.reset(seed=1)
    first = env.render()
    env.step(1)
    frame = env.render()
    assert (frame.shape, frame.dtype) == ((384, 960, 3), np.uint8)
    assert (frame != first).any()
    np.testing.assert_array_equal(frame, env.render())
    shades = frame.reshape(-1, 3) / 255.0
    share = {
        name: np.isclose(shades, to_rgb(colour), atol=0.01).all(axis=1).mean()
        for name, colour in (("host", drawing.HOST), ("asphalt", drawing.ASPHALT), ("rays", drawing.ON_BORDER))
    }
    assert share["host"] > 0.0005
    assert share["asphalt"] > 0.1
    assert share["rays"] > 0.001
    around_the_host = frame[192 - 80 : 192 + 80, 384 - 10 : 384 + 10].reshape(-1, 3) / 255.0
    assert np.isclose(around_the_host, to_rgb(drawing.HOST), atol=0.01).all(axis=1).mean() > 0.02


def test_a_child_processs_frames_are_the_same(make):
    frames = []
    for isolated in (False, True):
        env = make(render_mode="rgb_array", isolated=isolated)
        env.reset(seed=2)
        env.step(2)
        frames.append(env.render())
        env.close()
    np.testing.assert_array_equal(*frames)


def test_the_line_of_text_tells_speed_decision_and_the_end(monkeypatch, make):
    told, draw = [], Picture.draw
    monkeypatch.setattr(Picture, "draw", lambda self, moment, *text: (told.append(text), draw(self, moment, *text)))
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    env.render()
    for action in (1, 0, 0, 0, 0):
        env.step(action)
        env.render()
    assert told[0] == ("60 km/h", "0.0 s")
    assert told[1][0].endswith(", accelerate")
    assert told[2][1] == "2.0 s"
    assert told[-1][0].endswith("km/h, the end: duration")


def test_frames_a_second_are_decisions_a_second(make):
    assert make(render_mode="rgb_array").metadata["render_fps"] == 1.0
    often = make(render_mode="rgb_array", config={"episode": {"decision_period_s": 0.5}}, isolated=True)
    assert often.metadata["render_fps"] == 2.0


def test_a_window_shows_every_decision_until_it_is_closed(make, monkeypatch):
    import pygame

    shown, show = [], window.Window.show
    monkeypatch.setattr(window.Window, "show", lambda self, pixels: (shown.append(pixels), show(self, pixels)))
    monkeypatch.setattr(pygame.time, "wait", lambda ms: shown.append(ms))
    env = make(render_mode="human")
    env.reset(seed=1)
    assert pygame.display.get_surface().get_size() == (960, 384)
    on_screen = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    np.testing.assert_array_equal(on_screen, shown[0])
    env.step(1)
    assert env.render() is None
    assert 0 < shown[2] <= 1000
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    env.step(1)
    assert pygame.display.get_surface() is None
    env.step(1)  # it drives on without
    env.close()


def test_the_next_episode_has_the_same_window(make):
    env = make(render_mode="human", config={"episode": {"duration_s": 0.2, "decision_period_s": 0.1}})
    env.reset(seed=1)
    first = env.unwrapped._renderer._window
    env.step(0)
    env.reset(seed=2)
    assert env.unwrapped._renderer._window is first
    env.close()
    assert first.is_closed


def test_without_a_mode_there_is_nothing_to_show(make):
    env = make()
    env.reset(seed=1)
    with pytest.warns(UserWarning, match="shows nothing without a render_mode"):
        assert env.unwrapped.render() is None


@pytest.mark.parametrize("isolated", [False, True])
def test_bad_modes_and_missing_extras_are_one_clear_line(monkeypatch, isolated):
    with pytest.raises(InputError, match="render_mode 'rgb_arry' not found; did you mean 'rgb_array'"):
        HighwayEnv(render_mode="rgb_arry")
    found = importlib.util.find_spec
    for missing, mode in (("matplotlib", "rgb_array"), ("pygame", "human")):
        for module in (drawing, window):
            monkeypatch.setattr(module, "find_spec", lambda name, gone=missing: None if name == gone else found(name))
        with pytest.raises(InputError, match=r"pip install 'rail-sumo\[render\]'"):
            gymnasium.make(ID, render_mode=mode, isolated=isolated)


# What researchers' tools do with it.


def test_gymnasiums_checker_passes_with_its_render_checks_in_all_modes(make):
    env = make(
        render_mode="rgb_array", config={"episode": {"duration_s": 1.0, "decision_period_s": 0.1}}, isolated=True
    )
    check_env(env.unwrapped)


def test_stable_baselines_checker_passes(make):
    check_env_by_stable_baselines(make(render_mode="rgb_array").unwrapped)


def test_a_film_is_recorded(make, tmp_path):
    from moviepy import VideoFileClip

    env = RecordVideo(make(render_mode="rgb_array"), str(tmp_path / "films"), episode_trigger=lambda episode: True)
    env.reset(seed=1)
    over = False
    while not over:
        *_, terminated, truncated, _ = env.step(0)
        over = terminated or truncated
    env.close()
    (film,) = tmp_path.glob("films/*.mp4")
    with VideoFileClip(str(film)) as clip:
        assert tuple(clip.size) == (960, 384)
        assert clip.duration == pytest.approx(6.0, abs=1.0)  # six frames, one a second
        frame = clip.get_frame(0.0)
    assert np.isclose(frame.reshape(-1, 3) / 255.0, to_rgb(drawing.ASPHALT), atol=0.03).all(axis=1).mean() > 0.1


def test_vector_environments_have_frames_too():
    envs = gymnasium.make_vec(ID, num_envs=2, config=BRIEF, render_mode="rgb_array")
    try:
        envs.reset(seed=[1, 2])
        one, other = envs.render()
        assert one.shape == other.shape == (384, 960, 3)
        assert (one != other).any()
    finally:
        envs.close()


def test_a_list_of_frames_is_collected(make):
    env = make(render_mode="rgb_array_list")
    env.reset(seed=1)
    env.step(0)
    assert [frame.shape for frame in env.render()] == [(384, 960, 3)] * 2


def test_a_cell_that_is_run_twice_renders_again():
    frames = []
    for _ in range(2):
        env = gymnasium.make(ID, config=BRIEF, render_mode="rgb_array")
        env.reset(seed=1)
        frames.append(env.render())
    env.close()
    np.testing.assert_array_equal(*frames)
