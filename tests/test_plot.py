import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.pictures import plot
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.run_directory import PROGRESS, PROGRESS_COLUMNS, Checkpoint, RunDirectory
from rail_sumo.tables.shares import HEADINGS

N_FEATURES = 48


@pytest.fixture
def run(tmp_path):
    """Make a run whose every figure was these values, iteration by iteration, but for columns of their own."""

    def make(name, values, seed=0, config=None, inputs=None, **own):
        shape = Shape(N_FEATURES, 2)
        clone = PolicyParameters(np.zeros(shape.size), shape, Whitening(np.zeros(N_FEATURES), np.ones(N_FEATURES)))
        directory = RunDirectory.create(tmp_path / name, config or Config(), seed, inputs or {}, clone)
        rows = tuple(
            {column: float(value) for column in PROGRESS_COLUMNS}
            | {"iteration": number, "environment_steps": 1_000_000 * number, "seconds": 120.0 * number}
            | own
            for number, value in enumerate(values, 1)
        )
        directory.save(Checkpoint(clone, {"judge.weights": np.zeros(1)}, rows))
        return tmp_path / name

    return make


def lines(figure, panel=0):
    """(x, y) of each line with data."""
    return [line.get_xydata() for line in figure.axes[panel].lines if len(line.get_xydata())]


def test_a_runs_curve_is_its_running_mean_over_five_iterations(run):
    figure = plot.learning_curves([run("mine-seed0", [70, 60, 60, 60, 60, 70, 71])])
    (line,) = lines(figure)
    np.testing.assert_allclose(line[:, 0], range(1, 8))  # millions of steps
    np.testing.assert_allclose(line[:, 1], [70, 65, 190 / 3, 62.5, 62, 62, 64.2])


def test_against_time_the_axis_is_in_minutes(run):
    figure = plot.learning_curves([run("mine", [1, 2])], against="time")
    assert lines(figure)[0][:, 0].tolist() == [2.0, 4.0]
    assert figure.axes[2].get_xlabel() == "training, minutes"


@pytest.mark.parametrize("n_iterations", [2, 3, 5, 7, 12, 40])
def test_the_labels_of_a_short_runs_steps_stand_apart(n_iterations, run):
    short = run("short", range(n_iterations))
    progress = pd.read_csv(short / PROGRESS)
    progress.assign(environment_steps=progress["iteration"] * 640).to_csv(short / PROGRESS, index=False)
    figure = plot.learning_curves([short])
    figure.draw_without_rendering()
    for axes in figure.axes[2:]:
        left, right = axes.get_xlim()
        ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
        boxes = [label.get_window_extent() for at, label in ticks if left <= at <= right]
        assert len(boxes) > 1
        assert all(one.x1 + 15.0 < other.x0 for one, other in itertools.pairwise(boxes))  # a digit is 9 pixels wide


def test_runs_that_differ_by_their_seed_are_one_curve_with_a_confidence_band(run):
    runs = [
        run(f"mine-seed{seed}", [value] * length, seed=seed)
        for seed, (value, length) in enumerate([(60, 3), (66, 2), (63, 3)])
    ]
    figure = plot.learning_curves(runs)
    *each, mean = lines(figure)
    assert [len(line) for line in each] == [3, 2, 3]
    np.testing.assert_allclose(mean, [[1, 63], [2, 63]])  # as far as all have come
    (band,) = figure.axes[0].collections
    half = stats.t.ppf(0.975, 2) * 3.0 / np.sqrt(3)  # the three values' standard deviation is 3
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((63 - half, 63 + half))


def test_groups_have_curves_of_their_own_and_are_named_in_the_legend(run):
    names = {"two-layer-0": 0, "two-layer-1": 1, "one-layer-0": 0, "r0": 0, "r1": 1, "again_0": 7, "again_1": 7}
    runs = [run(name, [1, 2], seed=seed) for name, seed in names.items()]
    figure = plot.learning_curves(runs)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        *("two-layer (2 runs)", "one-layer", "r (2 runs)"),
        *("again_0", "again_1"),  # of one seed: no trainings independent of one another
    ]
    assert len({line.get_color() for line in figure.axes[0].lines}) == 5


@pytest.mark.parametrize(
    ("section", "changes", "inputs", "curves"),
    [
        ("train", {"learner": "gail"}, {}, ["mix-seed0", "mix-seed1"]),
        ("search", {"n_top": 3}, {}, ["mix-seed0", "mix-seed1"]),
        ("train", {}, {"network.file": "another content"}, ["mix-seed0", "mix-seed1"]),
        ("train", {"iterations": 7, "evaluation_episodes": 3}, {}, ["mix (2 runs)"]),
        ("train", {"demonstrations": "own1.parquet"}, {"train.demonstrations": "others"}, ["mix (2 runs)"]),
    ],
)
def test_runs_that_differ_by_more_than_their_seed_are_no_one_curve_whatever_their_names(
    run, section, changes, inputs, curves
):
    one = run("mix-seed0", [60, 61], seed=0)
    other = run("mix-seed1", [66, 67], seed=1, config=Config().changed(**{section: changes}), inputs=inputs)
    figure = plot.learning_curves([one, other])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == curves
    assert len(list(plot.apart([one, other]))) == len(curves) - 1


