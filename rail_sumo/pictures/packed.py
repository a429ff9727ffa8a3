"""What the replay page unpacks: a ground and films, checked and packed.

Numbers are rounded to `QUANTA`, written as differences along each vehicle's way, and deflated.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rail_sumo.film import Driven, Film, Ground, Holding, MarkKind, Stays, Why
from rail_sumo.records import EndReason, Floats

FORMAT = 2
"""Of what is packed; the page refuses another."""

QUANTA = {
    "position_m": 0.01,
    "heading_rad": 2 * np.pi / 36_000,  # 0.01 degree
    "speed_mps": 0.01,
    "ray_m": 0.01,
    "gap_m": 0.01,
    "size_m": 0.01,
    "probability": 0.0001,  # the judge's score too
}
"""What numbers are rounded to: each is off by half of it at most."""

Integers = NDArray[np.int64]


def check_film(film: Film, ground: Ground) -> None:
    """Raise ValueError where a film's arrays contradict one another, or its ground."""
    rows = (film.frame, film.vehicle, film.x_m, film.y_m, film.heading_rad, film.speed_mps)
    if len({np.shape(row) for row in rows}) != 1 or np.ndim(film.frame) != 1:
        raise ValueError(f"film '{film.name}': frame, vehicle, x_m, y_m, heading_rad and speed_mps differ in shape")
    if not all(np.isfinite(row).all() for row in rows):
        raise ValueError(f"film '{film.name}': a place, heading or speed is not a number")
    if film.n_frames < 1 or not film.step_s > 0:
        raise ValueError(f"film '{film.name}': {film.n_frames} frames of {film.step_s} s")
    for name, row, end in (("frame", film.frame, film.n_frames), ("vehicle", film.vehicle, len(film.vehicles))):
        if len(row) and not 0 <= row.min() <= row.max() < end:
            raise ValueError(f"film '{film.name}': a {name} outside 0 to {end - 1}")
    if len(np.unique(np.column_stack([film.vehicle, film.frame]), axis=0)) != len(film.frame):
        raise ValueError(f"film '{film.name}': a vehicle is twice in one frame")
    if film.signals and len(film.signals) != len(ground.stop_lines):
        raise ValueError(
            f"film '{film.name}': signals of {len(film.signals)} stop lines, but there are {len(ground.stop_lines)}"
        )
    if film.driven is not None:
        _check_driven(film.name, film.driven, film)


def _check_driven(name: str, driven: Driven, film: Film) -> None:
    of_frames = (driven.set_mps, driven.limit_mps, driven.gap_m, driven.holding)
    per_frame = all(np.shape(row) == (film.n_frames,) for row in of_frames)
    if not per_frame or driven.ray_m.ndim != 2 or len(driven.ray_m) != film.n_frames:
        raise ValueError(f"film '{name}': what the driver saw has not one row per frame")
    if not all(np.isfinite(row).all() for row in (driven.ray_m, driven.limit_mps)):
        raise ValueError(f"film '{name}': a ray or a limit is not a number")
    if not 0 <= driven.vehicle < len(film.vehicles):
        raise ValueError(f"film '{name}': the host is vehicle {driven.vehicle} of {len(film.vehicles)}")
    if len(driven.holding) and not 0 <= driven.holding.min() <= driven.holding.max() < len(get_args(Holding)):
        raise ValueError(f"film '{name}': what the speed followed is outside 0 to {len(get_args(Holding)) - 1}")
    moments = [decision.frame for decision in driven.decisions] + [mark.frame for mark in driven.marks]
    if any(not 0 <= frame < film.n_frames for frame in moments):
        raise ValueError(f"film '{name}': a decision or mark outside the film")
    if not {decision.why for decision in driven.decisions} <= set(get_args(Why)):
        raise ValueError(f"film '{name}': a decision with an unknown reason")
    if not {decision.stays for decision in driven.decisions} <= set(get_args(Stays)):
        raise ValueError(f"film '{name}': the set speed stays at an unknown place")
    if not {mark.kind for mark in driven.marks} <= set(get_args(MarkKind)):
        raise ValueError(f"film '{name}': a mark of an unknown kind")
    if driven.end_reason not in ("", *get_args(EndReason)):
        raise ValueError(f"film '{name}': it ended for an unknown reason")


