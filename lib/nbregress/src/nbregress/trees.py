"""JSON compared: figures' digests, and what plotly, Vega, Bokeh and widgets draw from."""

import base64
import gzip
import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from nbregress.comparison import Comparison
from nbregress.summary import difference
from nbregress.textdiff import RESIDUE, cut

# What is no data: styles that come with a version of the library, and names made at random.
_LEFT_OUT = {"template", "uid", "$schema", "usermeta", "config", "renderer", "version", "docid"}
_RANDOM = re.compile(
    r"[0-9a-f]{8}-(?:[0-9a-f]{4}-){3}[0-9a-f]{12}|\b(?:[\w-]*-)?[0-9a-f]{32}\b|^p\d{4,}$"
    r"|^altair-viz-\w+$|^(?:view|param|selector|layer|concat)_?\d+$"
)
_SUMMARIES = ("limits", "data", "tick places", "spacing")
_SHOWN, _FIRST = 5, ("title", "artists")


def figures_differences(stored: Any, new: Any, comparison: Comparison, name: str) -> list[str]:
    """What differs between two digests of this package, one message each.

    Parameters
    ----------
    stored, new : dict
        Results of `nbregress.figures.digest`, or frames of them, or of
        `nbregress.values.data_bundle`.
    comparison : Comparison
    name : str
        "figure" or "data": a written-out value of data is compared relatively to itself.

    Returns
    -------
    messages : list of str
    """
    for digest, which in ((new, "came"), (stored, "is stored")):
        if isinstance(digest, dict) and "error" in digest:
            return [f"{name}: no digest {which}, it could not be made: {digest['error']}"]
    if name == "figure" and _version(stored) != _version(new):
        return [f"{name}: its data were stored by another version of nbregress; refresh it"]
    if isinstance(stored, dict) and isinstance(new, dict) and "frames" in stored.keys() & new:
        return list(_frames(stored["frames"], new["frames"], comparison))
    return _limited(_walk(name, stored, new, comparison, each=name != "figure"))


def _version(digest: Any) -> Any:
    frames = digest.get("frames") if isinstance(digest, dict) else None
    return (frames[0] if frames else digest).get("version")


def _frames(stored: list[Any], new: list[Any], comparison: Comparison) -> Iterator[str]:
    if len(stored) != len(new):
        yield f"{len(new)} frames, stored {len(stored)}"
        return
    pairs = enumerate(zip(stored, new, strict=True), start=1)
    found = [(k, figures_differences(a, b, comparison, "figure")) for k, (a, b) in pairs]
    bad = [(number, messages) for number, messages in found if messages]
    for number, messages in bad[:2]:
        yield from (f"frame {number} of {len(new)}: {message}" for message in messages[:3])
    if len(bad) > 2:
        yield f"... and {len(bad) - 2} more frames"


def _limited(messages: Iterator[str]) -> list[str]:
    every = list(messages)
    more = [f"... and {len(every) - _SHOWN} more differences"] if len(every) > _SHOWN else []
    return every[:_SHOWN] + more


def _walk(
    name: str, old: Any, new: Any, comparison: Comparison, array: bool = False, each: bool = False
) -> Iterator[str]:
    if type(old) is not type(new):
        yield f"{name}: {short(new)}, stored {short(old)}"
    elif isinstance(old, dict):
        old, new = _with_named_columns(old), _with_named_columns(new)
        # What a reader looks for first: the artists before the limits that follow from them.
        for key in sorted(old.keys() | new.keys(), key=lambda k: (k not in _FIRST, k)):
            if key not in new:
                yield f"{name}: has no {key}, stored {short(old[key])}"
            elif key not in old:
                yield f"{name}: has a new {key}: {short(new[key])}"
            else:
                inner = name if key in ("axes", "artists", "data") else f"{name}, {key}"
                summary = array or key in _SUMMARIES or (each and key == "size" and not array)
                yield from _walk(inner, old[key], new[key], comparison, summary, each)
    elif isinstance(old, list) and any(isinstance(item, dict) for item in (*old, *new)):
        old, new = _same_grid_spelled_out(old), _same_grid_spelled_out(new)
        kinds = [[i.get("kind") if isinstance(i, dict) else "" for i in x] for x in (old, new)]
        new_names = _names(new)
        if kinds[0] != kinds[1]:
            # One missing or extra artist is not a difference of all that come after it.
            yield f"{name}: shows {_list(new_names)}; stored {_list(_names(old))}"
        else:
            for item_name, a, b in zip(new_names, old, new, strict=True):
                yield from _walk(f"{name}, {item_name}", a, b, comparison, False, each)
    elif isinstance(old, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True), start=1):
            place = f"{name} {k}" if len(new) > 1 else name
            yield from _walk(place, a, b, comparison, array, each)
    elif isinstance(old, str):
        tolerance = comparison.settings
        if array:
            message = difference(old, new, rtol=tolerance.rtol, atol=tolerance.atol, each=each)
        else:
            message = comparison.text(old, new)
            message = message and f"{cut(new)!r}, stored {cut(old)!r}"
        if message:
            yield f"{name}: {message}"
    elif old != new:
        yield f"{name}: {short(new)}, stored {short(old)}"


