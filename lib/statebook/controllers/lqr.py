"""The linear-quadratic regulator, with references and integrals."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.angles import wrap_angle
from statebook.controllers import feedback
from statebook.linearization import linearize
from statebook.residuals import point
from statebook.systems import System, as_system
from statebook.verdict.stability import stability
from statebook.verdict.words import format_complex


def weight(name: str, value: Any, size: int, *, definite: bool = False) -> np.ndarray:
    """Return a weight (size, size) from a matrix, its diagonal, or one number for all."""
    matrix = feedback.matrix_of(name, 1.0 if value is None else value, (size, size))
    if definite:
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        if np.min(np.linalg.eigvalsh(matrix / scale[:, None] / scale)) <= 1e-14:
            raise ValueError(f"{name} must be positive definite, got {matrix.tolist()}")
    return _validate.semidefinite(name, matrix)


_NEAR = 1e-4  # of the boundary, relative to A: rounding blurs repeated eigenvalues by so much


def unmoved(A: np.ndarray, B: np.ndarray, discrete: bool) -> list[complex]:
    """Eigenvalues of A on the stability boundary or beyond that no B u moves.

    A Popov-Belevitch-Hautus test; on the boundary it asks the boundary point, which rounding
    does not blur.
    """
    values = np.linalg.eigvals(A)
    norm = np.linalg.norm(A)
    B = B * (norm / (np.linalg.norm(B) or 1.0) or 1.0)  # the units of the inputs do not matter
    norm = norm or np.linalg.norm(B)
    beyond = np.abs(values) - 1 if discrete else values.real
    edge = values / np.where(values == 0, 1, np.abs(values)) if discrete else 1j * values.imag
    corners = [1.0, -1.0] if discrete else [0.0]
    near = np.abs(beyond) <= _NEAR * norm
    candidates = [(z, 1e-12) for z in (*corners, *edge[near])]
    candidates += [(z, 1e-8) for z in values[~near & (beyond > 0)]]

    def least(z: complex) -> float:
        return np.linalg.svd(np.hstack([z * np.eye(len(A)) - A, B]), compute_uv=False)[-1]

    return [complex(z) for z, tolerance in candidates if least(z) <= tolerance * norm]


def gain_of(
    name: str, A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, dt: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return K and S of the regulator, or raise why there is none that stabilizes."""
    import control

    discrete = _validate.is_discrete(dt)
    lost = unmoved(A, B, discrete)
    if lost:
        mode = format_complex(lost[0], 1.0)
        raise ValueError(f"no gain stabilizes {name} at x0: no input moves its mode {mode}")
    unseen = unmoved(A.T, Q, discrete)
    solve = control.dlqr if discrete else control.lqr
    try:
        K, S, _ = map(np.asarray, solve(A, B, Q, R))
        report = stability(A - B @ K, dt=dt)
        stable, reason = report.verdict == "asymptotically stable", report.reason
    except (ValueError, np.linalg.LinAlgError, control.ControlArgument) as error:
        stable, reason = False, str(error)
    on_edge = [z for z in unseen if abs(abs(z) - 1 if discrete else z.real) == 0]
    if on_edge or (not stable and unseen):
        mode = format_complex((on_edge or unseen)[0], 1.0)
        raise ValueError(
            f"Q must see what does not decay by itself, or the gain leaves it alone: it does not"
            f" see the mode {mode} of {name}"
        )
    if not stable:
        raise ValueError(f"no gain stabilizes {name} at x0: {reason}")
    return K, S


