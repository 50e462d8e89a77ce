"""The outputs of a cell compared: texts by their numbers, figures by their data."""

import json
import re
from typing import Any

from nbregress.comparison import Comparison
from nbregress.markup import html_differences, script_differences, svg_differences
from nbregress.mime import DATA_TYPE, DIGESTS, FIGURE_TYPE, WIDGET_TYPE, WIDGET_VIEW
from nbregress.patterns import as_printed
from nbregress.pictures import pictures_difference
from nbregress.textdiff import cut
from nbregress.trees import figures_differences, json_differences

_BY_TYPE = {
    "text/html": html_differences,
    "image/svg+xml": svg_differences,
    "application/javascript": script_differences,
}
_RICH = ("display_data", "execute_result")
_JSON = re.compile(r"application/(?:.*\+json|json|geo\+json)$")
# Data that a chart is drawn from; beside them its HTML and its name are not compared.
_CHARTS = re.compile(r"application/vnd\.(?:plotly|vega|vegalite)[.\w]*\+json$")
# Beside a digest these show the same once more, rounded or on paper.
_SHOWN = re.compile(r"text/(?:plain|html|latex|markdown)$|image/|application/(?:pdf|javascript)$")


def outputs_differences(stored: list[Any], new: list[Any], comparison: Comparison) -> list[str]:
    """What differs between the outputs of a cell, one message each.

    Parameters
    ----------
    stored, new : list of dict
        Outputs as the notebook format has them.
    comparison : Comparison

    Returns
    -------
    messages : list of str
        Empty if the outputs agree.

    Examples
    --------
    >>> from nbregress.settings import Settings
    >>> old = [{"output_type": "stream", "name": "stdout", "text": "1.000000"}]
    >>> outputs_differences(old, [], Comparison(Settings()))
    ['stdout: stored, but nothing was printed']
    """
    messages = []
    for name in ("stdout", "stderr"):
        was, now = (as_printed(_stream(outputs, name)) for outputs in (stored, new))
        if was and not now:
            messages.append(f"{name}: stored, but nothing was printed")
        elif now and not was:
            messages.append(f"{name}: printed, but none is stored: {cut(now)!r}")
        else:
            messages += _text(name, was, now, comparison)
    messages += _errors(_of_type(stored, "error"), _of_type(new, "error"), comparison)
    was_rich, now_rich = (
        [output["data"] for output in _of_type(outputs, *_RICH)] for outputs in (stored, new)
    )
    if len(was_rich) != len(now_rich):
        messages.append(
            f"{len(now_rich)} displayed outputs ({_kinds(now_rich)}), "
            f"stored {len(was_rich)} ({_kinds(was_rich)})"
        )
        return messages
    for index, (a, b) in enumerate(zip(was_rich, now_rich, strict=True), start=1):
        name = f"output {index}" if len(was_rich) > 1 else "output"
        messages += _bundle(name, a, b, comparison)
    return messages


def lacks_digest(stored: list[Any], new: list[Any]) -> bool:
    """Whether new outputs carry digests where the stored ones have none.

    Parameters
    ----------
    stored, new : list of dict
        Outputs as the notebook format has them.

    Returns
    -------
    lacking : bool
    """
    was, now = (
        [output["data"].keys() & set(DIGESTS) for output in _of_type(outputs, *_RICH)]
        for outputs in (stored, new)
    )
    return was != now


