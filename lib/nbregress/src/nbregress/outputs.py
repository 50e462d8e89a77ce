"""The outputs of a cell compared: texts by their numbers, figures by their data."""

import json
import re
from collections.abc import Iterator
from typing import Any

from nbregress.figures import MIME_TYPE, rename_digest
from nbregress.summary import difference
from nbregress.textdiff import text_difference
from nbregress.tolerance import Tolerance

_WIDGET = "application/vnd.jupyter.widget-view+json"
_PICTURES = ("image/png", "image/jpeg", "image/svg+xml", "application/pdf")
# A figure's digest holds the summary of an array under these names.
_ARRAYS = ("limits", "data")
# Pictures within HTML, and the random names that Matplotlib gives an animation's elements.
_EMBEDDED = re.compile(r"data:image/[\w+.-]+;base64,[\w+/=\\\s]+|(?<=[A-Za-z_])[0-9a-f]{32}")


def outputs_differences(stored: list[Any], new: list[Any], tolerance: Tolerance) -> list[str]:
    """What differs between the outputs of a cell, one message each.

    Parameters
    ----------
    stored, new : list of dict
        Outputs as the notebook format has them.
    tolerance : Tolerance

    Returns
    -------
    messages : list of str
        Empty if the outputs agree.

    Examples
    --------
    >>> old = [{"output_type": "stream", "name": "stdout", "text": "1.000000"}]
    >>> outputs_differences(old, [], Tolerance())
    ['stdout: stored, but nothing was printed']
    """
    messages = []
    for name in ("stdout", "stderr"):
        was, now = _stream(stored, name), _stream(new, name)
        if was and not now:
            messages.append(f"{name}: stored, but nothing was printed")
        elif now and not was:
            messages.append(f"{name}: printed, but none is stored: {_short(now)}")
        else:
            messages += _text(name, was, now, tolerance)
    messages += _errors(_of_type(stored, "error"), _of_type(new, "error"), tolerance)
    rich = ("display_data", "execute_result")
    was_rich, now_rich = (
        [rename_digest(output["data"]) for output in _of_type(outputs, *rich)]
        for outputs in (stored, new)
    )
    if len(was_rich) != len(now_rich):
        messages.append(
            f"{len(now_rich)} displayed outputs ({_kinds(now_rich)}), "
            f"stored {len(was_rich)} ({_kinds(was_rich)})"
        )
        return messages
    for index, (a, b) in enumerate(zip(was_rich, now_rich, strict=True), start=1):
        name = f"output {index}" if len(was_rich) > 1 else "output"
        messages += _bundle(name, a, b, tolerance)
    return messages


def figures_differences(
    stored: dict[str, Any], new: dict[str, Any], tolerance: Tolerance
) -> list[str]:
    """What differs between the digests of two figures, one message each.

    Parameters
    ----------
    stored, new : dict
        Results of `nbregress.figures.digest`.
    tolerance : Tolerance

    Returns
    -------
    messages : list of str
    """
    return list(_walk("figure", stored, new, tolerance))


def _walk(
    name: str, old: Any, new: Any, tolerance: Tolerance, array: bool = False
) -> Iterator[str]:
    if type(old) is not type(new):
        yield f"{name}: {_short(new)}, stored {_short(old)}"
    elif isinstance(old, dict):
        for key in sorted(old.keys() | new.keys(), key=_order):
            if key not in new:
                yield f"{name}: has no {key}, stored {_short(old[key])}"
            elif key not in old:
                yield f"{name}: has a new {key}: {_short(new[key])}"
            else:
                inner = name if key in ("axes", "artists", "data") else f"{name}, {key}"
                yield from _walk(inner, old[key], new[key], tolerance, array or key in _ARRAYS)
    elif isinstance(old, list) and any(isinstance(item, dict) for item in (*old, *new)):
        old, new = _same_grid_spelled_out(old), _same_grid_spelled_out(new)
        new_names = _names(new)
        if [item.get("kind") for item in old] != [item.get("kind") for item in new]:
            # One missing or extra artist is not a difference of all that come after it.
            yield f"{name}: shows {_list(new_names)}; stored {_list(_names(old))}"
        else:
            for item_name, a, b in zip(new_names, old, new, strict=True):
                yield from _walk(f"{name}, {item_name}", a, b, tolerance)
    elif isinstance(old, list) and len(old) == len(new):
        for a, b in zip(old, new, strict=True):
            yield from _walk(name, a, b, tolerance)
    elif isinstance(old, str):
        compare = difference if array else text_difference
        message = compare(old, new, rtol=tolerance.rtol, atol=tolerance.atol)
        if message and not array:
            message = f"{new!r}, stored {old!r}"
        if message:
            yield f"{name}: {message}"
    elif old != new:
        yield f"{name}: {_short(new)}, stored {_short(old)}"


