"""What a driver should see on any road: python benchmarks/road_senses.py CONFIG ROADS [--episodes 300] [--on 6].

Records the rule driver, who knows its true neighbours, in the varied worlds of a configuration with a LIDAR of 72
rays and 200 m. From that follows what fewer rays, a shorter range, more frames, or no speed or limit would have shown.
For each of these senses a clone is trained, and told by how well it predicts the rule driver's decisions on roads that
it was not trained on (those of ROADS, see roads.py): the cross-entropy among the allowed meta-actions, in nats per
decision, with its standard error over episodes. Lower is better: what cannot be seen cannot be predicted.
"""

import argparse
import contextlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from roads import listed

from rail_sumo import config_file, run
from rail_sumo.config import Config
from rail_sumo.imitation import bc
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Policy, Shape, Whitening
from rail_sumo.records import Floats

RAYS, RANGE_M = 72, 200.0
RICH: dict[str, Any] = {
    "lidar": {"n_rays": RAYS, "max_range_m": RANGE_M},
    "observation": {"host_speed": True, "speed_limit": True, "frames": 1},
}


class Senses(NamedTuple):
    rays: int = 24
    range_m: float = 100.0
    speed: bool = True
    limit: bool = True
    frames: int = 1

    def __str__(self) -> str:
        extras = [name for name, has in (("speed", self.speed), ("limit", self.limit)) if has] or ["nothing else"]
        return f"{self.rays} rays, {self.range_m:.0f} m, {' and '.join(extras)}, {self.frames} frames"


COMPARED = (
    Senses(speed=False, limit=False),
    Senses(limit=False),
    Senses(speed=False),
    Senses(),
    Senses(range_m=200.0),
    Senses(frames=2),
    Senses(range_m=200.0, frames=2),
    Senses(range_m=200.0, frames=3),
    Senses(rays=36, range_m=200.0, frames=2),
    Senses(rays=72, range_m=200.0, frames=2),
)


def seen(shown: Demonstrations, senses: Senses) -> Demonstrations:
    """Return what would have been seen with poorer senses than these were recorded with."""
    rays = np.arange(0, RAYS, RAYS // senses.rays)
    distance_m = shown.observations[:, rays]
    relative_mps = np.where(distance_m < senses.range_m, shown.observations[:, RAYS + rays], 0.0)
    speed, limit = shown.observations[:, 2 * RAYS], shown.observations[:, 2 * RAYS + 1]
    extras = [column for column, has in ((speed, senses.speed), (limit, senses.limit)) if has]
    newest = np.column_stack([np.minimum(distance_m, senses.range_m), relative_mps, *extras])
    frames, begins = [newest], np.flatnonzero(np.diff(shown.episode, prepend=-1))
    for _ in range(1, senses.frames):
        before = np.roll(frames[-1], 1, axis=0)
        before[begins] = frames[-1][begins]
        frames.append(before)
    return Demonstrations(np.hstack(frames), shown.actions, shown.episode, shown.allowed)


def surprise(clone: Policy, shown: Demonstrations) -> Floats:
    """Return each decision's cross-entropy under a clone that chooses among what was allowed."""
    outputs = np.array([clone.outputs(observation) for observation in shown.observations])
    outputs = np.where(shown.allowed, outputs, -np.inf)
    outputs -= outputs.max(axis=1, keepdims=True)
    return np.log(np.exp(outputs).sum(axis=1)) - outputs[np.arange(len(outputs)), shown.actions]


def recorded(world: Config, episodes: int, seed: int) -> Demonstrations:
    rich = world.changed(**RICH)
    return run.record("rule", rich, episodes=episodes, seed=seed, workers=2)


def joined(parts: list[Demonstrations]) -> Demonstrations:
    """Return recordings end to end; no two of their episodes have the same number."""
    episode, n = [], 0
    for part in parts:
        episode.append(part.episode + n)
        n += int(part.episode.max()) + 1
    return Demonstrations(
        np.concatenate([part.observations for part in parts]),
        np.concatenate([part.actions for part in parts]),
        np.concatenate(episode),
        np.concatenate([part.allowed for part in parts]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", type=Path)
    parser.add_argument("roads", type=Path)
    parser.add_argument("--episodes", type=int, default=300, help="in the varied worlds")
    parser.add_argument("--on", type=int, default=6, help="episodes on each of the roads")
    parser.add_argument("--seed", type=int, default=1811)
    given = parser.parse_args()
    world = config_file.load(given.config)
    training = recorded(world, given.episodes, given.seed)
    with contextlib.chdir(given.roads.parent):
        roads = listed(Path(given.roads.name))
        others = joined([recorded(config_file.load(None, overrides), given.on, given.seed) for _, overrides in roads])
    print(f"{len(training.actions)} decisions in varied worlds, {len(others.actions)} on {len(roads)} other roads")
    print("| senses | nats per decision | ± |\n| --- | --- | --- |", flush=True)
    for senses in COMPARED:
        shown, held_out = seen(training, senses), seen(others, senses)
        whitening = Whitening.of(shown.observations)
        shape = Shape(shown.observations.shape[1], world.policy.hidden)
        theta = bc.clone(shown, shape, whitening, world.cloning, given.seed, masked=True)
        nats = surprise(Policy(theta, shape, whitening), held_out)
        means = [nats[held_out.episode == episode].mean() for episode in np.unique(held_out.episode)]
        error = np.std(means, ddof=1) / np.sqrt(len(means))
        print(f"| {senses} | {np.mean(means):.3f} | {error:.3f} |", flush=True)


if __name__ == "__main__":
    main()
