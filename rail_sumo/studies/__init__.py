"""Many trainings, and what they come to."""
