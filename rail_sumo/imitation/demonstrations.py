"""What an expert saw and decided, and the Parquet file it is kept in."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rail_sumo.config import first_difference, recorded
from rail_sumo.errors import InputError
from rail_sumo.files import whole_file
from rail_sumo.policy import N_ACTIONS
from rail_sumo.records import Floats, Trajectory

ACTION = "action"
EPISODE = "episode"

METADATA_KEY = b"rail_sumo"
"""The file's metadata under this key is JSON: `features`, their names in order, and `about`, what they came from."""

_AGAIN = "record them again with: rail-sumo expert record"


@dataclass(frozen=True)
class Demonstrations:
    """Decisions of one or more episodes, in the order they were made.

    Observations are rounded to float32, in which they are stored: a learner that is handed them fresh and one that
    reads them from a file see the same numbers.

    Raises:
        ValueError: the three arrays do not fit together.
    """

    observations: Floats
    """(n, n_features)."""
    actions: NDArray[np.int64]
    """(n,): the `MetaAction` carried out on each observation; KEEP where another was refused."""
    episode: NDArray[np.int64]
    """(n,): which episode each decision belongs to."""

    def __post_init__(self) -> None:
        if self.observations.ndim != 2 or not len(self.observations) == len(self.actions) == len(self.episode):
            raise ValueError(
                f"demonstrations must have shapes (n, n_features), (n,) and (n,); "
                f"got {self.observations.shape}, {self.actions.shape} and {self.episode.shape}"
            )
        object.__setattr__(self, "observations", self.observations.astype(np.float32).astype(np.float64))

    @property
    def n_episodes(self) -> int:
        """How many episodes there are."""
        return len(np.unique(self.episode))

    def take(self, n_episodes: int) -> "Demonstrations":
        """Return the lowest-numbered `n_episodes` of them.

        Raises:
            InputError: there are fewer, or none is asked for.
        """
        if not 1 <= n_episodes <= self.n_episodes:
            raise InputError(
                f"{n_episodes} demonstrated trajectories wanted, and there are {self.n_episodes}; "
                f"set train.trajectories to 1..{self.n_episodes}, or record more with: rail-sumo expert record"
            )
        taken = np.isin(self.episode, np.unique(self.episode)[:n_episodes])
        return Demonstrations(self.observations[taken], self.actions[taken], self.episode[taken])

    def joined(self, driven: Sequence[tuple[Floats, NDArray[np.int64]]]) -> "Demonstrations":
        """Return these and further episodes' observations and decisions, numbered on."""
        first = int(self.episode.max()) + 1
        observations, actions = zip(*driven, strict=True)
        return Demonstrations(
            np.concatenate([self.observations, *observations]),
            np.concatenate([self.actions, *actions]),
            np.concatenate([self.episode, np.repeat(np.arange(len(driven)) + first, list(map(len, actions)))]),
        )

    @classmethod
    def from_trajectories(cls, trajectories: Sequence[Trajectory]) -> "Demonstrations":
        """Gather what was seen and carried out in driven episodes, at least one, and number them from 0."""
        lengths = [len(trajectory.actions) for trajectory in trajectories]
        return cls(
            np.concatenate([trajectory.observations for trajectory in trajectories]),
            np.concatenate([trajectory.carried_out for trajectory in trajectories]),
            np.repeat(np.arange(len(trajectories)), lengths),
        )

    def save(self, path: Path, *, features: Sequence[str], about: Mapping[str, object]) -> None:
        """Write a Parquet file: a float32 column per feature, `action` (int8) and `episode` (int32).

        The file appears under its name only once it is whole, replacing what was there.

        Args:
            path: where to.
            features: the observation's names in order.
            about: what they came from, as JSON values; goes into the file's metadata.

        Raises:
            ValueError: not one name per feature.
            InputError: the file cannot be written.
        """
        n_features = self.observations.shape[1]
        if len(features) != n_features:
            raise ValueError(f"features must name {n_features} columns; got {len(features)} names")
        columns = dict(zip(features, self.observations.astype(np.float32).T, strict=True))
        columns |= {ACTION: self.actions.astype(np.int8), EPISODE: self.episode.astype(np.int32)}
        metadata = json.dumps({"features": list(features), "about": dict(about)})
        table = pa.table(columns).replace_schema_metadata({METADATA_KEY: metadata})
        with whole_file(path) as partial:
            pq.write_table(table, partial, compression="zstd")

    @classmethod
    def load(
        cls, path: Path, *, features: Sequence[str], demonstrating: Mapping[str, object] | None = None
    ) -> "Demonstrations":
        """Read a Parquet file that `save` wrote, or one with the same columns in any order.

        Args:
            path: where from.
            features: the names of the observation that the learner will drive with, in order.
            demonstrating: how the learner senses and decides, see `Config.demonstrating`; a file that tells the
                configuration it was recorded with must tell the same.

        Raises:
            InputError: no such file, not Parquet, damaged, without a row, recorded with another observation than
                `features` or otherwise than `demonstrating`, or with a value that is missing, not finite or no
                meta-action.
        """
        table = _read(path)
        _check_recording(path, table, demonstrating)
        _check_layout(path, table.column_names, features)
        observations = np.column_stack([_numbers(path, table, name) for name in features])
        actions = _integers(path, table, ACTION)
        stray = actions[(actions < 0) | (actions >= N_ACTIONS)]
        if len(stray):
            raise InputError(f"{_named(path)} have an action {stray[0]}; actions are 0..{N_ACTIONS - 1}; {_AGAIN}")
        return cls(observations, actions, _integers(path, table, EPISODE))


