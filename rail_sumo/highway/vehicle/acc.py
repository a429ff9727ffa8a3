"""Adaptive cruise control: how fast the host drives behind the vehicle ahead. Pure: knows nothing of SUMO.

It acts at every SUMO step and only ever lowers the set speed. What it needs beyond its own limits of braking, because
somebody cuts in or brakes hard, is emergency braking: the car-following model of the host's vehicle type.
"""

import math
from typing import NamedTuple

from rail_sumo.config import Adas
from rail_sumo.highway.compiled import compiled
from rail_sumo.records import SECONDS_PER_STEP

SIGHT_M = 250.0
"""How far ahead the host looks for a leader, at least."""
RESPONSE_S = 0.5
"""The host aims at the speed that its gap will allow after this time. It smooths the leader's unsteadiness; behind a
leader that swings the host swings less as long as this is no longer than its time gap."""

SPARE_M, SPARE_S = 1.0, 0.1
"""How much farther, and how much longer in time, the host falls back behind a vehicle in a lane beside than behind one
in its own: it would come to a gap that is just long enough too slowly, and that would open and close again."""

FALLS_BACK_S = 4.0
"""Within about what time that gap is opened: behind one that has cut in it takes 15 s, and a queue may be nearer."""

AEB_TIME_GAP_S = 0.5
"""What emergency braking keeps to the vehicle ahead: less than adaptive cruise control does, which it is not to
disturb. SUMO keeps clear of contacts as long as this is no shorter than a step."""

# ISO 15622: adaptive cruise control brakes no harder than this at these speeds, and in proportion between them.
SLOW_MPS, FAST_MPS = 5.0, 20.0
HARDEST_WHEN_SLOW_MPS2, HARDEST_WHEN_FAST_MPS2 = 5.0, 3.5


class Leader(NamedTuple):
    """The vehicle ahead."""

    gap_m: float
    """From bumper to bumper."""
    speed_mps: float
    acceleration_mps2: float = 0.0
    """Averaged over the last half second, or for as long as it has been the leader."""


def sight_m(speed_mps: float, adas: Adas) -> float:
    """Return how far ahead the host must see to brake comfortably for a standing queue."""
    at_rest_m = adas.standstill_gap_m + adas.time_gap_s * speed_mps
    return max(SIGHT_M, braking_distance_m(speed_mps, adas.comfort_braking_mps2) + at_rest_m)


def braking_distance_m(speed_mps: float, braking_mps2: float) -> float:
    """Return how far a vehicle drives while it brakes evenly to a standstill: v^2 / (2 b)."""
    return speed_mps**2 / (2 * braking_mps2)


def allowed_mps(leader: Leader, adas: Adas) -> float:
    """Return the highest speed that needs no more than comfortable braking for the leader."""
    room_m = leader.gap_m - adas.standstill_gap_m
    return _allowed_mps(room_m, leader.speed_mps, adas.comfort_braking_mps2, adas.time_gap_s)


def following_mps(speed_mps: float, leader: Leader, adas: Adas) -> float:
    """Return the speed at the end of the next step that the leader allows, not counting how fast the host can speed up.

    The host brakes evenly towards its time gap: comfortably where it sees the leader in time, else as hard as it takes,
    up to `hardest_braking_mps2`.
    """
    return _following_mps(
        speed_mps,
        *leader,
        adas.standstill_gap_m,
        adas.time_gap_s,
        adas.comfort_braking_mps2,
        adas.emergency_braking_mps2,
        SECONDS_PER_STEP,
    )


def falling_in_mps(speed_mps: float, other: Leader, adas: Adas) -> float:
    """Return the speed at the end of the next step that opens a gap behind a vehicle in a lane beside.

    As behind a leader, but with no more than comfortable braking, and where the gap is too short, faster.
    """
    farther = other._replace(gap_m=other.gap_m - SPARE_M - SPARE_S * speed_mps)
    lacks_m = adas.standstill_gap_m + adas.time_gap_s * other.speed_mps - farther.gap_m
    opening_mps = max(other.speed_mps - lacks_m / FALLS_BACK_S, 0.0) if lacks_m > 0.0 else math.inf
    slowest_mps = speed_mps - adas.comfort_braking_mps2 * SECONDS_PER_STEP
    return max(min(following_mps(speed_mps, farther, adas), opening_mps), slowest_mps)


def letting_in_mps(speed_mps: float, other: Leader, stands_in_m: float, adas: Adas) -> float:
    """Return the speed at the end of the next step with which the host lets in a vehicle that must leave a lane beside.

    It falls in behind it, if it can come down comfortably to the speed that one drives at, or leaves a gap once both
    stand. Else it goes ahead: inf.

    Args:
        speed_mps: of the host.
        other: the vehicle that asks.
        stands_in_m: how far ahead of itself that one has to stand.
        adas: limits of the host's car-following.
    """
    closing_mps, comfort_mps2 = max(speed_mps - other.speed_mps, 0.0), adas.comfort_braking_mps2
    driving_m = other.gap_m - braking_distance_m(closing_mps, comfort_mps2)
    standing_m = other.gap_m + stands_in_m - braking_distance_m(speed_mps, comfort_mps2)
    has_room = max(driving_m, standing_m) >= adas.standstill_gap_m + SPARE_M / 2
    return falling_in_mps(speed_mps, other, adas) if has_room else math.inf


