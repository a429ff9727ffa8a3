"""Films for the page's tests, made without SUMO: a bent motorway of three lanes with a ramp and a signal, or a town.

python tests/films.py FOLDER writes the pages that the browser's tests open, and what they should show.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd

from rail_sumo import assets
from rail_sumo.film import Decision, Driven, Film, Ground, Holding, Lane, Mark, MarkKind, StopLine, Vehicle
from rail_sumo.pictures import page, report_page
from rail_sumo.records import MetaAction
from rail_sumo.tables import report
from rail_sumo.tables.shares import DIFFERENCE_COLUMNS, HEADINGS, SUMMARY_COLUMNS

LANE_M, N_LANES, N_RAYS, RANGE_M = 3.5, 3, 24, 100.0
EAST_M, NORTH_M = 468_000.0, 5_540_000.0  # far from the origin, as georeferenced networks are
SIGNAL_M, RAMP_M, END_M = 5_200.0, (1_500.0, 1_900.0), 12_000.0
ENTERS_S = 180.0  # the simulation's time when an episode begins
CLOSED_M = (3_000.0, 3_600.0)
HOSTILE = "</script><img src=x onerror=alert(1)>&\u2028'\""


def at(s, lateral):
    """x, y and heading at s along the motorway, `lateral` metres to the left of its right border."""
    s = np.asarray(s, dtype=float)
    y, slope = 180 * np.sin(s / 900), 0.2 * np.cos(s / 900)
    heading = np.arctan2(slope, 1.0)
    return EAST_M + s - lateral * np.sin(heading), NORTH_M + y + lateral * np.cos(heading), heading


def _lane(name, begin, end, lateral, **kind):
    x, y, _ = at(np.arange(begin, end + 1e-6, 10.0), lateral)
    kind = {"width_m": LANE_M, "is_open": True, "is_inside": False, "left_line": "dashed"} | kind
    return Lane(name, np.column_stack([x, y]), **kind)


def motorway():
    """Three lanes; a ramp on their right, a lane closed to cars, a solid line, and a signal far down the road."""
    lanes = []
    pieces = [("west", 0.0, CLOSED_M[0]), ("bus", *CLOSED_M), ("middle", CLOSED_M[1], SIGNAL_M)]
    for name, begin, end in (*pieces, ("east", SIGNAL_M + 20, END_M)):
        for lane in range(N_LANES):
            line = "none" if lane == N_LANES - 1 else "solid" if name == "middle" and lane == 0 else "dashed"
            is_open = not (name == "bus" and lane == 0)
            lanes.append(_lane(f"{name}_{lane}", begin, end, (lane + 0.5) * LANE_M, left_line=line, is_open=is_open))
    for lane in range(N_LANES):
        inside = {"is_inside": True, "left_line": "none"}
        lanes.append(_lane(f":crossing_{lane}_0", SIGNAL_M, SIGNAL_M + 20, (lane + 0.5) * LANE_M, **inside))
    s = np.arange(RAMP_M[0] - 200, RAMP_M[1] + 1, 10.0)
    away = np.clip((RAMP_M[0] - s) / 200, 0, 1) ** 1.5 * 40
    x, y, _ = at(s, -0.5 * LANE_M - away)
    lanes.append(Lane("ramp_0", np.column_stack([x, y]), LANE_M, True, False, "dashed"))
    corners = np.array(
        [
            at(SIGNAL_M + s, d)[:2]
            for s, d in ((0, -1), (6, -12), (14, -12), (20, -1), (20, 11.5), (14, 22), (6, 22), (0, 11.5))
        ]
    )
    stops = []
    for lane in range(N_LANES):
        right, left = at(SIGNAL_M - 1, lane * LANE_M + 0.3), at(SIGNAL_M - 1, (lane + 1) * LANE_M - 0.3)
        stops.append(StopLine(f"middle_{lane}", (*map(float, right[:2]), *map(float, left[:2]))))
    return Ground(tuple(lanes), (corners,), tuple(stops), "motorway")


def drive(seed=0, *, name="rail", seconds=300.0, step_s=0.1, n_vehicles=20, eager=1.0, ids=None, end_reason="duration"):
    """A host among others on the motorway, with everything that can happen to it."""
    rng = np.random.default_rng(seed)
    n_frames = round(seconds / step_s) + 1
    t = np.arange(n_frames) * step_s
    vehicles, speeds, places, lanes, laterals = [], [], [], [], []
    for who in range(n_vehicles):
        heavy = who > 0 and rng.random() < 0.3
        base = (27 + eager) if who == 0 else rng.uniform(19, 23) if heavy else rng.uniform(23, 31)
        speed = np.maximum(base + 2 * np.sin(t / rng.uniform(8, 20) + rng.uniform(0, 6)), 0)
        start = 600.0 if who == 0 else 600 + rng.uniform(-250, 700)
        s = start + np.concatenate([[0], np.cumsum(0.5 * step_s * (speed[1:] + speed[:-1]))])
        lane = np.full(n_frames, 0 if heavy else rng.integers(0, N_LANES))
        kind = ("truck", rng.uniform(10, 16), 2.5) if heavy else ("passenger", rng.uniform(4.2, 5.0), 1.8)
        if who == 5:
            kind = ("bus", 12.0, 2.5)
        vehicles.append(Vehicle(ids[who] if ids else ("host" if who == 0 else f"veh{who}"), *kind))
        speeds.append(speed), places.append(s), lanes.append(lane)
    decisions, marks, lateral = _decide(rng, n_frames, step_s, eager)
    for who in range(n_vehicles):
        laterals.append(lateral if who == 0 else (lanes[who] + 0.5) * LANE_M)
    rows = {key: [] for key in ("frame", "vehicle", "x_m", "y_m", "heading_rad", "speed_mps")}
    for who in range(n_vehicles):
        x, y, heading = at(places[who], laterals[who])
        sideways = np.arctan2(np.gradient(laterals[who], step_s), np.maximum(speeds[who], 1.0))
        near = np.abs(places[who] - places[0]) < 450 if who else np.ones(n_frames, dtype=bool)
        columns = (np.arange(n_frames), np.full(n_frames, who), x, y, heading + sideways, speeds[who])
        for key, column in zip(rows, columns, strict=True):
            rows[key].append(np.asarray(column)[near])
    columns = {key: np.concatenate(parts) for key, parts in rows.items()}
    order = np.lexsort((columns["vehicle"], columns["frame"]))
    columns = {key: column[order] for key, column in columns.items()}
    columns["frame"], columns["vehicle"] = columns["frame"].astype(np.int32), columns["vehicle"].astype(np.int32)
    changes = ((0, "r"), (300, "u"), (330, "G"), (1400, "y"), (1440, "r"), (1500, "G"))
    gap = np.min(
        [np.where((d := s - places[0] - 4.6) > 0, d, np.inf) for s in places[1:]] or [np.full(n_frames, np.inf)], axis=0
    )
    driven = Driven(
        vehicle=0,
        ray_m=_rays(columns, vehicles, laterals[0], n_frames),
        range_m=RANGE_M,
        set_mps=np.clip(np.round(speeds[0] / 1.39) * 1.39, 0, 33.3),
        limit_mps=np.where(places[0] < 3_600, 33.33, 27.78),
        gap_m=np.where(gap < 250, gap, np.nan),
        holding=_holding(rng, n_frames),
        decisions=decisions,
        marks=marks,
        end_reason=end_reason,
    )
    return Film(
        name=name,
        start_s=ENTERS_S,
        step_s=step_s,
        n_frames=n_frames,
        vehicles=tuple(vehicles),
        signals=(tuple((min(f, n_frames - 1), c) for f, c in changes),) * N_LANES,
        driven=driven,
        left_out="Vehicles farther than 450 m from the host are left out.",
        **columns,
    )


def sumos(seed=0, **kind):
    """The same, driven by SUMO's own driver."""
    film = drive(seed, **kind)
    holding = np.full(film.n_frames, get_args(Holding).index("SUMO"), dtype=np.int8)
    set_mps = np.full(film.n_frames, np.nan)
    return replace(film, driven=replace(film.driven, set_mps=set_mps, holding=holding, decisions=()))