@dataclass(frozen=True, eq=False)
class LQR:
    """Linear-quadratic regulator at an equilibrium.

    u = u0 - K (x - x0), clipped to the limit, with the K that minimizes the integral (in
    discrete time the sum) of dx' Q dx + du' R du among those that stabilize.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x0, u0 : array, shape (n,) and (m,)
        The equilibrium; u0 None is zeros.
    Q, R : number, or array of shape (n,) or (n, n), and (m,) or (m, m)
        Symmetric weights, or their diagonals, or one number for all; 1 if omitted. Q is
        positive semidefinite and sees every mode that does not decay, R positive definite.
    limit : float > 0, optional
        Largest magnitude of each input; more than what holds the equilibrium.
    circle : sequence of str
        Labels of states that are angles: their error is the short way round.
    tracked : sequence of str, or array C of shape (p, n), optional
        Labels of states, or the combinations C x, that follow the reference.
    reference : number, array (p,) or function of time, optional
        r of C x; C x0 if omitted. The law then acts about x0 + Nx dr, u0 + Nu dr, which hold
        dr = r - C x0 in the linearized system.
    integral : number, or array of shape (p,) or (p, p), optional
        Weight of the integrals of C x - r, which remove what disturbances and the nonlinear
        remainder leave. Their memory z with z' = C x - r (in discrete time z_next = z + C x - r)
        is a state: the law takes (x, z), and loop is what to simulate.

    Attributes
    ----------
    K : array, shape (m, n), or (m, n + p) with integrals
    S : array, shape (n, n), or (n + p, n + p)
        The cost to go is dx' S dx.
    wrapped : list of int
        Indices of the states in circle.
    level : float
        Below this cost to go no input reaches its limit; inf without a limit.
    loop : System
        The closed loop, with the states x, or (x, z); its inputs are disturbances that add to
        the control. While an input is at its limit, no integral grows further into it.

    Raises
    ------
    NotAnEquilibriumError
        As linearize.
    TypeError, ValueError
        No gain stabilizes, a weight is indefinite or does not see a mode, no state holds the
        reference, or an argument has the wrong type or shape.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., sections 7.4 and 7.5.

    Examples
    --------
    >>> import statebook as sb
    >>> LQR(sb.Particle(), [0, 0], Q=[1.0, 0.0], R=1.0).K.round(6)
    array([[1.      , 1.414214]])
    >>> servo = LQR(sb.Particle(), [0, 0], tracked=["p"], reference=2.0, integral=1.0)
    >>> run = sb.simulate(servo.loop, [0, 0, 0], [0.5], duration=30.0)  # a push of 0.5 N
    >>> run.states[0, -1].round(6)
    np.float64(2.0)
    """

    system: Any
    x0: Any
    u0: Any = None
    Q: Any = None
    R: Any = None
    limit: float | None = None
    circle: Sequence[str] = ()
    tracked: Any = field(default=None, kw_only=True)
    reference: Any = field(default=None, kw_only=True)
    integral: Any = field(default=None, kw_only=True)
    K: np.ndarray = field(init=False)
    S: np.ndarray = field(init=False, repr=False)
    wrapped: list[int] = field(init=False, repr=False)
    C: np.ndarray = field(init=False, repr=False)
    feedforward: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system = as_system(self.system, self.x0, self.u0)
        n, m = system.n, system.m
        if not m:
            raise ValueError(f"system must have inputs, got {system.name} without")
        x0, u0 = point(system, self.x0, self.u0, batch=False)
        limit = feedback.limit_of(self.limit, u0, "x0")
        circle = np.flatnonzero(feedback.rows_of("circle", self.circle, system.states).any(axis=0))
        Q, R = weight("Q", self.Q, n), weight("R", self.R, m, definite=True)
        if self.tracked is None and not (self.reference is None and self.integral is None):
            raise ValueError("tracked is required with reference or integral: label what follows")
        tracked = () if self.tracked is None else self.tracked
        C = feedback.rows_of("tracked", tracked, system.states)
        feedback.require_timeless(system, x0, u0)
        sys = linearize(system, x0, u0)
        A, B = np.asarray(sys.A), np.asarray(sys.B)
        feedforward = np.zeros((n + m, len(C)))
        if self.reference is not None:
            feedforward = self._feedforward(A - system.discrete * np.eye(n), B, C)
        if self.integral is not None:
            p = len(C)
            memory = np.eye(p) if system.discrete else np.zeros((p, p))
            A = np.block([[A, np.zeros((n, p))], [C, memory]])
            B = np.concatenate([B, np.zeros((p, m))])
            Q = scipy.linalg.block_diag(Q, weight("integral", self.integral, p))
        K, S = gain_of(system.name, A, B, Q, R, system.dt)
        vars(self).update(x0=x0, u0=u0, limit=limit, K=K, S=S, wrapped=circle.tolist())
        vars(self).update(C=C, feedforward=feedforward)
        self.target(0.0)  # reports what is wrong with the reference

    def _feedforward(self, A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Return (Nx, Nu) with A Nx + B Nu = 0 and C Nx = I."""
        n, p = len(A), len(C)
        M = np.block([[A, B], [C, np.zeros((p, B.shape[1]))]])
        wanted = np.concatenate([np.zeros((n, p)), np.eye(p)])
        N = np.linalg.lstsq(M, wanted, rcond=None)[0]
        if np.abs(M @ N - wanted).max() > 1e-8:
            raise ValueError("reference cannot be held: no state and input at rest give all C x")
        return N

    def target(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the state and the input about which the law acts at a time, (n,) and (m,)."""
        n = len(self.x0)
        if self.reference is None:
            return self.x0, self.u0
        r = self.reference(t) if callable(self.reference) else self.reference
        r = _validate.real_array("reference", r)
        if r.shape not in ((), (len(self.C),)):
            raise ValueError(f"reference must have shape ({len(self.C)},), got {r.shape}")
        shift = self.feedforward @ (r - self.C @ self.x0)
        return self.x0 + shift[:n], self.u0 + shift[n:]

    def error(self, x: Any, t: float = 0.0) -> np.ndarray:
        """Return x less its target, angles the short way round; z follows as it is.

        Parameters
        ----------
        x : array, shape (n,) or (n, N); with integrals (n + p,) or (n + p, N)
        t : float [s]
            Time, for a reference that depends on it.

        Returns
        -------
        array, shape of x
        """
        x = feedback.state_of(x, self.K.shape[1])
        target = np.zeros(len(x))
        target[: len(self.x0)] = self.target(t)[0]
        error = x - feedback.columns(target, x)
        if self.wrapped:
            error[self.wrapped] = wrap_angle(error[self.wrapped])
        return error

    def cost_to_go(self, x: Any, t: float = 0.0) -> np.ndarray:
        """Return dx' S dx, shape () or (N,)."""
        error = self.error(x, t)
        return np.einsum("i...,ij,j...->...", error, self.S, error)

    @cached_property
    def level(self) -> float:
        """The cost to go below which no input reaches its limit."""
        if self.limit is None:
            return np.inf
        if callable(self.reference):
            raise ValueError("level is that of one target, and the reference moves")
        margin = self.limit - np.abs(self.target(0.0)[1])
        # By the pseudo-inverse, as S is singular where Q does not see a mode that decays.
        spans = np.einsum("ij,jk,ik->i", self.K, np.linalg.pinv(self.S, hermitian=True), self.K)
        sizes = np.where(spans > 0, margin**2 / np.where(spans > 0, spans, 1.0), np.inf)
        return float(np.where(margin > 0, sizes, 0.0).min())

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (m,) or (m, N); with integrals u((x, z), t)."""
        error = self.error(x, t)
        u0 = feedback.columns(self.target(t)[1], error)
        return feedback.saturate(u0 - self.K @ error, self.limit)

    @property
    def loop(self) -> System:
        """The closed loop with its integrals; its inputs are disturbances."""
        system = as_system(self.system, self.x0, self.u0)
        p = self.K.shape[1] - system.n
        loop = feedback.closed_loop(system, partial(self._closed, system), {"z": p}, "LQR")
        linear = system.linear and self.limit is None and not self.wrapped
        return replace(loop, linear=linear, timed=system.timed or callable(self.reference))

    def _closed(self, system: System, y: np.ndarray, d: np.ndarray, t: float) -> np.ndarray:
        n, u = system.n, self(y, t)
        motion = np.asarray(system.rate(y[:n], u + d, t))
        if self.integral is None:
            return motion
        # C x - r, as C Nx = I: the way round a circle included.
        error = self.C @ self.error(y, t)[:n]
        z = feedback.unwound(error, u, self.K[:, n:], self.limit)
        return np.concatenate([motion, y[n:] + z if system.discrete else z])
