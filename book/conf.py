"""The site: Sphinx and MyST-NB over freshly executed chapters; nothing is fetched, ever."""

import sys
from importlib.metadata import version as installed
from importlib.resources import files
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # this folder is a copy, made by `run.py book`

import pages  # noqa: E402

project = "statebook"
author = "the statebook developers"
copyright = "the statebook developers; text and figures CC BY 4.0, code Apache-2.0"
release = installed("statebook")
html_title = f"statebook {release}"
html_last_updated_fmt = "%Y-%m-%d"
language = "en"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
exclude_patterns = ["**/.ipynb_checkpoints", "README.md"]

# Chapters arrive executed: `run.py book` puts them into chapters/ beside a copy of this file.
nb_execution_mode = "off"
nb_code_prompt_show = "Show {type}"
nb_code_prompt_hide = "Hide {type}"
nb_render_markdown_format = "myst"
suppress_warnings = [
    "mystnb.unknown_mime_type",  # a figure's digest has no place on a page
    "ref.python",  # the words of a parameter's type are prose, not references
]
# python-control represents systems in Markdown, with mathematics: prefer it to plain text.
nb_mime_priority_overrides = [("html", "text/markdown", 25)]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_dmath_double_inline = True
myst_heading_anchors = 3

# The whole of MathJax in one file, glyphs included, from a Python package.
html_static_path = ["_static", str(files("mathjax") / "static/mathjax/es5/tex-svg-full.js")]
mathjax_path = "tex-svg-full.js"
# Widget scripts would come from a CDN, and a slider on a static page computes nothing.
nb_ipywidgets_js = {}

html_theme = "furo"
html_css_files = ["statebook.css"]
html_js_files = ["statebook.js"]
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"
html_theme_options = {
    f"{mode}_css_variables": dict.fromkeys(
        ("color-brand-primary", "color-brand-content", "color-api-name", "color-api-pre-name"),
        colour,
    )
    for mode, colour in (("light", "#1b5e8a"), ("dark", "#7cc4f0"))
}

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
add_module_names = True  # as sb.NAME, see pages.py
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_param = False
napoleon_use_rtype = False

myst_substitutions = pages.write_all(HERE)


def setup(app):
    pages.connect(app)
