"""Input delays: in linear systems by Pade, and how long a delay a loop bears."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from statebook import _validate
from statebook.linearization import jacobians, linearize
from statebook.policies import as_plan, at_start
from statebook.sampling import state_space
from statebook.simulation import simulate
from statebook.systems import as_system
from statebook.times import whole_samples

if TYPE_CHECKING:
    import control

_ASIDE = 0.05  # how far from the margin, relative to it, simulations confirm it
_LEAST, _MOST = 12, 200  # periods of such a simulation
_ON_CIRCLE = 1e-6  # how far from 1 the modulus of exp(-j omega delay) may be computed


def with_input_delay(sys: Any, delay: float, *, order: int = 5) -> control.StateSpace:
    """A linear system whose inputs arrive later, by Pade.

    exp(-s delay) is replaced by python-control's Pade approximant in each input; in discrete
    time, by whole samples of waiting, which is exact.

    Parameters
    ----------
    sys : control.StateSpace or any linear system of `as_system`
    delay : float >= 0 [s]
    order : int > 0
        Order of the approximant: good for omega * delay up to about the order. Up to 10, beyond
        which its coefficients lose their digits.

    Returns
    -------
    control.StateSpace
        Inputs and outputs of sys; its states first, then the delays'.

    Raises
    ------
    TypeError, ValueError
        If sys is not linear, the delay is negative or, in discrete time, no whole samples, or
        the order is not 1..10.

    References
    ----------
    Golub and Van Loan, *Matrix Computations*, section 9.3.1 (Pade approximants).

    Examples
    --------
    >>> import control
    >>> late = with_input_delay(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 0.5, order=2)
    >>> late.nstates, np.allclose(abs(late(2j)), abs(1 / (1 + 2j)))
    (3, True)
    """
    import control

    delay = _validate.non_negative("delay", delay)
    if _validate.integer("order", order, 1) > 10:
        raise ValueError(f"order must be at most 10, got {order}")
    sys = state_space(sys)
    if _validate.is_discrete(sys.dt):
        order = int(whole_samples("delay", delay, sys.dt, f", got {delay:g}"))
        wait = control.tf2ss([1.0], [1.0] + [0.0] * order, dt=sys.dt)
    else:
        wait = control.tf2ss(*control.pade(delay, order)) if delay else control.ss([], [], [], 1.0)
    late = sys * control.append(*[wait] * sys.ninputs)
    own_first = np.roll(np.arange(late.nstates), sys.nstates)
    names = [f"{label}, delayed [{i}]" for label in sys.input_labels for i in range(wait.nstates)]
    A, B, C = late.A[np.ix_(own_first, own_first)], late.B[own_first], late.C[:, own_first]
    labels: dict[str, Any] = {"states": [*sys.state_labels, *names], "inputs": sys.input_labels}
    labels |= {"outputs": sys.output_labels, "name": f"{sys.name} with input delay"}
    return control.ss(A, B, C, late.D, sys.dt, **labels)


@dataclass(frozen=True, eq=False)
class DelayMargin:
    """The longest input delay with which a loop is stable, and what it rests on.

    Parameters
    ----------
    delay : float [s]
        The margin; infinite if no delay makes the linear loop unstable.
    omega : float [rad/s]
        Frequency of the oscillation that begins there; NaN if none does.
    growth : tuple of float [1/s]
        Rates at which simulations of the linear loop grow with 5 % less and 5 % more delay.
    """

    delay: float
    omega: float
    growth: tuple[float, float]

    def __repr__(self) -> str:
        if np.isinf(self.delay):
            return "DelayMargin(any delay)"
        below, above = self.growth
        return (
            f"DelayMargin({self.delay:.6g} s, at {self.omega:.6g} rad/s; simulated growth "
            f"{below:.2g}/s with 5 % less, {above:+.2g}/s with 5 % more)"
        )


def delay_margin(
    system: Any, policy: Callable[[np.ndarray, float], Any], x0: Any, *, confirm: bool = True
) -> DelayMargin:
    """The longest input delay with which a feedback loop is stable.

    With x' = A x + B u and u = K x(t - delay) about the equilibrium, the smallest delay for
    which det(j omega I - A - B K exp(-j omega delay)) = 0 for some omega. The delays are found
    from an eigenvalue problem, without a search, and confirmed by simulation from both sides.

    Parameters
    ----------
    system : system
        Whatever `as_system` takes, in continuous time.
    policy : callable
        u(x, t), smooth at x0; all its inputs arrive equally late.
    x0 : array, shape (n,)
        The equilibrium that the loop without delay holds.
    confirm : bool
        Whether to simulate the linear loop with 5 % less and 5 % more delay.

    Returns
    -------
    DelayMargin

    Raises
    ------
    NotAnEquilibriumError
        If x0 does not stay where it is under the policy.
    TypeError, ValueError
        If the loop is not stable without a delay, the system is in discrete time, or the
        policy has no value at x0.
    RuntimeError
        If a simulation does not confirm the margin.

    References
    ----------
    Chen, Gu and Nett, Systems & Control Letters 26 (1995) 107-117.

    Examples
    --------
    For x' = -x(t - delay) it is pi / 2.

    >>> margin = delay_margin(lambda x, u: u, lambda x, t: -x, [0.0])
    >>> round(margin.delay, 6), margin.growth[0] < 0 < margin.growth[1]
    (1.570796, True)
    """
    x0 = _validate.real_array("x0", x0, (None,))
    if not callable(policy):
        raise TypeError(f"policy must be a function u(x, t), got {policy!r}")
    policy = as_plan("policy", policy)
    u0 = np.atleast_1d(at_start("policy(x0, 0)", policy, x0, 0.0))
    known = as_system(system, x0, u0, names=("x0", "policy"))
    if known.discrete:
        raise ValueError(f"system must be in continuous time, got dt = {known.dt}")
    sys = linearize(known, x0, u0)
    A, B = np.asarray(sys.A), np.asarray(sys.B)
    later, _ = jacobians(lambda x: B @ np.atleast_1d(policy(x, 0.0)), x0)
    rightmost = np.linalg.eigvals(A + later).real.max()
    if rightmost >= 0:
        raise ValueError(
            f"the loop must be stable without a delay, but an eigenvalue has real part "
            f"{rightmost:.3g}"
        )
    delay, omega = _first_crossing(A, later)
    if np.isinf(delay) or not confirm:
        return DelayMargin(delay, omega, (np.nan, np.nan))
    below, above = (
        _growth(A, later, delay * (1 + aside), delay, omega) for aside in (-_ASIDE, _ASIDE)
    )
    if not below < 0 < above:
        raise RuntimeError(
            f"simulations do not confirm the delay margin {delay:.6g} s: with 5 % less the loop "
            f"grows at {below:.2g}/s, with 5 % more at {above:.2g}/s"
        )
    return DelayMargin(delay, omega, (below, above))


def _first_crossing(A: np.ndarray, later: np.ndarray) -> tuple[float, float]:
    """The smallest delay with an imaginary eigenvalue, and its frequency.

    With z = exp(-j omega delay), A + later z has the eigenvalue j omega, and its conjugate
    A + later / z has -j omega: their Kronecker sum is singular.
    """
    n = len(A)
    size = np.linalg.norm(A) + np.linalg.norm(later)  # in units of its own
    eye, A1, A0 = np.eye(n), later / size, A / size
    low, middle, high = np.kron(eye, A1), np.kron(A0, eye) + np.kron(eye, A0), np.kron(A1, eye)
    zero, one = np.zeros_like(low), np.eye(n * n)
    z = scipy.linalg.eigvals(
        np.block([[zero, one], [-low, -middle]]), np.block([[one, zero], [zero, high]])
    )
    z = z[np.isfinite(z)]
    z = z[np.abs(np.abs(z) - 1) < _ON_CIRCLE]
    best = (np.inf, np.nan)
    for unit in z / np.abs(z):
        values = np.linalg.eigvals(A + later * unit)
        crossing = values[(np.abs(values.real) < 1e-5 * size) & (values.imag > 1e-9 * size)]
        for omega in crossing.imag:
            best = min(best, (float(-np.angle(unit) % (2 * np.pi) / omega), float(omega)))
    return best


def _growth(A: np.ndarray, later: np.ndarray, delay: float, margin: float, omega: float) -> float:
    """Rate at which the simulated linear loop grows, near its margin."""
    unit = np.exp(-1j * omega * margin)
    values, right = np.linalg.eig(A + later * unit)
    left = np.linalg.inv(right)
    k = int(np.argmin(np.abs(values - 1j * omega)))
    # How the eigenvalue moves with the delay tells how long to wait.
    share = left[k] @ later @ right[:, k] * unit
    rate = abs((-1j * omega * share / (1 + margin * share)).real * (delay - margin))
    period = 2 * np.pi / omega
    duration = period * np.clip(np.ceil(6 / (rate * period + 1e-9)), _LEAST, _MOST)
    options: dict[str, Any] = {"delay": delay, "max_step": delay, "rtol": 1e-6, "atol": 1e-12}
    options["times"] = np.linspace(0, duration, int(60 * duration / period))
    run = simulate(lambda x, u: A @ x + u, right[:, k].real, lambda x, t: later @ x, **options)
    early, late = (
        np.abs(run.states[:, (run.times >= at - period) & (run.times <= at)]).max()
        for at in (duration / 2, duration)
    )
    return float(np.log(late / early) / (duration / 2))