def _decide(rng, n_frames, step_s, eager):
    """Decisions once a second, marks, and where across the road the host is."""
    decisions, marks, lateral = [], [], np.empty(n_frames)
    lane, per_second, now = 1, round(1 / step_s), 1.5 * LANE_M
    target = now
    for frame in range(n_frames):
        if frame % per_second == 0:
            is_open = [True, True, True, lane < N_LANES - 1 and rng.random() < 0.7, lane > 0 and rng.random() < 0.7]
            wish = np.array([4.0, 2.0 * eager, 1.0, 0.9, 0.9]) * rng.gamma(1.0, 1.0, 5)
            asked = MetaAction(int(np.argmax(wish)))
            carried_out, why = asked, ""
            if asked in (MetaAction.LEFT, MetaAction.RIGHT):
                step = 1 if asked is MetaAction.LEFT else -1
                if abs(target - now) > 0.05:
                    carried_out, why = MetaAction.KEEP, "under way"
                elif not 0 <= lane + step < N_LANES:
                    carried_out, why = MetaAction.KEEP, "no lane"
                elif not is_open[asked]:
                    carried_out, why = MetaAction.KEEP, str(rng.choice(["gap", "gap", "line", "room", "lane ends"]))
                else:
                    lane += step
                    target = (lane + 0.5) * LANE_M
                    marks.append(Mark(frame, "lane change", f"to the {asked.name.lower()}"))
                if why:
                    marks.append(Mark(frame, "refused", f"{asked.name.lower()}: {why}"))
            shares = tuple(float(share) for share in wish / wish.sum())
            judged = float(rng.beta(4, 3))
            stays = "lowest" if asked is MetaAction.DECELERATE and len(decisions) % 2 else ""
            decisions.append(Decision(frame, asked, carried_out, why, tuple(is_open), shares, judged, stays))
        now += np.clip(target - now, -1.7 * step_s, 1.7 * step_s)
        lateral[frame] = now
    kinds = [kind for kind in get_args(MarkKind) if kind not in ("lane change", "refused")]
    often = {"overtake": 40, "overtaken": 8, "hard braking": 3, "collision": 1, "struck": 1}
    for kind in kinds:
        for frame in rng.integers(0, n_frames, round(often.get(kind, 2) * (eager if kind == "overtake" else 1))):
            marks.append(Mark(int(frame), kind, f"veh{frame % 19 + 1}" if "overt" in kind else ""))
    return tuple(decisions), tuple(sorted(marks, key=lambda mark: mark.frame)), lateral


