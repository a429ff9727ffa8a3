"""The replay page: one HTML file to watch films with, which fetches nothing and opens from a disk.

The page's own modules lie in `replay/`; see `MODULES` for how they become one script. They unpack what `packed` packs.
"""

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from rail_sumo.files import check_file, whole_file
from rail_sumo.film import Film, Ground, Holding
from rail_sumo.pictures.packed import FORMAT, QUANTA, check_film, pack_film, pack_ground
from rail_sumo.records import MetaAction

MODULES = (
    "words",
    "colours",
    "theme",
    "decode",
    "timeline",
    "motion",
    "camera",
    "road",
    "vehicles",
    "stage",
    "marks",
    "curves",
    "card",
    "difference",
    "link",
    "save",
    "controls",
    "main",
)
"""In this order they are joined to one script, less what they import from one another: a browser does not load modules
from a disk. So a name at the top of a module is unique among all of them, and none imports from one below it."""

_FOLDER = Path(__file__).with_name("replay")
_IMPORT = re.compile(r"^import\s[^;]*?from\s+\"\./\w+\.js\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=async function|function|class|const|let)", re.MULTILINE)


def write(
    ground: Ground,
    films: Sequence[Film],
    file: Path,
    *,
    title: str,
    about: Mapping[str, str],
    overwrite: bool = False,
) -> None:
    """Write the page that shows one film, or two side by side on one clock.

    Args:
        ground: the road below.
        films: one or two, on this ground.
        file: what to write, such as `drive.html`.
        title: of the page.
        about: what the page tells of how the films were made, such as {"network": "highway3", "seed": "7"}.
        overwrite: whether the file may exist.

    Raises:
        InputError: the file exists, or cannot be written.
        ValueError: a film contradicts itself, see `check_film`.
    """
    check_file(file, overwrite=overwrite)
    page = whole_page(ground, films, title=title, about=about)
    with whole_file(file) as partial:
        partial.write_text(page, encoding="utf-8", newline="\n")


def whole_page(ground: Ground, films: Sequence[Film], *, title: str, about: Mapping[str, str]) -> str:
    """Return what `write` writes."""
    if not 1 <= len(films) <= 2:
        raise ValueError(f"a page shows one or two films, not {len(films)}")
    for film in films:
        check_film(film, ground)
    origin = _origin(ground, films)
    head = {
        "format": FORMAT,
        "title": title,
        "about": dict(about),
        "origin_m": origin,
        "quanta": QUANTA,
        "holdings": get_args(Holding),
        "actions": [action.name.lower() for action in MetaAction],
    }
    packed = {"ground": pack_ground(ground, origin)} | {
        f"film-{number}": pack_film(film, origin) for number, film in enumerate(films)
    }
    data = [
        f'<script type="application/json" id="head">{_json_in_html(head)}</script>',
        *(
            f'<script type="application/octet-stream" id="{name}">{base64.b64encode(blob).decode()}</script>'
            for name, blob in packed.items()
        ),
    ]
    style = _read("vendor/uPlot.min.css") + _dark_where_the_system_is(_read("style.css"))
    licence = f"/*!\n{_read('vendor/uPlot-LICENSE.txt').rstrip()}\n*/\n"  # goes with every copy
    scripts = (licence + _read("vendor/uPlot.iife.min.js"), joined_modules())
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data: blob:; media-src blob:; "
        f"style-src {_hash(style)}; script-src {' '.join(map(_hash, scripts))}"
    )
    parts = {
        "title": html.escape(title),
        "policy": policy,
        "style": f"<style>{style}</style>",
        "data": "\n".join(data),
        "scripts": f'<script>{scripts[0]}</script>\n<script type="module">{scripts[1]}</script>',
    }
    return re.sub(r"<!-- ([a-z]+) -->", lambda found: parts[found[1]], _read("page.html"))


def _dark_where_the_system_is(style: str) -> str:
    """Return a style sheet whose dark colours, the reader's choice, hold on a dark system too unless light is chosen.

    A style sheet cannot say both at once, and a script would come after the first light picture.
    """
    dark = re.search(r':root\[data-theme="dark"\] (\{[^}]*\})', style)
    assert dark is not None
    return f'{style}@media (prefers-color-scheme: dark) {{ :root:not([data-theme="light"]) {dark[1]} }}\n'


def joined_modules() -> str:
    """Return `MODULES` as one script."""
    sources = [_IMPORT.sub("", _read(f"{name}.js")) for name in MODULES]
    return "\n".join(_EXPORT.sub("", source) for source in sources)


def _origin(ground: Ground, films: Sequence[Film]) -> tuple[float, float]:
    """The south-western corner of everything, in whole metres: from there the browser's numbers are small."""
    shapes = [lane.points for lane in ground.lanes] + list(ground.junctions)
    tracks = [np.column_stack([film.x_m, film.y_m]) for film in films]
    corners = [np.min(np.reshape(points, (-1, 2)), axis=0) for points in (*shapes, *tracks) if np.size(points)]
    if not corners:
        return 0.0, 0.0
    x, y = np.floor(np.min(corners, axis=0))
    return float(x), float(y)


def _json_in_html(value: object) -> str:
    """JSON that ends no script element, whatever its strings hold."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))  # ASCII alone
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
