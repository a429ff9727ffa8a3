"""Draw the highway as the host sees it, from a real episode: python docs/highway.py [--driver NAME] [--out FILE].

Needs matplotlib: pip install 'rail-sumo[plots]'. Of all the moments of the episode at which a decision fell due, it
draws the one with the most to see: vehicles that the LIDAR hits, ahead and to the sides, and some that it misses.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.patches import FancyBboxPatch
from matplotlib.typing import ColorType
from numpy.typing import NDArray

from rail_sumo import drivers
from rail_sumo.config import Config, Traffic
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.network import road
from rail_sumo.highway.network.road import Road
from rail_sumo.records import KMH, Floats, Scene

BEHIND_M, AHEAD_M = 44.0, 66.0
MARGIN_M = 3.0
LEGEND_M = 4.2
ASPHALT, MARKING, RAIL, INK = "#e9edf0", "#ffffff", "#78858d", "#263238"
HOST = ON_VEHICLE = "#d55e00"  # vermilion: stands out from viridis to any eye
ON_RAIL = "#9aa7b0"
VEHICLE_RAY = {"color": ON_VEHICLE, "lw": 1.4, "marker": "o", "ms": 4.4}
RAIL_RAY = {"color": ON_RAIL, "lw": 0.9, "marker": "o", "ms": 3.0}


@dataclass(frozen=True)
class Moment:
    """The scene at a decision, and the scan made of it."""

    scene: Scene
    distance_m: Floats
    on_vehicle: NDArray[np.bool_]
    """(n_rays,): whether the ray ends on a vehicle."""

    @property
    def ends_m(self) -> Floats:
        """Where the rays end, shape (n_rays, 2), east and north of the host's centre."""
        n_rays = len(self.distance_m)
        angles = self.scene.heading_rad[0] + 2 * np.pi * np.arange(n_rays) / n_rays
        return self.distance_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])

    @property
    def places_m(self) -> Floats:
        """Centres of the vehicles, shape (n_vehicles, 2), east and north of the host's."""
        scene = self.scene
        return np.column_stack([scene.x_m - scene.x_m[0], scene.y_m - scene.y_m[0]])

    @property
    def seen(self) -> set[int]:
        """The rows of the scene that a ray ends on."""
        half = 0.5 * np.column_stack([self.scene.length_m, self.scene.width_m])
        outside = [np.abs(self.places_m[1:] - end) - half[1:] for end in self.ends_m[self.on_vehicle]]
        return {int(gap.max(axis=1).argmin()) + 1 for gap in outside}

    @property
    def interest(self) -> float:
        """How much there is to see: vehicles hit and missed, more for the one right ahead."""
        east = self.places_m[1:, 0]
        in_view = np.count_nonzero((east > 4.0 - BEHIND_M) & (east < AHEAD_M - 4.0))
        ahead = self.on_vehicle[0] and self.distance_m[0] < AHEAD_M - 8.0
        return len(self.seen) + 0.4 * in_view + 2.0 * ahead


def moments(driver: str, config: Config, seed: int) -> list[Moment]:
    """Drive an episode and return its decisions."""
    env, n_rays = HighwayEnv(config, hands_off=driver == "sumo"), config.lidar.n_rays
    supervisor, found = drivers.by_name(driver, config, seed), []
    observation, _ = env.reset(seed=seed)
    while not env.is_over:
        distance, relative = observation[:n_rays], observation[n_rays : 2 * n_rays]
        stands = np.isclose(relative, -env.scene.speed_mps[0])  # as the guard rail does
        found.append(Moment(env.scene, distance, (distance < config.lidar.max_range_m) & ~stands))
        observation, _ = env.drive(supervisor.decide(observation, env))
    env.close()
    return found


def draw(moment: Moment, course: Road, traffic: Traffic, out: Path) -> None:
    """Write the picture of a straight course that runs east."""
    right, left = course.boundaries[:, 1].min(), course.boundaries[:, 1].max()
    width, height = BEHIND_M + AHEAD_M, left - right + 2 * LEGEND_M
    plt.rcParams["font.size"] = 8
    figure = plt.figure(figsize=(10.0, 10.0 * height / width))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-BEHIND_M, AHEAD_M), ylim=(right - LEGEND_M, left + LEGEND_M))
    axes.axis("off")
    speeds = ScalarMappable(Normalize(*traffic.desired_kmh(course.highest_limit_mps * KMH)), "viridis")
    draw_road(axes, right, left, course.edges[0].n_lanes)
    draw_rays(axes, moment)
    for row in range(len(moment.scene.ids)):
        draw_vehicle(axes, moment, row, speeds)
    draw_caption(axes, left + 0.5 * LEGEND_M, moment)
    draw_legend(axes, right - 0.5 * LEGEND_M, speeds)
    figure.savefig(out, dpi=200, facecolor="white", metadata={"Software": None})