def test_runs_of_one_name_that_have_a_curve_each_are_told_with_why(run):
    runs = [run("few-seed0", [1, 2]), run("few-seed1", [1, 2], seed=1, config=Config().changed(policy={"hidden": 3}))]
    assert list(plot.apart(runs)) == ["the runs 'few' have a curve each: policy.hidden = 32, not 3"]
    twice = [run("again-0", [1, 2], seed=4), run("again-1", [1, 2], seed=4)]
    assert list(plot.apart(twice)) == ["the runs 'again' have a curve each: both have seed 4"]
    other = run("files-0", [1, 2]), run("files-1", [1, 2], seed=1, inputs={"network.file": "another content"})
    assert list(plot.apart(other)) == ["the runs 'files' have a curve each: the file of network.file has other content"]


def test_many_curves_are_told_apart_by_marks_where_colours_come_round_again(run):
    figure = plot.learning_curves([run(f"{letter}-run", [1, 2]) for letter in "abcdefghijklmno"])
    drawn = [line for line in figure.axes[0].lines if len(line.get_xdata())]
    assert len({(line.get_color(), line.get_marker()) for line in drawn}) == 15
    handles = figure.legends[0].legend_handles
    assert [(one.get_color(), one.get_marker()) for one in handles] == [
        (line.get_color(), line.get_marker()) for line in drawn
    ]


def test_the_judges_two_means_share_a_panel(run):
    figure = plot.learning_curves([run("mine", [1, 2], judge_expert_mean=0.6, judge_learner_mean=0.4)])
    drawn = {line.get_linestyle(): line.get_ydata().tolist() for line in figure.axes[3].lines if len(line.get_ydata())}
    assert drawn == {"-": [0.6, 0.6], "--": [0.4, 0.4]}  # as its title says


def test_where_nobody_judges_the_last_panel_has_the_reward_that_is_learned_from(run):
    alone = run("ars", [1, 2], judge_expert_mean=np.nan, judge_learner_mean=np.nan, mean_return=-7.0)
    figure = plot.learning_curves([alone])
    assert lines(figure, 3)[0][:, 1].tolist() == [-7.0, -7.0]
    beside = plot.learning_curves([alone, run("rail", [1, 2])])
    assert [axes.get_title("left") for axes in (figure.axes[3], beside.axes[3])] == [
        "what is learned from: reward a rollout",
        "judge's verdict on expert (solid) and learner (dashed)",
    ]


def test_a_run_without_an_iteration_is_refused(run):
    with pytest.raises(InputError, match=r"mine: no iteration to draw, as of a clone, which has none"):
        plot.learning_curves([run("mine", [])])
    figure = plot.learning_curves([run("clone", []), run("rail", [1, 2])])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["rail"]


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_picture_is_of_the_kind_its_name_says(run, tmp_path, suffix):
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    out = tmp_path / "pictures" / f"curves.{suffix}"
    plot.save(plot.learning_curves([run("mine", [1, 2])]), out)
    assert out.read_bytes().startswith(begins[suffix])
    assert [path.name for path in out.parent.iterdir()] == [out.name]


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_a_figure_is_the_same_bytes_whenever_it_is_drawn(run, kind):
    mine = run("mine", [1, 2])
    first, second = (plot.picture(plot.learning_curves([mine]), kind) for _ in range(2))
    assert first == second
    assert b"CreationDate" not in first
    assert b"dc:date" not in first


def test_what_cannot_be_written_is_refused_in_one_line(run, tmp_path):
    figure = plot.learning_curves([run("mine", [1, 2])])
    with pytest.raises(InputError, match=r"must end in \.png, \.svg or \.pdf; got 'curves\.jpg'"):
        plot.save(figure, plot.Path("curves.jpg"))
    (tmp_path / "there.png").write_text("mine")
    with pytest.raises(InputError, match=r"exists; choose another, or replace it with --overwrite"):
        plot.save(figure, tmp_path / "there.png")
    assert (tmp_path / "there.png").read_text() == "mine"


@pytest.mark.parametrize("what", HEADINGS.values())
def test_what_is_measured_is_written_whole(what):
    figure = plot.with_bands({"rule": np.array([[0.0, 1.0, 0.9, 1.1], [1.0, 2.0, 1.9, 2.1]])}, "share", what)
    figure.draw_without_rendering()
    written = figure.axes[0].yaxis.label.get_window_extent()
    assert figure.bbox.y0 <= written.y0
    assert written.y1 <= figure.bbox.y1
    assert figure.bbox.x0 <= written.x0


@pytest.mark.parametrize(("level", "interval"), [(0.0, np.nan), (41.0, 41.0)])
def test_where_nothing_differs_the_axis_shows_no_hundredths_of_it(level, interval):
    curve = np.array([[share, level, interval, interval] for share in (0.0, 0.5, 1.0)])
    figure = plot.with_bands({"rule": curve, "acc": curve}, "share", "contacts")
    assert figure.axes[0].get_ylim() == (max(level - 1.0, 0.0), level + 1.0)


def test_a_figure_without_neighbours_shows_its_interval_too():
    gap = np.full(3, np.nan)
    curve = np.array([[0.0, 1.0, 0.8, 1.2], [1.0, *gap], [2.0, 3.0, 2.5, 3.5], [3.0, 3.0, 2.5, 3.5]])
    (lone,) = plot.with_bands({"rule": curve}, "share", "speed").axes[0].collections[1:]
    assert [segment.tolist() for segment in lone.get_segments()] == [[[0.0, 0.8], [0.0, 1.2]]]


def test_the_experts_line_is_in_sight_however_far_from_it_a_figure_is():
    figure = plot.against_trajectories([40], {"rail": np.array([[7.0, 7.0, 7.0]])}, "overtakes")
    figure.draw_without_rendering()  # a warning is an error
    low, high = figure.axes[0].get_ylim()
    assert low <= 1.0 <= high
