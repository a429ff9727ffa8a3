"""How a driven vehicle gets others to make room for it in a lane beside, and makes room in its own, in SUMO."""

import math

import libsumo

from rail_sumo import config
from rail_sumo.highway.vehicle import acc, neighbours
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.highway.vehicle.hard_braking import HARD_MPS2
from rail_sumo.highway.vehicle.lane_ends import LEFT, RIGHT, Side, other, stands_before_m
from rail_sumo.highway.vehicle.neighbours import Neighbours
from rail_sumo.highway.vehicle.whereabouts import to_lane_end_m

COMMANDED_ONLY = 256
"""Lane-change mode of the host: no change of its own accord; the ADAS layer is the gate, SUMO only avoids overlap."""
ASKS, ASSERTIVE, NOT_ASSERTIVE = 257, "laneChangeModel.lcAssertive", "1e-9"
"""The same, but it means to leave a lane that does not lead on; and how little it then insists on it."""
STRATEGIC_WISH, NO_WISH = "laneChangeModel.lcStrategic", "-1"
"""How much it wants to leave a lane that does not lead on; and that it does not."""
SLOW_MPS = 1.0
"""A host that is slower waits at the end of its lane, or in a queue."""
INDICATOR = "rail_sumo.indicator"
"""The parameter of a host's vehicle by which others know to which side it must leave its lane, as by its indicator."""
MUST_LEAVE = "rail_sumo.must_leave"
"""The parameter that tells so from afar: 0 where its lane leads on, whatever SUMO's lane changer would rather have."""
WANTS, STRATEGIC = {LEFT: 2, RIGHT: 4}, 8
"""SUMO's bits of what a vehicle's lane changer means to do: to change to a side; and that its lane does not lead on."""
UNSURE_MPS = 0.5
"""By how much speeds change within a step, at most."""


