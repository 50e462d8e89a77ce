"""The site: Sphinx and MyST-NB over freshly executed chapters; nothing is fetched, ever."""

import json
import re
from importlib import import_module
from importlib.resources import files
from pathlib import Path

import statebook

HERE = Path(__file__).parent

project = "statebook"
author = "the statebook developers"
copyright = "the statebook developers, Apache-2.0"
html_title = "statebook"
language = "en"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["**/.ipynb_checkpoints"]

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
    f"{mode}_css_variables": dict.fromkeys(
        ("color-brand-primary", "color-brand-content", "color-api-name", "color-api-pre-name"),
        colour,
    )
    for mode, colour in (("light", "#1b5e8a"), ("dark", "#7cc4f0"))
}

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
add_module_names = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_param = False
napoleon_use_rtype = False


def opening(notebook):
    """Return a chapter's title and the question under it."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    text = "\n\n".join("".join(c["source"]) for c in cells[:3] if c["cell_type"] == "markdown")
    paragraphs = [" ".join(p.split()) for p in re.split(r"\n\s*\n", text) if p.strip()]
    titles = [p.lstrip("# ") for p in paragraphs if p.startswith("# ")]
    prose = [p for p in paragraphs if not p.startswith(("#", "-", "|", "`"))]
    question = re.sub(r"^\W*the question\W*", "", (prose or [""])[0], flags=re.IGNORECASE)
    return (titles or [notebook.stem])[0], question[:1].upper() + question[1:]


def chapter_list():
    """Return the front page's list of chapters, in Markdown."""
    rows = []
    for notebook in sorted(HERE.glob("chapters/*.ipynb")):
        title, question = opening(notebook)
        rows.append(f"[{title}](chapters/{notebook.name})\n: {question}\n")
    return "\n".join(rows)


def write_reference():
    """Write a page for every public module; return their list in Markdown."""
    folder = HERE / "reference"
    folder.mkdir(exist_ok=True)
    stub = Path(statebook.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    homes = {}  # of each room its public names, as the stub beside the package tells them
    for room, name in re.findall(r"^from \.(\S*) import (\w+) as", stub, re.MULTILINE):
        package = room.partition(".")[0] if room else name
        whole = package in ("controllers", "plotting")
        homes.setdefault(package if whole else room, []).extend([] if whole else [name])
    rows = []
    for name, members in sorted(homes.items()):
        module = import_module(f"statebook.{name}")
        chosen = f"\n   :members: {', '.join(members)}" if members else ""
        text = f"# {name}\n\n```{{eval-rst}}\n.. automodule:: {module.__name__}{chosen}\n```\n"
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
        rows.append(f"[{name}](reference/{name}.md)\n: {module.__doc__.splitlines()[0]}\n")
    return "\n".join(rows)


# This folder is a copy made by `run.py book`: what is written here does not touch the sources.
myst_substitutions = {"chapters": chapter_list(), "modules": write_reference()}
