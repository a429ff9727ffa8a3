"""Train, evaluate, demonstrate: what the command line does, each in one call."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rail_sumo import assets, drivers, learners, origin, roster, training
from rail_sumo.config import Config
from rail_sumo.config_file import dumps
from rail_sumo.errors import InputError
from rail_sumo.files import AnyPath, check_file, check_folder, whole_file, whole_folder
from rail_sumo.highway import metrics, varied
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.observation import feature_names
from rail_sumo.highway.sumo.options import floating_car_data
from rail_sumo.imitation.demonstrations import DRIVER_SHA256, Demonstrations
from rail_sumo.policy import ARGMAX, SAMPLED
from rail_sumo.records import Trajectory
from rail_sumo.rollout import (
    DEMONSTRATION,
    EVALUATION,
    SILENT,
    Observer,
    Task,
    Undriven,
    Who,
    WorkerCount,
    attempt_all,
    deciders,
    drive_all,
    practise_all,
    practise_all_advised,
    traffic_seed,
)
from rail_sumo.tables import report

BRIEF_S = 10.0
"""A warning follows where episodes last less than this in the mean, unless `episode.duration_s` itself is shorter."""
PART = "part.parquet"
"""The file of one episode's floating-car data, in a folder of its own."""


class Tables(NamedTuple):
    """What an evaluation has measured."""

    episodes: pd.DataFrame
    summary: pd.DataFrame
    decisions: pd.DataFrame

    def write(self, folder: AnyPath, *, overwrite: bool = False) -> None:
        """Write them into a folder, which is there whole or not at all; see `report.write`."""
        with whole_folder(folder, overwrite=overwrite) as whole:
            self.save(whole)

    def save(self, folder: Path) -> None:
        """Write them into a folder that is not whole yet."""
        report.save(folder, episodes=self.episodes, summary=self.summary)
        self.decisions.to_parquet(folder / report.DECISIONS, index=False)  # it is long: not as CSV too


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while episodes were driven: the tables of those that are done, and how many there were to be."""

    def __init__(self, tables: Tables, episodes: int) -> None:
        super().__init__()
        self.tables = tables
        self.episodes = episodes


def evaluate(
    policies: Mapping[str, Who],
    world: Config,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
    fcd: AnyPath | None = None,
    reference: str | None = None,
) -> Tables:
    """Drive every policy through the same held-out episodes and return the tables.

    Args:
        policies: the name in the tables, and who drives: a name as of `roster.find_driver`, what that returns, or a
            driver of your own.
        world: the same for all of them.
        episodes: how many; number i has the same traffic for every policy, and in every call with this seed.
        seed: of the traffic, which no training with any seed has met.
        workers: how many processes drive, or "ray". The tables do not depend on it.
        observer: called after every episode.
        fcd: a new folder for SUMO's floating-car data: the host, and who is within reach of its LIDAR, on every step.
            `pandas.read_parquet` reads the folder as one table, to which it adds `policy` and `episode`.
        reference: the policy that the summary's ratios and differences refer to; by default an expert, else the last.

    An episode that cannot begin, or in which SUMO stops, is told to the observer; its row has an `end_reason` and no
    figures, and the summary leaves it out.

    Raises:
        Interrupted: by Ctrl-C; it holds the tables of the episodes that are done.
        InputError: no policies, or the reference is none of them; fewer than one episode, a network or demand in which
            none could be driven, or floating-car data that cannot be written.
    """
    if not policies:
        raise InputError("name at least one policy to evaluate")
    if reference is not None and reference not in policies:
        raise InputError(f"reference '{reference}' is not among the policies: {', '.join(policies)}; name it there too")
    policies = {name: roster.who_drives(who, world) for name, who in policies.items()}
    require_drivable(world, episodes, policies.values())
    fcd = Path(fcd) if fcd else None
    if fcd:
        _check_fcd(fcd, workers)
    own = demand.read(world.traffic)
    for warning in (*demand.warnings(own, world.traffic), *road.misdrawn(world.network.file)):
        observer.note(warning)
    # One episode of everybody's after another: where that is interrupted, everybody has driven all but the last.
    labels = [(name, episode) for episode in range(episodes) for name in policies]
    tasks = [
        Task(
            policies[name],
            world,
            traffic_seed(seed, EVALUATION, episode),
            outputs=_floating_car_data(fcd, world, policy=name, episode=episode) if fcd else (),
        )
        for name, episode in labels
    ]
    results = _Results(policies, world, reference or report.reference_among(list(policies)))
    try:
        for label, driven in zip(labels, attempt_all("eval", tasks, workers, observer), strict=True):
            results.add(*label, driven)
    except KeyboardInterrupt:
        results.drop_unshared()
        if results.any_driven:
            raise Interrupted(results.tables(), len(labels)) from None
        raise
    except InputError:
        raise
    except Exception as error:  # of a driver of somebody's own
        name, episode = labels[results.n_added]
        error.add_note(f"while '{name}' drove episode {episode}")
        raise
    if not results.any_driven:
        raise InputError(results.undriven[0][-1])
    for name, episode, why in results.undriven:
        observer.note(f"{name} did not drive episode {episode}: {why}")
    if fcd:
        _require_whole(fcd)
    tables = results.tables()
    for doubt in _doubts(tables.episodes, world, draws_cars=own.has_traffic and episodes > 1):
        observer.note(doubt)
    return tables


def _doubts(episodes: pd.DataFrame, world: Config, *, draws_cars: bool) -> Iterator[str]:
    """Tell what makes the episodes say less than they seem to."""
    hosts = episodes["host"].dropna()
    if draws_cars and world.traffic.host == "replaces" and len(hosts) > 1 and hosts.nunique() == 1:
        yield (
            f"every episode drives the same car, '{hosts.iloc[0]}', since the demand has no other to draw: the "
            "intervals tell nothing of other cars; name one by traffic.host, or change traffic.begin_s"
        )
    lasts_s = episodes["duration_s"].mean()
    if lasts_s < min(BRIEF_S, world.episode.duration_s):
        yield (
            f"episodes last {lasts_s:.0f} s in the mean, and tell how hosts enter rather than how they drive; use a "
            "longer road, or longer routes"
        )


class _Results:
    """What the episodes of an evaluation came to, as far as they are driven; arguments as of `evaluate`."""

    def __init__(self, policies: Mapping[str, Who], world: Config, reference: str) -> None:
        self._policies = policies
        self._world = world
        self._reference = reference
        self._network = assets.network_name(world.network.file)
        self._rows: list[dict[str, Any]] = []
        self._decided: list[tuple[str, int, dict[str, Any]]] = []
        self.undriven: list[tuple[str, int, str]] = []
        """Policy, number and why, of episodes that could not be driven."""

    def add(self, name: str, episode: int, driven: Trajectory | Undriven) -> None:
        """Note a policy's episode."""
        if isinstance(driven, Undriven):
            self.undriven.append((name, episode, driven.why))
            told: dict[str, Any] = {"seed": driven.seed, "network": self._network, "end_reason": driven.end_reason}
        else:
            told = metrics.row(driven, self._world.adas)
            if not drivers.hands_off(self._policies[name]):
                self._decided.append((name, episode, metrics.decisions(driven)))
        self._rows.append({"policy": name, "episode": episode, **told})

    def drop_unshared(self) -> None:
        """Leave out the episode that not all have driven, unless there is no other."""
        whole = len(self._rows) // len(self._policies)
        if whole:
            self._rows = [row for row in self._rows if row["episode"] < whole]
            self._decided = [of_episode for of_episode in self._decided if of_episode[1] < whole]

    @property
    def n_added(self) -> int:
        """How many episodes there are."""
        return len(self._rows)

    @property
    def any_driven(self) -> bool:
        """Whether any episode was driven."""
        return len(self._rows) > len(self.undriven)

    def tables(self) -> Tables:
        """Return the tables, one policy after another."""
        rank = {name: number for number, name in enumerate(self._policies)}
        table = report.episodes(sorted(self._rows, key=lambda row: rank[row["policy"]]))
        decided = sorted(self._decided, key=lambda of_episode: rank[of_episode[0]])
        return Tables(table, report.summary(table, self._reference), report.decisions(decided))


