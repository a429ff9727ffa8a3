"""Learn a highway driver from demonstrations, without gradients, on SUMO."""
