"""What driving costs in dense traffic: python benchmarks/crowd.py [--vehicles 1000] [--driven 50] [--set KEY=VALUE].

Of a host among so many vehicles on highway5, a minute from its entry on, beside SUMO stepping alone over the very same
traffic (see throughput.py: all that changes what SUMO does is recorded and replayed, and must end alike); and of so
many driven vehicles at once beside the same demand left as it is. They take turns.
"""

import argparse
import statistics
import tempfile
import time
from typing import Any

from throughput import Recording, record, replay

from rail_sumo import rollout, roster
from rail_sumo.config import Config
from rail_sumo.config_file import load
from rail_sumo.drivers import Driver
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.traffic.fleet import Fleet
from rail_sumo.rollout import Task

MARK, FLEETS_MARK = 0.85, 0.5
"""Of bare SUMO's rate: one host's, and that of many."""
SIMULATED_S = 60.0
DEMAND = """<routes>
    <vType id="car" speedFactor="normc(0.9,0.1,0.7,1.1)"/>
    <route id="road" edges="highway"/>
    <flow id="fill" type="car" route="road" begin="0" end="1" number="{number}" departLane="random"
          departPos="random_free" departSpeed="desired"/>
    <flow id="follow" type="car" route="road" begin="1" end="3600" period="exp(1.5)" departLane="best"
          departSpeed="desired"/>
</routes>"""


def timed(driver: Driver, task: Task, recording: Recording | None = None) -> float:
    """Drive an episode; returns the seconds it took from the host's entry on."""
    env = HighwayEnv(task.config.seen_with(driver.senses))
    try:
        observation, _ = env.reset(seed=task.seed)
        if recording is not None:
            recording.n_before = len(recording.orders)
        started = time.perf_counter()
        while not env.is_over:
            observation, _ = env.drive(driver.decide(observation, env.agent))
        return time.perf_counter() - started
    finally:
        env.close()


def timed_fleet(world: Config, share: float, driver: str) -> tuple[float, Fleet]:
    """Drive a share of the demand; returns the seconds it took, and the fleet."""
    fleet = rollout.fleet_of(driver, world, share, 1)
    started = time.perf_counter()
    fleet.drive(SIMULATED_S)
    return time.perf_counter() - started, fleet


def median_ratio(loop: list[float], bare: list[float]) -> float:
    return statistics.median(b / a for a, b in zip(loop, bare, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--driven", type=int, default=50)
    parser.add_argument("--driver", default="rule", help="of the many: rule, random or keep")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], help="section.key=value, as in rail-sumo eval")
    given = parser.parse_args()
    with tempfile.NamedTemporaryFile("w", suffix=".rou.xml") as demand:
        demand.write(DEMAND.format(number=given.vehicles))
        demand.flush()
        overrides = ["network.file=highway5", f'traffic.routes=["{demand.name}"]', "traffic.begin_s=0"]
        at_once = ["traffic.warm_up_s=0", "traffic.entry_within_s=5", f"episode.duration_s={SIMULATED_S}"]
        one_host(load(None, [*overrides, *at_once, *given.set]), given.repeats)
        world = load(None, [*overrides, *given.set])
        many(world, given.driven / given.vehicles, given.driver, given.repeats)


def one_host(world: Config, repeats: int) -> None:
    expert: Any = roster.find_driver("expert", world)
    task = Task(expert, world, seed=1)
    recording = record(task, lambda task, recording: timed(expert, task, recording))
    loop, bare = [], []
    for _ in range(repeats):
        loop.append(timed(expert, task))
        bare.append(replay(recording))
    print(
        f"one host, {len(recording.end)} vehicles on the road at the end; simulated seconds a second, {repeats} turns"
    )
    for name, seconds in (("full loop", loop), ("bare SUMO", bare)):
        rates = sorted(SIMULATED_S / one for one in seconds)
        print(f"{name}: {statistics.median(rates):.1f} ({rates[0]:.1f} to {rates[-1]:.1f})")
    print(f"of bare SUMO: {median_ratio(loop, bare):.3f} (mark: {MARK})")


def many(world: Config, share: float, driver: str, repeats: int) -> None:
    loop, bare, decisions = [], [], 0
    for _ in range(repeats):
        seconds, fleet = timed_fleet(world, share, driver)
        loop.append(seconds)
        decisions = fleet.decisions
        bare.append(timed_fleet(world, 0.0, driver)[0])
    rates = sorted(decisions / one for one in loop)
    print(
        f"{len(fleet.driven)} vehicles driven by {driver}, {len(fleet.inserted)} in all; with loading, {repeats} turns"
    )
    print(f"decisions a second: {statistics.median(rates):,.0f} ({rates[0]:,.0f} to {rates[-1]:,.0f})")
    print(f"of bare SUMO: {median_ratio(loop, bare):.3f} (mark: {FLEETS_MARK})")


if __name__ == "__main__":
    main()
