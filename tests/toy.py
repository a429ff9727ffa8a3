"""Episodes of a world without roads: what the learners' tests are about does not depend on SUMO."""

import math

import numpy as np

from rail_sumo.records import Trajectory


def episode(observations, actions, end_reason="duration", seed=0):
    """An episode in which only decisions were made."""
    return Trajectory(
        observations=np.asarray(observations, dtype=np.float64),
        actions=np.asarray(actions, dtype=np.int64),
        speed_mps=np.full(len(actions) + 1, 20.0),
        lane_changing=np.zeros(len(actions), dtype=np.bool_),
        overtakes=0,
        overtaken=0,
        lane_changes=0,
        aborted_lane_changes=0,
        refused_decisions=0,
        collisions=int(end_reason == "collision"),
        struck=0,
        min_ttc_s=math.inf,
        end_reason=end_reason,
        seed=seed,
        network="nowhere",
    )
