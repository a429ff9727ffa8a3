"""What an expert saw and decided, and the Parquet file it is kept in."""

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rail_sumo.config_file import first_difference, recorded
from rail_sumo.errors import InputError
from rail_sumo.files import AnyPath, whole_file
from rail_sumo.policy import N_ACTIONS
from rail_sumo.records import Floats, MetaAction, Trajectory

ACTION = "action"
EPISODE = "episode"
ALLOWED = tuple(f"allowed_{action.name.lower()}" for action in MetaAction)
"""Columns that a file may lack: whether the driver was told that it may choose that meta-action."""

METADATA_KEY = b"rail_sumo"
"""The file's metadata under this key is JSON: `features`, their names in order, and `about`, what they came from."""

DRIVER_SHA256 = "driver_sha256"
"""The key, in `about`, of the SHA-256 of the recorded driver's weights or module; see `roster.content_of`."""

_AGAIN = "record them again with: rail-sumo expert record"
_OF_ANOTHER = (
    f"{_AGAIN} --driver rule, who drives with any senses, or of an expert that senses so (rail-sumo expert train)"
)
_DESCRIBED = "docs/extending.md, 'Demonstrations of your own', describes the columns"
_PANDAS_INDEX = "__index_level_"
"""How the column begins in which pandas stores an index without a name."""


