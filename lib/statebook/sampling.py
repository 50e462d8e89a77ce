"""From continuous to discrete time: systems, matrices and eigenvalues."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from statebook import _validate
from statebook.linearization import linearize
from statebook.systems import as_system

if TYPE_CHECKING:
    import control

DISCRETIZATIONS = ("zoh", "foh", "euler", "backward_euler", "tustin")
_ALSO = {"forward_diff": "euler", "backward_diff": "backward_euler", "bilinear": "tustin"}


def discretize(
    sys: Any, dt: float, method: str = "zoh", *, prewarp: float | None = None
) -> control.StateSpace:
    """Discretize a linear system.

    Parameters
    ----------
    sys : control.StateSpace or any linear system of `as_system`
        Continuous-time system x' = A x + B u, y = C x + D u.
    dt : float > 0 [s]
        Sample time.
    method : {"zoh", "foh", "euler", "backward_euler", "tustin"}
        "zoh" is exact for inputs held between samples, "foh" for inputs linear between them;
        see `discretize_many` for the formulas. python-control's names "forward_diff",
        "backward_diff" and "bilinear" are accepted too.
    prewarp : float > 0 [rad/s], optional
        With "tustin": the frequency (below pi/dt) at which the frequency response is kept.

    Returns
    -------
    control.StateSpace
        With timebase dt and the labels and name of sys.

    Raises
    ------
    TypeError, ValueError
        If sys is not linear or not in continuous time, dt is not positive or so long that
        exp(dt A) overflows, the method is unknown, I - dt A (or I - dt/2 A) is singular, or
        prewarp does not fit.

    Notes
    -----
    "foh", "backward_euler" and "tustin" change C and D too, as their state is not x(t_k) itself:
    see `discretize_many`.

    References
    ----------
    Franklin, Powell and Workman, *Digital Control of Dynamic Systems*, sections 4.3 and 6.1-6.3.

    Examples
    --------
    >>> import control
    >>> sys = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> discretize(sys, 0.5, "euler").A
    array([[0.5]])
    """
    import control

    dt = _validate.positive("dt", dt)
    method = _method(method)
    if prewarp is not None:
        prewarp = _validate.positive("prewarp", prewarp)
        if method != "tustin":
            raise ValueError(f'prewarp belongs to method "tustin", got method {method!r}')
        if prewarp * dt >= np.pi:
            raise ValueError(
                f"prewarp must be below pi/dt = {np.pi / dt:.4g} rad/s, got {prewarp:.4g}"
            )
    sys = state_space(sys)
    if _validate.is_discrete(sys.dt):
        raise ValueError(f"sys must be in continuous time, got one with dt = {sys.dt}")
    scipys_name = "backward_diff" if method == "backward_euler" else method
    try:
        with np.errstate(all="ignore"):
            result = control.sample_system(
                sys, dt, scipys_name, prewarp_frequency=prewarp, name=sys.name
            )
    except np.linalg.LinAlgError as error:
        raise _no_step(method, dt) from error
    _require_finite(np.asarray(result.A))
    return result


def discretize_many(
    A: Any, B: Any, dt: float, method: str = "zoh"
) -> tuple[np.ndarray, np.ndarray]:
    """Discretize a stack of pairs (A, B).

    With h = dt, ``z_{k+1} = Ad z_k + Bd u_k``:

    - "zoh": Ad = exp(h A), Bd = (integral of exp(s A) over 0..h) B; z = x.
    - "foh": the exact response to inputs that are linear between samples; z = x - G u, with G
      the response at h to a ramp that rises to 1 in h: B's share of u_{k+1} in x_{k+1}.
    - "euler": Ad = I + h A, Bd = h B; z = x.
    - "backward_euler": Ad = (I - h A)^-1, Bd = Ad h B; z = (I - h A) x - h B u.
    - "tustin" (trapezoidal): Ad = (I - h A/2)^-1 (I + h A/2), Bd = (I - h A/2)^-1 h B;
      z = (I - h A/2) x - h B u / 2.

    Parameters
    ----------
    A : array, shape (N, n, n) or (n, n)
        Continuous-time matrices; singular ones are no exception.
    B : array, shape (N, n, m) or (n, m)
    dt : float > 0 [s]
        Sample time.
    method : {"zoh", "foh", "euler", "backward_euler", "tustin"}

    Returns
    -------
    Ad : array, shape of A
    Bd : array, shape of B

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, an entry is not finite, dt is not positive, the method is unknown,
        or I - dt A (or I - dt/2 A) is singular.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395 (integrals from one exponential).

    Examples
    --------
    >>> Ad, Bd = discretize_many([[[0.0, 1.0], [0.0, 0.0]]], [[[0.0], [1.0]]], 0.5)
    >>> Ad[0].tolist(), Bd[0].tolist()
    ([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]])
    """
    A, B = _validate.array("A", A), _validate.array("B", B)
    if A.ndim not in (2, 3) or A.shape[-1] != A.shape[-2]:
        raise ValueError(f"A must have shape (N, n, n) or (n, n), got {A.shape}")
    if B.ndim != A.ndim or B.shape[:-1] != A.shape[:-1]:
        raise ValueError(
            f"B must have shape ({', '.join(map(str, A.shape[:-1]))}, m), got {B.shape}"
        )
    return one_step(A, B, _validate.positive("dt", dt), _method(method))


def map_eigenvalues(s: Any, dt: float, method: str = "zoh") -> np.ndarray:
    """Where a discretization sends eigenvalues.

    exp(s dt) for "zoh" and "foh", 1 + s dt for "euler", 1 / (1 - s dt) for "backward_euler" and
    (1 + s dt/2) / (1 - s dt/2) for "tustin".

    Parameters
    ----------
    s : array of complex [1/s]
        Continuous-time eigenvalues.
    dt : float > 0 [s]
        Sample time.
    method : {"zoh", "foh", "euler", "backward_euler", "tustin"}

    Returns
    -------
    array of complex, shape of s
        Eigenvalues of the map; infinite at a pole.

    Raises
    ------
    TypeError, ValueError
        If s is not finite, dt is not positive or the method is unknown.

    Examples
    --------
    >>> map_eigenvalues([-2.0, 2j], 1.0, "tustin").round(3).tolist()
    [0j, 1j]
    """
    z = _validate.array("s", s).astype(complex) * _validate.positive("dt", dt)
    method = _method(method)
    if method in ("zoh", "foh"):
        return np.exp(z)
    if method == "euler":
        return 1 + z
    above, below = (1 + 0 * z, 1 - z) if method == "backward_euler" else (1 + z / 2, 1 - z / 2)
    return np.divide(above, below, out=np.full_like(z, np.inf), where=below != 0)


def one_step(A: np.ndarray, B: np.ndarray, h: Any, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return Ad and Bd of pairs, or stacks of them: ``z_{k+1} = Ad z_k + Bd u_k``."""
    n, m = B.shape[-2:]
    identity = np.broadcast_to(np.eye(n), A.shape)
    if method == "euler":
        return identity + h * A, h * B
    if method in ("zoh", "foh"):
        # exp of [[A, B], [0, 0]] h: no inverse of A. The ramp's response from two integrators
        # in a row, in units of the sample time.
        size = n + (m if method == "zoh" else 2 * m)
        block = np.zeros((*A.shape[:-2], size, size), dtype=np.result_type(A, B))
        block[..., :n, :n], block[..., :n, n : n + m] = h * A, h * B
        block[..., n : size - m, n + m :] = np.eye(size - n - m)
        with np.errstate(all="ignore"):
            E = np.asarray(scipy.linalg.expm(block))
        _require_finite(E)
        Ad, held, ramp = E[..., :n, :n], E[..., :n, n : n + m], E[..., :n, n + m :]
        return Ad, held if method == "zoh" else held - ramp + Ad @ ramp
    weight = h if method == "backward_euler" else h / 2
    try:
        S = np.linalg.inv(identity - weight * A)
    except np.linalg.LinAlgError as error:
        raise _no_step(method, h) from error
    Ad = S if method == "backward_euler" else S @ (identity + weight * A)
    return Ad, S @ (h * B)


def _method(name: str) -> str:
    return _validate.choice("method", _ALSO.get(name, name), DISCRETIZATIONS)


def _no_step(method: str, h: float) -> ValueError:
    pole = 1 / h if method == "backward_euler" else 2 / h
    return ValueError(f'"{method}" has no step here: {pole:.6g} is an eigenvalue of A; change dt')


def _require_finite(E: np.ndarray) -> None:
    if not np.isfinite(E).all():
        raise ValueError("dt must be shorter: exp(A dt) exceeds the largest floating-point number")


def state_space(sys: Any) -> control.StateSpace:
    """Return a system that declares itself linear in python-control's form."""
    import control

    plain = callable(sys) and not (hasattr(sys, "dynamics") or hasattr(sys, "ninputs"))
    if plain or not (system := as_system(sys)).linear:
        raise ValueError("sys must be linear; call linearize(sys, x0, u0) first")
    if isinstance(sys, control.StateSpace):
        return sys
    result = linearize(system, np.zeros(system.n))
    result.name = system.name
    return result
