"""Events: the times at which a function of the state passes zero."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.policies import valued
from statebook.probes import is_time, positional


@dataclass(frozen=True, eq=False)
class Event:
    """A moment at which an event's function passed zero.

    Parameters
    ----------
    label : str
        Which event: its key, or its function's ``label`` or name.
    time : float [s]
    state : array, shape (n,)

    Examples
    --------
    >>> Event("impact", 1.5, np.array([0.0, -3.0]))
    Event(impact at t = 1.5 s)
    """

    label: str
    time: float
    state: np.ndarray

    def __repr__(self) -> str:
        return f"Event({self.label} at t = {self.time:.6g} s)"


class Watch:
    """One event's function, its options, and its last value."""

    def __init__(self, label: str, function: Callable[..., Any], x: np.ndarray, t: float) -> None:
        self.label, self._function = label, function
        names = (positional(function) or ([], 0, False))[0]
        # SciPy's order is told by the names: f(t, y).
        self._time_first = bool(names) and is_time(names[0])
        self._number = 1 if len(names) == 1 else 2
        given = getattr(function, "terminal", None)
        terminal = np.asarray(given or 0)  # None and 0 are False, as in SciPy
        if terminal.ndim or terminal.dtype.kind not in "biuf" or terminal < 0 or terminal % 1:
            raise ValueError(f"terminal of event {label} must be a bool or a count, got {given!r}")
        self._left = int(terminal) or np.inf
        direction = getattr(function, "direction", 0)
        self._direction = _validate.number(f"direction of event {label}", direction)
        self._value = self(x, t)

    def __call__(self, x: np.ndarray, t: float) -> float:
        """Evaluate the function."""
        order = ((t, x) if self._time_first else (x, t))[: self._number]
        with valued(f"event {self.label} has", x, t):
            value = np.asarray(self._function(*order))
        if value.size != 1 or value.dtype.kind not in "biuf" or np.isnan(value).any():
            raise TypeError(
                f"event {self.label} must return one real number from (x, t), got {value!r}"
                f" at t = {t:.6g}"
            )
        return float(value.reshape(()))

    def passed(self, x: np.ndarray, t: float) -> bool:
        """Whether the function has passed zero since it was last asked."""
        before, self._value = self._value, self(x, t)
        rising = before < 0 <= self._value and self._direction >= 0
        falling = before > 0 >= self._value and self._direction <= 0
        return rising or falling

    def locate(self, state: Callable[[float], np.ndarray], start: float, end: float) -> Event:
        """Find when the function passed zero within a step."""

        def value(t: float) -> float:
            return self(state(t), t)

        time = end
        if self._value != 0 and value(start) * value(end) < 0:
            time = scipy.optimize.brentq(value, start, end, xtol=1e-15, rtol=1e-15)
        return Event(self.label, float(time), state(time))

    def ends(self) -> bool:
        """Count an event; whether it was the last that a terminal event allows."""
        self._left -= 1
        return self._left <= 0


def watches(events: Any, x: np.ndarray, t: float) -> list[Watch]:
    """Check events: a function, functions, or functions by their labels."""
    if events is None:
        return []
    if x.ndim > 1:
        raise ValueError(
            f"events take one trajectory, got a batch of {x.shape[1]}: simulate one at a time"
        )
    events = [events] if callable(events) else events
    if not isinstance(events, Mapping | list | tuple):
        raise TypeError(f"events must be a function e(x, t), or several, got {events!r}")
    named = events.items() if isinstance(events, Mapping) else ((None, e) for e in events)
    result = []
    for label, function in named:
        if not callable(function):
            raise TypeError(f"events must be functions e(x, t), got {function!r}")
        label = label or getattr(function, "label", None) or getattr(function, "__name__", None)
        result.append(Watch(str(label or type(function).__name__), function, x.copy(), t))
    return result