def _order(key: str) -> tuple[bool, str]:
    # What a reader looks for first: the artists before the limits that follow from them.
    return key not in ("title", "artists"), key


def _names(items: list[dict[str, Any]]) -> list[str]:
    names: list[str] = []
    counts: dict[str, int] = {}
    for item in items:
        kind = item.get("kind", "axes")
        counts[kind] = counts.get(kind, 0) + 1
        label = item.get("label") or item.get("title")
        names.append(f"{kind} {counts[kind]}" + (f" {label!r}" if label else ""))
    return names


def _same_grid_spelled_out(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Lines that leave out x because they share it with the line before, with it."""
    full = []
    x = None
    for item in items:
        data = item.get("data")
        if item.get("kind") == "line" and isinstance(data, dict) and "through" not in data:
            x = data.get("x", x)
            item = {**item, "data": {"x": x, **data}}
        full.append(item)
    return full


def _bundle(name: str, old: dict[str, Any], new: dict[str, Any], tolerance: Tolerance) -> list[str]:
    was, now = old.keys() - {_WIDGET}, new.keys() - {_WIDGET}
    messages = []
    if MIME_TYPE in was and MIME_TYPE not in now:
        return [
            f"{name}: a figure's data are stored, but none came; is "
            "%load_ext nbregress still in the notebook?"
        ]
    if MIME_TYPE in now and MIME_TYPE not in was:
        return [f"{name}: a figure's data came, but none are stored"]
    if was - now:
        messages.append(f"{name}: {', '.join(sorted(was - now))} stored, but not produced")
    if now - was:
        messages.append(f"{name}: {', '.join(sorted(now - was))} produced, but not stored")
    for mime in sorted(was & now):
        if mime == MIME_TYPE:
            messages += figures_differences(old[mime], new[mime], tolerance)
        elif mime in _PICTURES and (mime != "image/svg+xml" or MIME_TYPE in was):
            continue
        elif mime == "text/plain" and MIME_TYPE in was:
            continue  # "<Figure size 640x480 with 1 Axes>": the size on paper
        else:
            a, b = (_as_text(bundle[mime]) for bundle in (old, new))
            if mime == "text/html":
                a, b = (_EMBEDDED.sub("", text) for text in (a, b))
            label = name if mime == "text/plain" else f"{name}, {mime}"
            messages += _text(label, a, b, tolerance)
    return messages


def _errors(old: list[Any], new: list[Any], tolerance: Tolerance) -> list[str]:
    was, now = ([f"{e['ename']}: {e['evalue']}" for e in errors] for errors in (old, new))
    if was and not now:
        return [f"raised {was[0]} when it was stored, but raises nothing now"]
    if now and not was:
        return [f"raises {now[0]}, but none is stored"]
    return [m for a, b in zip(was, now, strict=False) for m in _text("error", a, b, tolerance)]


def _text(name: str, old: str, new: str, tolerance: Tolerance) -> list[str]:
    message = text_difference(old, new, rtol=tolerance.rtol, atol=tolerance.atol)
    return [f"{name}, {message}"] if message else []


def _stream(outputs: list[Any], name: str) -> str:
    return "".join(o["text"] for o in _of_type(outputs, "stream") if o["name"] == name)


def _of_type(outputs: list[Any], *kinds: str) -> list[Any]:
    return [output for output in outputs if output["output_type"] in kinds]


def _kinds(bundles: list[dict[str, Any]]) -> str:
    kinds = ["figure" if bundle.keys() & {MIME_TYPE, *_PICTURES} else "text" for bundle in bundles]
    return ", ".join(kinds) or "none"


def _as_text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)


def _list(names: list[str]) -> str:
    return ", ".join(names) or "nothing"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return repr(text if len(text) <= 80 else text[:77] + "...")
