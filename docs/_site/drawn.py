"""Pictures that are drawn when the site is built: a page says `{drawn} overtakes`, and its caption below."""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from _site import pictures


class Drawn(SphinxDirective):
    """A figure, as SVG in the page itself."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the figure with its caption."""
        caption = " ".join(self.content)
        svg = pictures.svg(self.arguments[0], caption)
        figure = nodes.container(classes=["drawn"])
        figure += nodes.raw("", svg, format="html")
        figure += nodes.paragraph("", "", *self.parse_inline(caption)[0], classes=["caption"])
        return [figure]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("drawn", Drawn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
