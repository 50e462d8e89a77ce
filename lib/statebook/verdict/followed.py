"""A model along its parameters: its equilibrium and eigenvalues at each of their values."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from statebook import _validate
from statebook.equilibrium import find_equilibrium
from statebook.linearization import warn_of_differences
from statebook.residuals import jacobian
from statebook.systems import System, as_system, time_of
from statebook.variants import parameters_of, variant
from statebook.verdict.judgement import judge
from statebook.verdict.linear_part import precision_of

_TRIM = tuple(inspect.signature(find_equilibrium).parameters)[3:-1]  # all but guesses and time


@dataclass(frozen=True)
class Sample:
    """An equilibrium (x, u), with its eigenvalues, at one value of a parameter."""

    p: float
    x: np.ndarray | None
    u: np.ndarray | None
    eigenvalues: np.ndarray
    discrete: bool
    dt: float | bool | None


class Followed:
    """A model whose equilibrium and eigenvalues are asked for at values of its parameters.

    Parameters
    ----------
    model : system, or factory of systems or matrices
        See `eigenvalue_locus`; so for the others.
    names : sequence of str
    x0, u0, dt, t, trim
    """

    def __init__(
        self,
        model: Any,
        names: tuple[str, ...],
        x0: Any,
        u0: Any,
        dt: float | bool | None,
        t: float | None,
        trim: Mapping[str, Any] | None,
    ) -> None:
        known = () if isinstance(model, System) else parameters_of(model)
        self.own = [name for name in names if known is None or name in known]
        self.labels = [name for name in names if name not in self.own]
        if self.labels:
            try:
                view = as_system(model, x0, u0, dt=dt)
                options = (*(known or ()), *view.states, *view.inputs)
            except (TypeError, ValueError):  # a factory
                options = known or ()
            for name in self.labels:
                _validate.choice("the parameter", name, options)
        self.model, self.x0, self.u0, self.dt, self.t = model, x0, u0, dt, t
        self.worst: tuple[Any, np.ndarray, np.ndarray] = None, np.zeros(0), np.zeros(0, dtype=bool)
        self.trim = dict(trim or {})
        for name in self.trim:
            _validate.choice("a key of trim", name, _TRIM)

    def at(self, values: Mapping[str, float], beside: Sample | None = None) -> Sample:
        """Return the sample at values of the parameters, its equilibrium near another one."""
        model = variant(self.model, {n: values[n] for n in self.own}) if self.own else self.model
        p = next(iter(values.values()))
        if isinstance(model, np.ndarray | list | tuple):
            A = _validate.square("the matrix", _validate.real_array("the matrix", model))
            discrete = _validate.is_discrete(self.dt)
            eigenvalues = judge(A, discrete, check_distance=False).eigenvalues
            return Sample(p, None, None, eigenvalues, discrete, self.dt)
        x, u = (self.x0, self.u0) if beside is None else (beside.x, beside.u)
        system = as_system(model, x, u, dt=self.dt)
        x = np.zeros(system.n) if x is None and system.linear else x
        if x is None:
            raise ValueError("x0 is required: the equilibrium at the first value, or a guess of it")
        x = _validate.real_array("x0", x, (system.n,)).copy()
        u = np.zeros(system.m) if u is None else _validate.real_array("u0", u, (system.m,)).copy()
        trim = self.trim
        for label in self.labels:
            where = x if label in system.states else u
            where[(system.states if where is x else system.inputs).index(label)] = values[label]
            trim = {**trim, "fixed": [*dict.fromkeys([*trim.get("fixed", system.inputs), label])]}
        t = time_of(system, x, u, self.t)
        rest = system.dynamics(x, u, t) - (x if system.discrete else 0.0)
        if trim.keys() & {"derivative", "outputs"} or np.any(rest):
            found = find_equilibrium(system, x, u, t=t, **trim)
            x, u = found.x, found.u
        (J,), (error,), (inexact,), _ = jacobian(system, x, u, t)
        if error[inexact].max(initial=0.0) > self.worst[1][self.worst[2]].max(initial=-1.0):
            self.worst = system, error, inexact
        A = J[:, : system.n]
        precision = precision_of(A, error[:, : system.n])
        judged = judge(A, system.discrete, precision=precision, check_distance=False)
        return Sample(p, x, u, judged.eigenvalues, system.discrete, system.dt)

    def warn(self) -> None:
        """Warn once, of the worst of the derivatives that are differences."""
        warn_of_differences(*self.worst)
