"""What `gymnasium.make`, `make_vec` and `parallel_env` call: an environment here, or in processes of its own."""

from collections.abc import Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gymnasium.vector import AsyncVectorEnv

from rail_sumo import config_file
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.isolated import Isolated

if TYPE_CHECKING:
    from rail_sumo.highway.isolated_parallel import IsolatedParallel
    from rail_sumo.highway.parallel_env import HighwayParallelEnv

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


make.metadata = HighwayEnv.metadata  # type: ignore[attr-defined]  # gymnasium.make reads there what can be rendered


def make_vec(num_envs: int = 1, *, config: Given = None, **further: Any) -> AsyncVectorEnv:
    """Return several environments, each in a process of its own; arguments as in `make`."""
    one = partial(HighwayEnv, config_file.of(config), **further)
    return AsyncVectorEnv([one] * num_envs, context="spawn")


def parallel_env(
    hosts: int = 8, config: Given = None, *, isolated: bool = False
) -> "HighwayParallelEnv | IsolatedParallel":
    """Return the PettingZoo environment, in which several cars of a demand are agents; see `HighwayParallelEnv`.

    Args:
        hosts: how many agents there are.
        config: the world, as in `make`. A shipped network without a demand takes the shipped one of its name.
        isolated: put it into a process of its own, as in `make`.

    Raises:
        InputError: pettingzoo is not installed, a bad configuration, less than one host, or no demand that they could
            be the cars of.
    """
    if find_spec("pettingzoo") is None:
        raise InputError("several agents need pettingzoo; install it with: pip install 'rail-sumo[multi]'")
    world = config_file.of(config)
    if isolated:
        from rail_sumo.highway.isolated_parallel import IsolatedParallel

        return IsolatedParallel(world, hosts=hosts)
    from rail_sumo.highway.parallel_env import HighwayParallelEnv

    return HighwayParallelEnv(world, hosts=hosts)
