"""Fixed-step integration of x' = f(x, t)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate
from statebook.errors import DivergenceError, outside_domain
from statebook.runge_kutta import SEMI_IMPLICIT_EULER, ButcherTableau, as_tableau
from statebook.trajectory import Trajectory

_NEWTON_ITERATIONS = 50
_NEWTON_TOLERANCE = 1e-12
_DIFFERENCE = np.finfo(float).eps ** 0.5

Function = Callable[[Any, float], Any]
Step = Callable[[Function, np.ndarray, float, float], np.ndarray]


def integrate_euler(
    f: Function, x0: Any, N: int, dt: float, t0: float = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate x' = f(x, t) by N steps of Euler's method.

    ``x_{k+1} = x_k + dt f(x_k, t_k)`` with ``t_k = t0 + k dt`` (a product: adding dt N times
    would drift).

    Parameters
    ----------
    f : callable
        f(x, t), the derivative at a state and a time, of the shape of x.
    x0 : array, shape (n,) or (n, N) or a number
        State at t0.
    N : int >= 0
        Number of steps. From a duration T take ``round(T / dt)``: ``int(T / dt)`` may lose one.
    dt : float > 0 [s]
        Step.
    t0 : float [s]
        Initial time.

    Returns
    -------
    ts : array, shape (N + 1,)
        Times.
    xs : array, shape (N + 1, n) or (N + 1, \\*x0.shape)
        States, one row for each time.

    Raises
    ------
    DivergenceError
        If a state overflows; it holds the states before.
    TypeError, ValueError
        If an argument, or what f returns, has the wrong type or shape or is not finite.

    References
    ----------
    Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, section I.7.

    Examples
    --------
    >>> ts, xs = integrate_euler(lambda x, t: -x, [1.0], 2, 0.5)
    >>> ts.tolist(), xs.tolist()
    ([0.0, 0.5, 1.0], [[1.0], [0.5], [0.25]])
    """
    return integrate(f, x0, N, dt, t0, method="euler")


