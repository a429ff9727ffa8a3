"""Write the sources of highway2, highway4 and highway6: one carriageway of straights and bends, heading east at first.

The carriageway's middle line runs on the course that is laid out here, each bend an arc of a circle.
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

LANE_WIDTH_M = 3.5
SAGITTA_M = 0.1  # as far as an arc leaves the chords that stand for it
JUNCTION_M = (
    4.0  # of road between two edges; left to netconvert it may be no longer than the rounding, and look anywhere
)


@dataclass(frozen=True)
class Bend:
    """An arc of `turn_deg` degrees, leftwards if positive."""

    radius_m: float
    turn_deg: float


@dataclass(frozen=True)
class Section:
    """One edge: its limit and its straights, given by their length in metres, and bends."""

    limit_kmh: float
    parts: tuple[float | Bend, ...]


HIGHWAYS = {
    "highway2": (
        2,
        (
            Section(100, (300, Bend(600, 40), Bend(500, -50))),
            Section(100, (200, Bend(400, 60), Bend(450, -55), 150)),
            Section(100, (Bend(800, -35), Bend(550, 50), 250)),
            Section(100, (Bend(700, -30), 100, Bend(420, 45), Bend(600, -40), 300)),
        ),
    ),
    "highway4": (
        4,
        (
            Section(120, (500, Bend(1200, 25), 400)),
            Section(120, (Bend(1500, -30), 400)),
            Section(100, (Bend(1000, 35), Bend(1000, -35))),
            Section(120, (400, Bend(1400, 25))),
            Section(120, (300, Bend(1800, -20), 300)),
        ),
    ),
    "highway6": (
        6,
        (
            Section(130, (1250,)),
            Section(130, (Bend(4000, 8), 700)),
            Section(130, (Bend(5000, -8), 550)),
            Section(130, (1250,)),
        ),
    ),
}


@dataclass
class Pen:
    """Where the course has come to, and in which direction it leads on."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    def straight(self, length_m: float) -> None:
        """Go straight on."""
        self.x_m += length_m * math.cos(self.heading_rad)
        self.y_m += length_m * math.sin(self.heading_rad)

    def draw(self, part: float | Bend) -> Iterator[str]:
        """Go along a straight or a bend, and yield the points at the ends of its chords."""
        if isinstance(part, Bend):
            turn_rad = math.radians(part.turn_deg)
            n_chords = math.ceil(abs(turn_rad) / (2 * math.acos(1 - SAGITTA_M / part.radius_m)))
            chord_rad = turn_rad / n_chords
            for _ in range(n_chords):
                self.heading_rad += chord_rad / 2
                self.straight(2 * part.radius_m * math.sin(abs(chord_rad) / 2))
                self.heading_rad += chord_rad / 2
                yield self.point()
        else:
            self.straight(part)
            yield self.point()

    def point(self) -> str:
        """Return x and y as netconvert reads them."""
        return f"{self.x_m:.2f},{self.y_m:.2f}"


def end(k: int, pen: Pen) -> str:
    """Return the node at either end of the course, before section k + 1."""
    return f'<node id="n{k}" x="{pen.x_m:.2f}" y="{pen.y_m:.2f}" type="dead_end"/>'


def joint(k: int, pen: Pen, n_lanes: int) -> str:
    """Return the node between two sections, before section k + 1: a rectangle across the road."""
    ahead_m, left_m = JUNCTION_M / 2, n_lanes * LANE_WIDTH_M / 2
    cos, sin = math.cos(pen.heading_rad), math.sin(pen.heading_rad)
    corners = ((ahead_m, left_m), (ahead_m, -left_m), (-ahead_m, -left_m), (-ahead_m, left_m))
    shape = " ".join(f"{pen.x_m + a * cos - b * sin:.2f},{pen.y_m + a * sin + b * cos:.2f}" for a, b in corners)
    return f'<node id="n{k}" x="{pen.x_m:.2f}" y="{pen.y_m:.2f}" type="priority" shape="{shape}"/>'


def edge(k: int, n_lanes: int, section: Section, shape: Iterable[str]) -> str:
    """Return section k + 1 with its shape."""
    return (
        f'<edge id="section{k + 1}" from="n{k}" to="n{k + 1}" numLanes="{n_lanes}" width="{LANE_WIDTH_M}" '
        f'speed="{section.limit_kmh / 3.6:.4f}" spreadType="center" shape="{" ".join(shape)}"/>'
    )


def write(name: str, kind: str, root: str, elements: list[str]) -> None:
    """Write one of netconvert's plain files."""
    lines = [f"<{root}>", *(f"    {element}" for element in elements), f"</{root}>", ""]
    (Path(__file__).parent / name / f"{name}.{kind}.xml").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    for name, (n_lanes, sections) in HIGHWAYS.items():
        pen = Pen()
        nodes, edges = [end(0, pen)], []
        for k, section in enumerate(sections):
            shape = [pen.point(), *itertools.chain.from_iterable(map(pen.draw, section.parts))]
            edges.append(edge(k, n_lanes, section, shape))
            nodes.append(joint(k + 1, pen, n_lanes) if k + 1 < len(sections) else end(k + 1, pen))
        write(name, "nod", "nodes", nodes)
        write(name, "edg", "edges", edges)