def drive(
    driver: Who,
    world: Config,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
) -> list[Trajectory]:
    """Return what a driver saw, decided and did in the held-out episodes that `evaluate` has with this seed.

    Args:
        driver: who drives, as in `evaluate`.
        world: where.
        episodes: how many.
        seed: of the traffic.
        workers: how many processes drive, or "ray".
        observer: called after every episode.

    Raises:
        InputError: as in `evaluate`; or one of the episodes could not be driven.
    """
    who = roster.who_drives(driver, world)
    require_drivable(world, episodes, [who])
    tasks = [Task(who, world, traffic_seed(seed, EVALUATION, episode)) for episode in range(episodes)]
    return list(drive_all("drive", tasks, workers, observer))


def record(
    driver: Who,
    world: Config,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    observer: Observer = SILENT,
    adviser: Who | None = None,
) -> Demonstrations:
    """Return what a driver sees and carries out in traffic of its own, which no evaluation or training meets.

    The arguments are those of `drive`.

    Args:
        adviser: whose decisions are recorded in place of those that are carried out, as DAgger needs them; a driver
            with the same senses.

    Raises:
        InputError: no such driver; driver or adviser is SUMO's own, which takes no decisions; the adviser has other
            senses than the driver; or none of several attempts at an episode could be driven.
    """
    who = roster.who_decides(driver, world)
    advice = None if adviser is None else roster.who_advises(adviser, world, who)
    seeds = [traffic_seed(seed, DEMONSTRATION, episode) for episode in range(episodes)]
    tasks = [Task(who, world, one, adviser=advice) for one in seeds]
    if advice is None:
        return Demonstrations.from_trajectories(list(practise_all("record", tasks, workers, observer)))
    driven = practise_all_advised("record", tasks, workers, observer)
    return Demonstrations.from_trajectories(*map(list, zip(*driven, strict=True)))


