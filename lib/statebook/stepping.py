"""How a simulation goes from sample to sample: by iteration, fixed steps, or a solver."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from statebook.integration import step_of
from statebook.policies import Policy, Stretch
from statebook.systems import System

SOLVERS = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")
_SMALLEST_RTOL = 100 * np.finfo(float).eps  # SciPy's own limit
_CHECK_EVERY = 5_000  # steps
_HOPELESS = 1e6  # steps, minutes to hours of computing


class StoppedError(Exception):
    """The simulation cannot go on from a time and a state."""

    def __init__(self, reason: str, time: float, state: np.ndarray) -> None:
        super().__init__(reason)
        self.time = float(time)
        self.state = np.array(state)


class Flow:
    """The dynamics, NaN (with the trouble noted) where they or the control are not finite.

    A solver may try a step that leaves the domain and then take a shorter one, so that only
    the last trouble before it gives up is the caller's.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.trouble = ""
        self.error: Exception | None = None

    def __call__(self, x: np.ndarray, policy: Policy, t: float) -> np.ndarray:
        try:
            return self._evaluate(x, policy, float(t))
        except Exception as error:
            self.error = error  # for _step, to tell the caller's errors from the solver's
            raise

    def _evaluate(self, x: np.ndarray, policy: Policy, t: float) -> np.ndarray:
        nothing = np.nan * x
        if not np.isfinite(x).all():
            self.trouble = self.trouble or f"the state is not finite after t = {t:.6g}"
            return nothing
        u = policy(x, t)
        if not np.isfinite(u).all():
            self.trouble = f"u(x, t) is not finite at t = {t:.6g}"
            return nothing
        system = self.system
        try:
            if x.ndim == 1 or system.batched:
                value = np.asarray(system.rate(x, u, t))
            else:
                columns = zip(x.T, u.T, strict=True)
                value = np.stack([system.rate(*column, t) for column in columns], axis=1)
        except ArithmeticError as error:  # Python's numbers raise where NumPy's become infinite
            self.trouble = f"the dynamics failed at t = {t:.6g} ({error})"
            return nothing
        if value.shape != x.shape or value.dtype.kind not in "biuf":
            system.dynamics(x, u, t)  # raises the error that explains it
            raise TypeError(f"{system.name} must return real numbers, got {value!r}")
        if not np.isfinite(value).all():
            self.trouble = f"the dynamics are not finite at t = {t:.6g}"
        return value


def iterate(
    flow: Flow, x: np.ndarray, policy: Policy, times: np.ndarray, dt: float
) -> Iterator[np.ndarray]:
    """Yield the states of a discrete-time system at times[1:], whole samples apart."""
    k = 0
    for wanted in np.round((times[1:] - times[0]) / dt).astype(int):
        while k < wanted:
            t = times[0] + k * dt
            x_next = flow(x, policy, t)
            if not np.isfinite(x_next).all():
                raise StoppedError(flow.trouble, t, x)
            x, k = x_next, k + 1
        yield x


def fixed_steps(
    flow: Flow, x: np.ndarray, stretches: list[Stretch], times: np.ndarray, method: str
) -> Iterator[np.ndarray]:
    """Yield the states at times[1:], one step from each time or breakpoint to the next."""
    step = step_of(method, x.shape)
    done = 1
    for start, end, policy in stretches:

        def rate(x: np.ndarray, t: float, policy: Policy = policy) -> np.ndarray:
            return flow(x, policy, t)

        t = start
        while t < end:
            target = min(times[done], end)
            try:
                x_next = step(rate, x, t, target - t)
            except ArithmeticError as error:
                raise StoppedError(flow.trouble or str(error), t, x) from None
            if not np.isfinite(x_next).all():
                raise StoppedError(flow.trouble or "the next state is not finite", t, x)
            x, t = x_next, target
            if t == times[done]:
                yield x
                done += 1


def adaptive_steps(
    flow: Flow,
    x: np.ndarray,
    stretches: list[Stretch],
    times: np.ndarray,
    method: str,
    rtol: float,
    atol: float,
) -> Iterator[np.ndarray]:
    """Yield the states at times[1:] from a SciPy solver, started anew in each stretch."""
    size, columns = len(x), x.size // len(x)
    # SciPy takes the root mean square over all components: over N trajectories, one alone may
    # have sqrt(N) times the tolerance.
    rtol = max(rtol / columns**0.5, _SMALLEST_RTOL)
    options: dict[str, Any] = {"rtol": rtol, "atol": atol / columns**0.5}
    if columns > 1 and method == "LSODA":
        options.update(lband=size - 1, uband=size - 1)
    elif columns > 1 and method in ("Radau", "BDF"):
        blocks = scipy.sparse.kron(scipy.sparse.eye_array(columns), np.ones((size, size)))
        options.update(jac_sparsity=blocks.tocsc())

    def unflatten(y: np.ndarray) -> np.ndarray:  # one trajectory after the other
        return y.reshape(x.shape[::-1]).T

    y = x.T.ravel()
    done = 1
    for start, end, policy in stretches:

        def rate(t: float, y: np.ndarray, policy: Policy = policy) -> np.ndarray:
            return flow(unflatten(y), policy, t).T.ravel()

        # A solver that cannot choose its first step would look for it forever.
        if not np.isfinite(rate(start, y)).all():
            raise StoppedError(flow.trouble, start, unflatten(y))
        solver = getattr(scipy.integrate, method)(rate, start, y, end, **options)
        steps, mark = 0, start
        while solver.status == "running":
            t, y, flow.trouble = solver.t, solver.y, ""
            reason = _step(solver, flow)
            if reason:
                raise StoppedError(reason, t, unflatten(y))
            steps += 1
            if steps % _CHECK_EVERY == 0:
                length = (solver.t - mark) / _CHECK_EVERY
                if end - solver.t > _HOPELESS * length:
                    raise StoppedError(
                        f"steps of {length:.0e} s would take too long; is the control "
                        'discontinuous in x (sample it), the system stiff (method="LSODA"), '
                        "or the duration very long (simulate in parts)?",
                        solver.t,
                        unflatten(solver.y),
                    )
                mark = solver.t
            upto = np.searchsorted(times, solver.t, side="right")
            if upto > done:
                for sample in solver.dense_output()(times[done:upto]).T:
                    if not np.isfinite(sample).all():
                        raise StoppedError("the interpolated state is not finite", t, unflatten(y))
                    yield unflatten(sample)
                done = upto
        y = solver.y


def _step(solver: Any, flow: Flow) -> str:
    """Make a step; return why it failed, if it did."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"scipy\.")  # said by the status as well
        try:
            message = solver.step()
        except (ValueError, np.linalg.LinAlgError) as error:
            if error is flow.error:
                raise
            return flow.trouble or "the solver met numbers that are not finite"
    if solver.status == "failed":
        return flow.trouble or message.rstrip(".").lower()
    return "" if np.isfinite(solver.y).all() else flow.trouble or "the next state is not finite"