def pack_ground(ground: Ground, origin_m: tuple[float, float]) -> bytes:
    """Return the ground, deflated."""
    shapes = [lane.points for lane in ground.lanes] + list(ground.junctions)
    points = np.concatenate([np.reshape(shape, (-1, 2)) for shape in shapes]) if shapes else np.empty((0, 2))
    starts = _starts([len(shape) for shape in shapes])
    ends = np.array([line.ends for line in ground.stop_lines], dtype=float).reshape(-1, 2)
    header = {
        "name": ground.name,
        "is_left_hand": ground.is_left_hand,
        "lanes": [
            [lane.id, _quantum(lane.width_m, "size_m"), int(lane.is_open), int(lane.is_inside), lane.left_line]
            for lane in ground.lanes
        ],
        "stop_lines": [line.lane for line in ground.stop_lines],
    }
    return _packed(
        header,
        {
            "counts": np.array([len(shape) for shape in shapes], dtype=np.int64),
            "x": _differences(_quanta(points[:, 0] - origin_m[0], "position_m"), starts),
            "y": _differences(_quanta(points[:, 1] - origin_m[1], "position_m"), starts),
            "stop_x": _quanta(ends[:, 0] - origin_m[0], "position_m"),
            "stop_y": _quanta(ends[:, 1] - origin_m[1], "position_m"),
        },
    )


def pack_film(film: Film, origin_m: tuple[float, float]) -> bytes:
    """Return a film, deflated. Its rows are sorted by vehicle; a span is a stretch of frames without a gap."""
    order = np.lexsort((film.frame, film.vehicle))
    frame, vehicle = film.frame[order].astype(np.int64), film.vehicle[order].astype(np.int64)
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = (np.diff(vehicle) != 0) | (np.diff(frame) != 1)
    starts = np.flatnonzero(begins)
    kinds = sorted({vehicle.vclass for vehicle in film.vehicles})
    header = {
        "name": film.name,
        "start_s": film.start_s,
        "step_s": film.step_s,
        "n_frames": film.n_frames,
        "left_out": film.left_out,
        "vclasses": kinds,
        "vehicles": [
            [who.id, kinds.index(who.vclass), _quantum(who.length_m, "size_m"), _quantum(who.width_m, "size_m")]
            for who in film.vehicles
        ],
        "signals": film.signals,
        "driven": None if film.driven is None else _driven_header(film.driven),
    }
    heading = _quanta(film.heading_rad[order] % (2 * np.pi), "heading_rad")
    turns = _differences(heading, starts)
    streams = {
        "span_vehicle": _differences(vehicle[starts], _starts([len(starts)])),
        "span_first": frame[starts],
        "span_length": np.diff(np.append(starts, len(order))),
        "x": _second_differences(_quanta(film.x_m[order] - origin_m[0], "position_m"), starts),
        "y": _second_differences(_quanta(film.y_m[order] - origin_m[1], "position_m"), starts),
        "heading": (turns + 18_000) % 36_000 - 18_000,  # the short way round
        "speed": _differences(_quanta(film.speed_mps[order], "speed_mps"), starts),
    }
    if film.driven is not None:
        streams |= _driven_streams(film.driven)
    return _packed(header, streams)


def _driven_header(driven: Driven) -> dict[str, Any]:
    return {
        "vehicle": driven.vehicle,
        "n_rays": driven.ray_m.shape[1],
        "range_m": driven.range_m,
        "decisions": [
            [
                decision.frame,
                int(decision.asked),
                int(decision.carried_out),
                decision.why,
                [int(is_open) for is_open in decision.open],
                [_quantum(share, "probability") for share in decision.probabilities],
                None if decision.judged is None else _quantum(decision.judged, "probability"),
                decision.stays,
            ]
            for decision in driven.decisions
        ],
        "marks": [[mark.frame, mark.kind, mark.text] for mark in driven.marks],
        "end_reason": driven.end_reason,
    }


