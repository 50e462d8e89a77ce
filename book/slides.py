"""Make slide decks from core notebooks, with everything that they need beside them.

python book/slides.py [NN ...]      without a number, a deck of each chapter

A section's text, its question, its code with the figure, and the folded answer become slides one
below the other; a box on the book becomes the speaker's note. Open with any browser, offline.
"""

from __future__ import annotations

import re
import shutil
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import nbformat
from nbconvert import SlidesExporter
from traitlets.config import Config

ROOT = Path(__file__).resolve().parents[1]
DECKS = ROOT / "_build" / "slides"
STARTS = {
    "# ": "slide",
    "## ": "slide",
    "Predict:": "subslide",
    '<details class="in-the-book"': "notes",
    "<details": "fragment",
}
LEFT_OUT = re.compile(r"^\*?Your turn:.*|^\*Your turn:\*.*|^\*\*Before you start.*", re.DOTALL)


def pieces(text: str) -> list[tuple[str, str]]:
    """Split a cell of prose into (kind, text): slide, subslide, fragment, notes or nothing."""
    found: list[tuple[str, str]] = []
    for block in re.split(r"\n(?=## |Predict:|<details)|(?<=</details>)\n", text):
        kind = next((kind for start, kind in STARTS.items() if block.startswith(start)), "-")
        paragraphs = [p for p in block.split("\n\n") if not LEFT_OUT.match(p.strip())]
        words = re.sub(r"</?details.*?>|<summary>.*?</summary>", "", "\n\n".join(paragraphs))
        if words.strip():
            found.append((kind, words.strip()))
    return found


def slides(notebook: Any) -> Any:
    """Return a notebook whose cells say where a slide begins."""
    deck = nbformat.v4.new_notebook(metadata=notebook.metadata)

    def add(cell: Any, kind: str) -> None:
        cell.metadata["slideshow"] = {"slide_type": kind}
        deck.cells.append(cell)

    after_prose = True
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            for kind, text in pieces(cell.source):
                add(nbformat.v4.new_markdown_cell(text), kind)
            after_prose = True
        elif "hide-input" not in cell.metadata.get("tags", ()) or cell.outputs:
            add(cell, "subslide" if after_prose else "-")
            after_prose = False
    return deck


def assets() -> None:
    """Put the slides' scripts and styles beside them."""
    reveal = files("sphinx_revealjs") / "_static" / "revealjs"
    mathjax = files("mathjax") / "static" / "mathjax" / "es5" / "tex-svg-full.js"
    shutil.copytree(str(reveal), DECKS / "reveal", dirs_exist_ok=True)
    shutil.copy(str(mathjax), DECKS / "reveal")


def main(numbers: list[str]) -> int:
    folder = ROOT / "workbook"
    chosen = [p for n in numbers or ["[0-9][0-9]"] for p in sorted(folder.glob(f"{n}_*.ipynb"))]
    if not chosen:
        print(f"slides takes the numbers of chapters, such as 07; got {' '.join(numbers)}")
        return 1
    try:
        write(chosen)
    except OSError as error:
        print(f"slides: {error.filename or DECKS} was not written: {error.strerror or error}")
        return 1
    return 0


def write(chosen: list[Path]) -> None:
    """Write the decks of notebooks."""
    DECKS.mkdir(parents=True, exist_ok=True)
    assets()
    config = Config()
    config.TagRemovePreprocessor.enabled = True
    config.TagRemovePreprocessor.remove_input_tags = {"hide-input"}
    config.SlidesExporter.reveal_url_prefix, config.SlidesExporter.reveal_theme = "reveal", "white"
    config.SlidesExporter.exclude_input_prompt = config.SlidesExporter.exclude_output_prompt = True
    template = str(Path(__file__).with_name("slides.html.j2"))
    exporter = SlidesExporter(config=config, template_file=template)
    for path in chosen:
        deck = slides(nbformat.read(path, as_version=4))
        page, _ = exporter.from_notebook_node(deck, {"metadata": {"name": path.stem}})
        target = DECKS / f"{path.stem}.html"
        beside = target.with_suffix(".new")
        beside.write_text(page, encoding="utf-8")
        beside.replace(target)
        print("open " + target.as_uri())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
