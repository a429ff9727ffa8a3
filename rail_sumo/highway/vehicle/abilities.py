"""What a driven vehicle may do in SUMO: how fast it may be, how hard it may brake, which lanes are closed to it."""

import math
from collections.abc import Mapping

import libsumo

from rail_sumo import config
from rail_sumo.highway.names import HOST
from rail_sumo.highway.vehicle import acc
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.highway.vehicle.junctions import SUMO_SPEED_MODE
from rail_sumo.records import SECONDS_PER_STEP

HOST_TYPE = HOST
"""The id of its vehicle type."""
UNLIMITED = 10.0
"""Speed factor with which SUMO does not hold the host to the road's limits."""
AS_ALLOWED = 1.00001
"""Speed factor with which SUMO's own driver drives as fast as is allowed: networks tell 80 km/h as 22.2222 m/s."""
GENTLE_MPS2 = 3.0
"""How hard SUMO may brake the host for who comes first, where it is slow and near the line."""
STARTING_MPS2 = 1.0
"""How hard SUMO may brake the host where it stands at the line; see `Abilities.be_gentle`."""
EXPECTED_BRAKING_MPS2 = 4.5
"""The braking that other vehicles expect of the host."""
IGNORING = "ignoring"
"""SUMO's class of vehicles to which no lane is closed."""


