"""What driving is worth, for the expert and the reports; RAIL sees it only where `rail.reward_weight` says so.

The accounting of Min & Kim (IV 2018), from whom the paper takes its simulator, per SUMO step of 0.1 s.
"""

import numpy as np
from numpy.typing import NDArray

from rail_sumo.config import Adas
from rail_sumo.records import KMH, Floats, Trajectory

# Per SUMO step or per event.
LANE_CHANGING = -0.5
OVERTAKE = 0.5
OVERTAKEN = -0.5
REFUSED_DECISION = -0.1
COLLISION = -10.0


def reward(
    speed_mps: Floats,
    lane_changing: NDArray[np.bool_],
    adas: Adas,
    *,
    overtakes: int = 0,
    overtaken: int = 0,
    refused_decisions: int = 0,
    collisions: int = 0,
) -> float:
    """Return the total reward of a stretch of driving, from one decision's steps to a whole episode.

    Args:
        speed_mps: the host's speed after each step, shape (n_steps,); may be empty.
        lane_changing: whether a lane change was under way in each step, shape (n_steps,).
        adas: the host's speed range, which scales the longitudinal part.
        overtakes, overtaken, refused_decisions, collisions: how often each happened in the stretch.
    """
    return (
        longitudinal_reward(speed_mps, adas)
        + lateral_reward(lane_changing)
        + OVERTAKE * overtakes
        + OVERTAKEN * overtaken
        + REFUSED_DECISION * refused_decisions
        + COLLISION * collisions
    )


def total_reward(trajectory: Trajectory, adas: Adas) -> float:
    """Return what an episode earned."""
    return reward(
        trajectory.speed_mps[1:],
        trajectory.lane_changing,
        adas,
        overtakes=trajectory.overtakes,
        overtaken=trajectory.overtaken,
        refused_decisions=trajectory.refused_decisions,
        collisions=int(trajectory.end_reason == "collision"),
    )


def longitudinal_reward(speed_mps: Floats, adas: Adas) -> float:
    """Sum (v - min) / (max - min) over the speeds after each step: 0 at the lowest set speed or below, 1 at the top."""
    lowest_kmh, highest_kmh = adas.min_speed_kmh, adas.max_speed_kmh
    return float(np.maximum(0.0, (KMH * speed_mps - lowest_kmh) / (highest_kmh - lowest_kmh)).sum())


def lateral_reward(lane_changing: NDArray[np.bool_]) -> float:
    """Charge every step in which a lane change is under way, aborted ones included."""
    return LANE_CHANGING * int(lane_changing.sum())
