"""Tables, figures with their intervals, and pictures as the HTML of a page that fetches nothing."""

import base64
import html
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from rail_sumo.pictures import plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS = '<td class="words">'
"""How a cell begins that holds no number."""


class Interval(NamedTuple):
    """A figure with its 95 % interval, as a cell of a table."""

    value: float
    low: float
    high: float
    decimals: int | None = None
    """Of all three; None for as many as four digits take, and for the ends as many as tell them apart."""


class Share(NamedTuple):
    """In how many episodes something happened, and the 95 % interval of that share, as a cell of a table."""

    happened: int
    episodes: int
    low: float
    high: float


def table(frame: pd.DataFrame, caption: str = "", *, is_sortable: bool = True) -> str:
    """Return a table whose numbers have four digits and are sorted by their full value, where it can be sorted."""
    cells = [[_cell(value) for value in row] for row in frame.itertuples(index=False, name=None)]
    first = cells[0] if cells else [""] * frame.shape[1]
    heads = "".join(
        f'<th scope="col" class="{"words" if cell.startswith(WORDS) else "number"}">{html.escape(str(name))}</th>'
        for name, cell in zip(frame, first, strict=True)
    )
    rows = "".join(f"<tr>{''.join(row)}</tr>\n" for row in cells)
    below = f"<caption><span>{html.escape(caption)}</span></caption>" if caption else ""
    kind = ' class="sortable"' if is_sortable else ""
    return f'<div class="wide"><table{kind}>{below}<thead><tr>{heads}</tr></thead><tbody>\n{rows}</tbody></table></div>'


def details(summary: str, body: str) -> str:
    """Return what is shown once its summary is clicked; both are HTML."""
    return f"<details><summary>{summary}</summary>{body}</details>"


def picture(figure: "Figure", caption: str, title: str = "") -> str:
    """Return a figure, below a heading if it has a title."""
    return (f"<h3>{title}</h3>" if title else "") + image(plot.picture(figure, "svg"), caption)


def image(svg: bytes, caption: str) -> str:
    """Return a picture with what is told below it, which is its text for those who do not see it too."""
    data, told = base64.b64encode(svg).decode(), html.escape(caption)
    return f'<figure><img alt="{told}" src="data:image/svg+xml;base64,{data}"><figcaption>{told}</figcaption></figure>'


def _cell(value: Any) -> str:
    if isinstance(value, Interval):
        if math.isnan(value.value):
            return "<td></td>"
        shown = f"{value.value:.4g}" if value.decimals is None else f"{value.value:z.{value.decimals}f}"
        return f'<td data-value="{value.value!r}">{shown}{_within(value.low, value.high, value.decimals)}</td>'
    if isinstance(value, Share):
        if not value.episodes:
            return "<td></td>"
        within = f"<small>{100 * value.low:.2g} to {100 * value.high:.2g} %</small>"
        share = value.happened / value.episodes
        return f'<td data-value="{share!r}">{value.happened} of {value.episodes}{within}</td>'
    if isinstance(value, float):
        return "<td></td>" if math.isnan(value) else f'<td data-value="{value!r}">{value:.4g}</td>'
    text = html.escape(str(value))
    return f"<td>{text}</td>" if isinstance(value, int) else f"{WORDS}{text}</td>"


def _within(low: float, high: float, decimals: int | None) -> str:
    """Return an interval: its ends with so many decimals, or as many digits, four at least, as tell them apart."""
    if math.isnan(low):
        return ""
    if low == high:
        return "<small>± 0, the same in all</small>"
    if decimals is not None:
        return f"<small>{low:z.{decimals}f} to {high:z.{decimals}f}</small>"
    digits = next(n for n in range(4, 18) if f"{low:.{n}g}" != f"{high:.{n}g}")
    return f"<small>{low:.{digits}g} to {high:.{digits}g}</small>"