def _named(path: Path) -> str:
    return f"demonstrations '{path}'"


def _read(path: Path) -> pa.Table:
    if not path.is_file():
        raise InputError(f"{_named(path)} not found; give a Parquet file, or {_AGAIN}")
    try:
        with pq.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{_named(path)} are not a Parquet file, or a damaged one ({reason}); {_AGAIN}") from None
    if not table.num_rows:
        raise InputError(f"{_named(path)} hold no decision; {_AGAIN}")
    return table


def _check_recording(path: Path, table: pa.Table, demonstrating: Mapping[str, object] | None) -> None:
    said = (table.schema.metadata or {}).get(METADATA_KEY)
    if demonstrating is None or said is None:
        return  # somebody else's file
    try:
        about = json.loads(said).get("about", {})
        recording = recorded(about["config"]).demonstrating if "config" in about else {}
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{_named(path)} tell of their recording what cannot be read ({error}); {_AGAIN}") from None
    mismatch = first_difference(recording, demonstrating)
    if mismatch:
        raise InputError(f"{_named(path)} were recorded with {mismatch}; set it as it was, or {_AGAIN}")


def _check_layout(path: Path, columns: Sequence[str], features: Sequence[str]) -> None:
    for name in (ACTION, EPISODE):
        if name not in columns:
            raise InputError(f"{_named(path)} have no column '{name}'; {_AGAIN}")
    given = [name for name in columns if name not in (ACTION, EPISODE)]
    if sorted(given) == sorted(features):
        return
    lacking = [name for name in features if name not in given]
    difference = f"no '{lacking[0]}'" if lacking else f"also '{next(n for n in given if n not in features)}'"
    raise InputError(
        f"{_named(path)} have {len(given)} features ({difference}), the configuration wants {len(features)}; "
        f"set [lidar] and [observation] as they were recorded, or {_AGAIN}"
    )


def _numbers(path: Path, table: pa.Table, name: str) -> Floats:
    """Return a feature's column; what overflows float32 counts as infinite."""
    column = table[name]
    if not pa.types.is_floating(column.type):
        raise InputError(
            f"{_named(path)}: column '{name}' must hold floating-point numbers, not {column.type}; {_AGAIN}"
        )
    values = column.to_numpy().astype(np.float64)
    bad = ~(np.abs(values) <= np.finfo(np.float32).max)  # a missing value reads as NaN
    if bad.any():
        row = int(bad.argmax())
        raise InputError(f"{_named(path)}: column '{name}' must be finite, row {row} is {values[row]}; {_AGAIN}")
    return values


def _integers(path: Path, table: pa.Table, name: str) -> NDArray[np.int64]:
    column = table[name]
    if not pa.types.is_integer(column.type) or column.null_count:
        raise InputError(
            f"{_named(path)}: column '{name}' must hold an integer in every row, "
            f"not {column.type} with {column.null_count} missing; {_AGAIN}"
        )
    return column.to_numpy().astype(np.int64)
