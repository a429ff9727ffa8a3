"""How much of a course an episode drives: from where, how fast at most, how far."""

import math
from dataclasses import dataclass

from rail_sumo.config import Adas, Config
from rail_sumo.errors import CourseError
from rail_sumo.highway.network.road import Road
from rail_sumo.highway.sumo.placing import VEHICLE_M
from rail_sumo.highway.vehicle.passing import NEAR_M
from rail_sumo.records import KMH

MARGIN_M = 50.0
"""Room between the traffic window and the road's start, and between the host and the road's end."""
SHORT_START = 0.25
"""In a window of traffic on a short road the host starts after this share of it."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """What follows from a course, a place to start and a configuration."""

    road: Road
    start_m: float
    """Place on the course where the host starts, its front."""
    fastest_mps: float
    """The host's highest set speed on its course."""
    overrun_m: float
    """How much road it needs beyond where it looks for the last time."""
    near_m: float
    """Within what distance others are counted as passed."""
    sees_m: float
    """How far from the host, along either axis, a scene shows vehicles."""
    farthest_m: float
    """How far an episode goes at most, and the overrun."""

    @classmethod
    def along(cls, road: Road, config: Config, start_m: float, *, to_its_end: bool = False) -> "Stretch":
        """Return the stretch of a course that begins at a place on it.

        Args:
            road: the course.
            config: how a host drives, and for how long.
            start_m: the place, its front.
            to_its_end: whether it is driven to its last metre, where the vehicle arrives, and not only as far as a
                host looks for the last time.

        Raises:
            CourseError: the course is too short from there, or has limits with which nobody can drive.
        """
        fastest_mps = _fastest_mps(road, config.adas)
        closes_m = config.episode.decision_period_s * fastest_mps
        overrun_m, near_m = MARGIN_M + closes_m, max(NEAR_M, closes_m + VEHICLE_M)
        if to_its_end:
            overrun_m = 0.0
        farthest_m = min(config.episode.course_m, config.episode.duration_s * fastest_mps) + overrun_m
        sees_m = max(config.lidar.max_range_m, near_m) + VEHICLE_M
        found = cls(road, start_m, fastest_mps, overrun_m, near_m, sees_m, farthest_m)
        if found.drivable_m <= 0.0:
            raise CourseError(
                f"network '{road.name}': the course is {road.length_m:.0f} m long, and the host needs {start_m:.0f} m "
                f"of it behind its start and {overrun_m:.0f} m to spare at the end; use a longer course"
            )
        return found

    @classmethod
    def in_window(cls, road: Road, config: Config) -> "Stretch":
        """Return the stretch on which a window of traffic has room behind the host; on a short road it has less.

        Raises:
            CourseError: as in `along`.
        """
        whole_m = config.traffic.behind_m + MARGIN_M
        return cls.along(road, config, whole_m if road.is_loop else min(whole_m, SHORT_START * road.length_m))

    @property
    def drivable_m(self) -> float:
        """How far the host can drive before the road ends; inf on a loop."""
        return math.inf if self.road.is_loop else self.road.length_m - self.start_m - self.overrun_m


def _fastest_mps(course: Road, adas: Adas) -> float:
    """Return the host's highest set speed on its course.

    Raises:
        CourseError: a limit, or a range of set speeds, with which nobody can drive.
    """
    for edge in course.edges:
        if edge.limit_mps <= 0.0:
            raise CourseError(
                f"network '{course.name}': edge '{edge.id}' has a speed limit of {edge.limit_mps * KMH:.0f} km/h; "
                f"correct the network, or lead network.course around it"
            )
    limit_mps = course.highest_limit_mps
    lowest_mps, highest_mps = adas.lowest_mps(limit_mps), adas.highest_mps(limit_mps)
    if lowest_mps >= highest_mps:
        raise CourseError(
            f"network '{course.name}': the lowest set speed, {lowest_mps * KMH:.0f} km/h (adas.min_speed_kmh = "
            f"{adas.min_speed_kmh}), is not below the highest, {highest_mps * KMH:.0f} km/h (adas.max_speed_kmh = "
            f"{adas.max_speed_kmh}), where the limit is {limit_mps * KMH:.0f} km/h; lower the one or raise the other"
        )
    return highest_mps
