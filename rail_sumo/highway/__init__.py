"""The world the supervisor drives in."""
