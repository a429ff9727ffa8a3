"""RAIL on SUMO, from the shipped demonstrations: it beats its clone, and it is the judge that makes it."""

import numpy as np
import pytest
from scipy import stats

from rail_sumo import config, run
from rail_sumo.imitation.discriminator import Judge

SHORT = (
    "cloning.epochs=20",  # a clone that leaves something to gain
    "train.iterations=30",
    "search.n_directions=8",
    "search.averaging=0.0",
    "train.evaluation_episodes=48",
    "train.horizon_s=120",
    "episode.duration_s=180",
)


def gain_kmh(folder):
    """Train, and return the mean gain in speed on the clone over held-out traffic with its one-sided p-value."""
    episodes, _ = run.train(config.load(None, SHORT), folder, seed=0, workers=2)
    speeds = episodes.pivot(index="seed", columns="policy", values="speed_kmh")
    gains = (speeds["rail"] - speeds["clone"]).to_numpy()
    test = stats.permutation_test(
        (gains,), np.mean, permutation_type="samples", alternative="greater", n_resamples=9999, rng=0
    )
    return gains.mean(), test.pvalue


@pytest.mark.slow
def test_rail_drives_faster_than_its_clone_as_the_expert_does(tmp_path):
    gain, p = gain_kmh(tmp_path / "run")
    assert gain > 1.0
    assert p < 0.05


@pytest.mark.slow
def test_under_an_indifferent_judge_it_stays_the_clone(tmp_path, monkeypatch):
    monkeypatch.setattr(Judge, "returns", lambda self, trajectories: np.full(len(trajectories), 0.3))
    gain, p = gain_kmh(tmp_path / "run")
    assert gain == 0.0
    assert p == 1.0


@pytest.mark.slow
def test_under_a_judge_that_tosses_coins_it_does_not_improve(tmp_path, monkeypatch):
    rng = np.random.default_rng(7)
    monkeypatch.setattr(Judge, "returns", lambda self, trajectories: rng.normal(size=len(trajectories)))
    _, p = gain_kmh(tmp_path / "run")
    assert p > 0.05
