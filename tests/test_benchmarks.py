"""What the benchmarks make of what they measured; measuring takes them hours."""

import importlib
import io
import itertools
import math
from pathlib import Path

import ablations
import claims
import efficiency
import noise
import numpy as np
import pandas as pd
import placebo
import pytest
import sensing
import shown
import throughput
from rich.console import Console

from rail_sumo import config_file
from rail_sumo.highway.parallel_env import HighwayParallelEnv
from rail_sumo.imitation.demonstrations import Demonstrations

PARTS = {"kept", "variants"}
"""Of other benchmarks."""
NAMES = sorted({path.stem for path in Path(ablations.__file__).parent.glob("*.py")} - PARTS)


@pytest.mark.parametrize("name", NAMES)
def test_every_benchmark_can_be_asked_what_it_does(name, monkeypatch, capsys):
    if name == "outside":
        pytest.importorskip("imitation")
    benchmark = importlib.import_module(name)
    monkeypatch.setattr("sys.argv", [benchmark.__name__, "--help"])
    with pytest.raises(SystemExit) as ended:
        benchmark.main()
    assert ended.value.code == 0
    assert benchmark.__doc__.splitlines()[0][:40] in capsys.readouterr().out


def test_in_the_ablations_every_choice_is_varied_as_often_and_beside_each_of_the_others():
    signs = np.where(ablations.design(), 1, -1)
    assert {len(choices) for choices in ablations.CHOICES.values()} == {signs.shape[1]} == {12}
    assert len(signs) == 24
    np.testing.assert_array_equal(signs.T @ signs, 24 * np.eye(12))
    np.testing.assert_array_equal(signs[:12], -signs[12:])  # folded: no effect is mixed up with two others' joining
    for one, other in itertools.combinations(range(12), 2):
        np.testing.assert_array_equal(signs.T @ (signs[:, one] * signs[:, other]), 0)


def test_of_every_choice_the_default_is_the_configurations_and_the_other_way_is_not():
    for choice in itertools.chain.from_iterable(ablations.CHOICES.values()):
        if choice.override:
            key = choice.override.partition("=")[0]
            default, other = (config_file.load(None, overrides).flat()[key] for overrides in ([], [choice.override]))
            assert choice.name == key
            assert other != default
            if isinstance(default, int | float):
                assert float(choice.default) == default


@pytest.mark.parametrize("learner", ablations.CHOICES)
def test_an_effect_is_what_the_other_way_adds_and_its_interval_says_how_surely(learner):
    names = [choice.name for choice in ablations.CHOICES[learner]]
    trainings = pd.DataFrame(ablations.design(), columns=names)
    worth = dict(zip(names, np.linspace(-0.05, 0.06, len(names)), strict=True))
    chance = np.random.default_rng(0).normal(scale=0.01, size=len(trainings))
    trainings["speed_kmh"] = 1.0 + ablations.design() @ np.array(list(worth.values())) + chance
    found = ablations.effects(trainings, ablations.CHOICES[learner], "speed_kmh")
    assert found["effect"].to_dict() == pytest.approx(worth, abs=0.015)
    assert ((found["low"] < pd.Series(worth)) & (pd.Series(worth) < found["high"])).sum() >= 10  # of 12, at 95 %
    # 2 t / sqrt(24) sd, with 11 degrees of freedom
    assert (found["high"] - found["effect"]).to_numpy() == pytest.approx(
        np.full(12, 2 * 2.2 / math.sqrt(24) * 0.01), rel=0.6
    )


def curve(*speeds):
    looks = range(len(speeds))
    return pd.DataFrame({"iteration": looks, "steps": looks, "seconds": [10.0 * k for k in looks], "speed": speeds})


@pytest.mark.parametrize(
    ("speeds", "seconds"),
    [
        ((0.9, 0.95, 0.96, 0.94), 10.0),
        ((0.9, 0.96, 0.94, 0.95, 0.97), 30.0),  # one look alone may be chance
        ((0.95, 0.95), 0.0),
        ((0.9, 0.94, 0.99), math.inf),
    ],
)
def test_a_learner_has_got_there_when_two_looks_in_a_row_show_it(speeds, seconds):
    assert efficiency.got_there(curve(*speeds), 0.95)["seconds"] == seconds


