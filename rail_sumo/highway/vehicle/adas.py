"""The layer between the supervisor and the vehicle: a meta-action and the host's surroundings become commands.

It decides the set speed with its comfortable ramp, and the lane change: its gap gate, its lateral path, its reversal.
Following the vehicle ahead is adaptive cruise control (`acc`), which acts at every SUMO step below the set speed.
"""

import math
from collections.abc import Callable
from typing import Literal

from rail_sumo import config
from rail_sumo.film import Why
from rail_sumo.highway.vehicle import acc, lane_ends
from rail_sumo.highway.vehicle.hard_braking import HARD_MPS2
from rail_sumo.highway.vehicle.lane_ends import LEFT, RIGHT, Side
from rail_sumo.records import KMH, SECONDS_PER_STEP, SUMO_DECIDES, Command, Gaps, HostState, MetaAction

LATE_LATERAL_M = 0.25
"""How far before the border, in metres, the host becomes a vehicle of the lane it moves into. A neighbour in that lane
sees the host only from then on, and with this margin two cars 1.8 m wide cannot have touched before."""
FOLLOWER_TIME_GAP_S = 0.5
"""Time gap that the gate leaves to the vehicle behind."""
OPENING_TIME_GAP_S = 0.5
"""Time gap that it leaves at least to a faster vehicle ahead, where the host must leave its lane."""
GATE_BRAKING_MPS2 = HARD_MPS2
"""The hardest braking that a lane change may cost the host behind its new leader, or its new follower."""

EASY_MPS2 = 0.2
"""How gently braking to the end of such a lane would be, at the lowest speed to which the host slows for a gap beside:
far from the end it may find another, and would hold up those behind it for nothing."""
ROUNDED = 1.0001
"""By how much SUMO's own driver may be faster than is allowed: networks tell 80 km/h as 22.2222 m/s."""
TOUCH_M = 0.01
"""A place nearer than this counts as reached."""


