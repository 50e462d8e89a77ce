"""Notebook files: read, write at once, and keep of the old outputs what still agrees."""

import base64
import itertools
import json
import os
import warnings
from collections.abc import Container
from pathlib import Path
from typing import Any

import nbformat
from nbformat.v4 import new_output

from nbregress.comparison import Comparison
from nbregress.mime import WIDGET_VIEW
from nbregress.outputs import lacks_digest, outputs_differences
from nbregress.patterns import as_printed
from nbregress.session import NotebookError, cell_options
from nbregress.settings import Settings

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Chunks of a PNG file that describe the program and the time, not the picture.
_PNG_TEXT = {b"tEXt", b"zTXt", b"iTXt", b"tIME"}


def read(path: Path) -> Any:
    """Read a notebook of format 4, or an older one as if it were.

    Parameters
    ----------
    path : pathlib.Path
        The .ipynb file.

    Returns
    -------
    nb : nbformat.NotebookNode
        With its own minor version; cells have ids where that asks for them.

    Raises
    ------
    NotebookError
        If the file is missing or is not a notebook.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        nb: Any = nbformat.reader.reads(text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if nb.nbformat != 4:
                nb = nbformat.convert(nb, 4)
            if nb.nbformat_minor >= 5:
                _add_ids(nb)
            nbformat.validate(nb)
    except (OSError, UnicodeDecodeError) as error:
        raise NotebookError(f"cannot be read: {error}") from error
    except Exception as error:  # nbformat raises anything at what is no notebook
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise NotebookError(f"is not a notebook: {lines[0][:200]}") from error
    return nb


def _add_ids(nb: Any) -> None:
    ids = {cell.get("id") for cell in nb.cells}
    for index, cell in enumerate(nb.cells):
        if not cell.get("id"):
            names = (f"cell-{index + k}" for k in range(len(ids) + 1))
            cell["id"] = next(name for name in names if name not in ids)
            ids.add(cell["id"])


def as_written(nb: Any) -> bytes:
    """The file of a notebook: sorted keys, indent 1, UTF-8, a newline at the end.

    Parameters
    ----------
    nb : nbformat.NotebookNode

    Returns
    -------
    data : bytes
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return (nbformat.writes(nb).rstrip("\n") + "\n").encode("utf-8")


def write(nb: Any, path: Path, stored: Any = None) -> bool:
    """Write a notebook if it differs from the file's.

    The file is replaced at once, so that an interruption or a full disk leaves the old one.

    Parameters
    ----------
    nb : nbformat.NotebookNode
    path : pathlib.Path
    stored : nbformat.NotebookNode, optional
        What was read from the file. If somebody has saved another notebook there since, that
        one stays.

    Returns
    -------
    changed : bool
        False if the file held the same bytes already, but for its line ends.

    Raises
    ------
    NotebookError
        If it cannot be written.
    """
    if stored is not None and read(path) != stored:
        raise NotebookError("was saved by somebody else while it ran, and stays: run again")
    data = as_written(nb)
    target = path.resolve()
    beside = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        mode = 0o644
        if path.exists():
            old = path.read_bytes()
            if old.replace(b"\r\n", b"\n") == data:
                return False
            mode = path.stat().st_mode & 0o777
            if b"\r\n" in old:
                data = data.replace(b"\n", b"\r\n")
        beside.write_bytes(data)
        os.chmod(beside, mode)
        os.replace(beside, target)
    except OSError as error:
        raise NotebookError(f"cannot be written, and the old file is untouched: {error}") from error
    finally:  # also where Ctrl-C came between
        beside.unlink(missing_ok=True)
    return True


def normalize(nb: Any) -> None:
    """Strip an executed notebook of what is not a result, in place.

    Timings, the chunks and the order in which streams happened to arrive, what a progress
    bar overwrote, tracebacks with the paths of one machine, and the text chunks of PNG
    pictures go; kernel, language and widgets stay.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        A notebook of format 4.
    """
    nb.metadata.get("language_info", {}).pop("version", None)
    for cell in nb.cells:
        for name in ("execution", "ExecuteTime", "trusted"):
            cell.metadata.pop(name, None)
        if cell.cell_type == "code":
            cell["outputs"] = _merge_streams(cell.outputs)
            for output in cell.outputs:
                if output.output_type == "error":
                    output["traceback"] = [f"{output.ename}: {output.evalue}"]
                data = output.get("data", {})
                if isinstance(data.get("image/png"), str):
                    data["image/png"] = _plain_png(data["image/png"])