class LettingIn:
    """Asks others to make room for one vehicle, and tells how fast that may be to make room for others.

    Args:
        name: its id.
        beside: who is beside it.
        adas: limits of its car-following.
    """

    def __init__(self, name: str, beside: Neighbours, adas: config.Adas) -> None:
        self._name = name
        self._beside = beside
        self._adas = adas
        self.asks = False
        """Whether SUMO's drivers in a lane beside are asked to make room; SUMO may change lanes for it meanwhile."""
        self._before: dict[str, str] = {}  # parameters of its vehicle that are set, as they were
        self._told = {INDICATOR: "0", MUST_LEAVE: ""}  # what other hosts know of it
        self._in_from: list[Side] = []  # on which sides somebody must come into its lane

    # Others let it in.

    def ask(self, side: int, speed_mps: float) -> bool:
        """Ask everybody in the lane on a side for room; 0: no longer.

        Returns:
            Whether `asks` has changed.
        """
        self._tell(INDICATOR, str(side))
        self._let_pass(side, speed_mps)
        return (side != 0 or self.asks) and self._ask_sumo(side, speed_mps)

    def tell(self, must_leave: int | None) -> None:
        """Let other hosts know to which side its lane must be left, however far ahead; see `Command.must_leave`."""
        self._tell(MUST_LEAVE, "" if must_leave is None else str(must_leave))

    def _tell(self, parameter: str, value: str) -> None:
        if value != self._told[parameter]:
            self._told[parameter] = value
            libsumo.vehicle.setParameter(self._name, parameter, value)

    def _let_pass(self, side: int, speed_mps: float) -> None:
        """Where the host stands, have who stands so near behind it that it cannot move in front drive on past it.

        SUMO's drivers stop for a vehicle that must leave its lane, at any distance behind it. So the host is set not to
        want to until that one is past; the next may let it in.
        """
        passes = side != 0 and speed_mps < SLOW_MPS and self._beside.gaps(side).behind_m < self._adas.standstill_gap_m
        if passes != (STRATEGIC_WISH in self._before):
            self._set(STRATEGIC_WISH, NO_WISH if passes else None)

    def _set(self, parameter: str, value: str | None) -> bool:
        """Set a parameter of its lane-change model, or as it was before (None).

        Returns:
            Whether the model, which may be a demand's default, knows of it.
        """
        vehicle = libsumo.vehicle
        try:
            if value is not None:
                self._before[parameter] = vehicle.getParameter(self._name, parameter)
            vehicle.setParameter(self._name, parameter, self._before.pop(parameter) if value is None else value)
        except libsumo.TraCIException:
            self._before.pop(parameter, None)
            return False
        return True

    def _ask_sumo(self, side: int, speed_mps: float) -> bool:
        """Have SUMO's drivers in the lane on a side let the host in, as they do each other; 0: no longer.

        SUMO's lane changer makes drivers give way to a vehicle that wants to change lanes by itself. So the host is set
        to want to, and never does: its gaps would have to be longer than any. Only where SUMO takes a gap of no length,
        between a slower vehicle behind and a faster one ahead, it would change at once; there the host does not ask.
        Where others come to drive so in the very same step SUMO takes that gap, and the host is in the next lane.

        Nor does it ask while a vehicle ahead in a lane beside means to move into its own too close, or is so slow and
        near that the host would brake hard for it there. SUMO finds any gap safe before a vehicle that insists so
        little and brakes, and a vehicle may begin to want to move and do so within one step.
        """
        asks = side != 0 and self._needs_room(side, speed_mps) and not self._is_cut_in_on(speed_mps)
        if asks == self.asks:
            return False
        if not self._set(ASSERTIVE, NOT_ASSERTIVE if asks else None):
            return False
        libsumo.vehicle.setLaneChangeMode(self._name, ASKS if asks else COMMANDED_ONLY)
        self.asks = asks
        return True

    def _needs_room(self, side: int, mps: float) -> bool:
        """Whether SUMO's drivers would keep a gap between the host and its neighbours in the lane on a side."""
        vehicle = libsumo.vehicle
        ahead, behind = (vehicle.getNeighbors(self._name, mode) for mode in neighbours.modes(side))
        pairs = [(self._name, mps, name, vehicle.getSpeed(name)) for name, _ in ahead]
        pairs += [(name, vehicle.getSpeed(name), self._name, mps) for name, _ in behind]
        return any(
            vehicle.getSecureGap(rear, max(rear_mps - UNSURE_MPS, 0.0), front_mps + UNSURE_MPS, vehicle.getDecel(front))
            for rear, rear_mps, front, front_mps in pairs
        )

    def _is_cut_in_on(self, mps: float) -> bool:
        """Whether the next vehicle ahead in a lane beside means to move into its lane closer than SUMO finds safe.

        Or would be in its way there, whatever it means to do.
        """
        vehicle = libsumo.vehicle
        for side in (LEFT, RIGHT):
            name, gap_m = self._beside.ahead(side) or ("", math.inf)
            if not name:
                continue
            slow_mps = vehicle.getSpeed(name)
            if acc.braking_distance_m(max(mps - slow_mps, 0.0), HARD_MPS2) > gap_m:
                return True
            means = _means(name, other(side)) & WANTS[other(side)]
            if means and gap_m < vehicle.getSecureGap(self._name, mps, slow_mps, vehicle.getDecel(name)):
                return True
        return False

    # It lets others in.

    def heed(self) -> None:
        """Notice on which sides somebody ahead must come into its lane; until it looks again, it lets them in."""
        self._in_from = [side for side in (LEFT, RIGHT) if self._who_must_come(side)]

    def allowed_mps(self, speed_mps: float) -> float:
        """Return the highest speed at the end of the next step that makes room; inf if nobody needs any."""
        if not self._in_from:
            return math.inf
        coming = filter(None, map(self._who_must_come, self._in_from))
        return min((acc.letting_in_mps(speed_mps, *one, self._adas) for one in coming), default=math.inf)

    def _who_must_come(self, side: Side) -> tuple[Leader, float] | None:
        """Return who ahead in the lane on a side must come into the host's lane first, and how far on it stands.

        A vehicle that stands goes no farther. One that drives may go on to the end of its lane, and a host to as far
        before it as this host would.
        """
        vehicle, towards = libsumo.vehicle, other(side)
        must = WANTS[towards] | STRATEGIC
        for name, gap_m in self._beside.all_ahead(side):
            if vehicle.getParameter(name, INDICATOR) == str(towards):
                before_m = stands_before_m(towards, is_dead_end=not libsumo.lane.getLinks(vehicle.getLaneID(name)))
            elif _means(name, towards) & must == must and vehicle.getParameter(name, MUST_LEAVE) in ("", str(towards)):
                before_m = 0.0
            else:
                continue
            speed_mps = vehicle.getSpeed(name)
            goes_on_m = to_lane_end_m(name) - before_m if speed_mps > SLOW_MPS else 0.0
            return Leader(gap_m, speed_mps), max(goes_on_m, 0.0)
        return None


def _means(name: str, side: Side) -> int:
    """Return SUMO's bits of what a vehicle's lane changer means to do about the lane on a side."""
    state: int = libsumo.vehicle.getLaneChangeState(name, side)[0]
    return state