class Adas:
    """Carries meta-actions out; one instance an episode.

    A lane change moves the host sideways at `lateral_speed_mps`, even from a standstill, or it could not leave a lane
    at whose end it waits. Until it is complete a decision for the other side reverses it, and so does the layer itself
    while the gap closes before the host has crossed over.

    Args:
        config: its limits.
        start_mps: the first set speed.
        settle_s: how long after it has crossed over no decision takes the host back to the lane it came from.
        gain_s: within what time a change that is decided must get the host farther; 0 if it need not.
    """

    def __init__(self, config: config.Adas, *, start_mps: float, settle_s: float = 0.0, gain_s: float = 0.0) -> None:
        self._config = config
        self._gain_s = gain_s
        self._settle_steps = round(settle_s / SECONDS_PER_STEP)
        self._set_speed = start_mps
        self._side: Side | None = None  # the side of the change under way, None while keeping the lane
        self._width = 0.0  # lateral distance from lane centre to lane centre of the change under way
        self._border = 0.0  # ... and to the border between the two lanes
        self._moved = 0.0  # how much of it lies behind the host
        self._crossed = False
        self._reversing = False
        self._came_from: Side | None = None  # on which side the lane lies that it has last crossed over from
        self._settles = 0  # for how many steps no decision takes it back there
        self._sumos_lane_changes = 0
        self.lane_changes = 0
        self.aborted_lane_changes = 0
        self.refused_decisions = 0
        self.why: Why = ""
        """Why the last decision was not carried out."""
        self.falls_in = False
        """Whether the last command lowers the speed for a gap in the lane that the host must move into."""

    def set_mps(self, limit_mps: float) -> float:
        """Return the set speed, as it is held where the limit is this."""
        return self._config.held_mps(self._set_speed, limit_mps)

    @property
    def changing_lane(self) -> bool:
        """Whether a lane change is under way."""
        return self._side is not None

    @property
    def side(self) -> Side | None:
        """Where the change under way set out for: LEFT, RIGHT, or None while keeping the lane."""
        return self._side

    @property
    def is_reversing(self) -> bool:
        """Whether it goes back to the lane that it set out from."""
        return self._side is not None and self._reversing

    @property
    def aim(self) -> Side | Literal[0]:
        """On which side the lane is that the host is about to cross over into; 0 if it is not."""
        if self._side is None or self._crossed != self._reversing:
            return 0
        return self._into(self._side)

    def _into(self, side: Side) -> Side:
        return lane_ends.other(side) if self._crossed else side

    @property
    def lateral_m(self) -> float:
        """Offset from the centre of the lane the change under way set out from, leftwards positive."""
        return 0.0 if self._side is None else self._side * self._moved

    def allowed(self, host: HostState, gaps: Callable[[int], Gaps]) -> list[bool]:
        """Return for each `MetaAction` whether a masked policy may choose it: it would be carried out now.

        While a change is under way the mask offers only to hold or to turn back, though a speed decision would act.
        """
        if self._side is None:
            return [True, True, True, self._open(LEFT, host, gaps), self._open(RIGHT, host, gaps)]
        back = not self._reversing and self._may_turn_back(host, gaps)
        return [True, False, False, back and self._side == RIGHT, back and self._side == LEFT]

    def decide(self, action: MetaAction, host: HostState, gaps: Callable[[int], Gaps]) -> MetaAction:
        """Take one decision of the supervisor and return the meta-action that is carried out.

        A lane change that cannot be carried out safely is refused and counted, and KEEP is returned, as it is when that
        change is under way already.
        """
        carried_out, self.why = action, ""
        step = self._config.speed_step_kmh / KMH
        if action is MetaAction.ACCELERATE:
            self._set_speed = host.speed_mps + step
        elif action is MetaAction.DECELERATE:
            self._set_speed = host.speed_mps - step
        elif action is not MetaAction.KEEP and not self._steer(
            LEFT if action is MetaAction.LEFT else RIGHT, host, gaps
        ):
            carried_out = MetaAction.KEEP
        return carried_out

    def command(self, host: HostState, gaps: Callable[[int], Gaps], *, steps: int) -> Command:
        """Return what to do next, for at most `steps` steps: as many as need no fresh look.

        Near the end of a lane that does not lead on, the layer leaves it of its own accord as soon as it can. Until it
        has crossed over it falls in behind the vehicle ahead in the lane beside, and asks to be let in.
        """
        if host.sumos_lane_changes > self._sumos_lane_changes:
            self.lane_changes = self.lane_changes_by_now(host.sumos_lane_changes)
            self._sumos_lane_changes = host.sumos_lane_changes
            self._side = None  # a change under way is over then
        way_on = lane_ends.way_on(host)
        if way_on is not None and self._side is None and self._open(way_on, host, gaps):
            self._begin(way_on, host)
        set_speed = self.set_mps(host.limit_mps)
        speed = max(set_speed, host.speed_mps - self._config.comfort_braking_mps2 * SECONDS_PER_STEP)
        stays = self._side is None and way_on is None
        if stays and speed == set_speed == _within_limits(speed, host, self._config, steps=steps):
            return Command(speed, steps=steps, must_leave=lane_ends.must_leave(host))
        limited = _within_limits(speed, host, self._config, steps=1)
        falling_in = math.inf
        if way_on is not None and (self._side is None or self.aim == way_on):
            falling_in = self._falling_in_mps(host, gaps(way_on))
        self.falls_in = falling_in < limited
        limited = min(limited, falling_in)
        command = Command(limited) if self._side is None else self._sideways(self._side, limited, host, gaps)
        if command.cross:
            return command
        return command._replace(asks=way_on or 0, must_leave=lane_ends.must_leave(host))

    def note(self, steps: int) -> None:
        """Note that the last command was carried out, for so many steps."""
        self._settles = max(self._settles - steps, 0)

    def _falling_in_mps(self, host: HostState, beside: Gaps) -> float:
        """Return the speed that opens a gap behind the vehicle ahead in a lane beside; inf if none is in sight.

        The nearer the end of its own lane, the slower the host may become for that.
        """
        if math.isinf(beside.ahead_m):
            return math.inf
        ahead = acc.Leader(beside.ahead_m, beside.ahead_speed_mps)
        slowest = math.sqrt(2 * EASY_MPS2 * lane_ends.joins_in_m(host))
        return max(acc.falling_in_mps(host.speed_mps, ahead, self._config), slowest)

    def lane_changes_by_now(self, sumos: int) -> int:
        """Return how many were completed, with all that SUMO has changed by now while the host asked to be let in."""
        return self.lane_changes + sumos - self._sumos_lane_changes

    def _steer(self, side: Side, host: HostState, gaps: Callable[[int], Gaps]) -> bool:
        """Begin a lane change or turn the one under way round, and return whether this was done."""
        if self._side is None:
            self.why = self._obstacle(side, host, gaps)
            if not self.why:
                self._begin(side, host)
                return True
        turns_round = self._side is not None and (side == self._side) == self._reversing
        if turns_round and not self._reversing and self._may_turn_back(host, gaps):
            self._reversing = True
            return True
        if self._side is None or turns_round:  # no gap, no room to turn back, or turned back already
            self.refused_decisions += 1
        self.why = self.why or "under way"
        return False

    def _begin(self, side: Side, host: HostState) -> None:
        self._side, self._width, self._moved = side, _across(host, side), 0.0
        self._border = host.lane_width_m / 2
        self._crossed = self._reversing = False

    def _open(self, side: Side, host: HostState, gaps: Callable[[int], Gaps]) -> bool:
        """Whether a change to this side may begin: there is a lane, no line forbids it, road enough, and a gap."""
        return not self._obstacle(side, host, gaps)

    def _obstacle(self, side: Side, host: HostState, gaps: Callable[[int], Gaps]) -> Why:
        """Return what a change to this side may not begin for.

        A lane that soon leads off the course is not open, nor one farther away from it, nor for a while the one that
        the host came from, unless it must go back, nor one in which it gets no farther.
        """
        if not _across(host, side):
            return "line" if host.rightmost_lane <= host.lane + side <= host.leftmost_lane else "no lane"
        if not self._has_room(host, side):
            return "room"
        if not lane_ends.may_enter(host, side):
            return "lane ends"
        if self._settles and side == self._came_from and side != lane_ends.way_on(host):
            return "just left"
        if not self._safe(host, side, gaps(side)):
            return "gap"
        return "" if side == lane_ends.must_leave(host) or self._gains(side, host, gaps) else "no gain"

    def _gains(self, side: Side, host: HostState, gaps: Callable[[int], Gaps]) -> bool:
        """Whether it gets the host farther, or is asked for nothing."""
        return not self._gain_s or self._gets_m(host, gaps(side)) > self._gets_m(host, gaps(0))

    def _gets_m(self, host: HostState, lane: Gaps) -> float:
        """Return how far the host may get in a lane within the time in which a change must gain.

        As fast as it may be here, up to its time gap behind who is ahead, if that one keeps its speed.
        """
        behind_m = lane.ahead_m - self._config.standstill_gap_m - self._config.time_gap_s * host.speed_mps
        fastest_mps = self._config.highest_mps(host.limit_mps)
        return min(fastest_mps * self._gain_s, behind_m + lane.ahead_speed_mps * self._gain_s)

    def _may_turn_back(self, host: HostState, gaps: Callable[[int], Gaps]) -> bool:
        """Whether the change under way may be reversed by a decision: not into a lane that must be left by now."""
        assert self._side is not None
        if not self._crossed:
            return lane_ends.way_on(host) != self._side
        return self._open(lane_ends.other(self._side), host, gaps)

    def _has_room(self, host: HostState, side: Side) -> bool:
        """Whether a change to a side ends before the lanes part, even if the host speeds up meanwhile.

        A lane that does not lead on holds it back.
        """
        goes_on_m = host.left_goes_on_m if side == LEFT else host.right_goes_on_m
        room_m, seconds = host.to_edge_end_m + goes_on_m, _across(host, side) / self._config.lateral_speed_mps
        if goes_on_m:
            seconds += 2 * SECONDS_PER_STEP  # it may have to wait before it crosses over, see `_sideways`
        faster = self._config.acceleration_mps2 if host.ends_in_m(host.lane) > room_m else 0.0
        fastest = max(host.speed_mps, self._config.highest_mps(host.limit_mps))
        return room_m >= min(host.speed_mps + 0.5 * faster * seconds, fastest) * seconds

    def _safe(self, host: HostState, side: Side, gap: Gaps) -> bool:
        """The gate: neither the host behind its new leader nor the new follower needs to brake hard.

        Where the host must leave its lane, it takes shorter gaps: there it counts on who is ahead to drive on, unless
        that would set off emergency braking, and a gap may open, within 4 s to what the gate asks for.
        """
        limits, speed_mps = self._config, host.speed_mps
        ahead_mps, behind_mps = gap.ahead_speed_mps, gap.behind_speed_mps
        hardest = limits.emergency_braking_mps2
        hosts_own = min(GATE_BRAKING_MPS2, hardest)
        if side != lane_ends.way_on(host):
            ahead = _gap_needed(speed_mps, ahead_mps, limits.time_gap_s, hosts_own)
            behind = _gap_needed(behind_mps, speed_mps, FOLLOWER_TIME_GAP_S, GATE_BRAKING_MPS2)
        else:
            ahead = _gap_where_it_must(speed_mps, ahead_mps, limits.time_gap_s, hosts_own, hardest)
            behind = _gap_where_it_must(behind_mps, speed_mps, FOLLOWER_TIME_GAP_S, GATE_BRAKING_MPS2, hardest)
            ahead = max(ahead - acc.FALLS_BACK_S * max(ahead_mps - speed_mps, 0.0), OPENING_TIME_GAP_S * speed_mps)
            behind = max(behind - acc.FALLS_BACK_S * max(speed_mps - behind_mps, 0.0), 0.0)
        return gap.ahead_m >= limits.standstill_gap_m + ahead and gap.behind_m >= limits.standstill_gap_m + behind

    def _sideways(self, side: Side, speed: float, host: HostState, gaps: Callable[[int], Gaps]) -> Command:
        """One step of the change under way.

        The host does not cross over in a step that may take it on to the next edge, where its lane may have another
        number: it waits beside the border. Nothing takes it on from a lane that leads nowhere.
        """
        into = self._into(side)
        if self.aim and not (_across(host, into) and self._safe(host, into, gaps(into))):
            self._reversing = not self._reversing  # the lane the host is a vehicle of is always open to it
        stride = self._config.lateral_speed_mps * SECONDS_PER_STEP
        moved = min(max(self._moved + (-stride if self._reversing else stride), 0.0), self._width)
        cross = self._cross(side, moved)
        fastest = host.speed_mps + self._config.acceleration_mps2 * SECONDS_PER_STEP
        is_led_on = host.ends_in_m(host.lane) > host.to_edge_end_m
        if cross and is_led_on and host.to_edge_end_m <= fastest * SECONDS_PER_STEP:
            cross, moved = 0, self._moved
        self._moved = moved
        if cross:
            self._crossed = not self._crossed
            self._came_from, self._settles = lane_ends.other(into), self._settle_steps
        lateral = side * (self._moved - (self._width if self._crossed else 0.0))
        if self._moved == (0.0 if self._reversing else self._width):
            if self._reversing:
                self.aborted_lane_changes += 1
            else:
                self.lane_changes += 1
            self._side = None
        return Command(speed, lateral, cross)

    def _cross(self, side: Side, moved: float) -> int:
        """Cross over a little before the border, in either direction of travel."""
        if not self._crossed and not self._reversing and moved >= self._border - LATE_LATERAL_M:
            return side
        if self._crossed and self._reversing and moved <= self._border + LATE_LATERAL_M:
            return -side
        return 0


