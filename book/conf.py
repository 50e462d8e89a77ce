"""The site: Sphinx and MyST-NB over freshly executed chapters; nothing is fetched, ever."""

import json
import re
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

HERE = Path(__file__).parent

project = "statebook"
author = "the statebook developers"
copyright = "the statebook developers, Apache-2.0"
html_title = "statebook"
language = "en"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["chapters/.ipynb_checkpoints"]

# Chapters arrive executed: `run.py book` puts them into chapters/ beside a copy of this file.
nb_execution_mode = "off"
nb_render_markdown_format = "myst"
# A figure's digest has no place on a page; words of a docstring's type are no references.
suppress_warnings = ["mystnb.unknown_mime_type", "ref.python"]
# python-control represents systems in Markdown, with mathematics: prefer it to plain text.
nb_mime_priority_overrides = [("html", "text/markdown", 25)]
myst_enable_extensions = ["amsmath", "dollarmath", "deflist", "substitution"]
myst_dmath_double_inline = True
myst_heading_anchors = 3

# The whole of MathJax in one file, glyphs included, from a Python package.
html_static_path = ["_static", str(files("mathjax") / "static/mathjax/es5/tex-svg-full.js")]
mathjax_path = "tex-svg-full.js"
# Widget scripts would come from a CDN, and a slider on a static page computes nothing.
nb_ipywidgets_js = {}

html_theme = "furo"
html_css_files = ["statebook.css"]
html_copy_source = False
# Summaries of search results are fetched, which browsers refuse for file:// addresses.
html_show_search_summary = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1b5e8a", "color-brand-content": "#1b5e8a"},
    "dark_css_variables": {"color-brand-primary": "#7cc4f0", "color-brand-content": "#7cc4f0"},
}

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "ignore-module-all": True}
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False


def opening(notebook):
    """Return a chapter's title and the first paragraph under it."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    text = "\n\n".join("".join(c["source"]) for c in cells[:3] if c["cell_type"] == "markdown")
    paragraphs = [" ".join(p.split()) for p in re.split(r"\n\s*\n", text) if p.strip()]
    titles = [p.lstrip("# ") for p in paragraphs if p.startswith("# ")]
    prose = [p for p in paragraphs if not p.startswith(("#", "-", "|", "`"))]
    return (titles or [notebook.stem])[0], (prose or [""])[0]


def chapter_list():
    """Return the front page's list of chapters, in Markdown."""
    rows = []
    for notebook in sorted(HERE.glob("chapters/*.ipynb")):
        title, question = opening(notebook)
        rows.append(f"[{title}](chapters/{notebook.name})\n: {question}\n")
    return "\n".join(rows)


myst_substitutions = {"chapters": chapter_list()}


def list_modules(app, docname, source):
    """Append every public module of the library to the reference page."""
    if docname != "reference":
        return
    package = Path(find_spec("statebook").origin).parent
    modules = [m.name for m in iter_modules([str(package)]) if not m.name.startswith("_")]
    for name in modules:
        source[0] += f"\n## {name}\n\n```{{eval-rst}}\n.. automodule:: statebook.{name}\n```\n"


def setup(app):
    """Connect the hooks above."""
    app.connect("source-read", list_modules)
