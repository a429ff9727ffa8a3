"""What `gymnasium.make` and `make_vec` call: the environment here, or in processes of its own."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from gymnasium.vector import AsyncVectorEnv

from rail_sumo import config_file
from rail_sumo.config import Config
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.isolated import Isolated

Given = Config | Mapping[str, Any] | str | Path | None


def make(config: Given = None, *, isolated: bool = False, **further: Any) -> HighwayEnv | Isolated:
    """Return the environment.

    Args:
        config: the world: a `Config`, nested mappings such as `{"traffic": {"vehicles": 30}}`, a TOML file, or None for
            the default.
        isolated: put it into a process of its own. libsumo holds one simulation a process, so that of several
            environments in one process all but one must be.
        further: more arguments of `HighwayEnv`.

    Raises:
        InputError: a configuration with unknown keys or bad values, or a network or demand that cannot be driven.
    """
    kind = Isolated if isolated else HighwayEnv
    return kind(config_file.of(config), **further)


def make_vec(num_envs: int = 1, *, config: Given = None, **further: Any) -> AsyncVectorEnv:
    """Return several environments, each in a process of its own; arguments as in `make`."""
    one = partial(HighwayEnv, config_file.of(config), **further)
    return AsyncVectorEnv([one] * num_envs, context="spawn")