def needed_mps2(speed_mps: float, leader: Leader, adas: Adas) -> float:
    """Return the even braking that keeps the host clear of its leader; inf where nothing does."""
    room_m = leader.gap_m - adas.standstill_gap_m
    return _needed_mps2(speed_mps, room_m, leader.speed_mps, max(-leader.acceleration_mps2, 0.0), adas.time_gap_s)


def emergency_gap_m(speed_mps: float, leader_mps: float, braking_mps2: float) -> float:
    """Return the gap beyond the standstill gap below which emergency braking of this strength begins.

    T v + (v^2 - w^2) / (2 b) behind a leader of speed w (Krauss, 1998): it stays clear even if that one brakes as hard.
    """
    return AEB_TIME_GAP_S * speed_mps + (speed_mps**2 - leader_mps**2) / (2 * braking_mps2)


@compiled("float64(float64)")
def hardest_braking_mps2(speed_mps: float) -> float:
    """Return the hardest braking of adaptive cruise control at a speed (ISO 15622)."""
    part = min(max((speed_mps - SLOW_MPS) / (FAST_MPS - SLOW_MPS), 0.0), 1.0)
    return HARDEST_WHEN_SLOW_MPS2 + part * (HARDEST_WHEN_FAST_MPS2 - HARDEST_WHEN_SLOW_MPS2)


@compiled("float64(float64, float64, float64, float64)")
def _allowed_mps(room_m: float, leader_mps: float, braking_mps2: float, time_gap_s: float) -> float:
    """Return the speed from which even braking leads to the time gap behind a leader that brakes as hard.

    v^2 = u^2 + 2 b (s - T u) with u the leader's speed, at least b T. Nearer than T u to a slower leader the time gap
    T = s / v alone is kept, or braking would end in a jerk: there the two curves touch.
    """
    steady = max(leader_mps, braking_mps2 * time_gap_s)
    even = math.sqrt(max(steady**2 + 2 * braking_mps2 * (room_m - time_gap_s * steady), 0.0))
    return even if room_m >= time_gap_s * steady else max(even, max(room_m, 0.0) / time_gap_s)


@compiled("float64(float64, float64, float64, float64, float64)")
def _needed_mps2(
    speed_mps: float, room_m: float, leader_mps: float, leader_braking_mps2: float, time_gap_s: float
) -> float:
    """Return the even braking that keeps the host clear of a leader that goes on as it does now.

    The constant-acceleration heuristic of Kesting, Treiber & Helbing (2010): towards the place where a braking leader
    will stand, or towards its speed before the time gap is used up. Of a gap that is shorter already, as behind a
    vehicle that has cut in, half may be used up.
    """
    closing_mps = speed_mps - leader_mps
    if room_m <= 0.0:
        return math.inf if closing_mps > 0.0 else 0.0
    if leader_braking_mps2 > 0.0 and leader_mps * closing_mps <= 2 * room_m * leader_braking_mps2:
        return speed_mps**2 * leader_braking_mps2 / (leader_mps**2 + 2 * room_m * leader_braking_mps2)
    to_time_gap_m = max(room_m - time_gap_s * leader_mps, room_m / 2)
    return leader_braking_mps2 + max(closing_mps, 0.0) ** 2 / (2 * to_time_gap_m)


@compiled("float64(float64, float64, float64, float64, float64, float64, float64, float64, float64)")
def _following_mps(
    speed_mps: float,
    gap_m: float,
    leader_mps: float,
    leader_acceleration_mps2: float,
    standstill_gap_m: float,
    time_gap_s: float,
    comfort_braking_mps2: float,
    emergency_braking_mps2: float,
    step_s: float,
) -> float:
    room_m = gap_m - standstill_gap_m
    hardest = min(hardest_braking_mps2(speed_mps), emergency_braking_mps2)
    needed = _needed_mps2(speed_mps, room_m, leader_mps, max(-leader_acceleration_mps2, 0.0), time_gap_s)
    braking = min(max(needed, comfort_braking_mps2), hardest)
    soon_m = room_m - (speed_mps - leader_mps) * RESPONSE_S
    aim_mps = _allowed_mps(soon_m, leader_mps, braking, time_gap_s)
    acceleration_mps2 = max((aim_mps - speed_mps) / RESPONSE_S, -braking)
    return max(0.0, speed_mps + acceleration_mps2 * step_s)
