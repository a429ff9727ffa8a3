"""How fast it drives, beside what else could drive: python benchmarks/throughput.py [--quick] [--run DIR].

One table of simulated seconds per second: the whole loop with a two-layer policy, SUMO alone on the very same traffic,
the same traffic over a TraCI socket, and highway-env; then two workers against one, and a worker's memory; then agent
decisions per second of the environment of several agents, beside highway-env's with as many.
`benchmarks/README.md` says what each row is.
"""

import argparse
import importlib.util
import itertools
import math
import multiprocessing
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import libsumo
import numpy as np
from rich.console import Console
from rich.table import Table

import rail_sumo
from rail_sumo import cli  # noqa: F401  spawned workers import this module again: let them carry what the CLI's carry
from rail_sumo.config import Config
from rail_sumo.config_file import load
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST
from rail_sumo.highway.vehicle.lidar import Lidar
from rail_sumo.policy import Policy, PolicyParameters
from rail_sumo.records import SECONDS_PER_STEP, Scene
from rail_sumo.rollout import EVALUATION, Task, Workers, drive, traffic_seed, workers
from rail_sumo.run_directory import RunDirectory

INSTALL = "pip install 'rail-sumo[benchmarks]'"
VEHICLES = 20  # around the host, in every contender's world
OF_BARE, OF_HIGHWAY_ENV, OF_ONE_WORKER, MEMORY_MB = 0.65, 100.0, 1.9, 300.0  # the marks we set ourselves

Drive = Callable[[], float]
"""Drives for a while and returns the simulated seconds per second of wall-clock time, or the agent decisions."""
AGENTS = 8
RING = "ring5"  # whose shipped demand all agents drive in


@dataclass(frozen=True)
class Size:
    """How much is driven."""

    repeats: int
    episodes: int
    highway_env_s: int
    traci_s: int
    agents_s: int
    agents_highway_env_s: int
    worker_episodes: int


FULL = Size(
    repeats=7, episodes=4, highway_env_s=30, traci_s=30, agents_s=120, agents_highway_env_s=10, worker_episodes=32
)
QUICK = Size(repeats=3, episodes=1, highway_env_s=8, traci_s=8, agents_s=30, agents_highway_env_s=4, worker_episodes=16)


@dataclass
class Recording:
    """Everything that was told to SUMO in one episode, steps included, and where its vehicles were at the end."""

    arguments: list[str] = field(default_factory=list)
    orders: list[tuple[str, str, tuple[Any, ...], dict[str, Any]]] = field(default_factory=list)
    """(domain, function, positional and keyword arguments) of each."""
    n_before: int = 0
    """How many of them came before the host drove."""
    end: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def simulated_s(self) -> float:
        """How much time went on."""
        return SECONDS_PER_STEP * sum(function == "step" for _, function, _, _ in self.orders)

    def begin(self, seconds: float) -> "Recording":
        """Return its first seconds, without an end."""
        steps = itertools.accumulate(function == "step" for _, function, _, _ in self.orders)
        n_orders = next((i for i, n in enumerate(steps, 1) if n * SECONDS_PER_STEP >= seconds), len(self.orders))
        return Recording(self.arguments, self.orders[:n_orders])


def positions(api: Any) -> dict[str, tuple[float, float]]:
    """Return where every vehicle is."""
    return {name: api.vehicle.getPosition(name) for name in api.vehicle.getIDList()}


def record(task: Task, how: Callable[[Task, Recording], Any] = lambda task, _: drive(task)) -> Recording:
    """Drive an episode and write down all that changes what SUMO does; asking and watching change nothing."""
    recording = Recording()

    def watch(domain: str, function: str) -> Any:
        original = getattr(getattr(libsumo, domain), function)

        def told(*args: Any, **kwargs: Any) -> Any:
            recording.orders.append((domain, function, args, kwargs))
            return original(*args, **kwargs)

        return mock.patch.object(getattr(libsumo, domain), function, told)

    def start(arguments: list[str], original: Callable[[list[str]], Any] = libsumo.start) -> Any:
        recording.arguments = arguments[1:]  # without the program's name
        return original(arguments)

    def close(original: Callable[[], None] = libsumo.close) -> None:
        recording.end = positions(libsumo)
        original()

    with ExitStack() as patches:
        for domain in ("vehicle", "vehicletype", "route", "simulation"):
            for function in filter(changes_something, dir(getattr(libsumo, domain))):
                patches.enter_context(watch(domain, function))
        patches.enter_context(mock.patch.object(libsumo, "start", start))
        patches.enter_context(mock.patch.object(libsumo, "close", close))
        how(task, recording)
    return recording


def changes_something(function: str) -> bool:
    """Whether a function of a libsumo domain, by its name, can change what happens."""
    return function in ("add", "remove", "copy", "step") or re.match("set|change|slow|move", function) is not None


