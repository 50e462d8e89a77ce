"""Exact derivatives of f(x, u), and the linear system beside an equilibrium."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook.derivatives import InexactDerivativeWarning, differentiate
from statebook.errors import NotAnEquilibriumError
from statebook.rates import make_portable
from statebook.residuals import TOLERANCE, jacobian, labels_among, noise_of, point, scale_of
from statebook.systems import System, as_system, output_map, time_of

if TYPE_CHECKING:
    import control

_RANK = 1e-13  # of a slope that rounding makes, beside others
_BESIDE = 1e-12  # relative distance from x0 to the equilibrium that changes nothing


def jacobians(
    f: Any,
    x0: Any,
    u0: Any = None,
    *,
    t: float | None = None,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    scale: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate f(x, u) with respect to x and u.

    A = d f / d x, B = d f / d u, by complex step where f is analytic, which is checked.
    Elsewhere by adaptive differences, with a warning that gives the error.

    Parameters
    ----------
    f : system
        Whatever as_system takes.
    x0 : array, shape (n,) or (n, N)
        The point, any point: it need not be an equilibrium.
    u0 : array, shape (m,) or (m, N), optional
        Zeros if omitted.
    t : float, optional [s]
        The time, for a system that depends on it.
    states, inputs : sequence of str, optional
        Labels of the states and inputs to differentiate with respect to, in this order; all by
        default. One that is left out may have a kink at the point.
    scale : mapping of label to float > 0, optional
        Over which distance f varies with a state or input, in its unit; by default its own
        size, and 1 where it is 0. Other scales are found too, by more evaluations.

    Returns
    -------
    A : array, shape (n, n) or (N, n, n)
    B : array, shape (n, m) or (N, n, m)
        With fewer columns if `states` or `inputs` are given.

    Raises
    ------
    KinkError
        f has no derivative at the point.
    TypeError, ValueError
        x0, u0 or what f returns has the wrong type or shape, or is not finite; a label that the
        system does not have; t is missing.

    Warns
    -----
    InexactDerivativeWarning
        f is not analytic, or noise hides a derivative; the message gives the error.

    Examples
    --------
    >>> A, B = jacobians(lambda x, u: [x[1], u[0] - 3 * x[0]], [0, 0], [0])
    >>> A
    array([[ 0.,  1.],
           [-3.,  0.]])
    """
    system = as_system(f, x0, u0)
    x0, u0 = point(system, x0, u0)
    x, u = (a if a.ndim == 1 else a[:, 0] for a in (x0, u0))
    t = time_of(system, x, u, t)
    one_each = u0.ndim <= x0.ndim
    f0 = system.dynamics(x0, u0 if one_each else u, t)  # reports what is wrong with f
    columns, split = _columns(system, states, inputs)
    known = f0 if one_each else None
    found = jacobian(system, x0, u0, t, columns=columns, scale=scale, f0=known)
    warn_of_differences(system, found.error, found.inexact)
    A, B = found.J[..., :split], found.J[..., split:]
    return (A[0], B[0]) if x0.ndim == u0.ndim == 1 else (A, B)


def _columns(
    system: System, states: Sequence[str] | None, inputs: Sequence[str] | None
) -> tuple[list[int] | None, int]:
    """Return the numbers of the columns by label, None for all, and how many are states."""
    if states is None and inputs is None:
        return None, system.n
    chosen = system.states if states is None else labels_among("states", states, system.states)
    driven = system.inputs if inputs is None else labels_among("inputs", inputs, system.inputs)
    labels = (*system.states, *system.inputs)
    return [labels.index(label) for label in (*chosen, *driven)], len(chosen)


def warn_of_differences(system: System, error: np.ndarray, inexact: np.ndarray) -> None:
    """Warn the caller's caller where the complex step does not vouch for a derivative."""
    if inexact.any():
        warnings.warn(
            f"{system.name} is not analytic at the point, or noise hides a derivative: adaptive"
            f" differences were used, with an estimated error of {error[inexact].max():.1g}",
            InexactDerivativeWarning,
            stacklevel=3,
        )


