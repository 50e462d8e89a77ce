"""Outputs of a notebook without what changes from run to run."""

import base64
import binascii
import struct
import zlib
from typing import Any

from nbregress.figures import rename_digest

_KERNELSPEC = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
_WIDGET = "application/vnd.jupyter.widget-view+json"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Chunks of a PNG file that describe the program and the time, not the picture.
_PNG_TEXT = {b"tEXt", b"zTXt", b"iTXt", b"tIME"}


def normalize(nb: Any) -> None:
    """Strip an executed notebook of what is not a result, in place.

    Kernel and language version, timings, the chunks a stream happened to arrive in,
    tracebacks with the paths of one machine, random widget identifiers and the text
    chunks of PNG pictures go; a missing cell id becomes a counted one, and a figure's data
    under their old type get today's.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        A notebook of format 4.

    Examples
    --------
    >>> import nbformat
    >>> nb = nbformat.v4.new_notebook()
    >>> normalize(nb)
    >>> nb.metadata.kernelspec["name"]
    'python3'
    """
    nb.metadata["kernelspec"] = dict(_KERNELSPEC)
    nb.metadata.get("language_info", {}).pop("version", None)
    nb.metadata.pop("widgets", None)
    ids = {cell.get("id") for cell in nb.cells}
    for index, cell in enumerate(nb.cells):
        if (nb.nbformat, nb.nbformat_minor) >= (4, 5) and not cell.get("id"):
            cell["id"] = next(
                name for k in range(len(ids) + 1) if (name := f"cell-{index + k}") not in ids
            )
            ids.add(cell["id"])
        for name in ("execution", "ExecuteTime", "trusted"):
            cell.metadata.pop(name, None)
        if cell.cell_type == "code":
            cell["outputs"] = _merge_streams(cell.outputs)
            for output in cell.outputs:
                _normalize_output(output)


def _merge_streams(outputs: list[Any]) -> list[Any]:
    """A print's text, however many messages it came in."""
    merged: list[Any] = []
    for output in outputs:
        last = merged[-1] if merged else None
        if (
            last is not None
            and output.output_type == last.output_type == "stream"
            and output.name == last.name
        ):
            last["text"] += output.text
        else:
            merged.append(output)
    return merged


def _normalize_output(output: Any) -> None:
    if output.output_type == "error":
        output["traceback"] = [f"{output.ename}: {output.evalue}"]
    if "data" not in output:
        return
    output["data"] = rename_digest(output["data"])
    data = output["data"]  # a notebook node by now
    data.pop(_WIDGET, None)
    if isinstance(data.get("image/png"), str):
        data["image/png"] = _plain_png(data["image/png"])


def _plain_png(encoded: str) -> str:
    """The same picture without its text chunks; other data as it came."""
    try:
        png = base64.b64decode(encoded)
    except binascii.Error:
        return encoded
    if not png.startswith(_PNG_SIGNATURE):
        return encoded
    kept, position = [_PNG_SIGNATURE], len(_PNG_SIGNATURE)
    while position + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, position)
        end = position + 12 + length
        chunk = png[position:end]
        if len(chunk) < 12 + length or zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:], "big"):
            return encoded
        if chunk[4:8] not in _PNG_TEXT:
            kept.append(chunk)
        position = end
    # Jupyter ends the base64 text of a picture with a newline, as this does.
    return base64.encodebytes(b"".join(kept)).decode("ascii").replace("\n", "") + "\n"
