"""A model with other values of its parameters."""

import copy
import inspect
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any


def parameters_of(model: Any) -> tuple[str, ...] | None:
    """Return the names of a model's parameters; None if it takes any.

    Parameters
    ----------
    model : dataclass, control.NonlinearIOSystem or callable
        Its parameters are fields, entries of ``params`` or arguments, in that order.

    Raises
    ------
    TypeError
        It is none of these.

    Examples
    --------
    >>> parameters_of(lambda x, u, m=1.0, k=2.0: [x[1], (u[0] - k * x[0]) / m])
    ('x', 'u', 'm', 'k')
    """
    if is_dataclass(model) and not isinstance(model, type):
        return tuple(field.name for field in fields(model) if field.init)
    if hasattr(model, "nstates") and hasattr(model, "params"):
        parts = [model, *getattr(model, "syslist", ())]
        return tuple(dict.fromkeys(name for part in parts for name in part.params))
    if not callable(model) or hasattr(model, "ninputs"):  # a transfer function can be called
        raise TypeError(
            "model must be a dataclass, a function with keywords, a factory that returns a system,"
            f" or a control.NonlinearIOSystem with params, got {type(model).__name__}"
        )
    taken = inspect.signature(model).parameters
    return None if any(p.kind is p.VAR_KEYWORD for p in taken.values()) else tuple(taken)


def variant(model: Any, values: Mapping[str, Any]) -> Any:
    """Return a model with other values of its parameters.

    Parameters
    ----------
    model : dataclass, control.NonlinearIOSystem or callable
        A callable that asks for more than these values is a function f(x, u, ...), whose
        keywords they are; another one is a factory, which returns a system.
    values : mapping of str to object

    Returns
    -------
    object
        A new one; the model keeps its values.

    Raises
    ------
    TypeError, ValueError
        The model has no such parameter, or refuses the value.

    Examples
    --------
    >>> import statebook as sb
    >>> variant(sb.Pendulum(), {"m": 2.0}).m
    2.0
    """
    known = parameters_of(model)
    for name in values:
        if known is not None and name not in known:
            given = ", ".join(known) or "none"
            raise ValueError(f"{name!r} must be a parameter of the model; it has {given}")
    if is_dataclass(model) and not isinstance(model, type):
        return replace(model, **values)
    if not callable(model) or hasattr(model, "nstates"):
        changed = copy.copy(model)
        changed.params = {**model.params, **values}
        return changed
    try:
        inspect.signature(model).bind(**values)
    except TypeError:  # more is required: the state
        changed = partial(model, **values)
        changed.__name__ = getattr(model, "__name__", type(model).__name__)  # type: ignore
        return changed
    return model(**values)