def integrate(
    f: Function, x0: Any, N: int, dt: float, t0: float = 0, *, method: str | ButcherTableau = "rk4"
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate x' = f(x, t) by N equal steps of a method.

    Parameters
    ----------
    f : callable
        f(x, t), the derivative at a state and a time, of the shape of x.
    x0 : array, shape (n,) or (n, N) or a number
        State at t0, or a batch of them.
    N : int >= 0
        Number of steps.
    dt : float > 0 [s]
        Step.
    t0 : float [s]
        Initial time.
    method : str or ButcherTableau
        A name in `METHODS`, a tableau, or "semi_implicit_euler", which takes the first half of
        the state for positions q and the second for velocities v and moves the velocities
        first: ``v_next = v + dt f_v(q, v, t)``, then ``q_next = q + dt f_q(q, v_next, t)``.

    Returns
    -------
    ts : array, shape (N + 1,)
        Times ``t0 + k dt``.
    xs : array, shape (N + 1, n) or (N + 1, \\*x0.shape)
        States, one row for each time.

    Raises
    ------
    DivergenceError
        If a state overflows, or if the equations of an implicit step are not solved; its
        ``.trajectory`` holds the states before (None if they are complex).
    TypeError, ValueError
        If an argument, or what f returns, has the wrong type or shape or is not finite.

    References
    ----------
    Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, section II.1;
    Hairer, Lubich and Wanner, *Geometric Numerical Integration*, section I.1 (semi-implicit).

    Examples
    --------
    >>> ts, xs = integrate(lambda x, t: -x, [1.0], 10, 0.1)
    >>> round(xs[-1, 0] * np.exp(1), 5)
    np.float64(1.0)
    """
    x = np.asarray(_validate.array("x0", x0))
    N = _validate.integer("N", N, 0)
    dt = _validate.positive("dt", dt)
    t0 = _validate.number("t0", t0)
    step = step_of(method, x.shape)
    f = _checked(f, np.iscomplexobj(x))
    ts = t0 + dt * np.arange(N + 1)
    xs = np.empty((N + 1, *x.shape), dtype=x.dtype)
    xs[0] = x
    with np.errstate(all="ignore"):
        for k in range(N):
            try:
                xs[k + 1] = step(f, xs[k], ts[k], dt)
                reason = "" if np.isfinite(xs[k + 1]).all() else "the next state is not finite"
            except _NoSolution as failure:
                reason = str(failure)
            except Exception as error:
                if not outside_domain(error):
                    raise
                if k == 0:
                    raise ValueError(
                        f"f(x, t) has no value in the first step, from t = {t0:g}, "
                        f"x = {_validate.brief(x)}: {error}"
                    ) from error
                reason = f"f(x, t) failed ({error})"
            if not reason:
                continue
            if k == 0:  # a function that is not finite at the start is the caller's mistake
                _validate.array("f(x0, t0)", f(x, t0))
            states = np.atleast_2d(np.moveaxis(xs[: k + 1], 0, -1))
            raise DivergenceError(
                f"integration stopped at t = {ts[k]:.6g}, x = {_validate.brief(xs[k])}: {reason}; "
                f"{k} of {N} steps are in .trajectory",
                time=float(ts[k]),
                state=np.array(xs[k]),
                trajectory=None if np.iscomplexobj(xs) else Trajectory(ts[: k + 1], states),
            )
    return ts, xs


def step_of(method: str | ButcherTableau, shape: tuple[int, ...]) -> Step:
    """The function step(f, x, t, dt) -> x_next of a method, for states of a shape."""
    if method == SEMI_IMPLICIT_EULER:
        if not shape or shape[0] % 2:
            raise ValueError(
                f"{SEMI_IMPLICIT_EULER} needs as many positions as velocities, "
                f"got a state of shape {shape}"
            )
        return _semi_implicit_step
    tableau = as_tableau(method)
    A, b, c = (np.array(part, dtype=float) for part in (tableau.A, tableau.b, tableau.c))
    stages = _explicit_stages if tableau.explicit else _implicit_stages

    def step(f: Function, x: np.ndarray, t: float, dt: float) -> np.ndarray:
        return x + dt * _weighted(b, stages(f, x, t, dt, A, c))

    return step


class _NoSolution(ArithmeticError):
    """The equations of an implicit step were not solved."""


def _weighted(weights: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Sums of stages; the same as np.tensordot(weights, K, 1), in a third of the time."""
    sums = weights @ K.reshape(len(K), K[0].size)
    return sums.reshape(weights.shape[:-1] + K.shape[1:])


def _semi_implicit_step(f: Function, x: np.ndarray, t: float, dt: float) -> np.ndarray:
    half = len(x) // 2
    x_next = x.copy()
    x_next[half:] += dt * f(x, t)[half:]
    x_next[:half] += dt * f(x_next, t)[:half]
    return x_next


def _explicit_stages(
    f: Function, x: np.ndarray, t: float, dt: float, A: np.ndarray, c: np.ndarray
) -> np.ndarray:
    K = np.zeros((len(c), *x.shape), dtype=x.dtype)
    for i in range(len(c)):
        K[i] = f(x + dt * _weighted(A[i], K), t + c[i] * dt)
    return K


def _implicit_stages(
    f: Function, x: np.ndarray, t: float, dt: float, A: np.ndarray, c: np.ndarray
) -> np.ndarray:
    """Solve K_i = f(x + dt sum_j A_ij K_j, t + c_i dt) by Newton's method.

    Solving for K, not for the stages' states, keeps a stiff step accurate: the rounding
    error of f, large as its Jacobian J is large, is divided by I - dt A J.
    """
    times = t + c * dt
    K = np.stack([f(x, t)] * len(c))
    for _ in range(_NEWTON_ITERATIONS):
        Z = x + dt * _weighted(A, K)
        F = np.stack([f(z, time) for z, time in zip(Z, times, strict=True)])
        # The states may all be small, but a component near 0 among others is no small unit.
        least = min(1.0, _size(x, K, dt) or 1.0)
        J = np.stack([_jacobian(f, *args, least) for args in zip(Z, times, F, strict=True)])
        matrix = np.eye(K.size) - dt * np.einsum("ij,ikl->ikjl", A, J).reshape(K.size, -1)
        try:
            update = np.linalg.solve(matrix, (F - K).ravel()).reshape(K.shape)
        except np.linalg.LinAlgError:
            break
        K = K + update
        if dt * np.abs(update).max(initial=0) <= _NEWTON_TOLERANCE * _size(x, K, dt):
            return K
    raise _NoSolution("the equations of the implicit step were not solved; try a smaller dt")


def _size(x: np.ndarray, K: np.ndarray, dt: float) -> float:
    """Size of the states in a step."""
    return float(np.abs(x).max(initial=0) + dt * np.abs(K).max(initial=0))


def _jacobian(f: Function, x: np.ndarray, t: float, value: np.ndarray, least: float) -> np.ndarray:
    """Forward differences: Newton's method corrects their error in its next iteration.

    A component smaller than `least` is varied as if it had that size.
    """
    J = np.empty((x.size, x.size), dtype=x.dtype)
    for j, component in enumerate(np.ravel(x)):
        shifted = np.array(x)
        shifted.flat[j] += _DIFFERENCE * max(least, abs(component))
        J[:, j] = np.ravel(f(shifted, t) - value) / (shifted.flat[j] - component)
    return J


def _checked(f: Function, complex_state: bool) -> Function:
    """Wrap f so that its result is an array of numbers of the shape of x."""
    if not callable(f):
        raise TypeError(f"f must be a function f(x, t), got {f!r}")

    def checked(x: np.ndarray, t: float) -> np.ndarray:
        value = np.asarray(f(np.copy(x), float(t)))  # a copy: f may work in place
        if value.dtype.kind not in "biufc":
            raise TypeError(f"f(x, t) must return numbers, got {value!r} at t = {t:.6g}")
        if value.shape != x.shape:
            raise ValueError(
                f"f(x, t) must return the shape of x, {x.shape}, got {value.shape} at t = {t:.6g}"
            )
        if np.iscomplexobj(value) and not complex_state:
            raise TypeError("f(x, t) returned complex numbers for a real state: give a complex x0")
        return value

    return checked
