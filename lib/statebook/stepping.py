"""How a simulation goes from sample to sample: by iteration, fixed steps, or a solver."""

import bisect
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from statebook.dense_output import Steps, unflatten
from statebook.errors import outside_domain
from statebook.events import Event, Watch
from statebook.integration import Function, step_of
from statebook.policies import Policy, Stretch, held
from statebook.solvers import EXPLICIT
from statebook.systems import System

_CHECK_EVERY = 5_000  # steps
_MANY = 1_000_000  # steps: minutes to hours of computing
_HOPELESS = 1e9  # steps: days
_COLLAPSED = 0.01  # of a length that steps once had: the control chatters
_FLOAT = np.dtype(float)
_SMALLEST_RTOL = 100 * np.finfo(float).eps  # SciPy's own limit
_HINT = (
    "is the control discontinuous in x (sample it with simulate_clocked), or the system stiff "
    '(method="LSODA")? Where it is just long, give max_steps='
)


class StoppedError(Exception):
    """The simulation cannot go on from a time and a state."""

    def __init__(self, reason: str, time: float, state: np.ndarray) -> None:
        super().__init__(reason)
        self.time = float(time)
        self.state = np.array(state)


class Flow:
    """The dynamics, NaN where they or the control have no value.

    A solver may try a step that leaves the domain and then take a shorter one, so that only
    the last trouble before it gives up is the caller's.
    """

    def __init__(self, system: System, x: np.ndarray) -> None:
        self.system = system
        self.trouble = ""
        self.error: Exception | None = None
        self._rate = self._by_columns if x.ndim == 2 and not system.batched else system.rate

    def __call__(self, x: np.ndarray, policy: Policy, t: float) -> np.ndarray:
        """Evaluate the dynamics; it may be the function's own buffer."""
        u = None
        try:
            u = policy(x, t)
            value = np.asarray(self._rate(x, u, t))
        except Exception as error:
            return self._failed(error, x, "the dynamics" if u is not None else "u(x, t)", t)
        if value.shape != x.shape or (value.dtype is not _FLOAT and value.dtype.kind not in "biuf"):
            self._refuse(value, x, u, t)
        return value

    def _refuse(self, value: Any, x: np.ndarray, u: np.ndarray, t: float) -> None:
        try:
            self.system.dynamics(x, u, t)  # raises the error that explains it
            raise TypeError(f"{self.system.name} must return real numbers, got {value!r}")
        except (TypeError, ValueError) as error:
            self.error = error
            raise

    def control(self, policy: Policy, x: np.ndarray, t: float) -> np.ndarray:
        """Evaluate the control, NaN where it has no value."""
        try:
            return np.array(policy(x, t), dtype=float)
        except Exception as error:
            self._failed(error, x, "u(x, t)", t)
            return np.full((self.system.m, *x.shape[1:]), np.nan)

    def checked(self, x: np.ndarray, policy: Policy, t: float) -> np.ndarray:
        """Evaluate the dynamics, as new floats; note the trouble where they are not finite."""
        value = self(x, policy, t).astype(float)
        if not np.isfinite(value).all():
            self.explain(x, policy, t)
        return value

    def explain(self, x: np.ndarray, policy: Policy, t: float) -> None:
        """Note why the dynamics are not finite."""
        if not np.isfinite(x).all():
            self.trouble = self.trouble or f"the state is not finite after t = {t:.6g}"
        elif not np.isfinite(u := self.control(policy, x, t)).all():
            self.trouble = self.trouble or f"u(x, t) is not finite at t = {t:.6g}"
        else:
            self.trouble = f"the dynamics are not finite at t = {t:.6g}"
            self(x, held(u), t)

    def _by_columns(self, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        rates = [self.system.rate(*column, t) for column in zip(x.T, u.T, strict=True)]
        return np.stack([np.array(rate) for rate in rates], axis=1)

    def _failed(self, error: Exception, x: np.ndarray, what: str, t: float) -> np.ndarray:
        """NaN where a function left its domain; else the caller's own error."""
        if isinstance(error, StopIteration):  # would end a generator in silence
            raise RuntimeError(f"{what} had no further value at t = {t:.6g}") from error
        if not outside_domain(error) and np.isfinite(x).all():
            if self.error is not error and hasattr(error, "add_note"):  # Python 3.11
                error.add_note(f"in simulate, at t = {t:.6g}, x = {np.array2string(x)}")
            self.error = error  # to tell the caller's errors from the solver's
            raise error
        if np.isfinite(x).all():
            self.trouble = f"{what} failed at t = {t:.6g} ({error})"
        return np.nan * x


def _iterate(rate: Function, x: np.ndarray, t: float, dt: float) -> np.ndarray:
    return np.asarray(rate(x, t))


def fixed_steps(flow: Flow, steps: Steps, stretches: Iterable[Stretch], method: str) -> None:
    """Make one step from each time or end of a stretch to the next; a map is its own step."""
    step = _iterate if flow.system.discrete else step_of(method, steps.state.shape)
    last = steps.times[-1]
    for start, end, policy in stretches:

        def rate(x: np.ndarray, t: float, policy: Policy = policy) -> np.ndarray:
            return flow.checked(x, policy, float(t))

        t = start
        while t < min(end, last):
            x, target = steps.state, min(steps.times[steps.taken], end)
            try:
                x_next = step(rate, x, t, target - t)
            except ArithmeticError as error:
                raise StoppedError(flow.trouble or str(error), t, x) from None
            if not np.isfinite(x_next).all():
                raise StoppedError(flow.trouble or "the next state is not finite", t, x)
            t, flow.trouble = target, ""
            steps.advance(t, x_next)


@dataclass
class Solver:
    """A SciPy solver's method, tolerances and limits.

    Attributes
    ----------
    max_step : float
        The longest step.
    max_steps : float or None
        When so many steps would be needed it gives up; None is when they have collapsed.
    events : list of Watch
        What is watched at each step.
    found : list of Event
        What was found.
    """

    method: str
    rtol: float
    atol: np.ndarray
    max_step: float
    max_steps: float | None
    events: list[Watch] = field(default_factory=list)
    found: list[Event] = field(default_factory=list)
    _times: list[float] = field(default_factory=list)
    _gaps: list[float] = field(default_factory=list)
    _pace: float = 0.0

    @property
    def by_rows(self) -> bool:
        """Whether a batch is held row by row."""
        return self.method in EXPLICIT

    def stay_within(self, times: np.ndarray) -> np.ndarray:
        """Let no step be longer than the distance of the times there; return its switches."""
        gaps = np.diff(times)
        if not len(gaps) or np.ptp(gaps) <= 1e-9 * gaps[0]:
            self.max_step = min([self.max_step, *gaps[:1].tolist()])
            return times[:0]
        self._times, self._gaps = times.tolist(), [*gaps.tolist(), *gaps[-1:].tolist()]
        # LSODA's longest step is fixed from start to start.
        return times if self.method == "LSODA" else times[:0]

    def _longest(self, t: float) -> float:
        """The longest step from a time."""
        if not self._gaps:
            return self.max_step
        k = bisect.bisect_right(self._times, t, hi=len(self._times) - 1) - 1
        return min(self.max_step, self._gaps[k], max(self._times[k + 1] - t, self._gaps[k + 1]))

    def run(self, flow: Flow, steps: Steps, stretches: Iterable[Stretch], last: float) -> None:
        """Go through the stretches, to the last time or a terminal event."""
        shape, batch = steps.state.shape, steps.state.ndim == 2
        solver, longest = None, 0.0
        count, mark = 0, steps.time
        for start, end, policy in stretches:

            def rate(t: float, y: np.ndarray, policy: Policy = policy) -> np.ndarray:
                return self._flat(flow.checked(unflatten(y, shape, self.by_rows), policy, t))

            def fast(t: float, y: np.ndarray, policy: Policy = policy) -> np.ndarray:
                return flow(y.reshape(shape), policy, t).ravel() if batch else flow(y, policy, t)

            y = self._flat(steps.state)
            slope = rate(start, y)
            # A solver that cannot choose its first step would look for it forever.
            if not np.isfinite(slope).all():
                raise StoppedError(flow.trouble, start, steps.state)
            if solver is not None and self.by_rows:
                solver.f, solver.t_bound, solver.status = slope, end, "running"
                solver.h_abs = max(solver.h_abs, longest)
            else:
                solver = self._start(rate, start, y, end, shape, min(longest, end - start))
            if self.by_rows:  # their steps copy at once, and ask for the trouble
                solver.fun, solver.explain = fast, rate
            longest = 0.0
            while solver.status == "running":
                flow.trouble = ""
                solver.max_step = self._longest(solver.t)
                reason = _step(solver, flow)
                if reason:
                    raise StoppedError(reason, steps.time, steps.state)
                longest = max(longest, solver.t - solver.t_old)
                steps.add(solver.dense_output(), solver.y)
                if self.events and self._watch(steps, solver.t_old):
                    return
                count += 1
                if count % _CHECK_EVERY == 0:
                    self._check_pace(steps, last, count, mark)
                    mark = steps.time
            flow.trouble = ""

    def _start(
        self, rate: Any, t: float, y: np.ndarray, end: float, shape: tuple[int, ...], first: float
    ) -> Any:
        """A SciPy solver of the columns of a batch, as accurate as if each ran alone.

        The explicit ones hold y as (n, N) row by row, the others one trajectory after another.
        """
        n, columns, rtol = shape[0], y.size // shape[0], self.rtol
        atol = self._flat(np.broadcast_to(self.atol.reshape(-1, *[1] * (len(shape) - 1)), shape))
        options: dict[str, Any] = {"max_step": self._longest(t), "first_step": first or None}
        if self.by_rows:
            options["columns"] = columns
        else:
            rtol, atol = rtol / columns**0.5, atol / columns**0.5
            if columns > 1 and self.method == "LSODA":
                options.update(lband=n - 1, uband=n - 1)
            elif columns > 1:
                blocks = scipy.sparse.kron(scipy.sparse.eye_array(columns), np.ones((n, n)))
                options["jac_sparsity"] = blocks.tocsc()
        kind = EXPLICIT.get(self.method) or getattr(scipy.integrate, self.method)
        return kind(rate, t, y, end, rtol=max(rtol, _SMALLEST_RTOL), atol=atol, **options)

    def _flat(self, x: np.ndarray) -> np.ndarray:
        return x.ravel() if self.by_rows else x.T.ravel()

    def _watch(self, steps: Steps, start: float) -> bool:
        """Look for events in the last step; whether a terminal one ended the run."""
        located = []
        # At the samples too, or a step could pass zero and return.
        inside = steps.times[(steps.times > start) & (steps.times < steps.time)]
        for t in [*inside.tolist(), steps.time]:
            x = steps.at(t)
            located += [(w.locate(steps.at, start, t), w) for w in self.events if w.passed(x, t)]
            start = t
        for event, watch in sorted(located, key=lambda pair: pair[0].time):
            self.found.append(event)
            if watch.ends():
                steps.end_at(event.time)
                return True
        return False

    def _check_pace(self, steps: Steps, last: float, count: int, mark: float) -> None:
        length = (steps.time - mark) / _CHECK_EVERY
        ahead = (last - steps.time) / length if length else np.inf
        self._pace = max(self._pace, length)
        most = self.max_steps or (_MANY if length < _COLLAPSED * self._pace else _HOPELESS)
        if count + ahead > most:
            said = f"with steps of {length:.0e} s it would take more than {most:g} of them; {_HINT}"
            raise StoppedError(said, steps.time, steps.state)
        if ahead > _MANY and count == _CHECK_EVERY:
            warnings.warn(
                f"with steps of {length:.0e} s it will take some {ahead:.0e} of them; {_HINT}",
                stacklevel=7,
            )


def _step(solver: Any, flow: Flow) -> str:
    """Make a step; return why it failed, if it did."""
    try:
        message = solver.step()
    except (ValueError, np.linalg.LinAlgError) as error:
        if error is flow.error:
            raise
        return flow.trouble or "the solver met numbers that are not finite"
    if solver.status == "failed":
        return flow.trouble or message.rstrip(".").lower()
    return "" if np.isfinite(solver.y).all() else flow.trouble or "the next state is not finite"
