"""A model as its owner states it: states, units, operating point, limits; and what is odd in it."""

import inspect
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from statebook import _validate
from statebook.analysis.units import parsed
from statebook.linearization import jacobians
from statebook.residuals import labels_among, values_by_label
from statebook.systems import System, as_system
from statebook.variants import parameters_of, variant

_SLIPS = (1e3, 3.6, 180 / np.pi, 30 / np.pi)  # what units are taken for, and no gear has
_TURNS = 4 * np.pi  # beyond which an angle in rad is rather one in degrees


@dataclass(frozen=True, eq=False)
class OwnModel:
    """A model with its units, operating point, limits and uncertain parameters.

    Attributes
    ----------
    f : system
        As it was given.
    system : System
        With the labels of states and inputs.
    x, u : array, shape (n,) and (m,)
        Guess of the operating point.
    hold : tuple of str
        Labels that keep the guess's value.
    units : mapping of label to str
    limits : mapping of label to (low, high)
    uncertain : mapping of str to (float, float)
        A parameter's value and its relative error.
    sample_time : float > 0 [s], or None
    """

    f: Any
    system: System
    x: np.ndarray
    u: np.ndarray
    hold: tuple[str, ...]
    units: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]
    uncertain: Mapping[str, tuple[float, float]]
    sample_time: float | None

    def __repr__(self) -> str:
        labels, values = (*self.system.states, *self.system.inputs), [*self.x, *self.u]
        point = ", ".join(
            f"{label} = {value:.4g} {self.units.get(label, '')}".rstrip()
            for label, value in zip(labels, values, strict=True)
        )
        n, m = self.system.n, self.system.m
        return f"{self.system.name}: {n} states, {m} inputs; it runs at the guess {point}"

    def at(self, **values: Any) -> System:
        """Return the system with other values of its parameters.

        Examples
        --------
        >>> import statebook as sb
        >>> own = sb.own_model(sb.Pendulum(), guess={"theta": -sb.pi / 2})
        >>> own.at(m=2.0).source.m
        2.0
        """
        system = as_system(variant(self.f, values), self.x, self.u, dt=self.system.dt)
        view = self.system
        return replace(system, states=view.states, inputs=view.inputs, name=view.name)

    def sizes(self, rest: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return how far states and inputs may go from rest: to their nearer limit, or 1.

        Parameters
        ----------
        rest : Equilibrium

        Returns
        -------
        x, u : array, shape (n,) and (m,)

        Raises
        ------
        ValueError
            The operating point leaves no room within the limits.
        """
        found = []
        view = self.system
        for label, value in zip((*view.states, *view.inputs), [*rest.x, *rest.u], strict=True):
            low, high = self.limits.get(label, (value - 1.0, value + 1.0))
            room = min(value - low, high - value)
            if not room > 0:
                raise ValueError(
                    f"{label} must rest within its limits {low:g} to {high:g}, and it rests at"
                    f" {value:.4g} {self.units.get(label, '')}: is one of them in another unit?"
                )
            found.append(room)
        return np.array(found[: view.n]), np.array(found[view.n :])


def own_model(
    f: Any,
    *,
    states: Mapping[str, str] | Sequence[str] | None = None,
    inputs: Mapping[str, str] | Sequence[str] | None = None,
    guess: Mapping[str, float] | None = None,
    hold: Sequence[str] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    uncertain: Mapping[str, float] | None = None,
    sample_time: float | None = None,
    dt: float | bool | None = None,
    name: str | None = None,
) -> OwnModel:
    """State a model for an analysis, and find what is wrong with it.

    Parameters
    ----------
    f : system
        Whatever as_system takes.
    states, inputs : mapping of label to unit, or sequence of labels
        In f's order; of a model that has labels only their units are needed, and no order.
    guess : mapping of label to float, optional
        The operating point as far as it is known; 0 for the others.
    hold : sequence of str, optional
        Labels whose guess is kept while the rest is solved for; all inputs by default.
    limits : mapping of label to (low, high), optional
    uncertain : mapping of str to float > 0, optional
        Relative errors of f's parameters: keywords, fields, entries of ``params``.
    sample_time : float > 0 [s], optional
        Of the computer that is to control it.
    dt : float, bool or None
        Timebase of a function.
    name : str, optional

    Returns
    -------
    OwnModel

    Raises
    ------
    TypeError, ValueError
        f does not run at the guess, or returns too few or too many rates; a label or parameter is
        not known; the units contradict the rates, the guess or the limits.

    Examples
    --------
    >>> def cart(x, u, mass=2.0):
    ...     return [x[1], u[0] / mass]
    >>> own_model(cart, states={"place": "m", "speed": "m/s"}, inputs={"force": "N"})
    cart: 2 states, 1 inputs; it runs at the guess place = 0 m, speed = 0 m/s, force = 0 N
    """
    x_units, u_units = _units("states", states), _units("inputs", inputs)
    if callable(f) and not hasattr(f, "states") and not hasattr(f, "nstates"):
        if not x_units:
            raise ValueError('states must name the states of a function, as {"gap": "m"}')
        labels = (tuple(x_units), tuple(u_units))
    else:
        view = as_system(f)
        labels = (view.states, view.inputs)
        labels_among("states", tuple(x_units), view.states)
        labels_among("inputs", tuple(u_units), view.inputs)
    known = (*labels[0], *labels[1])
    at = values_by_label("guess", guess, known)
    x, u = (np.array([at.get(label, 0.0) for label in part]) for part in labels)
    system = replace(_running(f, x, u, dt, labels), states=labels[0], inputs=labels[1])
    system = replace(system, name=name or system.name)
    units = {**x_units, **u_units}
    bounds = _limits(limits, known, at, units)
    held = labels[1] if hold is None else labels_among("hold", hold, known)
    for label in labels[0]:
        if units.get(label) == "rad" and abs(at.get(label, 0.0)) > _TURNS:
            raise ValueError(
                f"the guess of {label} must be in rad, and {at[label]:g} rad are"
                f" {abs(at[label]) / 2 / np.pi:.3g} turns: write np.radians({at[label]:g})?"
            )
    if not system.discrete:
        _require_one_set_of_units(system, x, u, units)
    time = None if sample_time is None else _validate.positive("sample_time", sample_time)
    return OwnModel(f, system, x, u, held, units, bounds, _uncertain(f, uncertain), time)


def _units(name: str, given: Any) -> dict[str, str]:
    if given is None:
        return {}
    if isinstance(given, str) or not isinstance(given, Mapping | Sequence):
        raise TypeError(f'{name} must map labels to units, as {{"speed": "m/s"}}, got {given!r}')
    pairs = given.items() if isinstance(given, Mapping) else [(label, "") for label in given]
    return {str(label): str(unit) for label, unit in pairs}


def _running(f: Any, x: np.ndarray, u: np.ndarray, dt: Any, labels: Any) -> System:
    """Return the system, once it has run at the guess and returned a rate for each state."""
    try:
        system = as_system(f, x, u, dt=dt)
        value = np.asarray(system.rate(x, u, 0.0))
    except Exception as error:
        raise ValueError(
            f"f does not run at the guess x = {_validate.brief(x)}, u = {_validate.brief(u)}:"
            f" {type(error).__name__}: {error}{_hint(f, x, u)}"
        ) from error
    if value.dtype == object and value.shape == x.shape:
        kinds = ", ".join(sorted({type(entry).__name__ for entry in value}))
        raise ValueError(
            f"f must return numbers, got objects of the types {kinds}: take sin, cos and the like"
            " from numpy, not from sympy or another package of symbols"
        )
    if value.shape != x.shape:
        raise ValueError(
            f"f must return one rate for each of the {len(x)} states ({', '.join(labels[0])}),"
            f" shape {x.shape}, got shape {value.shape}"
        )
    system.dynamics(x, u)
    return system


def _hint(f: Any, x: np.ndarray, u: np.ndarray) -> str:
    """Say that f takes a single input as a number, if it does."""
    try:
        takes_number = u.size == 1 and np.shape(f(x.copy(), float(u[0]))) == x.shape
    except Exception:  # neither way
        return ""
    return "; it takes a number as u: give lambda x, u: f(x, u[0])" if takes_number else ""


def _limits(limits: Any, known: Sequence[str], at: Any, units: Any) -> dict[str, Any]:
    found = {}
    for label in labels_among("limits", tuple(limits or ()), known):
        low, high = _validate.real_array(f"limits[{label!r}]", limits[label], (2,)).tolist()
        if not low < high:
            raise ValueError(f"limits[{label!r}] must be (low, high), got {limits[label]!r}")
        if label in at and not low <= at[label] <= high:
            raise ValueError(
                f"the guess of {label} must lie within its limits {low:g} to {high:g}, got"
                f" {at[label]:g} {units.get(label, '')}: is one of them in another unit?"
            )
        found[label] = (low, high)
    return found


def _uncertain(f: Any, uncertain: Any) -> dict[str, tuple[float, float]]:
    """Return the value of each parameter that is named, and its relative error."""
    values = {**vars(f), **getattr(f, "params", {})} if hasattr(f, "__dict__") else {}
    if inspect.isfunction(f):
        values = {name: p.default for name, p in inspect.signature(f).parameters.items()}
    known, found = parameters_of(f) or (), {}
    numbers = {n: v for n, v in values.items() if isinstance(v, Real) and n in known}
    for name, error in (uncertain or {}).items():
        _validate.choice("uncertain", name, numbers)
        found[name] = float(numbers[name]), _validate.positive(f"uncertain[{name!r}]", error)
    return found


def _require_one_set_of_units(
    system: System, x: np.ndarray, u: np.ndarray, units: Mapping[str, str]
) -> None:
    """Refuse rates that are another state, as a position's is a speed, in another unit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            A, B = jacobians(system, x, u)
        except ValueError:  # a kink: no derivative to look at
            return
    for j, row in enumerate(np.hstack([A, B])):
        (entries,) = np.nonzero(row)
        if len(entries) != 1 or entries[0] >= system.n or entries[0] == j:
            continue
        k = int(entries[0])
        mine, other = (parsed(units.get(system.states[i]) or "?") for i in (j, k))
        if mine is None or other is None:
            continue
        names, slope = (system.states[j], system.states[k]), float(row[k])
        pair = f"{names[0]} [{units[names[0]]}] and {names[1]} [{units[names[1]]}]"
        if slope == 1 and other[1] != _rate_of(mine[1]) and mine[1] != _rate_of(other[1]):
            raise ValueError(
                f"units are mixed up: f says that {names[0]}' is {names[1]}, and the units of"
                f' {pair} are not those of a quantity and its rate; "" is a unit not to look at'
            )
        expected = other[0] / mine[0]
        slipped = np.isclose(abs(slope) / expected, [r for s in _SLIPS for r in (s, 1 / s)]).any()
        if other[1] == _rate_of(mine[1]) and expected != slope and (slipped or abs(slope) == 1):
            raise ValueError(
                f"units are mixed up: with {pair}, {names[0]}' must be {expected:.6g} {names[1]},"
                f' and f says {slope:.6g} {names[1]}; "" is a unit not to look at'
            )


def _rate_of(dimension: tuple[int, ...]) -> tuple[int, ...]:
    return (*dimension[:2], dimension[2] - 1, *dimension[3:])