def replay(recording: Recording) -> float:
    """Step SUMO through a recording and nothing else; returns the seconds it took, from the host's entry on.

    Raises:
        RuntimeError: the vehicles did not end where they were: it was not the same traffic.
    """
    libsumo.start(["sumo", *recording.arguments])
    orders = [partial(getattr(getattr(libsumo, d), f), *args, **kwargs) for d, f, args, kwargs in recording.orders]
    for order in orders[: recording.n_before]:
        order()
    started = time.perf_counter()
    for order in orders[recording.n_before :]:
        order()
    seconds = time.perf_counter() - started
    end = positions(libsumo)
    libsumo.close()
    if recording.end and end != recording.end:
        raise RuntimeError("the replay's vehicles did not end where the recorded ones did")
    return seconds


def full_loop(tasks: list[Task]) -> float:
    """Drive whole episodes, from loading the network to closing it."""
    started = time.perf_counter()
    simulated_s = sum(len(drive(task).lane_changing) for task in tasks) * SECONDS_PER_STEP
    return simulated_s / (time.perf_counter() - started)


def bare_sumo(recordings: list[Recording]) -> float:
    """Replay the same episodes."""
    return sum(recording.simulated_s for recording in recordings) / sum(map(replay, recordings))


def highway_env(seconds: int) -> float:
    """Drive highway-env, sized alike, with IDLE as every decision; making and resetting it is not timed."""
    import gymnasium
    import highway_env

    gymnasium.register_envs(highway_env)
    settings = {
        "lanes_count": 5,
        "vehicles_count": VEHICLES,
        "observation": {"type": "LidarObservation", "cells": 24},
        "simulation_frequency": 10,
        "policy_frequency": 1,
    }
    env = gymnasium.make("highway-fast-v0", config=settings)
    seed, over, spent = itertools.count(), True, 0.0
    for _ in range(seconds):
        if over:
            env.reset(seed=next(seed))
        started = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(1)
        spent += time.perf_counter() - started
        over = terminated or truncated
    env.close()
    return seconds / spent


def agents_of_ours(seconds: int) -> float:
    """Let `AGENTS` cars keep their lanes; returns agent decisions per second of the core, resetting not timed."""
    env = rail_sumo.parallel_env(AGENTS, ring(seconds))
    env.reset(seed=0)
    while len(env.agents) < AGENTS:  # they depart within seconds of one another
        env.step(dict.fromkeys(env.agents, 0))
    decisions, started = 0, time.process_time()
    for _ in range(seconds):
        decisions += len(env.agents)
        env.step(dict.fromkeys(env.agents, 0))
    spent = time.process_time() - started
    env.close()
    return decisions / spent


def ring(seconds: int) -> dict[str, Any]:
    """Return the world of the agents, whose episodes last longer than they are driven."""
    return {
        "network": {"file": RING},
        "traffic": {"entry_within_s": 0.0},
        "episode": {"course_m": math.inf, "duration_s": 2.0 * seconds + 600.0},
    }


def vehicles_on_the_ring() -> int:
    """Return how many vehicles share the road with the agents, these included, once all have entered."""
    env = rail_sumo.parallel_env(AGENTS, ring(1))
    env.reset(seed=0)
    while len(env.agents) < AGENTS:
        env.step(dict.fromkeys(env.agents, 0))
    number = libsumo.vehicle.getIDCount()
    env.close()
    return int(number)


def agents_of_highway_env(seconds: int, vehicles: int) -> float:
    """Drive highway-env with `AGENTS` controlled vehicles, all idle; returns agent decisions per second of the core.

    Making and resetting it is not timed.
    """
    import gymnasium
    import highway_env

    gymnasium.register_envs(highway_env)
    settings = {
        "lanes_count": 5,
        "controlled_vehicles": AGENTS,
        "vehicles_count": vehicles - AGENTS,
        "observation": {
            "type": "MultiAgentObservation",
            "observation_config": {"type": "LidarObservation", "cells": 24},
        },
        "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}},
        "simulation_frequency": 10,
        "policy_frequency": 1,
        "duration": seconds,
    }
    # Its checkers take the environment of one agent for granted.
    env = gymnasium.make("highway-fast-v0", config=settings, disable_env_checker=True)
    seed, over, spent = itertools.count(), True, 0.0
    for _ in range(seconds):
        if over:
            env.reset(seed=next(seed))
        started = time.process_time()
        _, _, terminated, truncated, _ = env.step((1,) * AGENTS)
        spent += time.process_time() - started
        over = terminated or truncated
    env.close()
    return AGENTS * seconds / spent