def cells(system, speed, mode="argmax", *, trajectories=40, seeds=2):
    """Seeds of two episodes each; in every one three lane changes, and one that is taken back."""
    rows = []
    for seed, episode in itertools.product(range(seeds), range(2)):
        rows.append({
            "system": system, "mode": mode, "as_trained": True, "trajectories": trajectories, "training_seed": seed,
            "episode": episode, "speed_kmh": speed + seed + 0.1 * episode, "overtakes": 40, "lane_changes": 3,
            "aborted_lane_changes": 1, "longitudinal_reward": 3000.0, "lateral_reward": -30.0,
            "refused_decisions": 2, "told_apart": 0.5 + 0.1 * seed, "collisions": 0, "struck": 0,
        })  # fmt: skip
    return pd.DataFrame(rows)


def test_a_system_is_compared_with_the_expert_on_its_own_seeds_for_each_number_of_trajectories():
    found = claims.ratios(
        pd.concat(
            [
                cells("expert", 60.0, "", trajectories=0),
                cells("bc-2", 63.0),
                cells("bc-2", 48.0, trajectories=5, seeds=1),
            ]
        )
    ).set_index("shown")
    # Means of 63.05 and 64.05 beside 60.05 and 61.05. The ratio is 1.0496. Its ends are where 63.55 - 60.55 r is 12.7
    # times half of 1 - r off 0.
    ends = [(63.55 - 6.353 * sign) / (60.55 - 6.353 * sign) for sign in (-1, 1)]
    assert found.loc[40, "speed_kmh"] == f"1.050 ({ends[0]:.3f} to {ends[1]:.3f})" == "1.050 (1.045 to 1.055)"
    assert found.loc[5, "speed_kmh"].startswith("0.800")  # 48.05 of 60.05; the other seed's 61.05 would make it 0.794
    assert found.loc[40, "told apart"].startswith("0.55 ")
    assert found["seeds"].to_dict() == {40: 2, 5: 1}
    assert len(found) == 2  # the expert is not compared with itself


def test_systems_are_compared_with_one_another_training_by_training():
    clone = cells("bc-2", 69.0)
    clone["speed_kmh"] += 0.2 * clone["training_seed"]
    found = claims.differences(pd.concat([cells("rail-2", 72.0), clone, cells("rail-1", 70.0)]))
    speeds = found[found["metric"] == "speed_kmh"].set_index(["one", "minus"])[["difference", "low", "high"]]
    # 3.0 and 2.8: 2.9, with a standard error of 0.1 and Student's t of 12.706.
    clones = speeds.loc[("rail-2 argmax", "bc-2 argmax")]
    assert clones.tolist() == pytest.approx([2.9, 2.9 - 1.2706, 2.9 + 1.2706], abs=1e-3)
    assert speeds.loc[("rail-1 argmax", "rail-2 argmax"), "difference"] == pytest.approx(-2.0)
    assert len(speeds) == 2  # of those that are not there, there is no row


def test_what_lane_changes_cost_and_how_many_are_taken_back():
    found = claims.lane_changing(pd.concat([cells("rail-2", 72.0), cells("rail-2", 72.0, trajectories=5, seeds=1)]))
    assert found.loc[("rail-2", "argmax", 40)].tolist() == [0.25, -10.0, 0, 4]
    assert found.loc[("rail-2", "argmax", 5)].tolist() == [0.25, -10.0, 0, 2]


def test_how_alike_episodes_on_the_same_traffic_are():
    expert, follower, opposite = (cells(name, 60.0, "", trajectories=0) for name in ("expert", "rule", "sumo"))
    expert["overtakes"] = [1, 2, 3, 4]
    follower["overtakes"] = [2, 4, 6, 8]
    opposite["overtakes"] = [4, 3, 2, 1]
    shuffled = pd.concat([expert, follower, opposite]).sample(frac=1.0, random_state=0)
    found = claims.correlations(shuffled)["overtakes"]
    assert {system: round(value, 6) for (system, _), value in found.items()} == {"rule": 1.0, "sumo": -1.0}


def test_how_far_a_driver_lies_from_itself_by_chance():
    driven = cells("expert", 60.0, "", trajectories=0, seeds=50)
    driven["overtakes"] = np.tile([30, 50], 50)  # a deviation of 10 from a mean of 40
    found = claims.chance_ratios(driven).set_index("metric")
    assert found.loc["lane_changes"].tolist() == [1.0, 1.0]
    # Of a ratio of two means of 16: 1.96 * sqrt(2 / 16) * 10 / 40 = 0.173, a little more above 1 than below.
    assert found.loc["overtakes"].tolist() == pytest.approx([1 - 0.17, 1 + 0.19], abs=0.02)


