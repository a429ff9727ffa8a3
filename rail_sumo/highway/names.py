"""Ids of what we put into a simulation, which nothing of a user's may have."""

OURS = "rail_sumo_"
"""What the ids of our own vehicles, types and routes begin with."""
HOST = f"{OURS}host"
"""The host, and its vehicle type."""