def _rays(columns, vehicles, lateral, n_frames):
    """How far rays reach, roughly: to boxes taken as circles, and to the borders of a straight road."""
    rays = np.full((n_frames, N_RAYS), RANGE_M)
    angles = 2 * np.pi * np.arange(N_RAYS) / N_RAYS
    width = N_LANES * LANE_M
    with np.errstate(divide="ignore"):
        left, right = (width - lateral[:, None]) / np.sin(angles), -lateral[:, None] / np.sin(angles)
    border = np.where(np.sin(angles) > 1e-6, left, np.where(np.sin(angles) < -1e-6, right, np.inf))
    rays = np.minimum(rays, border)
    bounds = np.searchsorted(columns["frame"], np.arange(n_frames + 1))
    sizes = np.array([(who.length_m, who.width_m) for who in vehicles])
    for frame in range(n_frames):
        rows = slice(bounds[frame], bounds[frame + 1])
        whose = columns["vehicle"][rows]
        x, y, heading = (columns[key][rows] for key in ("x_m", "y_m", "heading_rad"))
        host = int(np.flatnonzero(whose == 0)[0])
        turn = heading[host] + angles
        for other in np.flatnonzero(whose != 0):
            dx, dy = x[host] - x[other], y[host] - y[other]
            if np.hypot(dx, dy) > RANGE_M + 10:
                continue
            cos, sin = np.cos(heading[other]), np.sin(heading[other])
            place = np.array([dx * cos + dy * sin, dy * cos - dx * sin])
            way = np.array([np.cos(turn) * cos + np.sin(turn) * sin, np.sin(turn) * cos - np.cos(turn) * sin])
            half = sizes[whose[other]] / 2
            with np.errstate(divide="ignore", invalid="ignore"):
                near = (-np.sign(way) * half[:, None] - place[:, None]) / way
                far = (np.sign(way) * half[:, None] - place[:, None]) / way
            enters, leaves = np.nanmax(near, axis=0), np.nanmin(far, axis=0)
            hit = (enters <= leaves) & (enters > 0)
            rays[frame, hit] = np.minimum(rays[frame, hit], enters[hit])
    return rays


