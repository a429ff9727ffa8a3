"""Rows of drives to tables with intervals."""