def draw_road(axes: Axes, right: float, left: float, n_lanes: int) -> None:
    """Draw asphalt, lane markings and guard rails."""
    axes.axhspan(right, left, color=ASPHALT, lw=0, zorder=0)
    for border in np.linspace(right, left, n_lanes + 1)[1:-1]:
        axes.plot([-BEHIND_M, AHEAD_M], [border, border], color=MARKING, lw=1.8, dashes=(9, 7), zorder=1)
    for border in (right, left):
        axes.plot([-BEHIND_M, AHEAD_M], [border, border], color=RAIL, lw=3.0, zorder=1)


def draw_rays(axes: Axes, moment: Moment) -> None:
    """Draw every ray to where it ends."""
    y = moment.scene.y_m[0]
    for (east, north), on_vehicle in zip(moment.ends_m, moment.on_vehicle, strict=True):
        style = VEHICLE_RAY if on_vehicle else RAIL_RAY
        axes.plot([0.0, east], [y, y + north], **{**style, "marker": ""}, zorder=3 + on_vehicle)
        axes.plot(east, y + north, **style, mec="white", mew=0.7, zorder=7)


def draw_vehicle(axes: Axes, moment: Moment, row: int, speeds: ScalarMappable) -> None:
    """Draw a vehicle to scale with its speed in km/h, filled where the LIDAR hits it."""
    scene, is_host = moment.scene, row == 0
    east, y, length, width = moment.places_m[row, 0], scene.y_m[row], scene.length_m[row], scene.width_m[row]
    if not 0.5 * length - BEHIND_M < east < AHEAD_M - 0.5 * length:
        return
    speed = KMH * scene.speed_mps[row]
    colour = HOST if is_host else speeds.to_rgba(speed)
    hit = is_host or row in moment.seen
    draw_box(axes, east, y, length, width, colour, filled=hit, zorder=6 if is_host else 5)
    ink = "white" if hit and luminance(colour) < 0.5 else INK
    weight = "bold" if is_host else "normal"
    axes.text(east, y, f"{speed:.0f}", color=ink, fontweight=weight, ha="center", va="center_baseline", zorder=8)


def draw_box(
    axes: Axes, x: float, y: float, length: float, width: float, colour: ColorType, *, filled: bool, zorder: int = 5
) -> None:
    """Draw a vehicle's outline about its centre."""
    style = {"facecolor": colour, "edgecolor": INK, "lw": 0.9}
    if not filled:
        style = {"facecolor": "white", "edgecolor": colour, "lw": 1.5, "ls": (0, (2.2, 1.2))}
    corner = (x - 0.5 * length, y - 0.5 * width)
    shape = "round,pad=0,rounding_size=0.45"
    axes.add_patch(FancyBboxPatch(corner, length, width, boxstyle=shape, zorder=zorder, **style))


def luminance(colour: ColorType) -> float:
    """Return how bright a colour looks, 0..1 (ITU-R BT.709)."""
    return float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)))


def draw_caption(axes: Axes, y: float, moment: Moment) -> None:
    """Write above the road what is drawn, and how large."""
    n_rays = len(moment.distance_m)
    text = f"What the host senses: {n_rays} rays, one every {360 / n_rays:.0f}°"
    axes.text(MARGIN_M - BEHIND_M, y, text, va="center_baseline", color=INK, fontweight="bold")
    end = AHEAD_M - MARGIN_M
    axes.annotate("", (end, y), (end - 10.0, y), arrowprops={"arrowstyle": "-|>", "color": INK, "shrinkA": 0})
    axes.text(end - 11.0, y, "10 m, direction of travel", ha="right", va="center_baseline", color=INK)


def draw_legend(axes: Axes, y: float, speeds: ScalarMappable) -> None:
    """Write below the road what the marks mean."""
    x = MARGIN_M - BEHIND_M
    draw_box(axes, x + 1.25, y, 2.5, 1.3, HOST, filled=True)
    draw_box(axes, x + 62.75, y, 2.5, 1.3, INK, filled=False)
    axes.plot([x + 10.5, x + 13.0], [y, y], **VEHICLE_RAY)
    axes.plot([x + 30.5, x + 33.0], [y, y], **RAIL_RAY)
    for offset, text in (
        (3.5, "host"),
        (14.0, "ray on a vehicle"),
        (34.0, "ray on the guard rail, or on nothing"),
        (65.0, "vehicle no ray hits"),
    ):
        axes.text(x + offset, y, text, va="center_baseline", color=INK)
    end = AHEAD_M - MARGIN_M - 6.4
    ramp = np.linspace(speeds.norm.vmin, speeds.norm.vmax, 256)[None]
    axes.imshow(ramp, cmap=speeds.cmap, extent=(end - 12.0, end, y - 0.6, y + 0.6), aspect="auto")
    axes.text(end - 12.7, y, f"{speeds.norm.vmin:.0f}", ha="right", va="center_baseline", color=INK)
    axes.text(end + 0.7, y, f"{speeds.norm.vmax:.0f} km/h", va="center_baseline", color=INK)


def main() -> None:
    """Draw what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("--driver", default="expert", choices=drivers.NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".png"))
    arguments = parser.parse_args()
    config = Config()
    moment = max(moments(arguments.driver, config, arguments.seed), key=lambda moment: moment.interest)
    draw(moment, road.load(config.network.file), config.traffic, arguments.out)


if __name__ == "__main__":
    main()