def _holding(rng, n_frames):
    changes = rng.integers(0, n_frames, 40)
    often = {"set speed": 0.35, "vehicle ahead": 0.3, "emergency": 0.02, "signal": 0.08}
    often |= dict.fromkeys(("limit", "limit ahead", "top speed", "right of way", "lane end"), 0.05)
    values = rng.choice(len(get_args(Holding)), 41, p=[often.get(name, 0.0) for name in get_args(Holding)])
    return values[np.searchsorted(np.sort(changes), np.arange(n_frames), side="right")].astype(np.int8)


def town(seed=0, *, n_vehicles=3_000, seconds=600, step_s=1.0, blocks=14, block_m=160.0):
    """A grid of streets, and many vehicles of which none is driven by us."""
    rng = np.random.default_rng(seed)
    lanes, areas = [], []
    size, half = blocks * block_m, 6.0
    for line in range(blocks + 1):
        for cross in range(blocks):
            a, b, c = line * block_m, cross * block_m + half, (cross + 1) * block_m - half
            for sign, way in ((-1, "go"), (1, "come")):
                o = a + sign * 1.6
                ends = ([[b, o], [c, o]], [[c, o], [b, o]])[sign > 0]
                ends_up = ([[-o + 2 * a, b], [-o + 2 * a, c]], [[-o + 2 * a, c], [-o + 2 * a, b]])[sign > 0]
                lanes.append(Lane(f"h{line}_{cross}{way}_0", np.array(ends, dtype=float), 3.2, True, False, "none"))
                lanes.append(Lane(f"v{line}_{cross}{way}_0", np.array(ends_up, dtype=float), 3.2, True, False, "none"))
        for cross in range(blocks + 1):
            x, y = line * block_m, cross * block_m
            areas.append(np.array([[x - 6, y - 6], [x + 6, y - 6], [x + 6, y + 6], [x - 6, y + 6]]))
    n_frames = round(seconds / step_s) + 1
    parts = []
    vehicles = []
    for who in range(n_vehicles):
        first = int(rng.integers(0, n_frames // 2))
        last = int(rng.integers(first + 1, n_frames))
        frames = np.arange(first, last + 1)
        speed = np.maximum(rng.uniform(6, 15) + 4 * np.sin(frames / rng.uniform(4, 12)), 0)
        way = rng.uniform(0, size) + np.concatenate([[0], np.cumsum(speed[1:] * step_s)])
        line, horizontal, forward = rng.integers(0, blocks + 1) * block_m, rng.random() < 0.5, rng.random() < 0.5
        along = np.abs((way + size) % (2 * size) - size)  # turns round at the edge of town
        up = ((way + size) % (2 * size) > size) == forward
        along = along if forward else size - along
        offset = np.where(up, -1.6, 1.6)
        heading = np.where(up, 0.0, np.pi)
        x, y, turn = (along, line + offset, heading) if horizontal else (line - offset, along, heading + np.pi / 2)
        parts.append((frames, np.full(len(frames), who), x, y, turn, speed))
        heavy = rng.random() < 0.08
        vehicles.append(
            Vehicle(
                f"flow{who % 7}.{who}", "bus" if heavy else "passenger", 12.0 if heavy else 4.6, 2.5 if heavy else 1.8
            )
        )
    frame, vehicle, x, y, heading, speed = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((vehicle, frame))
    film = Film(
        name="town.fcd.xml",
        start_s=25_200.0,
        step_s=step_s,
        n_frames=n_frames,
        vehicles=tuple(vehicles),
        frame=frame[order].astype(np.int32),
        vehicle=vehicle[order].astype(np.int32),
        x_m=x[order],
        y_m=y[order],
        heading_rad=heading[order],
        speed_mps=speed[order],
    )
    return Ground(tuple(lanes), tuple(areas), (), "town"), film


def sweep(folder):
    """A sweep's folder: what its report needs, with figures that are as large as drawn ones."""
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    svg = '<svg xmlns="http://www.w3.org/2000/svg" width="360pt" height="259pt" viewBox="0 0 360 259"/>'
    for measure in HEADINGS:
        (folder / "figures" / f"{measure}.svg").write_text(svg)
    (folder / "sweep.md").write_text("# here: rule\n\n10 seeds\n\n| driver | share |\n| --- | ---: |\n| rule | 50% |\n")
    arms = [
        {"driver": "road-rail", "setting": "", "share": share, "vehicles": "all", "measure": measure, "seeds": 10}
        for share in (0.1, 0.5, 1.0)
        for measure in HEADINGS
    ]
    figures = ("mean", "low", "high", "difference", "difference_low", "difference_high")
    figures += ("relative", "relative_low", "relative_high", "seeds_to_tell", "seeds_for_5_percent")
    rows = [arm | {name: -1234.5678 - k for k, name in enumerate(figures)} for arm in arms]
    for name, columns in (("summary", SUMMARY_COLUMNS), ("differences", DIFFERENCE_COLUMNS)):
        report.typed(rows, columns).to_parquet(folder / f"{name}.parquet")
    pd.DataFrame({"share": [0.5]}).to_parquet(folder / "traffic.parquet")
    return folder


def _truth(film, frames):
    """What the page should tell of some frames, as plain JSON."""
    shown = []
    for frame in frames:
        rows = np.flatnonzero(film.frame == frame)
        entry = {
            "frame": frame,
            "vehicles": {
                film.vehicles[film.vehicle[row]].id: [
                    film.x_m[row],
                    film.y_m[row],
                    film.heading_rad[row],
                    film.speed_mps[row],
                ]
                for row in rows
            },
        }
        if film.driven:
            entry["rays"] = film.driven.ray_m[frame].tolist()
            entry["gap"] = None if np.isnan(film.driven.gap_m[frame]) else film.driven.gap_m[frame]
            entry["set"] = None if np.isnan(film.driven.set_mps[frame]) else film.driven.set_mps[frame]
            entry["limit"] = film.driven.limit_mps[frame]
            entry["holding"] = get_args(Holding)[film.driven.holding[frame]]
        shown.append(entry)
    decisions = [
        [
            d.frame,
            d.asked.name.lower(),
            d.carried_out.name.lower(),
            d.why,
            list(d.open),
            list(d.probabilities),
            d.judged,
            d.stays,
        ]
        for d in (film.driven.decisions if film.driven else ())
    ]
    marks = [[m.frame, m.kind, m.text] for m in (film.driven.marks if film.driven else ())]
    end_reason = film.driven.end_reason if film.driven else None
    return {
        "frames": shown,
        "decisions": decisions,
        "marks": marks,
        "n_frames": film.n_frames,
        "end_reason": end_reason,
    }


def main(folder):
    """Write the pages, and truth.json beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    ground = motorway()
    one, other = drive(1, name="road-rail"), drive(2, name="road-expert", eager=1.6)
    hostile = drive(3, name=HOSTILE, seconds=20, n_vehicles=6, ids=[f"{HOSTILE}{who}" for who in range(6)])
    short = drive(4, name="road-rail", seconds=9.5, end_reason="course")
    crash = drive(5, name="road-expert", seconds=20, eager=1.6, end_reason="collision")
    town_ground, crowd = town()
    thousand_ground, thousand = town(1, n_vehicles=1_000)
    about = {"network": "motorway", "traffic": "20 vehicles, seed 1", "made by": "rail-sumo 0.1.0"}
    pages = {
        "one": (ground, [one], "A drive on the motorway", about),
        "two": (ground, [one, other], "road-rail beside road-expert", about),
        "unequal": (ground, [short, crash], "One ends before the other", about),
        "sumo": (ground, [sumos(6, name="sumo", seconds=20)], "SUMO drives", about),
        "hostile": (ground, [hostile], HOSTILE, {HOSTILE: HOSTILE}),
        "town": (town_ground, [crowd], "Ten minutes in town", {"network": "town"}),
        "thousand": (thousand_ground, [thousand], "A thousand vehicles", {}),
    }
    truth = {}
    for name, (below, films, title, told) in pages.items():
        file = folder / f"{name}.html"
        page.write(below, films, file, title=title, about=told, overwrite=True)
        rng = np.random.default_rng(0)
        truth[name] = {
            "bytes": file.stat().st_size,
            "films": [_truth(film, sorted({0, *rng.integers(0, film.n_frames, 6).tolist()})) for film in films],
        }
        print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB, {len(films[0].frame)} rows")
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    report_page.write([assets.driver("road-rail")], folder / "report.html", overwrite=True)
    report_page.write([sweep(folder / "share")], folder / "sweep.html", overwrite=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
