"""The run directory: what training leaves behind, at every moment fit to be evaluated and gone on from.

`config.toml` holds every key; `policy.safetensors` the learned driver and `clone.safetensors` what it started from;
`judge.safetensors` the discriminator; `progress.csv` a row per iteration; `checkpoint.safetensors` all that the next
iteration depends on.
"""

import csv
import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from rail_sumo.assets import is_expert, own_version
from rail_sumo.config import Config
from rail_sumo.config_file import dumps, first_difference, load
from rail_sumo.errors import InputError
from rail_sumo.files import AnyPath, is_taken, whole_file, whole_folder
from rail_sumo.highway.observation import feature_names
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.tables.report import WORLD

CONFIG = "config.toml"
POLICY = "policy.safetensors"
CLONE = "clone.safetensors"
JUDGE = "judge.safetensors"
PROGRESS = "progress.csv"
CHECKPOINT = "checkpoint.safetensors"

DEMONSTRATIONS = "train.demonstrations"
"""The key that names them; trainings that are compared may have some of their own each."""
MAY_CHANGE = ("train.iterations", "train.evaluation_episodes")
"""Keys that an interrupted or finished run may be resumed with another value of: no iteration depends on them."""

PROGRESS_COLUMNS = (
    "iteration",
    "environment_steps",  # SUMO steps driven since the start
    "seconds",  # at work since the start, interruptions left out
    "mean_return",  # of this iteration's rollouts: the reward that the learner follows
    "judge_loss",
    "judge_expert_mean",
    "judge_learner_mean",
    "speed_kmh",  # in this iteration's rollouts, as the next two
    "overtakes",  # per rollout
    "lane_changes",  # per rollout
    "step_norm",  # how far theta moved
)
LEARNERS_COLUMNS = ("mean_return", "judge_loss", "judge_expert_mean", "judge_learner_mean", "step_norm")
"""Those of them that a learner tells; the others are measured."""

CHECKSUM = "sha256"
"""The key, in what a file tells of itself, of the SHA-256 of all else in it."""
MEMORY = "memory."
"""What the names of a learner's memory begin with in the file of its checkpoint, beside those of its policy."""
JUDGES = "judge."
"""What the names of the judge's tensors begin with among all that a checkpoint holds."""

Tensors = dict[str, NDArray[Any]]
Row = Mapping[str, float]
"""A row of `progress.csv`, keyed by `PROGRESS_COLUMNS`."""


@dataclass(frozen=True)
class Checkpoint:
    """Where training stands after an iteration; without progress, at the clone."""

    learned: PolicyParameters
    memory: Tensors = field(default_factory=dict)
    """All else that the learner's next iteration depends on, by names of its own; its judge's begin with `JUDGES`."""
    progress: tuple[Row, ...] = ()

    @property
    def iteration(self) -> int:
        """How many iterations are done."""
        return len(self.progress)