def demonstrate(
    driver: str,
    world: Config,
    out: AnyPath,
    *,
    episodes: int,
    seed: int,
    workers: WorkerCount = 1,
    overwrite: bool = False,
    observer: Observer = SILENT,
) -> Demonstrations:
    """Record a driver, by name, expert's folder or run directory, into a file; see `record` and `evaluate`.

    Where the world's senses are the default ones, the driver's own are recorded, and the observer is told.

    Raises:
        InputError: the file `out` is not named FILE.parquet, exists and is not to be overwritten, or cannot be written;
            the world has senses of its own, and the driver others; bad input of any kind.
    """
    if Path(out).suffix != ".parquet":
        raise InputError(f"demonstrations are a Parquet file, FILE.parquet; got '{out}'")
    check_file(out, overwrite=overwrite)
    require_drivable(world, episodes)
    who = roster.who_decides(driver, world)
    if not isinstance(who, str) and world.senses == Config().senses:
        given, world = world, world.seen_with(who.senses)
        if keys := drivers.settings(world.sensing, given.sensing):
            observer.note(f"the demonstrations have the senses of '{driver}'; to learn from them, set {keys}")
    if episodes < (wanted := world.train.trajectories):
        observer.note(f"learners want {wanted} episodes; to learn from so few, set train.trajectories={episodes}")
    drivers.require_same_senses(who, world, f"driver '{driver}'")
    demonstrations = record(who, world, episodes=episodes, seed=seed, workers=workers, observer=observer)
    about = {"driver": driver, "seed": str(seed), "config": dumps(world)}
    if content := roster.content_of(driver, world):
        about[DRIVER_SHA256] = content
    demonstrations.save(out, features=feature_names(world.lidar, world.observation), about=about)
    return demonstrations


def train(
    config: Config,
    out: AnyPath,
    *,
    seed: int,
    workers: WorkerCount = 1,
    resume: bool = False,
    observer: Observer = SILENT,
) -> Tables:
    """Learn a driver, and compare it on held-out traffic with the expert and, in either mode, with its clone.

    The run directory `out` appears once there is something to start from. From then on training may be interrupted at
    any moment, by kill -9 too, and with `resume` goes on to the very same policy, or to more iterations.

    Raises:
        InputError: `out` exists, or with `resume` is no run of this configuration, seed and files, or one of more
            iterations already; anything that is wrong with the configuration, the network, the demand or the
            demonstrations.
    """
    out = Path(out)
    require_drivable(config, config.train.evaluation_episodes)
    expert = drivers.load_expert(config)
    run = training.learn(config, out, seed=seed, workers=workers, resume=resume, observer=observer)
    policies: dict[str, Who] = {config.train.learner: run.policy()}
    if learners.learner_of(config).compared_with_clone:
        policies |= {f"clone, {mode}": run.clone.acting(mode) for mode in (ARGMAX, SAMPLED)}
    policies[report.EXPERT] = expert
    episodes = config.train.evaluation_episodes
    tables = evaluate(policies, config, episodes=episodes, seed=seed, workers=workers, observer=observer)
    tables.write(out, overwrite=True)
    own = tables.summary[tables.summary["policy"] == config.train.learner]
    means, notes = own.set_index("metric")["mean"], list(training.other_expert(config))
    with whole_file(out / assets.MANIFEST) as partial:
        partial.write_text(origin.manifest(out, means, seed, run.inputs, notes), encoding="utf-8")
    return tables


def _check_fcd(folder: Path, workers: WorkerCount) -> None:
    if workers == "ray":
        raise InputError("floating-car data are written on this machine: drive with a number of --workers, not ray")
    check_folder(folder)
    if {":", "$"}.intersection(str(folder)):
        raise InputError("SUMO writes floating-car data to no path with ':' or '$' in it; choose another for --out")


def _floating_car_data(folder: Path, world: Config, **part: str | int) -> tuple[str, ...]:
    """Return the options for one episode's part of a table, in a new folder named after the part as Hive does."""
    place = folder.joinpath(*(f"{key}={quote(str(value), safe='')}" for key, value in part.items()))
    place.mkdir(parents=True)
    return floating_car_data(place / PART, reach_m=world.lidar.max_range_m)


def _require_whole(folder: Path) -> None:
    """Raise InputError if a part is not whole, which SUMO does not tell."""
    for part in sorted(folder.rglob(PART)):
        try:
            pq.read_metadata(part)
        except (OSError, pa.ArrowException):
            raise InputError(
                f"SUMO could not write its floating-car data whole ('{part}'); is the disk full?"
            ) from None


def require_drivable(world: Config, episodes: int = 1, who: Iterable[Who] = ("keep",)) -> None:
    """Raise InputError for what can be known to be wrong before anybody of those who are to drive does."""
    if episodes < 1:
        raise InputError(f"episodes must be at least 1; got {episodes}")
    for fixed, hands_off in itertools.product(varied.one_of_each(world), {drivers.hands_off(one) for one in who}):
        HighwayEnv(fixed, hands_off=hands_off, companions=deciders("keep", fixed, 0))
