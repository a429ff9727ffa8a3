"""Ids of what we put into a simulation, which nothing of a user's may have, and SUMO's vehicle classes."""

OURS = "rail_sumo_"
"""What the ids of our own vehicles, types and routes begin with."""
HOST = f"{OURS}host"
"""The host, and its vehicle type."""

CARS = frozenset({"passenger", "private", "taxi", "evehicle", "hov", "vip", "custom1", "custom2", "ignoring"})
"""SUMO's classes of what drives as a car does."""
MOTOR_VEHICLES = CARS | {
    "delivery", "truck", "trailer", "bus", "coach", "motorcycle", "moped", "emergency", "authority", "army",
}  # fmt: skip
"""SUMO's classes of what drives on roads with a motor."""
