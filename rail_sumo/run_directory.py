"""The run directory: what training leaves, whole at every moment, to evaluate and to go on from.

`config.toml` holds every key, `policy.safetensors` the learned driver, `clone.safetensors` what it started from,
`judge.safetensors` the discriminator, `progress.csv` a row per iteration, `checkpoint.safetensors` what the next
iteration depends on.
"""

import json
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from rail_sumo import config
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway.observation import feature_names
from rail_sumo.policy import Shape, Whitening
from rail_sumo.records import Floats
from rail_sumo.rollout import LearnedDriver

Tensors = dict[str, NDArray[Any]]

CONFIG = "config.toml"
POLICY = "policy.safetensors"
CLONE = "clone.safetensors"
JUDGE = "judge.safetensors"
PROGRESS = "progress.csv"
CHECKPOINT = "checkpoint.safetensors"

PROGRESS_COLUMNS = (
    "iteration",
    "environment_steps",  # SUMO steps of 0.1 s driven since the start
    "seconds",  # of wall clock since the start, interruptions left out
    "mean_return",  # of the iteration's rollouts, by the judge
    "judge_loss",
    "judge_expert_mean",
    "judge_learner_mean",
    "speed_kmh",  # mean over the iteration's rollouts, like the next
    "lane_changes",
    "step_norm",  # how far theta moved
)


@dataclass(frozen=True)
class Checkpoint:
    """Where training stands after an iteration; 0 is the clone."""

    iteration: int
    theta: Floats
    judge: Tensors
    environment_steps: int = 0
    seconds: float = 0.0


class RunDirectory:
    """An existing run; every file in it is replaced at once, so a killed process leaves the old one or the new one.

    Raises:
        InputError: no such directory, or its configuration cannot be read.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_dir():
            raise InputError(f"run directory '{path}' not found")
        self.path = path
        self.config = config.load(path / CONFIG)

    @classmethod
    def create(cls, path: Path, config: Config, seed: int, clone: LearnedDriver, judge: Tensors) -> "RunDirectory":
        """Lay out a run that starts from the clone. It appears under its name once it is whole.

        Raises:
            InputError: it exists, or cannot be written.
        """
        require_new(path)
        features = feature_names(config.lidar, config.observation)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as partial:
                whole = Path(partial, path.name)
                whole.mkdir()
                _replace(whole / CONFIG, config_toml(config).encode())
                _replace(whole / PROGRESS, _lines([",".join(PROGRESS_COLUMNS)]))
                _replace(whole / CLONE, _driver(clone, features, seed, iteration=0))
                _save(whole, Checkpoint(0, clone.theta, judge), clone, features, seed)
                whole.rename(path)
        except OSError as error:
            raise InputError(f"cannot write run directory '{path}': {error.strerror or error}") from None
        return cls(path)
