"""What the site's pages hold that is made from the notebooks and the package's public names."""

from __future__ import annotations

import html
import inspect
import json
import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes

import statebook

HERE = Path(__file__).parent
PARTS = {"deeper": "Deeper", "exercises": "Exercises"}


def read_cells(notebook: Path) -> list[dict[str, Any]]:
    """Return a notebook's cells with each source as one string."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [{**cell, "source": "".join(cell["source"])} for cell in cells]


def opening(notebook: Path) -> tuple[str, str]:
    """Return a notebook's title and the question under it."""
    text = "\n\n".join(c["source"] for c in read_cells(notebook)[:3] if is_prose(c))
    paragraphs = [" ".join(p.split()) for p in re.split(r"\n\s*\n", text) if p.strip()]
    titles = [p.lstrip("# ") for p in paragraphs if p.startswith("# ")]
    prose = [p for p in paragraphs if not p.startswith(("#", "-", "|", "`", "*About"))]
    question = re.sub(r"^\W*the question\W*", "", (prose or [""])[0], flags=re.IGNORECASE)
    return (titles or [notebook.stem])[0], question[:1].upper() + question[1:]


def is_prose(cell: dict[str, Any]) -> bool:
    return cell["cell_type"] == "markdown"


def chapters(folder: str = "") -> list[Path]:
    """Return the notebooks of a folder of the workbook, in order."""
    return sorted((HERE / "chapters" / folder).glob("[0-9]*.ipynb"))


def listed(notebooks: list[Path]) -> str:
    """Return a list of notebooks with their questions, in Markdown."""
    rows = []
    for notebook in notebooks:
        title, question = opening(notebook)
        rows.append(f"[{title}]({notebook.relative_to(HERE).as_posix()})\n: {question}\n")
    return "\n".join(rows) or "(none yet)"


def write(path: Path, text: str) -> None:
    """Write a page, if it is new or another: Sphinx reads again what has a later time."""
    path.parent.mkdir(exist_ok=True)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


# ---- the reference ----


