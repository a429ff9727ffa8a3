"""Task -> Trajectory, and a `map` that drives many: serial, processes, Ray."""

from dataclasses import dataclass

import numpy as np

from rail_sumo.config import Config
from rail_sumo.policy import Policy, Shape, Whitening
from rail_sumo.records import Floats, Trajectory

# What a traffic seed is for. Children of different purposes never meet, so no learner sees evaluation traffic.
EVALUATION, TRAINING, DEMONSTRATION, EXPERT = range(4)


def traffic_seed(seed: int, *key: int) -> int:
    """Return the traffic seed of the child `key`, for example (TRAINING, iteration, direction), of the run's seed."""
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0] >> 1)


@dataclass(frozen=True)
class LearnedDriver:
    """A supervisor by its parameters: what travels to a worker."""

    theta: Floats
    shape: Shape
    whitening: Whitening

    def policy(self) -> Policy:
        """Return the callable supervisor."""
        return Policy(self.theta, self.shape, self.whitening)


@dataclass(frozen=True)
class Task:
    """One episode to drive: by whom, in which world, on which traffic."""

    driver: str | LearnedDriver
    config: Config
    seed: int


def drive(task: Task) -> Trajectory:
    """Drive one episode in this process."""
    raise NotImplementedError