def test_a_variant_is_set_beside_the_first_one_seed_by_seed():
    index = pd.MultiIndex.from_product([[0, 1], ["as it is", "blind"]], names=["seed", "variant"]).swaplevel()
    ratios = pd.DataFrame({"speed_kmh": [0.9, 0.8, 1.1, 1.0]}, index)
    found = sensing.added(ratios)
    assert found["speed_kmh"].to_dict() == pytest.approx({("blind", 0): -0.1, ("blind", 1): -0.1})
    assert sensing.with_interval(ratios.xs("blind", level="variant")["speed_kmh"]) == "0.900 +- 1.271"  # 12.7 x 0.1
    assert sensing.with_interval(found["speed_kmh"]) == "-0.100 +- 0.000"


def test_the_table_of_agents_tells_medians_spreads_and_how_many_times_highway_env():
    ours = throughput.Row("ours", lambda: 0.0, [900.0, 1200.0, 1000.0])
    other = throughput.Row("other", lambda: 0.0, [20.0, 16.0, 24.0])
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(throughput.table_of_agents([ours, other], 96))
    lines = [line.split("│")[1:-1] for line in console.export_text().splitlines() if line.startswith("│")]
    assert [[cell.strip() for cell in line] for line in lines] == [
        ["ours", "1,000", "900 .. 1,200", "50.0"],
        ["other", "20", "16 .. 24", "1.0"],
    ]


def test_the_agents_of_the_benchmark_all_decide_at_every_step(monkeypatch):
    clock, asked = iter([10.0, 12.0]), []
    step = HighwayParallelEnv.step
    monkeypatch.setattr(throughput.time, "process_time", lambda: next(clock))
    monkeypatch.setattr(
        HighwayParallelEnv,
        "step",
        lambda env, actions: asked.append(len(actions)) or step(env, actions),
    )
    assert throughput.agents_of_ours(5) == 8 * 5 / 2.0
    assert asked[-5:] == [8] * 5


def test_groups_of_trajectories_are_dealt_out_without_one_in_two_of_them():
    episode = np.repeat(np.arange(3, 9), 2)
    every = Demonstrations(np.arange(12.0)[:, None], np.zeros(12, int), episode)
    groups = [shown.dealt(every, 2, number) for number in range(3)]
    assert [sorted(set(group.episode.tolist())) for group in groups] == [[3, 4], [5, 6], [7, 8]]
    assert np.array_equal(np.concatenate([group.observations for group in groups]), every.observations)


# Whether the search goes anywhere.


def test_a_random_walk_is_as_straight_as_chance_has_it_and_a_straight_one_as_many_times_as_it_has_steps():
    rng = np.random.default_rng(0)
    steps = rng.standard_normal((100, 2000))
    norms = np.linalg.norm(steps, axis=1)
    assert placebo.straightness(steps.sum(axis=0), norms) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 2000))
    one_way = np.tile(steps[0], (100, 1))
    assert placebo.straightness(one_way.sum(axis=0), np.linalg.norm(one_way, axis=1)) == pytest.approx(100.0)


def test_a_placebo_is_as_far_from_the_clone_and_elsewhere_each_time():
    rng, theta = np.random.default_rng(0), np.arange(50.0)
    one, other = (placebo.elsewhere(theta, 7.0, rng) - theta for _ in range(2))
    assert np.linalg.norm(one) == pytest.approx(7.0)
    assert np.linalg.norm(other) == pytest.approx(7.0)
    assert abs(one @ other) < 0.5 * 49.0


def test_the_judges_verdicts_are_on_what_it_learned_from_and_on_other_drives(monkeypatch):
    """The judge here knows a decision by its number alone."""
    drives = Demonstrations(np.zeros((4, 3)), np.array([0, 0, 1, 1]), np.zeros(4, np.int64))
    unseen = Demonstrations(np.zeros((2, 3)), np.array([1, 1]), np.zeros(2, np.int64))
    monkeypatch.setattr(noise.training, "demonstrations_of", lambda world: drives)
    monkeypatch.setattr(noise.roster, "find_driver", lambda name, world: None)
    monkeypatch.setattr(noise.run, "record", lambda *args, **options: unseen)

    class Judge:
        def rewards(self, observations, actions):
            return np.where(actions == 0, 50.0, 0.0)

    class Learned:
        config = None

    found = noise.verdicts(Learned(), Judge(), 1)
    assert found == pytest.approx({"its demonstrations": 0.75, "other drives of the expert": 0.5})