@dataclass(frozen=True)
class Demonstrations:
    """Decisions of one or more episodes, in the order they were made.

    Observations are rounded to float32, in which they are stored: a learner that is handed them fresh and one that
    reads them from a file see the same numbers.

    Raises:
        ValueError: the arrays do not fit together, an observation is not finite in float32, an action is no
            `MetaAction`, or one that was not allowed.
    """

    observations: Floats
    """(n, n_features)."""
    actions: NDArray[np.int64]
    """(n,): the `MetaAction` carried out on each observation; KEEP where another was refused."""
    episode: NDArray[np.int64]
    """(n,): which episode each decision belongs to."""
    allowed: NDArray[np.bool_] = None  # type: ignore[assignment]  # what is given; never None afterwards
    """(n, 5): which meta-actions the driver was told it may choose; without it, all of them."""

    def __post_init__(self) -> None:
        observations = np.asarray(self.observations, dtype=np.float64)
        actions, episode = np.asarray(self.actions), np.asarray(self.episode)
        n, given = len(observations), "all" if self.allowed is None else np.shape(self.allowed)
        allowed = np.ones((n, N_ACTIONS), np.bool_) if self.allowed is None else np.asarray(self.allowed)
        shapes = actions.shape == episode.shape == (n,) and allowed.shape == (n, N_ACTIONS)
        if observations.ndim != 2 or not shapes:
            raise ValueError(
                f"demonstrations must have shapes (n, n_features), (n,), (n,) and (n, {N_ACTIONS}); "
                f"got {observations.shape}, {actions.shape}, {episode.shape} and {given}"
            )
        for name, numbers in (("actions", actions), ("episode", episode)):
            if not np.issubdtype(numbers.dtype, np.integer):
                raise ValueError(f"demonstrations' {name} must be integers; got {numbers.dtype}")
        if allowed.dtype != np.bool_:
            raise ValueError(f"demonstrations' allowed must be true or false; got {allowed.dtype}")
        if not (np.abs(observations) <= np.finfo(np.float32).max).all():
            raise ValueError("demonstrations' observations must be finite, and float32 must hold them")
        strays = actions[(actions < 0) | (actions >= N_ACTIONS)]
        if len(strays):
            raise ValueError(f"demonstrations' actions must lie in 0..{N_ACTIONS - 1}; got {strays[0]}")
        if not allowed[np.arange(n), actions].all():
            raise ValueError("demonstrations hold an action that was not allowed")
        object.__setattr__(self, "observations", observations.astype(np.float32).astype(np.float64))
        object.__setattr__(self, "actions", actions.astype(np.int64))
        object.__setattr__(self, "episode", episode.astype(np.int64))
        object.__setattr__(self, "allowed", allowed)

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
        return self.only(np.unique(self.episode)[:n_episodes])

    def only(self, episodes: NDArray[np.int64]) -> "Demonstrations":
        """Return those of the episodes with these numbers."""
        own = np.isin(self.episode, episodes)
        return Demonstrations(self.observations[own], self.actions[own], self.episode[own], self.allowed[own])

    def _numbered(self) -> NDArray[np.int64]:
        """Return episodes' numbers as they are, or from 0 where they are too large for the file."""
        fits = np.abs(self.episode).max() <= np.iinfo(np.int32).max
        return self.episode if fits else np.unique(self.episode, return_inverse=True)[1]

    def joined(self, others: "Demonstrations") -> "Demonstrations":
        """Return these and other episodes' decisions, those numbered on."""
        return Demonstrations(
            np.concatenate([self.observations, others.observations]),
            np.concatenate([self.actions, others.actions]),
            np.concatenate([self.episode, others.episode + self.episode.max() + 1]),
            np.concatenate([self.allowed, others.allowed]),
        )

    @classmethod
    def from_trajectories(
        cls, trajectories: Sequence[Trajectory], decisions: Sequence[NDArray[np.int64]] | None = None
    ) -> "Demonstrations":
        """Gather what was seen and carried out in driven episodes, at least one, and number them from 0.

        What was carried out counts as allowed, even if the driver did not heed what it was told.

        Args:
            trajectories: the episodes.
            decisions: what another driver would have decided in each, which counts instead.
        """
        if decisions is None:
            decisions = [trajectory.carried_out for trajectory in trajectories]
        actions = np.concatenate(decisions)
        return cls(
            np.concatenate([trajectory.observations for trajectory in trajectories]),
            actions,
            np.repeat(np.arange(len(trajectories)), list(map(len, decisions))),
            np.concatenate([trajectory.allowed for trajectory in trajectories])
            | np.eye(N_ACTIONS, dtype=np.bool_)[actions],
        )

    def save(self, path: AnyPath, *, features: Sequence[str], about: Mapping[str, object]) -> None:
        """Write a Parquet file: a float32 column per feature, `action` (int8), `episode` (int32), booleans `ALLOWED`.

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
        columns |= {ACTION: self.actions.astype(np.int8), EPISODE: self._numbered().astype(np.int32)}
        columns |= dict(zip(ALLOWED, self.allowed.T, strict=True))
        metadata = json.dumps({"features": list(features), "about": dict(about)})
        table = pa.table(columns).replace_schema_metadata({METADATA_KEY: metadata})
        with whole_file(path) as partial:
            split, others = list(features), [ACTION, EPISODE, *ALLOWED]  # split, floats take two thirds of the room
            pq.write_table(table, partial, compression="zstd", use_byte_stream_split=split, use_dictionary=others)

    @classmethod
    def load(
        cls, path: AnyPath, *, features: Sequence[str], demonstrating: Mapping[str, object] | None = None
    ) -> "Demonstrations":
        """Read a Parquet file that `save` wrote, or one with the same columns in any order, maybe without `ALLOWED`.

        Args:
            path: where from.
            features: the names of the observation that the learner will drive with, in order.
            demonstrating: how the learner senses and decides, see `Config.demonstrating`; a file that tells the
                configuration it was recorded with must tell the same.

        Raises:
            InputError: no such file, not Parquet, damaged, without a row, recorded with another observation than
                `features` or otherwise than `demonstrating`, or with a value that is missing, not finite, no
                meta-action or one that was not allowed.
        """
        path = Path(path)
        table = _read(path)
        _check_recording(path, table, demonstrating)
        _check_layout(path, table, features)
        observations = np.column_stack([_numbers(path, table, name) for name in features])
        actions = _integers(path, table, ACTION)
        stray = actions[(actions < 0) | (actions >= N_ACTIONS)]
        if len(stray):
            raise InputError(
                f"{_named(path)} have an action {stray[0]}; actions are 0..{N_ACTIONS - 1}; {_advice(table)}"
            )
        allowed = np.ones((len(actions), N_ACTIONS), np.bool_)
        if ALLOWED[0] in table.column_names:
            allowed = np.column_stack([_booleans(path, table, name) for name in ALLOWED])
            ignored = ~allowed[np.arange(len(actions)), actions]
            if ignored.any():
                raise InputError(
                    f"{_named(path)}: row {int(ignored.argmax())} has an action that its columns "
                    f"{ALLOWED[0]}... do not allow; {_advice(table)}"
                )
        return cls(observations, actions, _integers(path, table, EPISODE), allowed)


def recorded_on(path: Path) -> tuple[str, ...]:
    """Return the networks that a file tells its demonstrations were recorded on, as its configuration names them.

    Raises:
        InputError: it tells so in a way that cannot be read.
    """
    try:
        tree = tomllib.loads(_about(pq.read_schema(path)).get("config", ""))
        return tuple(tree.get("varied", {}).get("networks") or filter(None, [tree.get("network", {}).get("file")]))
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{_named(path)} tell of their recording what cannot be read ({error}); {_AGAIN}") from None


def recorded_by(path: Path) -> tuple[str, str]:
    """Return the name of the driver that a file tells it was recorded of, and the SHA-256 of what that driver is.

    Either is empty where the file does not tell it: somebody else's tells neither, one from before the SHA-256 was
    recorded the name alone, and our own drivers that have not learned have no SHA-256.

    Raises:
        InputError: it tells so in a way that cannot be read.
    """
    try:
        about = _about(pq.read_schema(path))
        return str(about.get("driver", "")), str(about.get(DRIVER_SHA256, ""))
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{_named(path)} tell of their recording what cannot be read ({error}); {_AGAIN}") from None


def _about(schema: pa.Schema) -> Mapping[str, Any]:
    """Return what a file tells of its recording; nothing if it is somebody else's."""
    said = (schema.metadata or {}).get(METADATA_KEY)
    return json.loads(said or "{}").get("about", {})