@contextmanager
def traci_sumo(arguments: list[str]) -> Iterator[Any]:
    """Start a SUMO process and yield TraCI, connected to it."""
    import traci

    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        traci.start([str(find_sumo()), *arguments], stdout=subprocess.DEVNULL)
        try:
            yield traci
        finally:
            traci.close()


def find_sumo() -> str | None:
    """Return the sumo program: beside this Python, or on the path."""
    beside = Path(sys.executable).with_name("sumo")
    return str(beside) if beside.exists() else shutil.which("sumo")


def over_traci(recording: Recording, task: Task) -> float:
    """Drive the same traffic over a socket, as one would write it: getters every step, scan and policy every decision.

    The recorded orders stand for the deciding, so that the traffic is the same; starting SUMO is not timed.
    """
    assert isinstance(task.driver, PolicyParameters)
    config, policy = task.config, task.driver.policy()
    borders = road.load(config.network.file).boundaries
    lidar = Lidar(config.lidar.n_rays, config.lidar.max_range_m, borders if config.lidar.road_edges else None)
    decision_steps = round(config.episode.decision_period_s / SECONDS_PER_STEP)
    steps = 0
    with traci_sumo(recording.arguments) as traci:
        started = time.perf_counter()
        for domain, function, args, kwargs in recording.orders:
            getattr(getattr(traci, domain), function)(*args, **kwargs)
            if function == "step":
                vehicles = {name: look(traci.vehicle, name) for name in traci.vehicle.getIDList()}
                steps += 1
                if steps % decision_steps == 0:
                    decide(policy, lidar, vehicles)
        return steps * SECONDS_PER_STEP / (time.perf_counter() - started)


def look(vehicle: Any, name: str) -> tuple[float, ...]:
    """Ask for what a box takes."""
    (x, y), angle = vehicle.getPosition(name), vehicle.getAngle(name)
    return x, y, np.radians(90.0 - angle), vehicle.getSpeed(name), vehicle.getLength(name), vehicle.getWidth(name)


def decide(policy: Policy, lidar: Lidar, vehicles: dict[str, tuple[float, ...]]) -> int:
    """Scan from the host and ask the policy."""
    host = vehicles.pop(HOST, None)
    if host is None:
        return 0
    x, y, heading, speed, length, width = np.array([host, *vehicles.values()]).T
    x, y = x - 0.5 * length * np.cos(heading), y - 0.5 * length * np.sin(heading)
    scene = Scene(0.0, [HOST, *vehicles], np.array((x, y, heading, speed, length, width)))
    return policy(lidar.scan(scene).ravel())


def with_workers(pool: Workers, tasks: list[Task]) -> float:
    """Drive episodes with workers that are up and warm."""
    started = time.perf_counter()
    simulated_s = sum(len(trajectory.lane_changing) for trajectory in pool.map(drive, tasks)) * SECONDS_PER_STEP
    return simulated_s / (time.perf_counter() - started)


def memory_mb(pid: int) -> dict[str, float]:
    """Return a process's memory: resident, its proportional share of it, and the most that was ever resident."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text() + Path(f"/proc/{pid}/status").read_text()
    names = {"RSS": "Rss", "PSS": "Pss", "peak RSS": "VmHWM"}
    found = dict(re.findall(r"^(\w+):\s+(\d+) kB", text, re.M))
    return {name: float(found[key]) / 1024 for name, key in names.items()}


def policy_of(run: Path | None, config: Config) -> PolicyParameters:
    """Return a run directory's policy; without one, a clone of the shipped demonstrations, with seed 0."""
    if run is not None:
        return RunDirectory(run).policy()
    from rail_sumo import assets
    from rail_sumo.highway.observation import feature_names
    from rail_sumo.imitation import bc
    from rail_sumo.imitation.demonstrations import Demonstrations
    from rail_sumo.policy import Shape, Whitening

    features = feature_names(config.lidar, config.observation)
    demonstrations = Demonstrations.load(assets.expert("demonstrations.parquet"), features=features)
    whitening, shape = Whitening.of(demonstrations.observations), Shape(len(features), config.policy.hidden)
    return PolicyParameters(bc.clone(demonstrations, shape, whitening, config.cloning, seed=0), shape, whitening)


@dataclass
class Row:
    """One contender and how fast it was, time after time."""

    name: str
    drive: Drive
    speeds: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        """The middle one of its speeds."""
        return statistics.median(self.speeds)


def interleave(rows: list[Row], repeats: int) -> None:
    """Let the contenders take turns, so that a slow minute of the machine strikes all of them."""
    for _ in range(repeats):
        for row in rows:
            row.speeds.append(row.drive())


