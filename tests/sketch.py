"""Small networks, element by element."""

import itertools
import math
import re

import numpy as np


def edge(name, *, y=0.0, x=(0.0, 100.0), lanes=2, closed=(), width=3.2):
    """An edge that runs east; lane 0 lies on y, the next ones to its left."""
    access = ("pedestrian", "all")
    rows = "".join(
        f'<lane id="{name}_{k}" index="{k}" disallow="{access[k in closed]}" speed="30" '
        f'length="{x[1] - x[0]:.2f}" width="{width}" shape="{x[0]},{y + k * width} {x[1]},{y + k * width}"/>'
        for k in range(lanes)
    )
    return f'<edge id="{name}" from="{name}-" to="{name}+">{rows}</edge>'


def leads_on(here, ahead, lanes, *, direction="s", to=None, access=""):
    """Connections from some lanes of one edge to the same lanes, or those in `to`, of another; no internal lanes.

    `access` is an attribute that says whom they are open to.
    """
    return "".join(
        f'<connection from="{here}" to="{ahead}" fromLane="{k}" toLane="{j}" dir="{direction}" state="M" {access}/>'
        for k, j in zip(lanes, lanes if to is None else to, strict=True)
    )


def nobody_waits(lanes):
    """What a junction says of its links, one for each lane, where none crosses another."""
    return "".join(
        f'<request index="{k}" response="{"0" * lanes}" foes="{"0" * lanes}" cont="0"/>' for k in range(lanes)
    )


def cut_road(*lengths_m, lanes=3, inside_m=0.0, width=3.2):
    """A road that runs east, cut into edges part0, part1, ...; a whole network, which SUMO loads too.

    They meet at junctions cut0, cut1, ... where nobody else comes, `inside_m` long within; without it there are no
    internal lanes. The right lane lies on y = 0.
    """

    def rows(edge_id, start_m, length_m):
        return "".join(
            f'<lane id="{edge_id}_{k}" index="{k}" speed="36.11" length="{length_m:.2f}" width="{width}" '
            f'shape="{start_m},{k * width} {start_m + length_m},{k * width}"/>'
            for k in range(lanes)
        )

    def names(edge_id):
        return " ".join(f"{edge_id}_{k}" for k in range(lanes))

    internal, edges, junctions, connections, start_m = "", "", "", "", 0.0
    for number, length_m in enumerate(lengths_m):
        ends = (
            "west" if not number else f"cut{number - 1}",
            "east" if number + 1 == len(lengths_m) else f"cut{number}",
        )
        edges += (
            f'<edge id="part{number}" from="{ends[0]}" to="{ends[1]}">{rows(f"part{number}", start_m, length_m)}</edge>'
        )
        start_m += length_m
        if number + 1 == len(lengths_m):
            break
        inside = f":cut{number}_0"
        if inside_m:
            internal += f'<edge id="{inside}" function="internal">{rows(inside, start_m, inside_m)}</edge>'
        junctions += (
            f'<junction id="cut{number}" type="priority" x="{start_m}" y="0" incLanes="{names(f"part{number}")}" '
            f'intLanes="{names(inside) if inside_m else ""}" shape="{start_m},-2 {start_m + inside_m},-2 {start_m},12">'
            f"{nobody_waits(lanes)}</junction>"
        )
        for k in range(lanes):
            via = f'via="{inside}_{k}" ' if inside_m else ""
            connections += (
                f'<connection from="part{number}" to="part{number + 1}" fromLane="{k}" toLane="{k}" {via}'
                f'dir="s" state="M"/>'
            )
            if inside_m:
                connections += (
                    f'<connection from="{inside}" to="part{number + 1}" fromLane="{k}" toLane="{k}" dir="s" state="M"/>'
                )
        start_m += inside_m
    last = f"part{len(lengths_m) - 1}"
    dead_ends = (
        '<junction id="west" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,-2 0,12"/>'
        f'<junction id="east" type="dead_end" x="{start_m}" y="0" incLanes="{names(last)}" intLanes="" '
        f'shape="{start_m},-2 {start_m},12"/>'
    )
    location = (
        f'<location netOffset="0,0" convBoundary="0,0,{start_m},0" origBoundary="0,0,{start_m},0" projParameter="!"/>'
    )
    return f'<net version="1.20">{location}{internal}{edges}{junctions}{dead_ends}{connections}</net>'


def oval(straight_m, radius_m, lanes=3, width=3.2, limit_mps=10.0):
    """Two straights and two half circles, driven anticlockwise; edges half0 and half1 are a straight and a bend each.

    The radius is that of the inner edge of the leftmost lane, which is the innermost.
    """

    def lane(half, k):
        radius = radius_m + (lanes - k - 0.5) * width
        arc = [(straight_m + radius * math.sin(a), -radius * math.cos(a)) for a in np.linspace(0.0, math.pi, 25)]
        points = [(0.0, -radius), *arc]
        if half:
            points = [(straight_m - x, -y) for x, y in points]
        shape = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
        length_m = sum(math.dist(*pair) for pair in itertools.pairwise(points))
        return f'<lane id="half{half}_{k}" index="{k}" speed="{limit_mps}" length="{length_m:.2f}" shape="{shape}"/>'

    edges = junctions = connections = ""
    for half in (0, 1):
        rows = "".join(lane(half, k) for k in range(lanes))
        edges += f'<edge id="half{half}" from="joint{half}" to="joint{1 - half}">{rows}</edge>'
        comes = " ".join(f"half{1 - half}_{k}" for k in range(lanes))
        y = radius_m if half else -radius_m
        junctions += (
            f'<junction id="joint{half}" type="priority" x="{straight_m if half else 0.0}" y="{y}" incLanes="{comes}" '
            f'intLanes="" shape="0,{y} 1,{y} 0,{y + 1}">{nobody_waits(lanes)}</junction>'
        )
        connections += leads_on(f"half{half}", f"half{1 - half}", range(lanes))
    return f'<net version="1.20">{edges}{junctions}{connections}</net>'


def with_exit(length_m, lanes):
    """A road whose right lane leads off and whose others lead on."""
    text = cut_road(length_m, 400.0, lanes=lanes)
    whole = text[text.index('<edge id="part1"') :]
    whole = whole[: whole.index("</edge>") + len("</edge>")]
    rows = re.findall("<lane .*?/>", whole)
    number = re.compile(r'id="part1_\d" index="\d"')
    exits = number.sub('id="exit_0" index="0"', rows[0])
    leads_on = "".join(number.sub(f'id="main_{k}" index="{k}"', row) for k, row in enumerate(rows[1:]))
    parts = "".join(
        f'<edge id="{name}" from="cut0" to="east">{row}</edge>' for name, row in (("exit", exits), ("main", leads_on))
    )
    text = text.replace(whole, parts)
    for k in range(lanes):
        name = "main" if k else "exit"
        text = text.replace(
            f'to="part1" fromLane="{k}" toLane="{k}"', f'to="{name}" fromLane="{k}" toLane="{max(k - 1, 0)}"'
        )
    ends = " ".join(f"part1_{k}" for k in range(lanes))
    return text.replace(ends, " ".join(("exit_0", *(f"main_{k}" for k in range(lanes - 1)))))
