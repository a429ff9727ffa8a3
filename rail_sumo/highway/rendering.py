"""What an environment shows of its host, as Gymnasium asks for it: a frame for every decision."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rail_sumo.config import FASTEST_CAR_MPS, Config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.highway import drawing, window
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.network import markings
from rail_sumo.records import KMH, SECONDS_PER_STEP

MODES = ("human", "rgb_array")
FRAME_PX = 960
VIEW = drawing.View(behind_m=44.0, ahead_m=66.0, right_m=18.4, left_m=18.4)
"""What a frame shows: 960 x 384 pixels."""


class Renderer:
    """Draws the road around a host from above, at its last decision.

    Args:
        config: the world.
        mode: "rgb_array", "human" for a window, or None to show nothing.

    Raises:
        InputError: there is no such mode, or what it needs is not installed.
    """

    def __init__(self, config: Config, mode: str | None) -> None:
        self._config = config
        self._mode = checked(mode)
        self._picture: drawing.Picture | None = None
        self._window: window.Window | None = None

    def forget(self) -> None:
        """Choose colours anew for the next frame: another network has other limits."""
        self._picture = None

    def show(self, agent: Agent) -> None:
        """Show a host in the window, in the mode "human"; do nothing in others."""
        if self._mode == "human":
            self._window = self._window or window.Window("rail-sumo", metadata_of(self._config)["render_fps"])
            self._window.show(self.frame(agent))

    def frame(self, agent: Agent | None) -> NDArray[np.uint8]:
        """Return the road around a host, shape (384, 960, 3).

        Raises:
            RuntimeError: there is none yet.
        """
        if agent is None:
            raise RuntimeError("there is nothing to show yet; call reset()")
        course = agent.stretch.road
        if self._picture is None:
            self._picture = drawing.Picture(FRAME_PX, VIEW, (0.0, min(course.highest_limit_mps, FASTEST_CAR_MPS) * KMH))
        moment = drawing.Moment(
            agent.scene,
            agent.observation[: self._config.lidar.n_rays],
            markings.of(course),
            course.boundaries,
            is_left_hand=course.is_left_hand,
        )
        self._picture.draw(moment, _told(agent), f"{agent.n_steps * SECONDS_PER_STEP:.1f} s")
        return self._picture.pixels()

    def close(self) -> None:
        """Close the window; harmless when none is open."""
        if self._window is not None:
            self._window.close()
            self._window = None


def checked(render_mode: str | None) -> str | None:
    """Return a render mode, if all is there that it needs.

    Raises:
        InputError: there is no such mode, or what it needs is not installed.
    """
    if render_mode is not None:
        if render_mode not in MODES:
            raise InputError(f"render_mode '{render_mode}' not found{did_you_mean(render_mode, MODES)}")
        drawing.require_matplotlib()
        if render_mode == "human":
            window.require_pygame()
    return render_mode


def metadata_of(config: Config) -> dict[str, Any]:
    """Return Gymnasium's metadata: a frame for every decision, as many in a second as are taken."""
    return {"render_modes": list(MODES), "render_fps": 1.0 / config.episode.decision_period_s}


def _told(agent: Agent) -> str:
    """Return the line above a frame: the host's speed, and its last decision."""
    speed = f"{agent.scene.speed_mps[0] * KMH:.0f} km/h"
    if agent.end is not None:
        return f"{speed}, the end: {agent.end}"
    if agent.decided is None:
        return speed
    asked, why = agent.decided[0].name.lower(), agent.adas.why
    return f"{speed}, {asked}{f' (not carried out: {why})' if why else ''}"