def _within_limits(speed_mps: float, host: HostState, config: config.Adas, *, steps: int) -> float:
    """Return a speed, lowered as far as it must so that in so many steps the host keeps to every limit and stop.

    It brakes comfortably; for a dead end, harder. Where it is too late for that, it exceeds a limit for a while, but
    for a stop brakes as hard as it takes.
    """
    comfort, hardest = config.comfort_braking_mps2, config.emergency_braking_mps2
    seconds = steps * SECONDS_PER_STEP
    fastest = max(host.speed_mps, min(speed_mps, host.speed_mps + config.acceleration_mps2 * seconds))
    travel_m = fastest * seconds
    allowed = min(speed_mps, _approaching(host.limit_mps, host, 0.0, travel_m, comfort))
    for beyond_m, limit in host.limits_ahead:
        allowed = min(allowed, _approaching(limit, host, host.to_edge_end_m + beyond_m, travel_m, comfort))
    stops = [(*stop, comfort) for stop in host.stops_ahead]
    stops.append((lane_ends.stands_in_m(host), 0.0, lane_ends.braking_mps2(host, comfort)))
    for ahead_m, slow, least in stops:
        it_takes = (host.speed_mps**2 - slow**2) / (2 * max(ahead_m, TOUCH_M))
        allowed = min(allowed, _approaching(slow, host, ahead_m, travel_m, min(max(it_takes, least), hardest)))
    return allowed


