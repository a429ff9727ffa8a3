"""A world without roads: what the learners' tests are about does not depend on SUMO.

Three sights, drawn anew in every decision; the expert always does the same about the same.
"""

import math

import numpy as np

from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.policy import Policy, Shape, Whitening
from rail_sumo.records import MetaAction, Trajectory

SHAPE = Shape(n_features=3, hidden=None)
WHITENING = Whitening(np.full(3, 1 / 3), np.full(3, np.sqrt(2) / 3))
EXPERT_ACTIONS = np.array([MetaAction.ACCELERATE, MetaAction.LEFT, MetaAction.KEEP])
N_DECISIONS = 40


def sights(seed, n=N_DECISIONS):
    return np.eye(3)[np.random.default_rng(seed).integers(3, size=n)]


def advice(seen):
    """What the expert does about each sight, shape (n,)."""
    return EXPERT_ACTIONS[seen.argmax(axis=1)]


def expert():
    return Demonstrations.from_trajectories([episode(seen, advice(seen)) for seen in map(sights, range(5))])


def agreement(theta, shape=SHAPE, whitening=WHITENING):
    """In what share of the three sights a policy does what the expert does."""
    policy = Policy(theta, shape, whitening)
    return np.mean([policy(sight) == action for sight, action in zip(np.eye(3), EXPERT_ACTIONS, strict=True)])


def wrong_everywhere():
    """A policy that always decelerates, by a small margin, which the expert never does."""
    theta = np.zeros((5, 4))
    theta[MetaAction.DECELERATE, -1] = 0.2
    return theta.ravel()


def episode(observations, actions, end_reason="duration", seed=0, carried_out=None):
    """An episode in which only decisions were made."""
    return Trajectory(
        observations=np.asarray(observations, dtype=np.float64),
        decisions=np.asarray(actions, dtype=np.int64),
        carried_out=np.asarray(actions if carried_out is None else carried_out, dtype=np.int64),
        allowed=np.ones((len(actions), 5), dtype=np.bool_),
        decision_step=np.arange(len(actions)),
        decision_place=np.zeros((len(actions), 3)),
        speed_mps=np.full(len(actions) + 1, 20.0),
        distance_m=2.0 * len(actions),
        limit_mps=np.full(len(actions), 80.0 / 3.6),
        lane_changing=np.zeros(len(actions), dtype=np.bool_),
        overtakes=0,
        overtaken=0,
        lane_changes=0,
        aborted_lane_changes=0,
        refused_decisions=0,
        collisions=int(end_reason == "collision"),
        struck=0,
        hard_brakings_behind=0,
        min_ttc_s=math.inf,
        end_reason=end_reason,
        seed=seed,
        network="nowhere",
        host="host",
        depart_s=0.0,
    )
