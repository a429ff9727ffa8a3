"""A page that says `{commands}`, `{keys}` or `{columns}` holds there what `reference` makes of the code."""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from _site import reference

MADE = {"commands": reference.commands, "keys": reference.keys, "columns": reference.columns}


class Generated(SphinxDirective):
    """Reads the Markdown that is made, as if it stood in the page."""

    def run(self) -> list[nodes.Node]:
        """Return its sections."""
        return self.parse_text_to_nodes(MADE[self.name](), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    for name in MADE:
        app.add_directive(name, Generated)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