def _bundle(
    name: str, old: dict[str, Any], new: dict[str, Any], comparison: Comparison
) -> list[str]:
    both = old.keys() & new.keys()
    for mime, what in ((FIGURE_TYPE, "a figure's"), (WIDGET_TYPE, "a widget's")):
        if mime in old and mime not in new:
            return [f"{name}: {what} data are stored, but none came"]
        if mime in new and mime not in old:
            return [f"{name}: {what} data came, but none are stored; refresh the notebook"]
    left_out = {WIDGET_VIEW, DATA_TYPE} - (both & {DATA_TYPE})
    shown = [b.get(DATA_TYPE, {}).get("and") == "text" for b in (old, new)]
    if (both & set(DIGESTS) and not all(shown)) or any(map(_CHARTS.match, both)):
        left_out |= {mime for mime in old.keys() | new.keys() if _SHOWN.match(mime)}
    # Of a figure, the text is its size on paper; what else carries frames may say more.
    if FIGURE_TYPE in both and not _as_text(new.get("text/plain", "<Figure")).startswith("<Figure"):
        left_out -= {"text/plain"}
    was, now = old.keys() - left_out, new.keys() - left_out
    messages = []
    if was - now:
        messages.append(f"{name}: {', '.join(sorted(was - now))} stored, but not produced")
    if now - was:
        messages.append(f"{name}: {', '.join(sorted(now - was))} produced, but not stored")
    for mime in sorted(was & now):
        a, b = old[mime], new[mime]
        label = name if mime == "text/plain" else f"{name}, {mime}"
        if a == b and mime != FIGURE_TYPE:
            continue
        if mime == FIGURE_TYPE:
            messages += figures_differences(a, b, comparison, "figure")
        elif mime == DATA_TYPE:
            messages += figures_differences(a, b, comparison, f"{name}, data")
        elif mime == WIDGET_TYPE:
            messages += _widget(label, a, b, comparison)
        elif _JSON.match(mime):
            messages += json_differences(label, _as_json(a), _as_json(b), comparison)
        else:
            picture = mime.startswith("image/") or mime == "application/pdf"
            compare = _BY_TYPE.get(mime, _picture if picture else _text)
            messages += compare(label, _as_text(a), _as_text(b), comparison)
    return messages


def _picture(name: str, old: str, new: str, comparison: Comparison) -> list[str]:
    message = pictures_difference(old, new)
    return [f"{name}: {message}"] if message else []


def _widget(name: str, old: Any, new: Any, comparison: Comparison) -> list[str]:
    """A widget's values as JSON, but what an Output widget holds as outputs."""
    messages: list[str] = []

    def apart(value: Any, found: list[Any]) -> Any:
        if isinstance(value, dict):
            if isinstance(value.get("outputs"), list):
                found.append([o for o in value["outputs"] if isinstance(o, dict)])
            return {k: apart(v, found) for k, v in value.items() if k != "outputs"}
        return [apart(v, found) for v in value] if isinstance(value, list) else value

    held: tuple[list[Any], list[Any]] = ([], [])
    old, new = (apart(value, found) for value, found in zip((old, new), held, strict=True))
    for a, b in zip(*held, strict=False):
        messages += [f"within a widget: {m}" for m in outputs_differences(a, b, comparison)]
    return messages + json_differences(name, old, new, comparison)


def _errors(old: list[Any], new: list[Any], comparison: Comparison) -> list[str]:
    was, now = ([f"{e['ename']}: {e['evalue']}" for e in errors] for errors in (old, new))
    if was and not now:
        return [f"raised {cut(was[0])} when it was stored, but raises nothing now"]
    if now and not was:
        return [f"raises {cut(now[0])}, but none is stored"]
    return [m for a, b in zip(was, now, strict=False) for m in _text("error", a, b, comparison)]


def _text(name: str, old: str, new: str, comparison: Comparison) -> list[str]:
    message = comparison.text(old, new)
    return [f"{name}, {message}"] if message else []


def _stream(outputs: list[Any], name: str) -> str:
    return "".join(_as_text(o["text"]) for o in _of_type(outputs, "stream") if o["name"] == name)


def _of_type(outputs: list[Any], *kinds: str) -> list[Any]:
    return [output for output in outputs if output["output_type"] in kinds]


def _kinds(bundles: list[dict[str, Any]]) -> str:
    kinds = [
        "figure" if any(m == FIGURE_TYPE or m.startswith("image/") for m in bundle) else "text"
        for bundle in bundles
    ]
    return cut(", ".join(kinds), 80) or "none"


def _as_text(value: Any) -> str:
    if isinstance(value, list) and all(isinstance(line, str) for line in value):
        return "".join(value)
    if isinstance(value, str):
        return value
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)


def _as_json(value: Any) -> Any:
    if isinstance(value, str):
        try:
            return json.loads(value)
        except json.JSONDecodeError:
            return value
    return value
