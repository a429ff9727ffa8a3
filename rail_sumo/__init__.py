"""Learn a highway driver from demonstrations, and drive it in SUMO.

Importing it registers the environment `RailSumo/Highway-v0` with Gymnasium; neither SUMO nor torch is imported by that.
`parallel_env` makes the environment of several agents.
"""

from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from rail_sumo.highway.make import parallel_env

__all__ = ["parallel_env"]

gymnasium.register(
    "RailSumo/Highway-v0",
    entry_point="rail_sumo.highway.make:make",
    vector_entry_point="rail_sumo.highway.make:make_vec",
)


def __getattr__(name: str) -> Any:
    if name in __all__:  # imported when it is asked for: SUMO comes with it
        from rail_sumo.highway import make

        return getattr(make, name)
    raise AttributeError(f"module 'rail_sumo' has no attribute '{name}'")