def slowed_for(host: HostState, config: config.Adas, speed_mps: float) -> Literal["limit", "stop", "lane end"]:
    """Return what `Adas.command` lowers a speed for, where it does: a limit, a place to stop at, or the lane's end."""

    def within(part: HostState) -> float:
        return _within_limits(speed_mps, part, config, steps=1)

    no_stops = host._replace(stops_ahead=())
    endless = host._replace(leads_on_m=(math.inf,) * len(host.leads_on_m))
    if within(endless._replace(stops_ahead=())) <= within(host):
        return "limit"
    return "lane end" if within(no_stops) <= within(host) else "stop"


def _approaching(limit_mps: float, host: HostState, ahead_m: float, travel_m: float, braking_mps2: float) -> float:
    """Return the highest speed, some metres from here, that a limit ahead allows: sqrt(v^2 + 2 b s).

    It is no lower than such braking comes down to in one step.
    """
    allowed = math.sqrt(limit_mps**2 + 2 * braking_mps2 * max(ahead_m - travel_m, 0.0))
    return max(allowed, host.speed_mps - braking_mps2 * SECONDS_PER_STEP)


def _across(host: HostState, side: Side) -> float:
    """Return the lateral distance from the centre of the host's lane to that of the next, in metres."""
    return host.to_left_m if side == LEFT else host.to_right_m


