"""Task -> Trajectory, and what drives many: serial, processes, Ray."""

import copy
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rail_sumo import drivers
from rail_sumo.config import Config
from rail_sumo.errors import InputError, NotBegun
from rail_sumo.highway.camera import Camera
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.sumo.simulation import Simulation
from rail_sumo.highway.traffic.fleet import Fleet, Instead
from rail_sumo.highway.traffic.rides import Decide
from rail_sumo.policy import PolicyParameters
from rail_sumo.records import EndReason, Floats, Trajectory

# What a traffic seed is for. Children of different purposes never meet, so no learner sees evaluation traffic.
EVALUATION, TRAINING, DEMONSTRATION, EXPERT_TRAINING = range(4)


def traffic_seed(seed: int, *key: int) -> int:
    """Return the traffic seed of the child `key`, for example (TRAINING, iteration, direction), of the run's seed.

    Raises:
        InputError: the seed is negative.
    """
    if seed < 0:
        raise InputError(f"a seed is a whole number from 0 up; got {seed}")
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0] >> 1)


ATTEMPTS = 10
"""How many episodes are tried for one to learn from."""

Who = str | PolicyParameters | drivers.Driver
"""Who drives, as it travels to a worker: a driver's name, parameters, or a driver itself."""


@dataclass(frozen=True)
class Task:
    """One episode to drive: the driver, the world, and the traffic's seed."""

    driver: Who
    config: Config
    seed: int
    adviser: Who | None = None
    """Whose advice `practise_advised` notes."""
    outputs: tuple[str, ...] = ()
    """Further options of SUMO's; see `HighwayEnv`."""


@dataclass(frozen=True)
class Undriven:
    """An episode that could not begin, or in which SUMO stopped."""

    seed: int
    """Of its traffic."""
    end_reason: EndReason
    why: str


Driven = TypeVar("Driven")


def drive(task: Task) -> Trajectory:
    """Drive one episode in this process.

    Raises:
        NotBegun: it cannot begin.
        InputError: SUMO stops.
    """
    return _drive(task, driver_of(task.driver, task.config, task.seed))


def attempt(task: Task) -> Trajectory | Undriven:
    """Drive one episode in this process, or tell why it could not be driven."""
    try:
        return drive(task)
    except InputError as error:
        return Undriven(task.seed, "not begun" if isinstance(error, NotBegun) else "SUMO stopped", str(error))


def practise(task: Task) -> Trajectory:
    """Drive one episode to learn from; where it cannot be driven, one on the next traffic that follows from its seed.

    Raises:
        InputError: none of `ATTEMPTS` could be driven.
    """
    return _practise(drive, task)


def practise_advised(task: Task) -> tuple[Trajectory, NDArray[np.int64]]:
    """Do as `practise` does; return beside it what the task's adviser would have decided, shape (n_decisions,)."""
    return _practise(_drive_advised, task)


def _practise(how: Callable[[Task], Driven], task: Task) -> Driven:
    for attempt_number in range(1, ATTEMPTS):
        try:
            return how(task)
        except InputError:  # it cannot begin, or SUMO stops
            task = replace(task, seed=traffic_seed(task.seed, attempt_number))
    return how(task)


def _drive_advised(task: Task) -> tuple[Trajectory, NDArray[np.int64]]:
    assert task.adviser is not None
    adviser = driver_of(task.adviser, task.config, task.seed)
    driver = drivers.Advised(driver_of(task.driver, task.config, task.seed), adviser)
    return _drive(task, driver), np.array(driver.advice, dtype=np.int64)


def film(task: Task) -> tuple[Camera, Trajectory]:
    """Drive one episode in this process and film it.

    Raises:
        NotBegun: it cannot begin.
        InputError: SUMO stops.
    """
    driver = driver_of(task.driver, task.config, task.seed)
    with closing(_world_of(task, driver)) as env:
        observation = _begin_episode(env, task.seed)
        camera = Camera(env, partial(drivers.probabilities, driver))
        while not env.is_over:
            observation = camera.drive(driver.decide(observation, env.agent))
        return camera, env.trajectory()


def _drive(task: Task, driver: drivers.Driver) -> Trajectory:
    with closing(_world_of(task, driver)) as env:
        observation = _begin_episode(env, task.seed)
        while not env.is_over:
            observation, _ = env.drive(driver.decide(observation, env.agent))
        return env.trajectory()


