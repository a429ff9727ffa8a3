"""Draw the highway as the host sees it, from a real episode: python docs/highway.py [--driver NAME] [--out FILE].

Needs matplotlib: pip install 'rail-sumo[render]'. Of all the moments of the episode at which a decision fell due, it
draws the one with the most to see: vehicles that the LIDAR hits, ahead and to the sides, and some that it misses.
"""

import argparse
from pathlib import Path

import numpy as np

from rail_sumo import drivers
from rail_sumo.config import Config
from rail_sumo.highway.drawing import Moment, Picture, View
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import markings, road
from rail_sumo.records import KMH

VIEW = View(behind_m=44.0, ahead_m=66.0, right_m=8.6, left_m=8.6)
WIDTH_PX, TEXT_PX = 2000, 22.0


def moments(driver: str, config: Config, seed: int) -> list[Moment]:
    """Drive an episode and return its decisions."""
    env, n_rays = HighwayEnv(config, hands_off=driver == "sumo"), config.lidar.n_rays
    supervisor, found = drivers.by_name(driver, config, seed), []
    observation, _ = env.reset(seed=seed)
    course = env.stretch.road
    while not env.is_over:
        found.append(Moment(env.scene, observation[:n_rays], markings.of(course), course.boundaries))
        observation, _ = env.drive(supervisor.decide(observation, env.agent))
    env.close()
    return found


def interest(moment: Moment) -> float:
    """Return how much there is to see: vehicles hit and missed, more for the one right ahead."""
    ahead_m = moment.centres_m[1:, 0]
    in_view = np.count_nonzero((ahead_m > 4.0 - VIEW.behind_m) & (ahead_m < VIEW.ahead_m - 4.0))
    follows = moment.on_vehicle[0] and moment.distance_m[0] < VIEW.ahead_m - 8.0
    return np.count_nonzero(moment.seen[1:]) + 0.4 * in_view + 2.0 * follows


def main() -> None:
    """Draw what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("--driver", default="expert", choices=drivers.NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".png"))
    arguments = parser.parse_args()
    config = Config()
    course = road.load(config.network.file)
    n_rays = config.lidar.n_rays
    picture = Picture(WIDTH_PX, VIEW, config.traffic.desired_kmh(course.highest_limit_mps * KMH), text_px=TEXT_PX)
    picture.draw(
        max(moments(arguments.driver, config, arguments.seed), key=interest),
        f"What the host senses: {n_rays} rays, one every {360 / n_rays:.0f}°",
        "it drives to the right",
    )
    picture.save(arguments.out)


if __name__ == "__main__":
    main()