class RunDirectory:
    """An existing run. Every file is replaced at once: a process killed while writing leaves the old one whole.

    Raises:
        InputError: not there, incomplete or damaged.
    """

    def __init__(self, path: AnyPath) -> None:
        path = Path(path)
        if path.is_file():
            meant = f", '{path.parent}'" if (path.parent / CONFIG).is_file() else ""
            raise InputError(f"'{path}' is a file; name the run's folder{meant}")
        if not path.is_dir():
            raise InputError(f"run directory '{path}' not found")
        if not (path / CONFIG).is_file():
            is_evaluation = " (it is an evaluation: name those who drove there)" if (path / WORLD).is_file() else ""
            raise InputError(f"'{path}' is not a run directory: it has no {CONFIG}{is_evaluation}")
        if not (path / CLONE).is_file() and is_expert(path):
            raise InputError(
                f"'{path}' is an expert's folder, not a run directory: it drives under that name, and train.expert "
                "takes it; what goes on with a training or draws one wants a run of rail-sumo train"
            )
        self.path = path
        self.config = load(path / CONFIG)
        clone, _, self._about = _read_driver(path / CLONE)
        self.clone = replace(clone, senses=self.config.senses)

    @classmethod
    def create(
        cls, path: Path, config: Config, seed: int, inputs: Mapping[str, str], clone: PolicyParameters
    ) -> "RunDirectory":
        """Lay out a run that starts from the clone. It appears under its name only once it is whole.

        Args:
            path: where.
            config, seed: what it is started with.
            inputs: the files it reads, by the keys that name them, as SHA-256.
            clone: what the first iteration starts from.

        Raises:
            InputError: it exists, or cannot be written.
        """
        require_new(path)
        features = feature_names(config.lidar, config.observation)
        with whole_folder(path) as whole:
            _write(whole / CONFIG, dumps(config).encode())
            _write(whole / CLONE, _driver_bytes(clone, {"seed": seed, "inputs": dict(inputs), "features": features}))
            cls(whole).save(Checkpoint(clone))
        return cls(path)

    @property
    def seed(self) -> int:
        """The seed the run was started with."""
        return int(self._about["seed"])

    @property
    def inputs(self) -> Mapping[str, str]:
        """The SHA-256 of every file that it reads, as they were when it was started, by the keys that name them."""
        return cast(Mapping[str, str], self._about["inputs"])

    @property
    def unfinished(self) -> str:
        """That it has done fewer iterations than it is to have; empty if it has done them.

        Raises:
            InputError: the policy's file is damaged.
        """
        _, _, about = _read_driver(self.path / POLICY)
        wanted = self.config.train.n_iterations
        done = about.get("iteration", wanted)  # files from before it was there
        return f"'{self.path}' has done {done} of {wanted} iterations; go on with --resume" if done < wanted else ""

    def policy(self) -> PolicyParameters:
        """Return the learned driver, with the senses that it was trained with.

        Raises:
            InputError: the file is damaged.
        """
        learned, _, _ = _read_driver(self.path / POLICY)
        return replace(learned, senses=self.config.senses)

    def judge(self) -> Tensors:
        """Return what the judge's file holds; nothing for a learner without one.

        Raises:
            InputError: the file is damaged.
        """
        path = self.path / JUDGE
        return _read(path)[0] if path.exists() else {}

    def checkpoint(self) -> Checkpoint:
        """Return where training stands."""
        path = self.path / CHECKPOINT
        learned, memory, about = _read_driver(path)
        if about.get("made_of", self._made_of) != self._made_of:
            raise InputError(
                f"'{path}' is of another run, or {CONFIG} beside it was changed; put both back as they were, or start "
                f"another run with --out"
            )
        try:
            return Checkpoint(learned, memory, tuple(about["progress"]))
        except KeyError as error:
            raise _damaged(path, error) from None

    def differs_from(self, other: "RunDirectory") -> str:
        """Return by what another run is more than the same training once more, with another seed; "" if by nothing.

        It may have demonstrations of its own, and how many iterations and evaluation episodes it is to have does not
        matter.
        """
        if self.seed == other.seed:
            return f"both have seed {self.seed}"
        ours, theirs = (one._fixed | {DEMONSTRATIONS: ""} for one in (self, other))
        if ours != theirs:
            return first_difference(ours, theirs)
        files = [{**one.inputs, DEMONSTRATIONS: ""} for one in (self, other)]
        names = sorted(dict(files[0].items() ^ files[1].items()))
        return f"the file of {names[0]} has other content" if names else ""

    @property
    def _fixed(self) -> dict[str, Any]:
        """The keys that its iterations follow from."""
        return {key: value for key, value in self.config.flat().items() if key not in MAY_CHANGE}

    @property
    def _made_of(self) -> str:
        """What its iterations follow from, as SHA-256."""
        followed = json.dumps([self._fixed, self.seed, self.inputs], sort_keys=True)
        return hashlib.sha256(followed.encode()).hexdigest()

    def save(self, checkpoint: Checkpoint) -> None:
        """Store an iteration.

        Raises:
            InputError: the disk is full, or the directory cannot be written.
        """
        learned, iteration = checkpoint.learned, {"iteration": checkpoint.iteration}
        _write(self.path / POLICY, _driver_bytes(learned, self._about | iteration))
        judge = {name.removeprefix(JUDGES): x for name, x in checkpoint.memory.items() if name.startswith(JUDGES)}
        if judge:
            _write(self.path / JUDGE, _bytes(judge, iteration))
        _write(self.path / PROGRESS, _csv(checkpoint.progress))
        # Last, so that whatever is newer than it will be written again.
        about = {"features": self._about["features"], "progress": checkpoint.progress, "made_of": self._made_of}
        _write(self.path / CHECKPOINT, _driver_bytes(learned, about, checkpoint.memory))

    def require_same(self, config: Config, seed: int, inputs: Mapping[str, str]) -> None:
        """Refuse to take a run up again as another one; more iterations or evaluation episodes are no other.

        Raises:
            InputError: the run was started with another seed, configuration or content of the files it reads, or has
                done more iterations than it is to have.
        """
        mismatch = first_difference(self._fixed | {"seed": self.seed}, config.flat() | {"seed": seed})
        if mismatch:
            raise InputError(
                f"run directory '{self.path}' was started with {mismatch}; resume it as it was started, or start "
                f"another with --out"
            )
        for key, checksum in self.inputs.items():
            if inputs.get(key) != checksum:
                raise InputError(
                    f"the content of {key} has changed since run directory '{self.path}' was started; put it back as "
                    f"it was, or start another run with --out"
                )
        done = self.checkpoint().iteration
        if config.train.n_iterations < done:
            raise InputError(
                f"run directory '{self.path}' has done {done} iterations; set train.iterations to no less, or start "
                f"another with --out"
            )

    def go_on(self, config: Config, seed: int, inputs: Mapping[str, str]) -> None:
        """Take a run up again, with more iterations or evaluation episodes if the configuration says so.

        Raises:
            InputError: it would be another run; see `require_same`.
        """
        self.require_same(config, seed, inputs)
        if config != self.config:
            _write(self.path / CONFIG, dumps(config).encode())
            self.config = config


