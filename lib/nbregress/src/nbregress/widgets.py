"""Widgets: their random names counted, their values beside what they show."""

import json
import re
from typing import Any

from nbregress.mime import WIDGET_TYPE, WIDGET_VIEW

_STATE = "application/vnd.jupyter.widget-state+json"
_REFERENCE = "IPY_MODEL_"
# Traits that say how a widget looks, or how the kernel speaks with it.
_LEFT_OUT = re.compile(
    r"_(?:model|view|dom|property)_|_states_|layout$|style$|msg_id$|tabbable$|tooltip$|comm_id$"
)
_PICTURES = ("image/", "text/html", "application/pdf")


def attach_widgets(nb: Any, keep: bool) -> None:
    """Give each widget that a notebook shows its values.

    The models' random names become counted ones, in the order the models were made.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        Executed, with the widgets' state in its metadata; changed in place.
    keep : bool
        Whether the state stays there.
    """
    found = nb.metadata.pop("widgets", None)
    if not found:
        return
    names = {old: f"{number:032x}" for number, old in enumerate(found[_STATE]["state"], start=1)}
    pattern = re.compile("|".join(map(re.escape, names)))

    def renamed(value: Any) -> Any:
        return json.loads(pattern.sub(lambda match: names[match[0]], json.dumps(value)))

    found = renamed(found)
    for cell in nb.cells:
        for output in cell.get("outputs", ()):
            if WIDGET_VIEW in output.get("data", {}):
                data = renamed(output["data"])
                model = data[WIDGET_VIEW].get("model_id")
                output["data"] = {**data, WIDGET_TYPE: _tree(model, found[_STATE]["state"], ())}
    if keep:
        nb.metadata["widgets"] = found


def _tree(name: Any, states: dict[str, Any], above: tuple[Any, ...]) -> Any:
    """A widget's values, with those of the widgets that it holds."""
    model = states.get(name)
    if model is None or name in above:
        return {"model": "elsewhere"}

    def values(value: Any) -> Any:
        if isinstance(value, str) and value.startswith(_REFERENCE):
            return _tree(value.removeprefix(_REFERENCE), states, (*above, name))
        if isinstance(value, list):
            return [values(item) for item in value]
        if isinstance(value, dict):
            return {key: values(item) for key, item in value.items()}
        return value

    result = {"model": model["model_name"]}
    for key, value in model["state"].items():
        if key == "outputs" and isinstance(value, list):
            result[key] = [_plain_output(output) for output in value]
        elif not _LEFT_OUT.search(key) and value is not None:
            result[key] = values(value)
    if model.get("buffers"):
        result["buffers"] = [buffer.get("data") for buffer in model["buffers"]]
    return result


def _plain_output(output: dict[str, Any]) -> dict[str, Any]:
    """What an Output widget holds, without pictures whose data are there."""
    kept = {k: v for k, v in output.items() if k not in ("metadata", "transient", "traceback")}
    data = kept.get("data")
    if data and any("vnd.nbregress" in mime for mime in data):
        kept["data"] = {k: v for k, v in data.items() if not k.startswith(_PICTURES)}
    return kept