def _gap_needed(speed_mps: float, leader_mps: float, time_gap_s: float, braking_mps2: float) -> float:
    """Return the gap that holds the time gap and the distance in which a vehicle brakes to its leader's speed.

    T w + (v^2 - w^2) / (2 b) behind a leader of speed w, as if it did not move on meanwhile; T v behind a faster one.
    """
    slower = min(speed_mps, leader_mps)
    return time_gap_s * slower + (speed_mps**2 - slower**2) / (2 * braking_mps2)


def _gap_where_it_must(
    speed_mps: float, leader_mps: float, time_gap_s: float, braking_mps2: float, hardest_mps2: float
) -> float:
    """Return the gap where the leader drives on meanwhile: T w + (v - w)^2 / (2 b); T v behind a faster one.

    No harder than b, as MOBIL's safety criterion has it (Kesting, Treiber & Helbing, 2007); and so far that emergency
    braking does not begin.
    """
    slower = min(speed_mps, leader_mps)
    drives_on = time_gap_s * slower + (speed_mps - slower) ** 2 / (2 * braking_mps2)
    return max(drives_on, acc.emergency_gap_m(speed_mps, slower, hardest_mps2))


class HandsOff:
    """Stands in for `Adas` when SUMO's own driver drives: keeps to limits and stops, and counts SUMO's lane changes.

    SUMO changes lanes within one step, so each counts one step as under way.

    Args:
        config: its limits.
        keeps_limits: whether it does; else they are SUMO's to keep, as of its other vehicles.
    """

    lateral_m = 0.0
    aim = 0
    side = None
    why: Why = ""
    is_reversing = False
    falls_in = False
    aborted_lane_changes = 0
    refused_decisions = 0

    def __init__(self, config: config.Adas, *, keeps_limits: bool = True) -> None:
        self._config = config
        self._keeps_limits = keeps_limits
        self.changing_lane = False
        self.lane_changes = 0

    def lane_changes_by_now(self, sumos: int) -> int:
        """Return how many SUMO has changed by now."""
        return sumos

    def set_mps(self, limit_mps: float) -> float:
        """Return NaN: SUMO's driver has no set speed."""
        return math.nan

    def allowed(self, host: HostState, gaps: Callable[[int], Gaps]) -> list[bool]:
        """Return that only keeping is allowed: no decision is carried out."""
        return [True, False, False, False, False]

    def decide(self, action: MetaAction, host: HostState, gaps: Callable[[int], Gaps]) -> MetaAction:
        """Ignore the decision and return KEEP."""
        return MetaAction.KEEP

    def note(self, steps: int) -> None:
        """Do nothing: of a lane change of SUMO's nothing is left to wait for."""

    def command(self, host: HostState, gaps: Callable[[int], Gaps], *, steps: int) -> Command:
        """Return one step of SUMO's own driving."""
        self.changing_lane = host.sumos_lane_changes > self.lane_changes
        self.lane_changes = host.sumos_lane_changes
        if not self._keeps_limits:
            return Command(SUMO_DECIDES)
        highest = self._config.highest_mps(host.limit_mps)
        fastest = max(highest, host.speed_mps - self._config.comfort_braking_mps2 * SECONDS_PER_STEP)
        limited = _within_limits(fastest, host, self._config, steps=1)
        is_too_fast = host.speed_mps > highest * ROUNDED
        return Command(limited if limited < fastest or is_too_fast else SUMO_DECIDES)