def _advice(table: pa.Table) -> str:
    """Return what to do about a file: record it again, unless it is a table of somebody's own."""
    return _AGAIN if _is_recorded(table) else _DESCRIBED


def _is_recorded(table: pa.Table) -> bool:
    """Return whether a file tells what it was recorded from, legibly or not."""
    try:
        return _about(table.schema) != {}
    except (ValueError, AttributeError):
        return True


def _named(path: Path) -> str:
    return f"demonstrations '{path}'"


def _read(path: Path) -> pa.Table:
    if not path.is_file():
        raise InputError(f"{_named(path)} not found; give a Parquet file, or record one with: rail-sumo expert record")
    try:
        with pq.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"{_named(path)} are not a Parquet file, or a damaged one ({reason}); write them to one, or {_AGAIN}"
        ) from None
    if not table.num_rows:
        raise InputError(f"{_named(path)} hold no decision; {_advice(table)}")
    return table


def _check_recording(path: Path, table: pa.Table, demonstrating: Mapping[str, object] | None) -> None:
    if demonstrating is None:
        return
    try:
        about = _about(table.schema)
        recording = recorded(about["config"]).demonstrating if "config" in about else {}
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{_named(path)} tell of their recording what cannot be read ({error}); {_AGAIN}") from None
    mismatch = first_difference(recording, demonstrating)
    if mismatch:
        raise InputError(f"{_named(path)} were recorded with {mismatch}; set it as it was, or {_OF_ANOTHER}")


def _check_layout(path: Path, table: pa.Table, features: Sequence[str]) -> None:
    columns = table.column_names
    for name in (ACTION, EPISODE):
        if name not in columns:
            raise InputError(f"{_named(path)} have no column '{name}'; {_advice(table)}")
    if any(name in columns for name in ALLOWED):
        for name in ALLOWED:
            if name not in columns:
                raise InputError(f"{_named(path)} have no column '{name}', but others like it; {_advice(table)}")
    given = [name for name in columns if name not in (ACTION, EPISODE, *ALLOWED)]
    if sorted(given) == sorted(features):
        return
    lacking = [name for name in features if name not in given]
    others = [name for k, name in enumerate(given) if name not in features or name in given[:k]]
    if not lacking and all(name.startswith(_PANDAS_INDEX) for name in others):
        raise InputError(
            f"{_named(path)} have a column '{others[0]}', in which pandas keeps the table's index; leave it out: "
            "to_parquet(..., index=False)"
        )
    difference = f"no '{lacking[0]}'" if lacking else f"also '{others[0]}'"
    remedy = (
        f"set [lidar] and [observation] as they were recorded, or {_OF_ANOTHER}"
        if _is_recorded(table)
        else f"add, rename or leave out columns, or set [lidar] and [observation] to what was sensed; {_DESCRIBED}"
    )
    raise InputError(
        f"{_named(path)} have {len(given)} features ({difference}), the configuration wants {len(features)}, from "
        f"'{features[0]}' to '{features[-1]}'; {remedy}"
    )


def _numbers(path: Path, table: pa.Table, name: str) -> Floats:
    """Return a feature's column; what overflows float32 counts as infinite."""
    column = table[name]
    if not pa.types.is_floating(column.type):
        raise InputError(
            f"{_named(path)}: column '{name}' must hold floating-point numbers, not {column.type}; {_advice(table)}"
        )
    values = column.to_numpy().astype(np.float64)
    bad = ~(np.abs(values) <= np.finfo(np.float32).max)  # a missing value reads as NaN
    if bad.any():
        row = int(bad.argmax())
        raise InputError(
            f"{_named(path)}: column '{name}' must be finite, row {row} is {values[row]}; {_advice(table)}"
        )
    return values


def _integers(path: Path, table: pa.Table, name: str) -> NDArray[np.int64]:
    return _whole(path, table, name, "an integer", pa.types.is_integer).to_numpy().astype(np.int64)


def _booleans(path: Path, table: pa.Table, name: str) -> NDArray[np.bool_]:
    return _whole(path, table, name, "true or false", pa.types.is_boolean).to_numpy()


def _whole(
    path: Path, table: pa.Table, name: str, wanted: str, is_wanted: Callable[[pa.DataType], bool]
) -> pa.ChunkedArray:
    """Return a column of the wanted type in which nothing is missing."""
    column = table[name]
    if not is_wanted(column.type) or column.null_count:
        raise InputError(
            f"{_named(path)}: column '{name}' must hold {wanted} in every row, "
            f"not {column.type} with {column.null_count} missing; {_advice(table)}"
        )
    return column
