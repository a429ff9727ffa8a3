"""Learn a highway driver from demonstrations, and drive it in SUMO.

Importing it registers the environment `RailSumo/Highway-v0` with Gymnasium; neither SUMO nor torch is imported by that.
"""

import gymnasium

gymnasium.register(
    "RailSumo/Highway-v0",
    entry_point="rail_sumo.highway.make:make",
    vector_entry_point="rail_sumo.highway.make:make_vec",
)