def _merge_streams(outputs: list[Any]) -> list[Any]:
    """Between two other outputs, all of stdout and then all of stderr."""
    merged: list[Any] = []
    for streams, run in itertools.groupby(outputs, lambda o: bool(o.output_type == "stream")):
        if not streams:
            merged += run
            continue
        texts = {"stdout": "", "stderr": ""}
        for output in run:
            texts[output.name] = texts.get(output.name, "") + output.text
        merged += [new_output("stream", name=n, text=as_printed(t)) for n, t in texts.items() if t]
    return merged


def _plain_png(encoded: str) -> str:
    """The same picture without its text chunks; other data as it came."""
    try:
        png = base64.b64decode(encoded)
    except ValueError:
        return encoded
    kept, position = png[:8], 8
    while png.startswith(_PNG_SIGNATURE) and position + 12 <= len(png):
        end = position + 12 + int.from_bytes(png[position : position + 4], "big")
        if png[position + 4 : position + 8] not in _PNG_TEXT:
            kept += png[position:end]
        position = end
    if position != len(png):
        return encoded
    # Jupyter ends the base64 text of a picture with a newline, as this does.
    return base64.encodebytes(kept).decode("ascii").replace("\n", "") + "\n"


def keep_agreeing(
    stored: Any, nb: Any, settings: Settings, only: Container[int] | None = None
) -> tuple[list[str], list[str]]:
    """Give the cells of an executed notebook their stored outputs where they agree.

    So a run on another machine, with other last digits and other picture bytes, changes
    nothing. Outputs of cells that are ignored are kept; a cell that gained a digest is new.

    Parameters
    ----------
    stored : nbformat.NotebookNode
        The notebook as it was before it was executed.
    nb : nbformat.NotebookNode
        The same notebook, executed and normalized; changed in place.
    settings : Settings
    only : container of int, optional
        Places of the cells that may change; default: all.

    Returns
    -------
    changed : list of str
        The cells with new outputs, as "In [3]".
    kept : list of str
        The cells whose outputs were kept although they are not the same.
    """
    changed, kept, widgets = [], [], []
    for index, (old, cell) in enumerate(zip(stored.cells, nb.cells, strict=True)):
        if cell.cell_type != "code":
            continue
        shows_widget = any(WIDGET_VIEW in output.get("data", {}) for output in cell.outputs)
        options = cell_options(cell)
        same = old.outputs == cell.outputs and old.execution_count == cell.execution_count
        ignored = options.get("check") is False and old.execution_count is not None
        if same or options.get("skip"):
            continue
        comparison, pair = Comparison(settings.with_tags(cell)), (old.outputs, cell.outputs)
        new = not ignored and (lacks_digest(*pair) or bool(outputs_differences(*pair, comparison)))
        if new and (only is None or index in only):
            changed.append(f"In [{cell.execution_count}]")
            continue
        if shows_widget:
            widgets.append((old, cell))
            continue
        if old.outputs != cell.outputs:
            kept.append(f"In [{cell.execution_count}]")
        _keep(old, cell)
    shown = [c.get("outputs") for c in nb.cells if f"In [{c.get('execution_count')}]" in changed]
    if WIDGET_VIEW not in json.dumps(shown):  # all models have new names, or all the old
        for old, cell in widgets:
            kept.append(f"In [{cell.execution_count}]")
            _keep(old, cell)
        if "widgets" in stored.metadata:
            nb.metadata["widgets"] = stored.metadata["widgets"]
    return changed, kept


def _keep(old: Any, cell: Any) -> None:
    cell["outputs"] = old.outputs
    for output in cell.outputs:
        if output.output_type == "execute_result":
            output["execution_count"] = cell.execution_count
