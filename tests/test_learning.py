"""RAIL on SUMO, from the shipped demonstrations: it beats its clone, and it is the judge that makes it."""

import numpy as np
import pytest
from scipy import stats

from rail_sumo import config_file, run, training
from rail_sumo.imitation.discriminator import Discriminator
from rail_sumo.policy import ARGMAX

pytestmark = pytest.mark.xdist_group("learning")  # `by_its_judge` is trained once

SHORT = (
    "policy.masked=false",  # a masked clone drives as its expert does already
    "cloning.epochs=20",  # and so does an unmasked one nearly, if cloned for long
    "train.iterations=30",
    "search.n_directions=8",
    "train.evaluation_episodes=24",
    "train.horizon_s=60",
    "episode.duration_s=180",
)


def gains_kmh(folder, *further):
    """Train, and return the gain in speed on the clone in every held-out episode."""
    config = config_file.load(None, [*SHORT, *further])
    learned = training.learn(config, folder, seed=0, workers=2)
    who = {"rail": learned.policy(), "clone, argmax": learned.clone.acting(ARGMAX)}
    episodes, *_ = run.evaluate(who, config, episodes=config.train.evaluation_episodes, seed=0, workers=2)
    speeds = episodes.pivot(index="seed", columns="policy", values="speed_kmh")
    return (speeds["rail"] - speeds["clone, argmax"]).to_numpy()


@pytest.fixture(scope="module")
def by_its_judge(tmp_path_factory):
    return gains_kmh(tmp_path_factory.mktemp("rail") / "run")


@pytest.mark.slow
def test_rail_drives_faster_than_its_clone_as_the_expert_does(by_its_judge):
    test = stats.permutation_test(
        (by_its_judge,), np.mean, permutation_type="samples", alternative="greater", n_resamples=9999, rng=0
    )
    assert by_its_judge.mean() > 1.0
    assert test.pvalue < 0.05


@pytest.mark.slow
def test_under_an_indifferent_judge_it_stays_the_clone(tmp_path, monkeypatch):
    monkeypatch.setattr(Discriminator, "returns", lambda self, trajectories: np.full(len(trajectories), 0.3))
    assert not gains_kmh(tmp_path / "run", "train.iterations=2", "train.evaluation_episodes=4").any()


@pytest.mark.slow
def test_under_a_judge_turned_round_it_gains_less_than_half(by_its_judge, tmp_path, monkeypatch):
    """A walk that the judge's figures did not lead would gain by chance, and as much with either sign."""
    returns = Discriminator.returns
    monkeypatch.setattr(Discriminator, "returns", lambda self, trajectories: -returns(self, trajectories))
    assert gains_kmh(tmp_path / "run").mean() < 0.5 * by_its_judge.mean()