def _with_named_columns(table: dict[str, Any]) -> dict[str, Any]:
    """A data frame whose columns carry their names, for the messages; anything else as it is."""
    pairs = zip(table.get("columns", ()), table.get("names", ()), strict=False)
    named = [{"label": name, **c} for c, name in pairs if isinstance(c, dict)]
    return {**table, "columns": named} if named else table


def _names(items: list[Any]) -> list[str]:
    names: list[str] = []
    counts: dict[str, int] = {}
    for item in items:
        known = item if isinstance(item, dict) else {"kind": "entry"}
        kind = str(known.get("kind", known.get("dtype", "axes")))
        counts[kind] = counts.get(kind, 0) + 1
        label = known.get("label") or known.get("title")
        names.append(f"{kind} {counts[kind]}" + (f" {label!r}" if label else ""))
    return names


def _same_grid_spelled_out(items: list[Any]) -> list[Any]:
    """Lines that leave out x because they share it with the line before, with it."""
    full = []
    x = None
    for item in items:
        data = item.get("data") if isinstance(item, dict) else None
        if isinstance(data, dict) and item.get("kind") == "line" and "through" not in data:
            x = data.get("x", x)
            item = {**item, "data": {"x": x, **data}}
        full.append(item)
    return full


def json_differences(name: str, stored: Any, new: Any, comparison: Comparison) -> list[str]:
    """What differs between JSON data of a chart or a widget, one message each.

    Names made at random are compared by the order of their appearance, arrays in base64 by
    their numbers, and what only styles a chart not at all.

    Parameters
    ----------
    name : str
    stored, new : object
        As `json.loads` gives it.
    comparison : Comparison

    Returns
    -------
    messages : list of str

    Examples
    --------
    >>> from nbregress.settings import Settings
    >>> json_differences("chart", {"y": [1.0, 2.0]}, {"y": [1.0, 2.5]}, Comparison(Settings()))
    ['chart, y, item 2: 2.5, stored 2.0']
    """
    old, new = (_plain(value, {}) for value in (stored, new))
    return _limited(_json(name, old, new, comparison, 0.0))


def _plain(value: Any, seen: dict[str, str]) -> Any:
    """JSON with counted names for random ones, and arrays where they were encoded."""
    if isinstance(value, dict):
        array = _decoded(value)
        if array is not None:
            return array
        return {
            _plain(key, seen): _plain(item, seen)
            for key, item in value.items()
            if key not in _LEFT_OUT
        }
    if isinstance(value, list):
        return [_plain(item, seen) for item in value]
    if isinstance(value, str) and len(value) < 200:
        return _RANDOM.sub(lambda m: seen.setdefault(m[0], f"name {len(seen) + 1}"), value)
    return value


def _decoded(value: dict[str, Any]) -> dict[str, Any] | None:
    """An array as plotly (dtype, bdata) or Bokeh (dtype, array) encode it."""
    encoded = value.get("bdata", value.get("array", value.get("__ndarray__")))
    if isinstance(encoded, dict):
        encoded = encoded.get("data")
    if not isinstance(encoded, str) or "dtype" not in value:
        return None
    try:
        raw = base64.b64decode(encoded)
        raw = gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw
        dtype = np.dtype(str(value["dtype"]))
        dtype = dtype.newbyteorder(">" if value.get("order") == "big" else "<")
        return {"shape": value.get("shape"), "values": np.frombuffer(raw, dtype).tolist()}
    except (ValueError, TypeError, OSError, EOFError):
        return None


def _json(name: str, old: Any, new: Any, comparison: Comparison, beside: float) -> Iterator[str]:
    settings = comparison.settings
    numbers = (int, float)
    if isinstance(old, dict) and isinstance(new, dict):
        for key in old.keys() | new.keys():
            if key not in new or key not in old:
                word = "missing" if key not in new else "new"
                yield f"{name}: {word}: {cut(key, 60)} {short(old.get(key, new.get(key)))}"
        for key in old:
            if key in new:
                yield from _json(f"{name}, {cut(key, 60)}", old[key], new[key], comparison, 0.0)
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{name}: {len(new)} items, stored {len(old)}"
            return
        sizes = [abs(v) for v in (*old, *new) if type(v) in numbers and abs(v) < float("inf")]
        for k, (a, b) in enumerate(zip(old, new, strict=True), start=1):
            yield from _json(f"{name}, item {k}", a, b, comparison, max(sizes, default=0.0))
    elif type(old) in numbers and type(new) in numbers:
        allowed = settings.rtol * max(abs(old), abs(new)) + settings.atol + RESIDUE * beside
        exact = isinstance(old, int) and isinstance(new, int)
        if old != new and not (old != old and new != new):
            if exact or not abs(old - new) <= allowed:
                yield f"{name}: {new!r}, stored {old!r}"
    elif isinstance(old, str) and isinstance(new, str):
        message = comparison.text(old, new)
        if message:
            yield f"{name}: {message}"
    elif old != new:
        yield f"{name}: {short(new)}, stored {short(old)}"


def short(value: Any) -> str:
    """A value as a message shows it.

    Parameters
    ----------
    value : object
        JSON data.

    Returns
    -------
    text : str
    """
    return repr(cut(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False), 80))


def _list(names: list[str]) -> str:
    return cut(", ".join(names) or "nothing", 400)