def jacobian_at_rest(
    system: System,
    x0: np.ndarray,
    u0: np.ndarray,
    t: float = 0.0,
    *,
    columns: Sequence[int] | None = None,
    scale: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the Jacobian at an equilibrium, and how well it is known.

    Parameters
    ----------
    system : System
    x0, u0 : array, shape (n,) and (m,)
    t : float [s]
    columns : sequence of int, optional
        The c components of (x, u) to differentiate with respect to; all by default.
    scale : mapping of label to float > 0, optional

    Returns
    -------
    J, error, inexact : array, shape (n, c)
        The error is that of the derivative, and what J changes by between x0 and the exact
        equilibrium beside it; an entry below its error is 0. The last marks what the complex
        step does not vouch for.

    Raises
    ------
    NotAnEquilibriumError
        f(x0, u0) is not 0 (or not x0, in discrete time).
    """
    n, z = system.n, np.concatenate([x0, u0])
    kept = np.arange(z.size) if columns is None else np.asarray(columns, dtype=int)
    f0 = system.dynamics(x0, u0, t)
    rest = f0 - x0 if system.discrete else f0
    found = jacobian(system, x0, u0, t, columns=columns, scale=scale, f0=f0)
    J, error, inexact, flat = (part[0] for part in found)
    slope = J - np.eye(n, z.size)[:, kept] if system.discrete else J
    s = scale_of(system, z[:, None], scale)[:, 0]

    def residual(z: np.ndarray) -> np.ndarray:
        return system.probe(z[:n], z[n:], t) - (z[:n] if system.discrete else 0.0)

    states = kept[kept < n]
    size = s[states]
    scaled = slope[:, kept < n] * size
    terms = np.abs(slope) @ np.abs(z[kept])
    doubtful = flat.any() or error.any() or (np.abs(rest) > 1e-12 * terms).any()
    if not doubtful and _is_sound(scaled):
        return J, error, inexact
    noise = noise_of(residual, z, np.maximum(s, 1.0))
    allowed = TOLERANCE * terms + noise
    if (np.abs(rest) > allowed).any():
        worst = np.argmax(np.abs(rest) / np.maximum(allowed, 1e-300))
        reach = np.abs(residual(z[:, None] + np.diag(0.1 * s))[worst])
        size = max(float(terms[worst]), float(np.nanmax(reach, initial=0.0)))
        raise NotAnEquilibriumError(
            f"x0 is not an equilibrium: |f(x0, u0){' - x0' if system.discrete else ''}| ="
            f" {abs(rest[worst]):.3g} against a scale of {size:.3g}; call find_equilibrium first,"
            " or use jacobians for the affine model"
        )
    # The equilibrium is beside x0, by as much as the residual and its noise leave open.
    open_to = np.linalg.lstsq(scaled, np.stack([rest, noise / 8], axis=1), rcond=_RANK)[0].T
    for move in open_to * size:
        if (np.abs(move) > _BESIDE * size).any():
            other = x0.copy()
            other[states] -= move
            try:
                changed = jacobian(system, other, u0, t, columns=columns, scale=scale)[0][0] - J
            except ValueError:  # a kink beside the point
                continue
            error = np.maximum(error, np.abs(changed))
    return np.where(np.abs(J) <= error, 0.0, J), error, inexact


def _is_sound(J: np.ndarray) -> bool:
    """Whether all singular values of J, rows in units of their own, are far from rounding."""
    rows = np.abs(J).max(axis=1, initial=0.0)
    values = np.linalg.svd(J / np.where(rows > 0, rows, 1.0)[:, None], compute_uv=False)
    return not ((values > _RANK) & (values < 1e-6)).any()


def linearize(
    system: Any,
    x0: Any,
    u0: Any = None,
    *,
    t: float | None = None,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    scale: Mapping[str, float] | None = None,
) -> control.StateSpace:
    """Linearize a system at an equilibrium.

    d x' = A d x + B d u with the exact Jacobians of f at (x0, u0), and likewise for the
    outputs of a python-control system; those of others are their states.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x0 : array, shape (n,)
    u0 : array, shape (m,), optional
        Zeros if omitted.
    t : float, optional [s]
        The time, for a system that depends on it: the linear system holds near that time.
    states, inputs : sequence of str, optional
        Labels of the states and inputs to keep, in this order; all by default. The others are
        held at x0 and u0, where f may have a kink.
    scale : mapping of label to float > 0, optional
        Over which distance f varies with a state or input; see jacobians.

    Returns
    -------
    control.StateSpace
        With the labels and the timebase of the system, named after it. One without inputs
        gets an input "none" of no effect: python-control has no systems without inputs.

    Raises
    ------
    NotAnEquilibriumError
        f(x0, u0) is not 0 (or not x0, in discrete time).
    KinkError
        f has no derivative at the point.
    TypeError, ValueError
        x0 or u0 has the wrong type or shape, or is not finite; a label that the system does not
        have; t is missing.

    References
    ----------
    H. K. Khalil, Nonlinear Systems, 3rd ed., section 4.3.

    Examples
    --------
    >>> import statebook as sb
    >>> linearize(sb.Pendulum(g=9.8), [sb.pi / 2, 0]).A
    array([[0. , 1. ],
           [9.8, 0. ]])
    """
    system = as_system(system, x0, u0)
    x0, u0 = point(system, x0, u0, batch=False)
    t = time_of(system, x0, u0, t)
    columns, _ = _columns(system, states, inputs)
    J, error, inexact = jacobian_at_rest(system, x0, u0, t, columns=columns, scale=scale)
    warn_of_differences(system, error, inexact)
    return linear_system(system, x0, u0, t, J, columns)


def linear_system(
    system: System,
    x0: np.ndarray,
    u0: np.ndarray,
    t: float,
    J: np.ndarray,
    columns: list[int] | None = None,
) -> control.StateSpace:
    """Return the linear system of a Jacobian, with the outputs' derivatives and all labels."""
    import control

    make_portable(control.StateSpace)
    outputs, H = _outputs(system, x0, u0, t, columns)
    kept, split = [*system.states, *system.inputs], system.n
    if columns is not None:
        kept, split = [kept[j] for j in columns], sum(j < system.n for j in columns)
        J = J[columns[:split]]
    inputs, B, D = kept[split:], J[:, split:], H[:, split:]
    if not inputs:
        inputs, B, D = ["none"], np.zeros((split, 1)), np.zeros((len(outputs), 1))
    labels = {"states": kept[:split], "inputs": inputs, "outputs": outputs}
    name = f"{system.name}_linearized"
    # Of an unspecified timebase python-control takes some responses in discrete time.
    dt = 0 if system.dt is None else system.dt
    matrices = J[:, :split], B, H[:, :split], D, dt
    return control.StateSpace(*matrices, **labels, name=name, remove_useless_states=False)


def _outputs(
    system: System, x0: np.ndarray, u0: np.ndarray, t: float, columns: list[int] | None
) -> tuple[list[str], np.ndarray]:
    """Return the labels of the outputs and their derivatives with respect to (x, u)."""
    n, z = system.n, np.concatenate([x0, u0])
    kept = list(range(z.size)) if columns is None else columns
    labels, output = output_map(system)
    if output is None:
        states = [j for j in kept if j < n]
        return [system.states[j] for j in states], np.eye(z.size)[np.ix_(states, kept)]
    J, error, inexact, _ = differentiate(
        lambda z: output(z[:n], z[n:], t), z[:, None], kept, labels=(*system.states, *system.inputs)
    )
    warn_of_differences(system, error, inexact)
    return list(labels), J[0]
