"""How the site is built: `make docs`. Nothing is fetched; a broken link, anchor or name is an error."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # for _site

project = "rail-sumo"
author = "The rail-sumo developers"
copyright = "the rail-sumo developers"
version = release = version_of("rail-sumo")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "_site.drawn",
    "_site.formulas",
    "_site.tables",
]
exclude_patterns = ["_site", "data", "figures"]
root_doc = "index"
language = "en"
highlight_language = "none"  # of blocks that name no language: commands and what they print

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # `page.md#a-heading`, as code hosts have it

# The pages with `{code-cell}` are run when the site is built, in a process of their own.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 180
nb_execution_show_tb = True
nb_merge_streams = True

# A name of ours that is not there is an error. Those of other libraries are not looked up: that would take a network.
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!rail_sumo\b).*")]
nitpick_ignore = [  # what signatures of the public names mention, and nobody outside needs
    ("py:class", "rail_sumo.config.Judge"),
    ("py:class", "rail_sumo.highway.vehicle.host.Host"),
    ("py:class", "rail_sumo.highway.stretch.Stretch"),
]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
default_role = "code"
add_module_names = False
toc_object_entries = False

copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True

html_theme = "furo"
html_title = "rail-sumo"
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0a5a8c", "color-brand-content": "#0a5a8c"},
    "dark_css_variables": {"color-brand-primary": "#6cb8e6", "color-brand-content": "#6cb8e6"},
}
