"""Learn a highway driver from demonstrations, and drive it in SUMO."""