def rooms() -> dict[str, list[str]]:
    """Return the public names of each room, as the stub beside the package tells them."""
    stub = Path(statebook.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    homes: dict[str, list[str]] = {}
    for room, name in re.findall(r"^from \.(\S*) import (\w+) as", stub, re.MULTILINE):
        package = room.partition(".")[0] if room else name
        whole = package in ("controllers", "plotting")  # their names are sb.plotting.NAME
        homes.setdefault(package if whole else room, []).extend([] if whole else [name])
    return dict(sorted(homes.items()))


def write_reference(folder: Path) -> str:
    """Write a page for every room; return their list in Markdown."""
    rows = []
    for room, names in rooms().items():
        module = import_module(f"statebook.{room}")
        about = inspect.getdoc(module) or ""
        if names:
            body = f".. automodule:: {module.__name__}\n   :no-members:\n\n"
            for name in names:
                value = getattr(statebook, name)
                kind = "class" if inspect.isclass(value) else "function"
                kind = kind if callable(value) else "data"
                body += f".. auto{kind}:: statebook.{name}\n"
        else:
            body = f".. automodule:: {module.__name__}\n"
        write(folder / f"{room}.md", f"# {room}\n\n```{{eval-rst}}\n{body}```\n")
        what = ", ".join(f"`sb.{name}`" for name in names)
        rows.append(f"[{room}](reference/{room}.md)\n: {about.splitlines()[0]} {what}\n")
    return "\n".join(rows)


@cache
def users() -> dict[str, list[str]]:
    """Return, of each public name, the chapters whose code uses it."""
    found: dict[str, list[str]] = {}
    for notebook in [*chapters(), *chapters("cases")]:
        code = "\n".join(c["source"] for c in read_cells(notebook) if not is_prose(c))
        for name in sorted(set(re.findall(r"\bsb\.((?:plotting\.|controllers\.)?\w+)", code))):
            found.setdefault(name, []).append(notebook.relative_to(HERE).with_suffix("").as_posix())
    return found


def add_users(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Add to an entry of the reference the chapters that use it."""
    places = users().get(name.removeprefix("statebook."), [])
    if places and what in ("class", "function"):
        names = [f"{'case ' * ('/cases/' in p)}{p.split('/')[-1][:2]}" for p in places]
        links = ", ".join(f":doc:`{n} </{p}>`" for n, p in zip(names, places, strict=True))
        lines += ["", f"Used in chapters {links}.", ""]


def name_as_used(app: Any, doctree: Any, docname: str = "") -> None:
    """Show public names as sb.NAME, and leave the words of a type alone.

    Sphinx takes each word of "float [s]" for a name and links s to an attribute of that name.
    """
    public = set(statebook.__all__)
    for prefix in doctree.findall(addnodes.desc_addname):
        text = prefix.astext()
        if text.startswith("statebook."):
            prefix.replace_self(addnodes.desc_addname("", text.replace("statebook.", "sb.", 1)))
    for reference in list(doctree.findall(addnodes.pending_xref)):
        target = reference.get("reftarget", "")
        if reference.get("refdomain") == "py" and target.split(".")[-1] not in public:
            if reference.get("refexplicit") is not True and reference.get("reftype") != "mod":
                reference.replace_self(reference.children)


# ---- the book's items ----


def items() -> str:
    """Return the table of the source's items and errata, with the notebooks that show them."""
    text = (HERE / "inventory.toml").read_text(encoding="utf-8")
    rows = re.findall(r'\[\[row\]\]\nid = "(\w+)"\n.*?\ntext = "(.*?)"\n', text, re.DOTALL)
    places: dict[str, list[str]] = {}
    for notebook in [*chapters(), *chapters("deeper")]:
        link = notebook.relative_to(HERE).as_posix()
        deeper = "deeper " if notebook.parent.name == "deeper" else ""
        for cell in read_cells(notebook):
            for row in cell["metadata"].get("covers", ()):
                entry = f"[{deeper}{notebook.stem[:2]}]({link})"
                if entry not in places.setdefault(row, []):
                    places[row].append(entry)
    table = ["| | what | shown in |", "| --- | --- | --- |"]
    for row, what in rows:
        what = what.replace("|", r"\|").replace("\\\\", "\\").replace("$", r"\$")
        table.append(f"| {row} | {what} | {', '.join(places.get(row, ['the exercises']))} |")
    return "\n".join(table)


def exercises() -> str:
    """Return the table of all exercises: chapter, title, level and minutes."""
    table = ["| | exercise | level | minutes |", "| --- | --- | --- | ---: |"]
    for notebook in chapters("exercises"):
        link = notebook.relative_to(HERE).as_posix()
        heading = r"^## (\d+)\. (.*?) \(([\w ]+), (\d+) minutes\)"
        for cell in filter(is_prose, read_cells(notebook)):
            for number, title, level, minutes in re.findall(heading, cell["source"], re.MULTILINE):
                table.append(
                    f"| {notebook.stem[:2]}.{number} | [{title}]({link}) | {level} | {minutes} |"
                )
    return "\n".join(table)


def write_all(here: Path) -> dict[str, str]:
    """Write the generated pages; return what the hand-written ones insert."""
    core = [path for path in chapters() if path.stem[:2] < "80"]
    return {
        "chapters": listed(core),
        "primers": listed([path for path in chapters() if path.stem[:2] >= "80"]),
        "cases": listed(chapters("cases")),
        "items": items(),
        "exercises": exercises(),
        "projects": listed([path for path in chapters("exercises") if "project" in path.stem]),
        "modules": write_reference(here / "reference"),
    }


# ---- each notebook's page ----


def cell(name: str, text: str) -> dict[str, Any]:
    return {"cell_type": "markdown", "id": name, "metadata": {}, "source": text}


def frame_notebook(app: Any, docname: str, source: list[str]) -> None:
    """Add a line of links to a notebook's page: to download it, and to its other parts."""
    place = HERE / f"{docname}.ipynb"
    if not docname.startswith("chapters/") or not place.is_file():
        return
    notebook = json.loads(source[0])
    folder = "" if place.parent.name == "chapters" else place.parent.name
    links = [f"{{download}}`Download this notebook <{place.name}>`"]
    parts = []
    for part, title in {"": "Core", **PARTS}.items():
        other = HERE / "chapters" / part / place.name
        if folder not in ("", *PARTS) or part == folder or not other.is_file():
            continue
        up = "../" if folder else ""
        parts.append(f"{part}/{place.stem}" if part else place.stem)
        links.append(f"[{title}]({up}{part + '/' if part else ''}{place.name})")
    notebook["cells"].insert(1, cell("sb-links", " · ".join(links)))
    if not folder and parts:
        toctree = "\n".join(["```{toctree}", ":hidden:", "", *parts, "```"])
        notebook["cells"].append(cell("sb-parts", toctree))
    source[0] = json.dumps(notebook)


def describe(
    app: Any, pagename: str, templatename: str, context: dict[str, Any], tree: Any
) -> None:
    """Give a page the description that previews of links show, and the search its texts."""
    if tree is not None:
        prose = [p.astext() for p in tree.findall(nodes.paragraph)]
        words = " ".join(" ".join(prose[:2]).split())[:200]
        for name, text in (
            ('name="description"', words),
            ('property="og:title"', context.get("title", "statebook")),
            ('property="og:description"', words),
            ('property="og:type"', "article"),
        ):
            text = html.escape(re.sub(r"<.*?>", "", text), quote=True)
            context["metatags"] = context.get("metatags", "") + f'\n<meta {name} content="{text}">'
    tree_key = "furo_navigation_tree"  # a heading without a level is none to a screen reader
    if tree_key in context:
        level = 'role="heading" aria-level="2"'
        context[tree_key] = context[tree_key].replace('role="heading"', level)
    if pagename == "search":
        app.add_js_file("texts.js", priority=100)
        app.add_js_file("search.js", priority=101)


def write_texts(app: Any, error: Exception | None) -> None:
    """Write the pages' texts into a script: a page from a file may not fetch another."""
    if error or app.builder.name != "html":
        return
    texts = {}
    for docname in sorted(app.env.found_docs):
        blocks = []
        for section in app.env.get_doctree(docname).findall(nodes.section):
            own = [n for n in section.findall(nodes.paragraph) if nearest_section(n) is section]
            words = html.escape(" ".join(" ".join(n.astext() for n in own).split()))
            blocks.append(f'<p id="{section["ids"][0]}">{words} </p>')
        texts[docname] = "".join(blocks)
    script = "window.STATEBOOK_TEXTS = " + json.dumps(texts, ensure_ascii=False) + ";\n"
    (Path(app.outdir) / "_static" / "texts.js").write_text(script, encoding="utf-8")


def nearest_section(node: Any) -> Any:
    """Return the section that a node stands in."""
    while node is not None and not isinstance(node, nodes.section):
        node = node.parent
    return node


def connect(app: Any) -> None:
    """Hang the functions above into Sphinx."""
    app.connect("source-read", frame_notebook)
    app.connect("autodoc-process-docstring", add_users)
    app.connect("doctree-read", name_as_used)
    app.connect("html-page-context", describe, priority=900)  # after the theme's own
    app.connect("build-finished", write_texts)