class Abilities:
    """Gives one vehicle emergency braking, and keeps what SUMO lets it do in step with how it is driven.

    Emergency braking is car-following that brakes safely and never harder than it may: Krauss without imperfection, a
    deceleration as hard as emergency braking, and others told to expect `EXPECTED_BRAKING_MPS2`. SUMO never exceeds
    `decel` under setSpeed in the default speed mode, and this model needs no more to stay clear of a leader that brakes
    as hard. Adaptive cruise control (`acc`) brakes long before.

    Args:
        name: its id.
        adas: its limits.
        fastest_mps: the highest set speed on its course.
        shares_type: whether others are of its vehicle type too.
    """

    def __init__(self, name: str, adas: config.Adas, *, fastest_mps: float, shares_type: bool) -> None:
        self._name = name
        self._adas = adas
        self._shares_type = shares_type
        self._fastest_mps = self.ceiling_mps = fastest_mps
        """How fast its vehicle may be: no faster than it can, though its course allows it."""
        self._can_mps = math.inf
        self._class = ""  # its own, while it drives on into a lane that was closed too late
        self._gentle_mps2 = math.inf  # how hard SUMO may brake it for who comes first
        self._is_of_a_demand = self._braces = False
        self._is_of_a_type = False  # of the demand's, which SUMO drives
        self._comes_down = False  # from the speed that it has entered with to the one that its type drives at
        self._speed_factor: float | None = None  # that SUMO's own driver was last told; None where SUMO keeps its own
        types = libsumo.vehicletype
        types.setAccel(HOST_TYPE, adas.acceleration_mps2)
        types.setDecel(HOST_TYPE, adas.emergency_braking_mps2)
        types.setEmergencyDecel(HOST_TYPE, adas.emergency_braking_mps2)
        types.setApparentDecel(HOST_TYPE, min(EXPECTED_BRAKING_MPS2, adas.emergency_braking_mps2))
        types.setImperfection(HOST_TYPE, 0.0)
        types.setMaxSpeed(HOST_TYPE, fastest_mps)
        types.setTau(HOST_TYPE, acc.AEB_TIME_GAP_S)
        types.setMinGap(HOST_TYPE, adas.standstill_gap_m)

    def become(self, own: Mapping[str, str | float], *, speed_mps: float, fastest_mps: float) -> None:
        """Be as the vehicle that has these properties, by what SUMO's setters call them, and drives so fast.

        It never drives faster than that vehicle can.
        """
        for what, value in own.items():
            self._set(what, value)
        self._is_of_a_demand = True
        self._set("Decel", self._hardest_mps2)
        self._can_mps = fastest_mps
        self._keep_below_ceiling(speed_mps)

    def hand_over(self, kind: str | None) -> None:
        """Drive as SUMO's own driver: as one of this vehicle type, or as the host but for its time gap and limits."""
        vehicle = libsumo.vehicle
        if kind is None:
            vehicle.setTau(self._name, self._adas.time_gap_s)  # as a vehicle of SUMO's, it has no other time gap
            self._speed_factor = UNLIMITED
            return
        self._is_of_a_type = self._comes_down = True
        vehicle.setType(self._name, kind)
        vehicle.setSpeedMode(self._name, SUMO_SPEED_MODE)

    def _set(self, what: str, value: str | float) -> None:
        """Set a property of its vehicle type; if others are of it too, of the vehicle, to which SUMO gives its own."""
        if self._shares_type:
            getattr(libsumo.vehicle, f"set{what}")(self._name, value)
        else:
            getattr(libsumo.vehicletype, f"set{what}")(HOST_TYPE, value)

    # How fast.

    def follow(self, *, fastest_mps: float, speed_mps: float) -> None:
        """Be as fast as another course allows, on which it drives at this speed now."""
        self._fastest_mps = fastest_mps
        if not self._is_of_a_type:
            self._keep_below_ceiling(speed_mps)

    def hold_below(self, speed_mps: float) -> None:
        """Let it drive no faster than this, whatever is commanded."""
        self._set("MaxSpeed", speed_mps)

    def _keep_below_ceiling(self, speed_mps: float) -> None:
        """Have its vehicle be no faster than it can and its course allows; below its speed SUMO would brake hard."""
        self.ceiling_mps = max(min(self._fastest_mps, self._can_mps), speed_mps)
        self._set("MaxSpeed", self.ceiling_mps)

    def keep_to_limit(self, speed_mps: float) -> None:
        """Have SUMO's own driver keep to the limit of its lane and the highest set speed, where it has none of its own.

        Or be no faster than it is, while the assistance layer has it slow down: SUMO would brake hard.
        """
        if self._comes_down:
            self._come_down(speed_mps)
        if self._speed_factor is None:
            return
        limit_mps = libsumo.lane.getMaxSpeed(libsumo.vehicle.getLaneID(self._name))
        if speed_mps < self.ceiling_mps and self.ceiling_mps > self._fastest_mps:  # it has entered faster
            self.ceiling_mps = max(speed_mps, self._fastest_mps)
            libsumo.vehicle.setMaxSpeed(self._name, self.ceiling_mps)  # handed over, it is of a type of its own
        factor = max(AS_ALLOWED, speed_mps / limit_mps) if limit_mps > 0.0 else AS_ALLOWED
        if factor != self._speed_factor:
            libsumo.vehicle.setSpeedFactor(self._name, factor)
            self._speed_factor = factor

    def _come_down(self, speed_mps: float) -> None:
        """Have it come down comfortably to the mean speed factor and the highest speed of its type.

        The car in whose place it has entered may have been faster than that, and SUMO would brake it hard.
        """
        vehicle, types = libsumo.vehicle, libsumo.vehicletype
        kind = vehicle.getTypeID(self._name)  # the one drawn from a distribution
        factor, fastest_mps = types.getSpeedFactor(kind), types.getMaxSpeed(kind)
        limit_mps = libsumo.lane.getMaxSpeed(vehicle.getLaneID(self._name))
        slower_mps = speed_mps - self._adas.comfort_braking_mps2 * SECONDS_PER_STEP
        vehicle.setSpeedFactor(self._name, max(factor, slower_mps / limit_mps) if limit_mps > 0.0 else factor)
        vehicle.setMaxSpeed(self._name, max(fastest_mps, slower_mps))
        self._comes_down = slower_mps > min(factor * limit_mps, fastest_mps)

    # How hard it brakes.

    def be_gentle(self, is_gentle: bool, *, stands: bool = False) -> None:
        """Have SUMO brake gently for who comes first, or as hard as it may.

        SUMO finds that out a second after it has called the way open, and stops then as late and as hard as it may.

        Where two head for one lane, SUMO lets the first in only if it would need the longer way to stop, however far
        away the other is. A vehicle that stands never would, unless it may brake gently alone.

        Args:
            is_gentle: whether it does.
            stands: whether the vehicle stands at the line.
        """
        gentle_mps2 = (STARTING_MPS2 if stands else GENTLE_MPS2) if is_gentle else math.inf
        if gentle_mps2 != self._gentle_mps2:
            self._gentle_mps2 = gentle_mps2
            self._set("Decel", self._hardest_mps2)

    def brace(self, now_mps: float, next_mps: float, leader: Leader | None) -> None:
        """Have SUMO brake as hard as it may, where it takes more than it may brake at other times.

        And where its leader is so near that it would brake so at once, though adaptive cruise control need not: the
        harder emergency braking may be, the later it begins.

        A vehicle of a demand brakes no harder than others expect then: SUMO's drivers keep a longer gap behind one that
        may brake harder, and where many are driven, fewer would enter and change lanes.
        """
        if not self._is_of_a_demand:
            return
        needed_mps2 = (now_mps - next_mps) / SECONDS_PER_STEP
        if leader is not None:
            needed_mps2 = max(needed_mps2, acc.needed_mps2(now_mps, leader, self._adas))
        if (needed_mps2 > self._unbraced_mps2 or self._is_near(leader, next_mps)) != self._braces:
            self._braces = not self._braces
            self._set("Decel", self._hardest_mps2)

    def _is_near(self, leader: Leader | None, speed_mps: float) -> bool:
        """Whether its leader is nearer than where SUMO begins to brake for it, unless it is to be gentle."""
        if leader is None or math.isfinite(self._gentle_mps2):
            return False
        nearest_m = acc.emergency_gap_m(speed_mps, leader.speed_mps, self._unbraced_mps2)
        return leader.gap_m < self._adas.standstill_gap_m + nearest_m

    @property
    def _hardest_mps2(self) -> float:
        """How hard SUMO may brake it now."""
        return self._adas.emergency_braking_mps2 if self._braces else self._unbraced_mps2

    @property
    def _unbraced_mps2(self) -> float:
        """How hard it may where nothing asks for more."""
        expected_mps2 = EXPECTED_BRAKING_MPS2 if self._is_of_a_demand else math.inf
        return min(self._gentle_mps2, expected_mps2, self._adas.emergency_braking_mps2)

    # Where.

    @property
    def vclass(self) -> str:
        """SUMO's class of it."""
        return self._class or libsumo.vehicle.getVehicleClass(self._name)

    def heed_closings(self, heeds: bool) -> None:
        """Keep out of lanes that are closed to it; or drive on into one, where it is too late to stop."""
        if heeds == bool(self._class):
            own = self.vclass
            self._set("VehicleClass", own if heeds else IGNORING)
            self._class = "" if heeds else own