def _driven_streams(driven: Driven) -> dict[str, Integers]:
    n_frames, n_rays = driven.ray_m.shape
    one = _starts([n_frames])
    return {
        "ray": _differences(_quanta(driven.ray_m.T.ravel(), "ray_m"), np.arange(n_rays) * n_frames),
        **_with_gaps("set", driven.set_mps, "speed_mps"),
        "limit": _differences(_quanta(driven.limit_mps, "speed_mps"), one),
        **_with_gaps("gap", driven.gap_m, "gap_m"),
        "holding": _differences(driven.holding.astype(np.int64), one),
    }


def _with_gaps(name: str, values: Floats, quantum: str) -> dict[str, Integers]:
    """Return values of which some are not there, and which are."""
    one, is_there = _starts([len(values)]), np.isfinite(values)
    return {
        name: _differences(_quanta(np.where(is_there, values, 0.0), quantum), one),
        f"has_{name}": _differences(is_there.astype(np.int64), one),
    }


def _packed(header: Mapping[str, Any], streams: Mapping[str, Integers]) -> bytes:
    """Deflate the header's length (four bytes, little-endian), the header, and the streams one after the other."""
    encoded = {name: _varints(values) for name, values in streams.items()}
    sizes = {name: [len(streams[name]), len(encoded[name])] for name in streams}
    head = json.dumps(
        {**header, "streams": sizes},
        ensure_ascii=False,
        allow_nan=False,
        separators=(",", ":"),
        default=lambda number: number.item(),  # numpy's
    )
    raw = head.encode("utf-8", "replace")
    return zlib.compress(b"".join([len(raw).to_bytes(4, "little"), raw, *encoded.values()]), 9)


def _varints(values: Integers) -> bytes:
    """Encode as protocol buffers do: the sign in the lowest bit, then seven bits a byte, the lowest first."""
    _check_fits(values)
    rest = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    sizes = np.ones(len(rest), dtype=np.int64)
    for bits in range(7, 64, 7):
        sizes += rest >= np.uint64(1 << bits)
    places = np.cumsum(sizes) - sizes
    encoded = np.zeros(int(sizes.sum()), dtype=np.uint8)
    for byte in range(int(sizes.max(initial=0))):
        has = sizes > byte
        more = np.where(sizes[has] > byte + 1, 0x80, 0)
        encoded[places[has] + byte] = ((rest[has] >> np.uint64(7 * byte)) & np.uint64(0x7F)) | more.astype(np.uint64)
    return encoded.tobytes()


def _starts(lengths: Sequence[int]) -> Integers:
    """Where stretches of these lengths start; those without a length do not."""
    ends = np.cumsum(np.array(lengths, dtype=np.int64))
    return (ends - lengths)[np.array(lengths, dtype=np.int64) > 0].astype(np.int64)


def _differences(values: Integers, starts: Integers) -> Integers:
    """Return each value less the one before it; at a start, the value itself."""
    found = np.diff(values, prepend=0)
    found[starts] = values[starts]
    return found


def _second_differences(values: Integers, starts: Integers) -> Integers:
    """Return each value less where the two before it point; right after a start, less the one before it."""
    first = _differences(values, starts)
    found = np.diff(first, prepend=0)
    found[starts] = first[starts]
    after = starts[starts + 1 < len(values)] + 1
    found[after] = first[after]  # a start right after a start is its own difference too
    return found


def _quanta(values: ArrayLike, of: str) -> Integers:
    rounded = np.rint(np.asarray(values, dtype=np.float64) / QUANTA[of])
    _check_fits(rounded)
    return rounded.astype(np.int64)


def _check_fits(values: NDArray[Any]) -> None:
    if len(values) and not -(2**31) <= values.min() <= values.max() < 2**31:
        raise ValueError("a number is too large to be packed: do places lie more than 5,000 km apart?")


def _quantum(value: float, of: str) -> int:
    return round(float(value) / QUANTA[of])
