"""What driving costs in dense traffic: python benchmarks/crowd.py [--vehicles 1000] [--set KEY=VALUE].

A host among so many vehicles on ring5, two minutes from its entry on, beside SUMO stepping alone over the very same
traffic (see throughput.py: all that changes what SUMO does is recorded and replayed, and must end alike). The two
take turns.
"""

import argparse
import statistics
import time
from typing import Any

from throughput import Recording, record, replay

from rail_sumo import run
from rail_sumo.config_file import load
from rail_sumo.drivers import Driver
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.rollout import Task

OF_THE_DEMAND = 96
"""Vehicles in ring5's demand."""
MARK = 0.85
"""Of bare SUMO's rate."""


def timed(driver: Driver, task: Task, recording: Recording | None = None) -> float:
    """Drive an episode; returns the seconds it took from the host's entry on."""
    env = HighwayEnv(task.config.seen_with(driver.senses))
    try:
        observation, _ = env.reset(seed=task.seed)
        if recording is not None:
            recording.n_before = len(recording.orders)
        started = time.perf_counter()
        while not env.is_over:
            observation, _ = env.drive(driver.decide(observation, env))
        return time.perf_counter() - started
    finally:
        env.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    given = parser.parse_args()
    overrides = [
        "network.file=ring5",
        'traffic.routes=["ring5"]',
        f'traffic.options=["scale={given.vehicles / OF_THE_DEMAND}"]',
        "traffic.begin_s=0",
        "episode.course_m=inf",
        "episode.duration_s=120",
    ]
    world = load(None, [*overrides, *given.set])
    expert: Any = run.find_driver("expert", world)
    task = Task(expert, world, seed=1)
    recording = record(task, lambda task, recording: timed(expert, task, recording))
    loop, bare = [], []
    for _ in range(given.repeats):
        loop.append(timed(expert, task))
        bare.append(replay(recording))
    simulated_s = world.episode.duration_s
    print(
        f"{len(recording.end)} vehicles on the road at the end; simulated seconds per second, median of {given.repeats}"
    )
    for name, seconds in (("full loop", loop), ("bare SUMO", bare)):
        rates = sorted(simulated_s / one for one in seconds)
        print(f"{name}: {statistics.median(rates):.1f} ({rates[0]:.1f} to {rates[-1]:.1f})")
    ratio = statistics.median(b / a for a, b in zip(loop, bare, strict=True))
    print(f"of bare SUMO: {ratio:.3f} (mark: {MARK})")


if __name__ == "__main__":
    main()