def table(rows: list[Row], bare: Row, other: Row | None, marks: dict[str, str]) -> Table:
    """Return the rows with their ratios."""
    shown = Table(title="simulated seconds per second, one core unless the row says otherwise", title_justify="left")
    for heading in ("", "median", "min .. max", "x bare SUMO", "x highway-env", "mark"):
        shown.add_column(heading, justify="right" if heading else "left")
    for row in rows:
        spread = f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}"
        beside = f"{row.median / other.median:.1f}" if other else ""
        shown.add_row(
            row.name, f"{row.median:,.0f}", spread, f"{row.median / bare.median:.3f}", beside, marks.get(row.name, "")
        )
    return shown


def table_of_agents(rows: list[Row], vehicles: int) -> Table:
    """Return the rows of the environments of several agents."""
    title = f"agent decisions per second of one core: {AGENTS} agents among {vehicles} vehicles"
    shown = Table(title=title, title_justify="left")
    for heading in ("", "median", "min .. max", "x highway-env"):
        shown.add_column(heading, justify="right" if heading else "left")
    for row in rows:
        spread = f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}"
        beside = f"{row.median / rows[1].median:.1f}" if len(rows) > 1 else ""
        shown.add_row(row.name, f"{row.median:,.0f}", spread, beside)
    return shown


def measure_agents(size: Size) -> Table:
    """Measure the environment of several agents, beside highway-env's if it is installed."""
    vehicles = vehicles_on_the_ring()
    rows = [Row(f"rail_sumo.parallel_env, {RING}", partial(agents_of_ours, size.agents_s))]
    if importlib.util.find_spec("highway_env"):
        other = partial(agents_of_highway_env, size.agents_highway_env_s, vehicles)
        rows.append(Row("highway-env, highway-fast-v0", other))
    interleave(rows, size.repeats)
    return table_of_agents(rows, vehicles)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--run", type=Path, help="a run directory whose policy drives; else a clone of the expert")
    parser.add_argument("--agents", action="store_true", help="measure the environments of several agents alone")
    parser.add_argument("--quick", action="store_true", help="a short run, to see that it works")
    arguments = parser.parse_args()
    size = QUICK if arguments.quick else FULL
    console = Console(width=120)
    describe_machine(console)
    if arguments.agents:
        console.print(measure_agents(size))
        return

    config = load(None, [f"traffic.vehicles={VEHICLES}"])
    driver = policy_of(arguments.run, config)
    tasks = [Task(driver, config, traffic_seed(0, EVALUATION, episode)) for episode in range(size.worker_episodes)]
    recordings = [record(task) for task in tasks[: size.episodes]]
    loop = Row("full loop, two-layer policy", partial(full_loop, tasks[: size.episodes]))
    bare = Row("bare SUMO, the same traffic", partial(bare_sumo, recordings))
    rows, other = [loop, bare], None
    if importlib.util.find_spec("highway_env"):
        other = Row("highway-env, highway-fast-v0", partial(highway_env, size.highway_env_s))
        rows.append(other)
    else:
        console.print(f"highway-env is not installed; to set it beside: {INSTALL}")
    if importlib.util.find_spec("traci") and find_sumo():
        rows.append(
            Row("the same over TraCI with getters", partial(over_traci, recordings[0].begin(size.traci_s), tasks[0]))
        )
    else:
        console.print(f"the sumo program is not installed; to set TraCI beside: {INSTALL}")
    interleave(rows, size.repeats)

    with workers(1) as serial, workers(2) as pair:
        pids = [child.pid for child in multiprocessing.active_children()]
        with_workers(pair, tasks[:8])
        one = Row("one worker", partial(with_workers, serial, tasks[: len(tasks) // 2]))
        two = Row("two workers, two cores", partial(with_workers, pair, tasks))
        interleave([one, two], max(3, size.repeats // 2))
        memory = [memory_mb(pid) for pid in pids if pid is not None]
    marks = {
        loop.name: f">= {OF_BARE:.2f}, >= {OF_HIGHWAY_ENV:.0f}",
        two.name: f"{two.median / one.median:.2f} x one; >= {OF_ONE_WORKER}",
    }
    shown = table([*rows, one, two], bare, other, marks)
    used = ", ".join(f"{name} {max(worker[name] for worker in memory):.0f}" for name in memory[0])
    shown.caption = f"A worker's memory, MB: {used}; mark: < {MEMORY_MB:.0f}."
    console.print(shown)
    console.print(measure_agents(size))


def describe_machine(console: Console) -> None:
    """Print what the figures hold for."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("libsumo", "numpy", "gymnasium", "highway-env"))
    console.print(f"Python {platform.python_version()}, {packages}; {os.cpu_count()} cores, {platform.machine()}")
    load, _, _ = os.getloadavg()
    if load > 0.3:
        console.print(f"warning: the machine is busy (load {load:.1f}); the figures are too low and unsteady")


if __name__ == "__main__":
    main()
