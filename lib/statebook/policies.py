"""One view of every form in which a control may be given."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.dense_output import Steps
from statebook.errors import outside_domain
from statebook.probes import arguments_of, is_time, number_of_inputs, positional, takes_batches
from statebook.systems import System
from statebook.times import interval_of

Policy = Callable[[np.ndarray, float], np.ndarray]
_FLOAT = np.dtype(float)
_SMOOTH = 6  # delays after which the kink of a start is too smooth to be seen


class Stretch(NamedTuple):
    """A stretch of time in which a control has no switch."""

    start: float
    end: float
    policy: Policy


@dataclass(frozen=True)
class Control:
    """A control of m inputs, or of m inputs of each of a batch.

    A plan is a function of time alone, of m or m N inputs; without one there is a policy.
    """

    m: int
    batch: tuple[int, ...]
    plan: ControlTrajectory | None
    policy: Policy

    @property
    def is_policy(self) -> bool:
        """Whether the control is a function that may depend on the state."""
        return self.plan is None and self.m > 0

    def stretches(self, start: float, end: float, switches: np.ndarray) -> Iterator[Stretch]:
        """The stretches between switches, and breakpoints of a plan.

        At the end of a stretch its policy is the limit from the left.
        """
        plan = self.plan
        marks = switches if plan is None else np.union1d(switches, plan.breakpoints)
        slack = 1e-12 * max(abs(start), abs(end), end - start)
        inside = marks[(marks > start) & (marks < end - slack)]
        inside = inside[np.diff(inside, prepend=start) > slack]
        cuts = np.array([start, *inside.tolist(), end])
        ends = itertools.pairwise(cuts.tolist())
        if plan is None:
            for a, b in ends:
                yield Stretch(a, b, self.policy if b == end else _before(self.policy, b))
            return
        pieces = interval_of((cuts[:-1] + cuts[1:]) / 2, plan.breakpoints).tolist()
        for (a, b), k in zip(ends, pieces, strict=True):
            coefficients = plan.coefficients[:, k].reshape(-1, self.m, *self.batch)
            yield Stretch(a, b, _polynomial(coefficients, float(plan.breakpoints[k])))

    def delayed(
        self, delay: float, before: np.ndarray, switches: np.ndarray, steps: Steps
    ) -> tuple[Control, np.ndarray]:
        """The control that arrives `delay` later, and its switches; until then `before`."""
        first, start = np.reshape(before, (1, 1, -1)), float(steps.times[0])
        if self.plan is not None:
            own = self.plan.between(start, float(steps.times[-1]))
            coefficients = np.zeros((len(own.coefficients), 1, first.size))
            coefficients[-1] = first[0]
            breakpoints = np.concatenate([[start], own.breakpoints + delay])
            coefficients = np.concatenate([coefficients, own.coefficients], axis=1)
            plan = ControlTrajectory(breakpoints, coefficients)
            return of_plan(plan, self.m, self.batch), np.empty(0)

        early = [start, *switches.tolist(), np.inf]
        late = [time + delay for time in early]

        def policy(x: np.ndarray, t: float) -> np.ndarray:
            k = bisect.bisect_right(late, t) - 1
            if k < 0:
                return before
            # On the side of the switch that t is on, in spite of rounding.
            then = min(max(t - delay, early[k]), float(np.nextafter(early[k + 1], -np.inf)))
            return self.policy(steps.at(then), then)

        kinks = start + delay * np.arange(1, _SMOOTH + 1)
        return Control(self.m, self.batch, None, policy), np.union1d(kinks, late[1:-1])


def held(u: np.ndarray) -> Policy:
    """The policy that returns one value."""
    return lambda x, t: u


def _polynomial(coefficients: np.ndarray, origin: float) -> Policy:
    """The policy that is a polynomial of the time, highest power first."""
    first, *others = coefficients

    def policy(x: np.ndarray, t: float) -> np.ndarray:
        value, since = first, t - origin
        for coefficient in others:
            value = value * since + coefficient
        return value

    return policy


def _before(policy: Policy, end: float) -> Policy:
    last = float(np.nextafter(end, -np.inf))
    return lambda x, t: policy(x, min(t, last))


def of_plan(plan: ControlTrajectory, m: int, batch: tuple[int, ...]) -> Control:
    """The control of a plan of m inputs, or of m inputs of each of a batch."""
    if batch and plan.m == m:
        spread = np.repeat(plan.coefficients, batch[0], axis=2)
        plan = ControlTrajectory(plan.breakpoints, spread)
    return Control(m, batch, plan, lambda x, t: plan(t).reshape(m, *batch))


@contextmanager
def valued(what: str, x: np.ndarray, t: float) -> Iterator[None]:
    """Say of what is evaluated that it has no value at a state and a time, where it has none."""
    try:
        with np.errstate(all="ignore"):
            yield
    except Exception as error:
        if not outside_domain(error):
            raise
        raise ValueError(
            f"{what} no value at t = {t:g}, x = {_validate.brief(x)}: {error}"
        ) from error


def at_start(name: str, function: Callable[..., Any], x: np.ndarray, t: float) -> np.ndarray:
    """Evaluate a function of x and t where a run starts: finite and real, or an error."""
    with valued(f"{name} has", x, t):
        value = function(x.copy(), t)
    return np.array(_validate.real_array(name, value))


def as_plan(name: str, u: Any) -> Any:
    """A SciPy piecewise polynomial as a control trajectory; anything else as it is.

    A function must take (x, t): in another order it would give wrong numbers in silence.
    """
    if isinstance(u, scipy.interpolate.PPoly):
        return ControlTrajectory.from_ppoly(u)
    if not callable(u) or isinstance(u, ControlTrajectory):
        return u
    names, required, variadic = positional(u) or (["x", "t"], 2, False)
    if required <= 2 and (len(names) > 1 or variadic) and not any(map(is_time, names[:1])):
        return u
    given = ", ".join(names)
    raise TypeError(
        f"{name} must take (x, t), got a function of ({given}); write lambda x, t: f({given})"
    )


def example_input(
    system: Any, u: Any, x0: np.ndarray, t: float, times: np.ndarray | None
) -> np.ndarray | None:
    """A control at the start: what tells m to a system that is a plain function."""
    x = x0 if x0.ndim == 1 else x0[:, 0]
    if u is None:
        return None
    if isinstance(u, ControlTrajectory):
        return u.on_piece(interval_of(np.float64(t), u.breakpoints), t)
    if callable(u):
        return np.atleast_1d(at_start("u(x0, t0)", u, x, t))
    value = np.atleast_1d(_validate.real_array("u", u))
    if value.ndim == 2 and x0.ndim == 1:
        return value[:, 0]
    plain = callable(system) and not (hasattr(system, "dynamics") or hasattr(system, "nstates"))
    if not plain or value.ndim > 1 or value.size < 2:
        return value
    samples = times is not None and len(times) == value.size
    one_each = x0.shape[1:] == value.shape
    if (samples or one_each or value.size > x.size) and _reads_one(system, x):
        if not (samples or one_each):
            raise ValueError(
                f"u has {value.size} entries, but the function reads only the first: samples of "
                "a control go with times= of the same length, a held one has shape (1,)"
            )
        return value[:1]
    return value


def _reads_one(f: Callable[..., Any], x: np.ndarray) -> bool:
    """Whether a function f(x, u) reads one input, however many it is given."""
    time = (0.0,) if arguments_of(f)[0] > 2 else ()
    beside = x + 1e-3 * (1 + np.abs(x))
    return number_of_inputs(lambda u: f(beside.copy(), u, *time), x.size) == 1


def as_control(
    u: Any, system: System, x0: np.ndarray, times: np.ndarray, sampled: np.ndarray | None
) -> Control:
    """View a control of any form as one; `sampled` are the times that samples belong to.

    A function is probed: one that does not take a batch is called column by column.
    """
    m, batch = system.m, x0.shape[1:]
    if m == 0 and not callable(u) and (u is None or np.size(u) == 0):
        return Control(0, batch, None, held(np.empty((0, *batch))))
    if not isinstance(u, ControlTrajectory) and not callable(u):
        u = _plan_of(u, m, batch, times, sampled)
    if isinstance(u, ControlTrajectory):
        if u.m not in (m, m * int(np.prod(batch))):
            raise ValueError(f"u must have m = {m} inputs, got a control trajectory of {u.m}")
        start, end = u.breakpoints[[0, -1]]
        slack = 1e-12 * max(np.abs(times[[0, -1]]).max(), end - start)
        if times[0] < start - slack or times[-1] > end + slack:
            raise ValueError(
                f"u must cover the simulated times [{times[0]:g}, {times[-1]:g}], "
                f"got a control trajectory over [{start:g}, {end:g}]"
            )
        return of_plan(u, m, batch)
    function, t0, shape = u, float(times[0]), (m,)

    def policy(x: np.ndarray, t: float) -> np.ndarray:
        value = np.asarray(function(x.copy(), t))
        if value.dtype is _FLOAT and value.shape == shape and x.ndim == 1:
            return value  # as `shaped` does with most of them, without a call
        return shaped("u(x, t)", value, m, x.shape[1:])

    def one_by_one(x: np.ndarray, t: float) -> np.ndarray:
        return np.stack([policy(column, t) for column in x.T], axis=1)

    if not batch:
        return Control(m, batch, None, policy)
    # Different columns, or a policy that mixes them up would pass.
    beside = x0 + (1 + np.abs(x0)) * np.linspace(0.0, 1e-3, batch[0])
    now = partial(policy, t=t0)
    agrees = all(takes_batches(now, x, alone=now, rtol=1e-9) for x in (x0, beside))
    return Control(m, batch, None, policy if agrees else one_by_one)


def _plan_of(
    u: Any, m: int, batch: tuple[int, ...], times: np.ndarray, sampled: np.ndarray | None
) -> ControlTrajectory:
    """The plan of a held number or array, or of samples at the times."""
    value = np.zeros(m) if u is None else _validate.real_array("u", u)
    count = 0 if sampled is None else len(sampled)
    forms = [(m,), (m, *batch)] + ([(), batch] if m == 1 else [])
    if value.shape not in forms:
        if value.shape in ((m, count), (count,) if m == 1 else ()) and count > 1:
            return ControlTrajectory.piecewise_linear(sampled, value)
        rule = f"u must have shape ({m},)" + (f" or ({m}, {batch[0]})" if batch else "")
        if count > 1:
            rule += f", or ({m}, {count}), one column for each of the times"
        hint = "; samples of a control go with times= of the same length"
        hint = hint if not count and value.ndim and len(value.T) > 1 else ""
        raise ValueError(f"{rule}, got {value.shape}{hint}")
    value = shaped("u", value, m, batch)
    end = times[-1] if len(times) > 1 else times[0] + 1.0
    return ControlTrajectory(np.array([times[0], end]), value.reshape(1, 1, -1))


def shaped(name: str, value: Any, m: int, batch: tuple[int, ...]) -> np.ndarray:
    """Check a control and bring it to the shape (m, *batch); it need not be finite."""
    value = np.asarray(value)
    if value.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be real numbers, got {value!r}")
    if m == 1 and value.shape in ((), batch):
        value = value[None]
    elif value.shape == (m, 1) and not batch:  # a column, as K @ x.reshape(n, 1) is
        value = value[:, 0]
    if value.shape not in ((m,), (m, *batch)):
        allowed = f"({m},)" + (f" or ({m}, {batch[0]})" if batch else "")
        raise ValueError(f"{name} must have shape {allowed}, got {value.shape}")
    value = value.astype(float, copy=False)
    return np.repeat(value[:, None], batch[0], axis=1) if batch and value.ndim == 1 else value
