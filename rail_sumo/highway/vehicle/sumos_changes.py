"""Lane changes that SUMO makes for a driven vehicle: as its driver, or while the vehicle asks to be let in."""

from collections.abc import Mapping, Sequence

import libsumo

EDGES_PER_STEP = 10
"""Onto no more edges than these, junctions' insides included, does a vehicle come within a step."""


class SumosChanges:
    """Counts them.

    Args:
        name: the vehicle's id.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lane_id = ""
        self.count = 0

    def follow(self, next_lanes: Mapping[str, Sequence[str]]) -> None:
        """Count along a course: the lanes that each of its lanes leads to."""
        self._next_lanes = next_lanes

    def begin(self) -> None:
        """Count from the lane that the vehicle is on now."""
        self._lane_id = libsumo.vehicle.getLaneID(self._name)

    def note(self) -> bool:
        """Return whether SUMO has changed lanes for it in the last step."""
        lane_id = libsumo.vehicle.getLaneID(self._name)
        changed = lane_id != self._lane_id and self._is_beside(lane_id)
        self._lane_id = lane_id
        self.count += changed
        return changed

    def _is_beside(self, lane_id: str) -> bool:
        """Whether a lane is beside the one that the vehicle was on, or beside those that this one leads to."""
        edge_id, reached = lane_id.rpartition("_")[0], {self._lane_id}
        for _ in range(EDGES_PER_STEP):
            on_edge = {one for one in reached if one.rpartition("_")[0] == edge_id}
            if on_edge:
                return lane_id not in on_edge
            reached = {ahead for one in reached for ahead in self._next_lanes.get(one, ())}
        return False
