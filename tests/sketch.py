"""Small networks, element by element."""


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
