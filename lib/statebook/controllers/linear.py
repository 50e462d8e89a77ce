"""Linear feedback: PD, PID and LQR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from statebook import _validate
from statebook.angles import wrap_angle
from statebook.equilibrium import find_equilibrium
from statebook.linearization import linearize
from statebook.systems import System, as_system
from statebook.verdict.stability import stability


def saturate(u: np.ndarray, limit: float | None) -> np.ndarray:
    """Clip a control to plus and minus a limit, if there is one."""
    return u if limit is None else np.clip(u, -limit, limit)


def columns(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return a vector so that it broadcasts against a state or a batch of states."""
    return values if like.ndim == 1 else values[:, None]


@dataclass(frozen=True)
class LQR:
    """Linear-quadratic regulator at an equilibrium.

    u = u0 - K (x - x0), clipped to the limit, with the K that minimizes the integral (in
    discrete time the sum) of dx' Q dx + du' R du.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x0, u0 : array, shape (n,) and (m,)
        The equilibrium; u0 None is zeros.
    Q, R : array, shape (n, n) and (m, m)
        Symmetric weights, Q positive semidefinite, R positive definite.
    limit : float > 0, optional
        Largest magnitude of each input.
    circle : sequence of str
        Labels of states that are angles: their error is the short way round.

    Attributes
    ----------
    K : array, shape (m, n)
    S : array, shape (n, n)
        The cost to go is dx' S dx.
    wrapped : list of int
        Indices of the states in circle.
    level : float
        Below this cost to go no input reaches its limit; inf without a limit.

    Raises
    ------
    NotAnEquilibriumError
        As linearize.
    TypeError, ValueError
        No gain stabilizes, or an argument has the wrong type or shape.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., section 7.5.

    Examples
    --------
    >>> import statebook as sb
    >>> LQR(sb.Particle(), [0, 0], Q=np.diag([1.0, 0.0]), R=[[1.0]]).K.round(6)
    array([[1.      , 1.414214]])
    """

    system: Any
    x0: Any
    u0: Any = None
    Q: Any = None
    R: Any = None
    limit: float | None = None
    circle: Sequence[str] = ()
    K: np.ndarray = field(init=False)
    S: np.ndarray = field(init=False, repr=False)
    wrapped: list[int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import control

        system = as_system(self.system, self.x0, self.u0)
        n, m = system.n, system.m
        limit = None if self.limit is None else _validate.positive("limit", self.limit)
        weights = [
            np.eye(size) if weight is None else _validate.real_array(name, weight, (size, size))
            for name, weight, size in (("Q", self.Q, n), ("R", self.R, m))
        ]
        absent = [label for label in self.circle if label not in system.states]
        if absent:
            raise ValueError(f"circle must hold labels among {system.states}, got {absent[0]!r}")
        sys = linearize(system, self.x0, self.u0)
        solve = control.dlqr if system.discrete else control.lqr
        try:
            K, S, _ = solve(sys, *weights)
        except (ValueError, np.linalg.LinAlgError, control.ControlArgument) as error:
            raise ValueError(f"no gain stabilizes {system.name} at x0: {error}") from error
        u0 = np.zeros(m) if self.u0 is None else _validate.real_array("u0", self.u0, (m,))
        for name, value in {
            "x0": _validate.real_array("x0", self.x0, (n,)),
            "u0": u0,
            "limit": limit,
            "K": np.asarray(K),
            "S": np.asarray(S),
            "wrapped": [system.states.index(label) for label in self.circle],
        }.items():
            object.__setattr__(self, name, value)

    def error(self, x: Any) -> np.ndarray:
        """Return x - x0 with angles the short way round, shape (n,) or (n, N)."""
        x = np.asarray(x)
        error = x - columns(self.x0, x)
        error[self.wrapped] = wrap_angle(error[self.wrapped])
        return error

    def cost_to_go(self, x: Any) -> np.ndarray:
        """Return dx' S dx, shape () or (N,)."""
        error = self.error(x)
        return np.einsum("i...,ij,j...->...", error, self.S, error)

    @property
    def level(self) -> float:
        """The cost to go below which no input reaches its limit."""
        if self.limit is None:
            return np.inf
        spans = np.einsum("ij,jk,ik->i", self.K, np.linalg.inv(self.S), self.K)
        return float(((self.limit - np.abs(self.u0)) ** 2 / spans).min())

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (m,) or (m, N)."""
        error = self.error(x)
        return saturate(columns(self.u0, error) - self.K @ error, self.limit)


def _holding_control(system: System, target: Any, limit: float | None) -> np.ndarray:
    """Return the control that keeps a system at rest at a target of its positions."""
    if not system.m or system.n != 2 * system.m:
        raise ValueError(
            f"the system must have positions, as many velocities and as many inputs,"
            f" got {system.n} states and {system.m} inputs; use LQR"
        )
    target = _validate.real_array("target", target, (system.m,))
    at_rest = np.concatenate([target, np.zeros(system.m)])
    u = find_equilibrium(system, at_rest, fixed=system.states).u
    if limit is not None and np.abs(u).max() > limit:
        raise ValueError(
            f"limit must be at least {np.abs(u).max():.4g} to hold the target, got {limit:g}"
        )
    return u


def _require_stable(loop: System, x0: np.ndarray, gains: str) -> None:
    report = stability(loop, x0)
    if report.verdict != "asymptotically stable":
        raise ValueError(f"{gains} do not stabilize the target: {report.reason}")


@dataclass(frozen=True)
class PD:
    """Proportional-derivative control of positions towards a target.

    u = u0 - kp (q - target) - kd v, clipped to the limit, where u0 holds the target.

    Parameters
    ----------
    system : system
        With states (q, v) and one input a position: Particle, Oscillator, Pendulum, PlanarArm.
    target : array, shape (m,)
        Positions to hold.
    kp, kd : float
        Gains. Those that do not make the target asymptotically stable are refused.
    limit : float > 0, optional
        Largest magnitude of each input.

    Raises
    ------
    TypeError, ValueError
        The system has another form, the gains destabilize, the limit cannot hold the target.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., chapter 11.

    Examples
    --------
    >>> import statebook as sb
    >>> PD(sb.Pendulum(), target=[0.0], kp=20.0, kd=3.0)([0.1, 0.0], 0.0).round(6)
    array([7.8])
    """

    system: Any
    target: Any
    kp: float
    kd: float
    limit: float | None = None
    u0: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        system = as_system(self.system)
        limit = None if self.limit is None else _validate.positive("limit", self.limit)
        kp, kd = _validate.number("kp", self.kp), _validate.number("kd", self.kd)
        object.__setattr__(self, "u0", _holding_control(system, self.target, limit))
        object.__setattr__(self, "target", _validate.real_array("target", self.target))
        at_rest = np.concatenate([self.target, np.zeros(system.m)])
        loop = as_system(lambda x: system.dynamics(x, self._unlimited(x)), at_rest)
        loop = replace(loop, linear=system.linear)
        _require_stable(loop, at_rest, f"the gains kp = {kp:g}, kd = {kd:g}")

    def _unlimited(self, x: np.ndarray) -> np.ndarray:
        q, v = np.split(x, 2)
        return columns(self.u0, x) - self.kp * (q - columns(self.target, x)) - self.kd * v

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (m,) or (m, N)."""
        return saturate(self._unlimited(np.asarray(x)), self.limit)


@dataclass(frozen=True)
class PID:
    """Proportional-integral-derivative control, its memory a state.

    u = u0 - kp (q - target) - ki z - kd v with z' = q - target, clipped to the limit. The
    law needs z, so it does not fit u(x, t): loop is the closed system with the state (x, z).
    While an input is at its limit, its z does not grow further into it (anti-windup).

    Parameters
    ----------
    system, target, kp, kd, limit
        As PD.
    ki : float
        Integral gain.

    Attributes
    ----------
    loop : System
        States (q, v, z); its inputs are disturbances that add to the control.

    Raises
    ------
    TypeError, ValueError
        As PD.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., section 11.4 (windup).

    Examples
    --------
    >>> import statebook as sb
    >>> pid = PID(sb.Particle(m=2.0), target=[1.0], kp=6.0, ki=2.0, kd=5.0)
    >>> rest = sb.find_equilibrium(pid.loop, [0, 0, 0], [0.5])  # z carries the disturbance
    >>> rest.x.round(6) + 0.0
    array([1.  , 0.  , 0.25])
    """

    system: Any
    target: Any
    kp: float
    ki: float
    kd: float
    limit: float | None = None
    u0: np.ndarray = field(init=False)
    loop: System = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system = as_system(self.system)
        limit = None if self.limit is None else _validate.positive("limit", self.limit)
        gains = [_validate.number(name, getattr(self, name)) for name in ("kp", "ki", "kd")]
        object.__setattr__(self, "u0", _holding_control(system, self.target, limit))
        object.__setattr__(self, "target", _validate.real_array("target", self.target))
        loop = System(
            rate=lambda y, d, t: self._closed(system, y, d),
            states=(*system.states, *(f"z{i + 1}" for i in range(system.m))),
            inputs=system.inputs,
            name=f"{system.name} with PID",
        )
        object.__setattr__(self, "loop", loop)
        at_rest = np.concatenate([self.target, np.zeros(2 * system.m)])
        names = "the gains kp = {:g}, ki = {:g}, kd = {:g}".format(*gains)
        _require_stable(loop, at_rest, names)

    def __call__(self, y: Any, t: float) -> np.ndarray:
        """Evaluate the control at y = (q, v, z), shape (m,) or (m, N)."""
        y = np.asarray(y)
        q, v, z = np.split(y, 3)
        error = q - columns(self.target, y)
        u = columns(self.u0, y) - self.kp * error - self.ki * z - self.kd * v
        return saturate(u, self.limit)

    def _closed(self, system: System, y: np.ndarray, d: np.ndarray) -> np.ndarray:
        u = self(y, 0.0)
        q, _, z = np.split(y, 3)
        error = q - columns(self.target, y)
        if self.limit is not None:
            # -ki z is the integral's part of u: hold z where it would push on in vain.
            winding = (np.abs(u) >= self.limit) & (u * -self.ki * error > 0)
            error = np.where(winding, 0.0, error)
        motion = system.rate(y[: system.n], u + (d if d.ndim == y.ndim else d[:, None]), 0.0)
        return np.concatenate([motion, error + 0 * z])
