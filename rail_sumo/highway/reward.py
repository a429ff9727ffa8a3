"""What driving is worth, for the expert and the reports; RAIL sees it only where `rail.reward_weight` says so.

The accounting of Min & Kim (IV 2018), whose simulator the paper uses, per SUMO step of 0.1 s.
"""

import numpy as np
from numpy.typing import NDArray

from rail_sumo.config import Adas
from rail_sumo.records import Floats, Trajectory

# Per SUMO step or per event.
LANE_CHANGING = -0.5
OVERTAKE = 0.5
OVERTAKEN = -0.5
REFUSED_DECISION = -0.1
COLLISION = -10.0


def reward(
    speed_mps: Floats,
    limit_mps: Floats,
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
        limit_mps: the speed limit in each step, shape (n_steps,).
        lane_changing: whether a lane change was under way in each step, shape (n_steps,).
        adas: the host's speed range, which scales the longitudinal part.
        overtakes, overtaken, refused_decisions, collisions: how often each happened in the stretch.
    """
    return (
        longitudinal_reward(speed_mps, limit_mps, adas)
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
        trajectory.limit_mps,
        trajectory.lane_changing,
        adas,
        overtakes=trajectory.overtakes,
        overtaken=trajectory.overtaken,
        refused_decisions=trajectory.refused_decisions,
        collisions=int(trajectory.end_reason == "collision"),
    )


def longitudinal_reward(speed_mps: Floats, limit_mps: Floats, adas: Adas) -> float:
    """Sum (v - low) / (high - low) over the speeds after each step; low and high are the range of the set speed there.

    0 at the lowest set speed or below, 1 at the highest, more while the host brakes down to a lower limit; 0 where the
    range is empty.
    """
    per_limit = {limit: (adas.lowest_mps(limit), adas.highest_mps(limit)) for limit in np.unique(limit_mps).tolist()}
    total = 0.0
    for limit, (lowest, highest) in per_limit.items():
        if lowest < highest:
            above = np.maximum(0.0, speed_mps[limit_mps == limit] - lowest)
            total += float(above.sum()) / (highest - lowest)
    return total


def lateral_reward(lane_changing: NDArray[np.bool_]) -> float:
    """Charge every step in which a lane change is under way, aborted ones included."""
    return LANE_CHANGING * int(lane_changing.sum()) + 0.0  # not -0.0
