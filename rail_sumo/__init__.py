"""Learn a highway driver from demonstrations, and drive it in SUMO.

Importing it registers the environment `RailSumo/Highway-v0` with Gymnasium; neither SUMO nor torch is imported by that.
`parallel_env` makes the environment of several agents, `load_driver` loads a learned driver.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from rail_sumo.highway.make import parallel_env
    from rail_sumo.roster import load_driver

    __version__: str

__all__ = ["__version__", "load_driver", "parallel_env"]
_ROOMS = {"load_driver": "rail_sumo.roster", "parallel_env": "rail_sumo.highway.make"}

gymnasium.register(
    "RailSumo/Highway-v0",
    entry_point="rail_sumo.highway.make:make",
    vector_entry_point="rail_sumo.highway.make:make_vec",
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version("rail-sumo")
    if name in _ROOMS:  # imported when it is asked for: SUMO comes with it
        return getattr(import_module(_ROOMS[name]), name)
    raise AttributeError(f"module 'rail_sumo' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
