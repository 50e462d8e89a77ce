"""A self-contained HTML page: stored and new outputs side by side."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Notebooks: {title}</title><style>
body {{ font-family: system-ui, sans-serif; margin: 2em auto; max-width: 90em; padding: 0 1em }}
pre {{ overflow: auto; background: #f6f6f6; padding: .6em; max-height: 30em }}
.pair {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(20em, 1fr)); gap: 1em }}
.messages {{ background: #fff0f0; border-left: .3em solid #c00 }} img, svg {{ max-width: 100% }}
iframe {{ width: 100%; height: 24em; border: 1px solid #ddd }}
</style></head><body><h1>{title}</h1><p>{noise}</p><ol>{index}</ol>{cells}</body></html>
"""
_CELL = """<section id="c{number}"><h2>{notebook}, {cell}</h2>
<details><summary>Source</summary><pre>{source}</pre></details>
<pre class="messages">{messages}</pre>
<div class="pair"><div><h3>Stored</h3>{stored}</div><div><h3>New</h3>{new}</div></div></section>
"""


def write_report(path: Path, cells: Sequence[Mapping[str, Any]], noise: Mapping[str, int]) -> Path:
    """Write the report.

    Parameters
    ----------
    path : pathlib.Path
    cells : sequence of mapping
        Those that have ``messages`` differ, and have ``notebook``, ``cell``, ``source`` and
        the stored and the new ``outputs`` too.
    noise : mapping of str to int
        In how many cells each pattern matched.

    Returns
    -------
    path : pathlib.Path
    """
    different = [cell for cell in cells if cell.get("messages")]
    sections, index = [], []
    for number, cell in enumerate(different, start=1):
        stored, new = cell["outputs"]
        texts = {name: html.escape(str(cell[name])) for name in ("notebook", "cell", "source")}
        messages = html.escape("\n".join(cell["messages"]))
        sections.append(
            _CELL.format(
                number=number, messages=messages, stored=_shown(stored), new=_shown(new), **texts
            )
        )
        index.append(f'<li><a href="#c{number}">{texts["notebook"]}, {texts["cell"]}</a></li>')
    met = ", ".join(f"{name} in {count} cells" for name, count in sorted(noise.items()))
    page = _PAGE.format(
        title=f"{len(different)} of {len(cells)} cells differ or fail",
        noise=html.escape(f"Noise that was not compared: {met or 'none'}."),
        index="".join(index),
        cells="".join(sections),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")
    return path


def _shown(outputs: Sequence[Mapping[str, Any]]) -> str:
    """Outputs as a browser shows them; HTML of theirs runs no script."""
    parts = []
    for output in outputs:
        data = output.get("data", {})
        if output["output_type"] == "stream":
            parts.append(f"<pre>{html.escape(''.join(output['text']))}</pre>")
        elif output["output_type"] == "error":
            message = f"{output['ename']}: {output['evalue']}"
            parts.append(f"<pre>{html.escape(message)}</pre>")
        elif pictures := [m for m in ("image/png", "image/jpeg", "image/gif") if m in data]:
            encoded = "".join(data[pictures[0]]).replace("\n", "")
            parts.append(f'<img alt="" src="data:{pictures[0]};base64,{html.escape(encoded)}">')
        elif frame := "".join(data.get("image/svg+xml", "")) or "".join(data.get("text/html", "")):
            parts.append(f'<iframe sandbox srcdoc="{html.escape(frame)}"></iframe>')
        else:
            text = data.get("text/plain", ", ".join(data))
            parts.append(f"<pre>{html.escape(''.join(text))}</pre>")
    return "".join(parts) or "<p>nothing</p>"
