"""An environment in a process of its own, so that several live side by side."""

import os
import secrets
import subprocess
import sys
from contextlib import suppress
from multiprocessing.connection import Client, Connection, Listener
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rail_sumo.config import Config
from rail_sumo.highway import rendering
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.observation import bounds
from rail_sumo.records import Floats, MetaAction, Trajectory


class Child:
    """An environment of some kind in a child process, which ends with it.

    The child runs this module alone: a script needs no `if __name__ == "__main__"` for it. A call takes about 0.1 ms
    longer than here.

    Args:
        kind: the environment's class.
        arguments, named: those of its constructor.

    Raises:
        InputError: as the constructor does.
    """

    def __init__(self, kind: type, *arguments: Any, **named: Any) -> None:
        self._connection: Connection | None = None
        key = secrets.token_bytes(32)
        with Listener(authkey=key) as listener:
            self.process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(listener.address)],
                stdin=subprocess.PIPE,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
            assert self.process.stdin is not None
            self.process.stdin.write(key)
            self.process.stdin.close()
            self._connection = listener.accept()
        self._connection.send(kind)
        self.ask("__init__", *arguments, **named)

    def ask(self, method: str, *arguments: Any, **named: Any) -> Any:
        """Call a method of the environment; what it raises is raised here.

        Raises:
            RuntimeError: the process has been closed, or has died.
        """
        if self._connection is None:
            raise RuntimeError("the environment is closed")
        try:
            self._connection.send((method, arguments, named))
            is_error, answer = self._connection.recv()
        except (EOFError, OSError) as error:
            self._end()
            raise RuntimeError(f"the environment's process has died ({error!r})") from None
        if is_error:
            raise answer
        return answer

    def close(self) -> None:
        """End the process; harmless when it has ended."""
        if self._connection is not None:
            with suppress(EOFError, OSError):
                self._connection.send(None)
        self._end()

    def _end(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None
            self.process.wait()

    def __del__(self) -> None:
        with suppress(Exception):  # while the interpreter shuts down nothing is certain
            self.close()


class Isolated(gymnasium.Env[Floats, np.int64]):
    """Does all that `HighwayEnv` does, in a child process that ends with it; see `Child`.

    Args:
        config: the world.
        further: more arguments of `HighwayEnv`.

    Raises:
        InputError: as `HighwayEnv` does.
    """

    metadata = HighwayEnv.metadata

    def __init__(self, config: Config, *, render_mode: str | None = None, **further: Any) -> None:
        self.render_mode = rendering.checked(render_mode)
        self.metadata = rendering.metadata_of(config)
        self.observation_space = spaces.Box(*bounds(config.lidar, config.observation), dtype=np.float64)
        self.action_space = spaces.Discrete(len(MetaAction))
        self._child = Child(HighwayEnv, config, render_mode=render_mode, **further)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; the same seed gives the same traffic."""
        super().reset(seed=seed)
        return self._child.ask("reset", seed=seed, options=options)

    def step(self, action: int | np.int64) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Take one decision and drive until the next falls due."""
        return self._child.ask("step", MetaAction.of(action))

    def render(self) -> NDArray[np.uint8] | None:
        """Return the road around the host, see `HighwayEnv`; a window is the child's own."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() shows nothing without a render_mode; make the environment with one")
        return self._child.ask("render") if self.render_mode == "rgb_array" else None

    def action_masks(self) -> list[bool]:
        """Return for each meta-action whether a masked policy may choose it now."""
        return self._child.ask("action_masks")

    def trajectory(self) -> Trajectory:
        """Return the episode so far."""
        return self._child.ask("trajectory")

    def close(self) -> None:
        """End the process; harmless when it has ended."""
        self._child.close()


def serve(address: str, key: bytes) -> None:
    """Do what the parent asks, until it asks no more or is gone."""
    with Client(address, authkey=key) as parent, suppress(EOFError):
        kind = parent.recv()
        env = kind.__new__(kind)
        while (asked := parent.recv()) is not None:
            method, args, named = asked
            try:
                parent.send((False, getattr(env, method)(*args, **named)))
            except Exception as error:
                parent.send((True, error))
        env.close()


if __name__ == "__main__":
    serve(sys.argv[1], sys.stdin.buffer.read())