def _world_of(task: Task, driver: drivers.Driver) -> HighwayEnv:
    return HighwayEnv(
        task.config.seen_with(driver.senses),
        hands_off=drivers.hands_off(task.driver),
        outputs=task.outputs,
        companions=deciders(task.driver, task.config, task.seed),
    )


def _begin_episode(env: HighwayEnv, seed: int) -> Floats:
    try:
        return env.reset(seed=seed)[0]
    except InputError as error:
        raise NotBegun(str(error)) from None


def driver_of(who: Who, config: Config, seed: int) -> drivers.Driver:
    """Return a driver of one vehicle for one episode; what it draws follows from the seed.

    A driver itself tells by `begin(seed)` who that is. One without it is copied, so that what it remembers is the same
    with one worker as with many; or drives as it is, if it cannot be copied.
    """
    if isinstance(who, str):
        return drivers.by_name(who, config, seed)
    if isinstance(who, PolicyParameters):
        return drivers.Learned(who, seed)
    if isinstance(who, drivers.Begins):
        return who.begin(seed)
    try:
        return copy.deepcopy(who)
    except Exception:  # of whatever it holds: an open file, an environment in a process of its own
        return who


def deciders(who: Who, world: Config, seed: int) -> Callable[[str], Decide]:
    """Return what gives each of many vehicles a driver; what that draws follows from the seed and the vehicle's id."""

    def decides(vehicle: str) -> Decide:
        return driver_of(who, world, traffic_seed(seed, *vehicle.encode())).decide

    return decides


def fleet_of(who: Who | Instead, world: Config, share: float, seed: int, outputs: Sequence[str] = ()) -> Fleet:
    """Return a demand of which a share is driven, as the driver senses it; each vehicle draws by its own id.

    Args:
        who: who drives, or what a vehicle of the share gets instead.
        world: network, demand, and how vehicles sense and drive.
        share: of the cars, 0 to 1.
        seed: of the traffic, of which cars are driven, and of whatever a driver draws.
        outputs: further options of SUMO's.
    """
    if who in ("nothing", "acc"):
        return Fleet(world, share, seed, who, outputs)
    return Fleet(world.seen_with(getattr(who, "senses", None)), share, seed, deciders(who, world, seed), outputs)


WorkerCount = int | Literal["ray"]
DROPS_S, ENDS_S = 0.1, 20.0
"""Within these a pool has dropped tasks that are cancelled, which it stumbles over when a worker ends; and a worker has
ended that is told to."""


class Observer(Protocol):
    """Receives progress."""

    def start(self, work: str, total: int, done: int = 0) -> None:
        """Work of `total` parts begins, `done` of them already there."""

    def advance(self, figures: Mapping[str, float]) -> None:
        """One more part is done; figures may tell how it went, by the names of the tables' columns."""

    def note(self, text: str) -> None:
        """Something happened that the user should know of."""


class _Silent:
    def start(self, work: str, total: int, done: int = 0) -> None: ...

    def advance(self, figures: Mapping[str, float]) -> None: ...

    def note(self, text: str) -> None: ...


SILENT = _Silent()


def practise_all(
    work: str, tasks: list[Task], number: WorkerCount, observer: Observer = SILENT
) -> Iterator[Trajectory]:
    """Yield trajectories to learn from in the tasks' order; see `practise` and `workers`."""
    yield from _drive_all(practise, work, tasks, number, observer)


def attempt_all(
    work: str, tasks: list[Task], number: WorkerCount, observer: Observer = SILENT
) -> Iterator[Trajectory | Undriven]:
    """Yield the tasks' trajectories in their order, and why there is none; see `workers`."""
    yield from _drive_all(attempt, work, tasks, number, observer)


def practise_all_advised(
    work: str, tasks: list[Task], number: WorkerCount, observer: Observer = SILENT
) -> Iterator[tuple[Trajectory, NDArray[np.int64]]]:
    """Yield what `practise_advised` returns, in the tasks' order; see `workers`."""
    yield from _drive_all(practise_advised, work, tasks, number, observer)


