"""The policy's input vector, laid out and named."""

from collections import deque

import numpy as np

from rail_sumo import config
from rail_sumo.records import Floats

UNREACHED = 200.0
"""Beyond any speed, relative speed (m/s) or lateral offset (m) on a road."""


def feature_names(lidar: config.Lidar, observation: config.Observation) -> list[str]:
    """Return the name of every feature, units included, oldest frame last."""
    frame = [f"distance_{ray}_m" for ray in range(lidar.n_rays)]
    frame += [f"relative_speed_{ray}_mps" for ray in range(lidar.n_rays)]
    if observation.host_speed:
        frame.append("host_speed_mps")
    if observation.speed_limit:
        frame.append("speed_limit_mps")
    if observation.lateral_state:
        frame.append("lateral_m")
    ages = ["" if age == 0 else f"_{age}_ago" for age in range(observation.frames)]
    return [name + age for age in ages for name in frame]


def bounds(lidar: config.Lidar, observation: config.Observation) -> tuple[Floats, Floats]:
    """Return the lowest and highest value of every feature: ranges for distances, what no car reaches for the rest."""
    names = feature_names(lidar, observation)
    is_distance = np.array([name.startswith("distance") for name in names])
    return np.where(is_distance, 0.0, -UNREACHED), np.where(is_distance, lidar.max_range_m, UNREACHED)


class Layout:
    """Builds observations of shape (len(feature_names),), within `bounds`; an episode's first fills every frame."""

    def __init__(self, lidar: config.Lidar, observation: config.Observation) -> None:
        self.n_features = len(feature_names(lidar, observation))
        self._observation = observation
        self._frames: deque[Floats] = deque(maxlen=observation.frames)

    def reset(self) -> None:
        """Forget the frames of the last episode."""
        self._frames.clear()

    def observe(self, scan: Floats, *, speed_mps: float, limit_mps: float, lateral_m: float) -> Floats:
        """Return the observation after one more scan.

        Args:
            scan: distances and relative speeds, shape (2, n_rays), as `Lidar.scan` returns it.
            speed_mps: the host's speed.
            limit_mps: the speed limit where it is; what no car can drive counts as no limit.
            lateral_m: its offset from the centre of the lane it started its lane change on, leftwards positive.
        """
        extras = []
        if self._observation.host_speed:
            extras.append(speed_mps)
        if self._observation.speed_limit:
            extras.append(min(limit_mps, config.FASTEST_CAR_MPS))
        if self._observation.lateral_state:
            extras.append(lateral_m)
        frame = np.append(scan, extras) if extras else scan.ravel()
        if self._observation.frames == 1:
            return frame
        self._frames.appendleft(frame)
        while len(self._frames) < self._observation.frames:
            self._frames.append(frame)
        return np.concatenate(self._frames)
