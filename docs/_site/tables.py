"""Tables of figures: an interval stays on one line, `0.999` above `(0.991 to 1.008)`; many columns are set smaller."""

import re

from docutils import nodes
from sphinx.application import Sphinx

INTERVAL = re.compile(r"\([^()]*\d to [^()]*\d[^()]*\)|[\d.]+ ± [\d.]+|\([+-][\d.]+ ± [\d.]+\)")
MANY = 8
"""So many columns make a table wide."""
NO_BREAK = {" ": "\N{NO-BREAK SPACE}", "-": "\N{NON-BREAKING HYPHEN}"}


def set_tables(app: Sphinx, document: nodes.document) -> None:
    """Let no line break into an interval in a table, and mark wide tables for the style sheet."""
    for group in document.findall(nodes.tgroup):
        if group["cols"] >= MANY:
            group.parent["classes"].append("wide")
    for entry in document.findall(nodes.entry):
        for text in list(entry.findall(nodes.Text)):
            kept = INTERVAL.sub(lambda found: "".join(NO_BREAK.get(one, one) for one in found[0]), text.astext())
            if kept != text.astext():
                text.parent.replace(text, nodes.Text(kept))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register it."""
    app.connect("doctree-read", set_tables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
