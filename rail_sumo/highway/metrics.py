"""Trajectory -> one row: an episode's figures, by the names of the `episodes` table's columns."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rail_sumo.config import Adas
from rail_sumo.highway.reward import lateral_reward, longitudinal_reward
from rail_sumo.highway.vehicle.hard_braking import hard_brakings
from rail_sumo.records import KMH, SECONDS_PER_STEP, MetaAction, Trajectory

NO_APPROACH_S = 3600.0
"""A longer time to collision is no approach: over 200 m that is closing in by less than 0.06 m/s, 0.2 km/h."""


def row(trajectory: Trajectory, adas: Adas) -> dict[str, Any]:
    """Return an episode's row of the `episodes` table, without its columns `policy` and `episode`.

    The trajectory holds at least one step.
    """
    speed_mps = trajectory.speed_mps[1:]
    braking_mps2 = -np.diff(trajectory.speed_mps) / SECONDS_PER_STEP
    return {
        "seed": trajectory.seed,
        "network": trajectory.network,
        "host": trajectory.host,
        "depart_s": trajectory.depart_s,
        "duration_s": len(speed_mps) * SECONDS_PER_STEP,
        "distance_m": trajectory.distance_m,
        "speed_kmh": _speed_kmh(trajectory),
        "overtakes": trajectory.overtakes,
        "overtaken": trajectory.overtaken,
        "lane_changes": trajectory.lane_changes,
        "aborted_lane_changes": trajectory.aborted_lane_changes,
        "longitudinal_reward": longitudinal_reward(speed_mps, trajectory.limit_mps, adas),
        "lateral_reward": lateral_reward(trajectory.lane_changing),
        "collisions": trajectory.collisions,
        "struck": trajectory.struck,
        "refused_decisions": trajectory.refused_decisions,
        "min_ttc_s": trajectory.min_ttc_s if trajectory.min_ttc_s <= NO_APPROACH_S else math.inf,
        "hardest_braking_mps2": max(0.0, float(braking_mps2.max())),
        "hard_brakings": hard_brakings(trajectory.speed_mps),
        "hard_brakings_behind": trajectory.hard_brakings_behind,
        "end_reason": trajectory.end_reason,
    }


def decisions(trajectory: Trajectory) -> dict[str, Any]:
    """Return the columns of an episode's part of the `decisions` table, without `policy` and `episode`."""
    names = np.array([action.name.lower() for action in MetaAction])
    distance_m, x_m, y_m = trajectory.decision_place.reshape(-1, 3).T
    return {
        "time_s": trajectory.decision_step * SECONDS_PER_STEP,
        "distance_m": distance_m,
        "x_m": x_m,
        "y_m": y_m,
        "speed_kmh": trajectory.speed_mps[trajectory.decision_step] * KMH,
        "asked": names[trajectory.decisions],
        "carried_out": names[trajectory.carried_out],
    }


def means(trajectories: Sequence[Trajectory]) -> dict[str, float]:
    """Return the means over one or more episodes that progress reports show, by the table's column names."""
    return {
        "speed_kmh": float(np.mean([_speed_kmh(trajectory) for trajectory in trajectories])),
        "overtakes": float(np.mean([trajectory.overtakes for trajectory in trajectories])),
        "lane_changes": float(np.mean([trajectory.lane_changes for trajectory in trajectories])),
    }


def _speed_kmh(trajectory: Trajectory) -> float:
    """Return distance over duration.

    SUMO moves vehicles by their new speed for the whole step (Euler), or by the mean of the old and the new one
    (ballistic) as soon as any vehicle type has an `actionStepLength` of its own, as those of the made traffic do.
    """
    return trajectory.distance_m / (len(trajectory.limit_mps) * SECONDS_PER_STEP) * KMH
