"""Write the sources of ring5 beside this file: eight edges, counter-clockwise, on a circle of 500 m radius.

The middle lane's centre line runs on the circle.
"""

import math
from pathlib import Path

RADIUS_M = 500.0
N_LANES = 5
N_EDGES = 8
SEGMENTS_PER_EDGE = 24  # of 16.4 m: the polyline is shorter than the circle by 0.01 %


def point(turns: float) -> tuple[str, str]:
    """Return x and y after a part of a turn from the circle's eastern point."""
    angle_rad = 2 * math.pi * turns
    return f"{RADIUS_M * math.cos(angle_rad):.3f}", f"{RADIUS_M * math.sin(angle_rad):.3f}"


def node(k: int) -> str:
    """Return the node before edge k."""
    x, y = point(k / N_EDGES)
    return f'<node id="n{k}" x="{x}" y="{y}" type="priority"/>'


def edge(k: int) -> str:
    """Return edge k with its shape."""
    shape = " ".join(",".join(point((k + i / SEGMENTS_PER_EDGE) / N_EDGES)) for i in range(SEGMENTS_PER_EDGE + 1))
    return (
        f'<edge id="ring{k}" from="n{k}" to="n{(k + 1) % N_EDGES}" numLanes="{N_LANES}" width="3.2" speed="22.2222" '
        f'spreadType="center" shape="{shape}"/>'
    )


def connection(k: int, lane: int) -> str:
    """Return the connection that leads a lane of edge k straight on."""
    return f'<connection from="ring{k}" to="ring{(k + 1) % N_EDGES}" fromLane="{lane}" toLane="{lane}"/>'


def write(kind: str, root: str, elements: list[str]) -> None:
    """Write one of netconvert's plain files."""
    lines = [f"<{root}>", *(f"    {element}" for element in elements), f"</{root}>", ""]
    Path(__file__).with_name(f"ring5.{kind}.xml").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    write("nod", "nodes", [node(k) for k in range(N_EDGES)])
    write("edg", "edges", [edge(k) for k in range(N_EDGES)])
    write("con", "connections", [connection(k, lane) for k in range(N_EDGES) for lane in range(N_LANES)])