def drive_all(work: str, tasks: list[Task], number: WorkerCount, observer: Observer = SILENT) -> Iterator[Trajectory]:
    """Yield the tasks' trajectories in their order; see `drive` and `workers`."""
    yield from _drive_all(drive, work, tasks, number, observer)


def _drive_all(
    how: Callable[[Task], Driven], work: str, tasks: list[Task], number: WorkerCount, observer: Observer
) -> Iterator[Driven]:
    if number != "ray" and number < 1:
        raise InputError(f"workers must be 1 or more, or ray; got {number}")
    observer.start(work, len(tasks))
    number = number if number == "ray" else max(1, min(number, len(tasks)))
    if number != 1:
        who = [one for task in tasks for one in (task.driver, task.adviser)]
        _require_picklable({id(one): one for one in who}.values())
    with workers(number, fresh=any(task.outputs for task in tasks)) as pool:
        for driven in pool.map(how, tasks):
            observer.advance({})  # one episode's figures tell little, and nothing of others' episodes
            yield driven


def _require_picklable(who: Iterable[Who | None]) -> None:
    for one in who:
        try:
            pickle.dumps(one)
        except Exception as error:  # whatever the driver's own code raises too
            raise InputError(
                f"driver {type(one).__name__} cannot be sent to worker processes ({error}): define it at the top level "
                "of a module, without open files and functions in it, or drive with one worker"
            ) from None


class Workers(Protocol):
    """Anything with an ordered `map`."""

    def map(self, function: Callable[[Any], Any], iterable: Iterable[Any], /) -> Iterator[Any]:
        """Return the results in the order of the iterable."""


class _Serial:
    map = staticmethod(map)


class _Ray:
    def __init__(self, pool: Any) -> None:
        self.map = pool.imap


@contextmanager
def workers(number: WorkerCount, *, fresh: bool = False) -> Iterator[Workers]:
    """Yield something with a `map`: this process for 1, a pool of processes, or a Ray cluster's.

    The pool spawns its processes, so none of them carries the parent's torch or its open simulation. They leave
    Ctrl-C to the parent, and end with it.

    Args:
        number: how many.
        fresh: whether every task has a process of its own: SUMO keeps in mind, as long as its process lives, which
            vehicles it was first told to write outputs of.

    Raises:
        InputError: Ray is wanted and not installed, or a process of the pool died.
    """
    if number == 1 and not fresh:
        yield _Serial()
        return
    if number == "ray":
        with _ray_pool() as pool:
            yield _Ray(pool)
        return
    spawn = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(number, spawn, initializer=_begin, max_tasks_per_child=1 if fresh else None)
    earlier_children = set(multiprocessing.active_children())
    with _ignoring_ctrl_c():  # the workers inherit it, so none is interrupted while it starts
        for _ in range(0 if fresh else number):
            executor.submit(int)  # each starts one
    try:
        yield executor
    except BrokenProcessPool:
        raise InputError(
            "a worker process died: memory ran out, or SUMO crashed on this network or demand, or a script of yours "
            "starts workers outside of if __name__ == '__main__'; --workers 1 drives in one process and tells which"
        ) from None
    except BaseException:
        stopping = threading.Thread(target=_stop_all_but, args=(earlier_children,))
        stopping.start()
        executor.shutdown(cancel_futures=True)
        stopping.join()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _stop_all_but(others: set[BaseProcess]) -> None:
    """End this process's children, whatever they are at: a task may take minutes yet, and SUMO hear of it late.

    They are joined by the pool alone: of two who do, one may be told for some milliseconds that a child still lives.
    """
    time.sleep(DROPS_S)
    children = set(multiprocessing.active_children()) - others
    for child in children:
        child.terminate()
    for child in children:
        if not wait([child.sentinel], ENDS_S):
            child.kill()


@contextmanager
def _ignoring_ctrl_c() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # which alone hears it
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin() -> None:
    """In a worker: leave Ctrl-C to the parent, and end when the parent says so or ends, so that no orphan works on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: _end())
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        _end()

    threading.Thread(target=follow, daemon=True).start()


def _end() -> None:
    Simulation.clear_away()
    os._exit(1)


def _ray_pool() -> Any:
    try:
        from ray.util.multiprocessing import Pool
    except ImportError:
        raise InputError("--workers ray needs Ray; install it with: pip install 'rail-sumo[ray]'") from None
    return Pool()
