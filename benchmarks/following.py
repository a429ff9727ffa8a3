"""How the host follows: python benchmarks/following.py.

Two tables, each row a drive of its own on SUMO. The host comes up to five standing cars that are in sight from 250 m
on. Then it drives behind a leader whose speed swings by 10 km/h to either side.
"""

import argparse
import math

import libsumo
import numpy as np
from rich.console import Console
from rich.table import Table

from rail_sumo import config
from rail_sumo.highway.network import road
from rail_sumo.highway.sumo.simulation import HOST, Simulation
from rail_sumo.records import KMH, SECONDS_PER_STEP, Command

ANY_SPEED = config.Adas(max_speed_kmh=140.0, min_speed_kmh=40.0)
START_M, LANE, CAR_M = 500.0, 2, 5.0
SWING_KMH = 10.0


def simulate() -> Simulation:
    course = road.load("highway5")
    simulation = Simulation(course.net_file, seed=1)
    simulation.lay_course(course, ANY_SPEED, sees_m=100.0)
    libsumo.route.add("along", ["highway"])
    libsumo.lane.setMaxSpeed(f"highway_{LANE}", ANY_SPEED.highest_mps(0.0))
    return simulation


def add(name: str, gap_m: float, speed_mps: float) -> None:
    """Put a car ahead of the host that drives as it is told, whatever lies ahead of it."""
    front_m = START_M + gap_m + CAR_M
    libsumo.vehicle.add(name, "along", departLane=str(LANE), departPos=str(front_m), departSpeed=str(speed_mps))
    libsumo.vehicle.setSpeedMode(name, 0)
    libsumo.vehicle.setLaneChangeMode(name, 0)
    libsumo.vehicle.setSpeed(name, speed_mps)


def gap_m(name: str) -> float:
    return libsumo.vehicle.getLanePosition(name) - CAR_M - libsumo.vehicle.getLanePosition(HOST)


def standing_queue(kmh: float) -> tuple[float, float, float]:
    """Return the hardest braking, the smallest time to collision and the gap at rest."""
    with simulate() as simulation:
        simulation.add_host(["highway"], lane=LANE, front_m=START_M, speed_mps=kmh / KMH)
        for car in range(5):
            add(f"queue{car}", 250.0 + 7.5 * car, 0.0)
        simulation.wait_for_host()
        simulation.run(Command(kmh / KMH, steps=600))
        host = simulation.host
        return -np.diff(host.speeds_mps).min() / SECONDS_PER_STEP, host.min_ttc_s, gap_m("queue0")


def swing(kmh: float, period_s: float) -> float:
    """Return how much the host swings in the last period of three minutes, as a share of its leader's swing."""
    mean_mps, swing_mps = kmh / KMH, SWING_KMH / KMH
    with simulate() as simulation:
        simulation.add_host(["highway"], lane=LANE, front_m=START_M, speed_mps=mean_mps)
        add("leader", ANY_SPEED.standstill_gap_m + ANY_SPEED.time_gap_s * mean_mps, mean_mps)
        simulation.wait_for_host()
        for step in range(round(180.0 / SECONDS_PER_STEP)):
            phase = 2 * math.pi * step * SECONDS_PER_STEP / period_s
            libsumo.vehicle.setSpeed("leader", mean_mps + swing_mps * math.sin(phase))
            simulation.run(Command(mean_mps + 2 * swing_mps))
        return np.ptp(simulation.host.speeds_mps[-round(period_s / SECONDS_PER_STEP) :]) / (2 * swing_mps)


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    console = Console(width=100)
    queue = Table("from, km/h", "hardest braking, m/s²", "smallest time to collision, s", "gap at rest, m")
    for kmh in (50, 80, 100, 130):
        queue.add_row(str(kmh), *(f"{figure:.2f}" for figure in standing_queue(kmh)))
    periods = (10, 20, 30, 60)
    swings = Table("swing, of the leader's", *(f"{period} s" for period in periods))
    for kmh in (40, 70, 110):
        swings.add_row(f"around {kmh} km/h", *(f"{swing(kmh, period):.2f}" for period in periods))
    console.print(queue, swings)


if __name__ == "__main__":
    main()