def require_new(path: Path) -> None:
    """Raise InputError if there is something where a new run is to be."""
    if is_taken(path):
        raise InputError(f"output folder '{path}' exists; go on with it by --resume, or choose another with --out")


def _csv(progress: tuple[Row, ...]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, PROGRESS_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(progress)
    return text.getvalue().encode()


def _driver_bytes(driver: PolicyParameters, about: dict[str, Any], memory: Tensors | None = None) -> bytes:
    tensors = {"theta": driver.theta, "whitening_mean": driver.whitening.mean, "whitening_std": driver.whitening.std}
    acts = {"hidden": driver.shape.hidden, "samples": driver.samples, "masked": driver.masked}
    remembered = {MEMORY + name: tensor for name, tensor in (memory or {}).items()}
    return _bytes(tensors | remembered, about | acts)


def _read_driver(path: Path) -> tuple[PolicyParameters, Tensors, dict[str, Any]]:
    """Return a file's driver, its other tensors, and what it says about itself."""
    tensors, about = _read(path)
    try:
        shape = Shape(len(about["features"]), about["hidden"])
        whitening = Whitening(tensors.pop("whitening_mean"), tensors.pop("whitening_std"))
        acts = {name: about.get(name, False) for name in ("samples", "masked")}  # files from before these were there
        driver = PolicyParameters(tensors.pop("theta"), shape, whitening, **acts)
        driver.policy()
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(path, error) from None
    return driver, {name.removeprefix(MEMORY): tensor for name, tensor in tensors.items()}, about


def _bytes(tensors: Tensors, about: dict[str, Any]) -> bytes:
    # One metadata key: safetensors writes several in random order, and equal runs must give equal bytes.
    about = about | {"version": own_version()}
    tensors = {name: np.asarray(tensor, order="C") for name, tensor in tensors.items()}  # safetensors takes it for that
    text = json.dumps(about | {CHECKSUM: _checksum(tensors, about)}, sort_keys=True)
    return safetensors.numpy.save(tensors, metadata={"rail_sumo": text})


def _read(path: Path) -> tuple[Tensors, dict[str, Any]]:
    try:
        with safe_open(path, framework="numpy") as file:
            tensors = {name: np.asarray(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118
            about = json.loads(file.metadata()["rail_sumo"])
        written = about.pop(CHECKSUM, None)
        if written not in (None, _checksum(tensors, about)):  # files from before it was there pass
            raise ValueError("its content is not what was written")
        return tensors, about
    except FileNotFoundError:
        raise InputError(
            f"'{path.parent}' is not a complete run directory: it has no {path.name}; restore it or train again"
        ) from None
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise _damaged(path, error) from None


def _checksum(tensors: Tensors, about: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a file's numbers and of what it tells of itself, which safetensors does not keep."""
    named = [name.encode() + tensors[name].tobytes() for name in sorted(tensors)]
    return hashlib.sha256(b"".join([*named, json.dumps(about, sort_keys=True).encode()])).hexdigest()


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(f"'{path}' is truncated or damaged ({type(error).__name__}: {error}); restore it or train again")


def _write(file: Path, content: bytes) -> None:
    with whole_file(file) as partial:
        partial.write_bytes(content)
