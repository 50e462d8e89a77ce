"""Widgets: their random names counted, their values beside what they show."""

import json
import re
from typing import Any

from nbregress.mime import WIDGET_TYPE, WIDGET_VIEW

_STATE = "application/vnd.jupyter.widget-state+json"
_REFERENCE = "IPY_MODEL_"
# Traits that say how a widget looks, or how the kernel speaks with it.
_LEFT_OUT = re.compile(r"_|layout$|style$|msg_id$|tabbable$|tooltip$|comm_id$")
_PICTURES = ("image/", "text/html", "application/pdf")


def attach_widgets(nb: Any, states: dict[str, Any], buffers: dict[str, Any]) -> None:
    """Give each widget that a notebook shows its values, and the notebook their state.

    The models' random names become counted ones, in the order the models were made.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        Executed; changed in place. It keeps the state in its metadata if it had one.
    states, buffers : dict
        Of each model, by its name, as nbclient collects them.
    """
    if not states:
        nb.metadata.pop("widgets", None)
        return
    names = {old: f"{number:032x}" for number, old in enumerate(states, start=1)}
    pattern = re.compile("|".join(map(re.escape, names)))

    def renamed(value: Any) -> Any:
        text = json.dumps(value)
        return json.loads(pattern.sub(lambda match: names[match[0]], text))

    renamed_states = renamed(states)
    renamed_buffers = renamed({k: list(v.values()) for k, v in buffers.items()})
    for cell in nb.cells:
        for output in cell.get("outputs", ()):
            if WIDGET_VIEW in output.get("data", {}):
                output["data"] = {k: renamed(v) for k, v in output["data"].items()}
                model = output["data"][WIDGET_VIEW].get("model_id")
                output["data"][WIDGET_TYPE] = _tree(model, renamed_states, renamed_buffers, ())
    if "widgets" in nb.metadata:
        kept = {}
        for name, state in renamed_states.items():
            kept[name] = {
                "model_module": state.get("_model_module"),
                "model_module_version": state.get("_model_module_version"),
                "model_name": state.get("_model_name"),
                "state": state,
            }
            if renamed_buffers.get(name):
                kept[name]["buffers"] = renamed_buffers[name]
        nb.metadata["widgets"] = {_STATE: {"state": kept, "version_major": 2, "version_minor": 0}}


def _tree(
    name: Any, states: dict[str, Any], buffers: dict[str, Any], above: tuple[Any, ...]
) -> Any:
    """A widget's values, with those of the widgets that it holds."""
    state = states.get(name)
    if state is None or name in above:
        return {"model": "elsewhere"}

    def values(value: Any) -> Any:
        if isinstance(value, str) and value.startswith(_REFERENCE):
            return _tree(value.removeprefix(_REFERENCE), states, buffers, (*above, name))
        if isinstance(value, list):
            return [values(item) for item in value]
        if isinstance(value, dict):
            return {key: values(item) for key, item in value.items()}
        return value

    result = {"model": state.get("_model_name")}
    for key, value in state.items():
        if key == "outputs" and isinstance(value, list):
            result[key] = [_plain_output(output) for output in value]
        elif not _LEFT_OUT.search(key) and value is not None:
            result[key] = values(value)
    if buffers.get(name):
        result["buffers"] = [buffer.get("data") for buffer in buffers[name]]
    return result


def _plain_output(output: dict[str, Any]) -> dict[str, Any]:
    """What an Output widget holds, without pictures whose data are there."""
    kept = {k: v for k, v in output.items() if k not in ("metadata", "transient", "traceback")}
    data = kept.get("data")
    if data and any("vnd.nbregress" in mime for mime in data):
        kept["data"] = {k: v for k, v in data.items() if not k.startswith(_PICTURES)}
    return kept
