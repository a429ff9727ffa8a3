"""SUMO, which one process holds once: who is on the road, who comes and goes, and how time goes on."""
