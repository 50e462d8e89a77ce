"""A sampled controller: what acts on the plant between the ticks of a clock."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from statebook.control_trajectory import ControlTrajectory
from statebook.dense_output import Steps
from statebook.policies import Control, Policy, Stretch, held, of_plan
from statebook.times import interval_of

_ROUNDING = 1e-9  # periods


class Clock:
    """Calls a policy once a tick, and holds what it returned from `delay` later on.

    Parameters
    ----------
    command : callable
        u(x, t) of shape (m,) or (m, N), called in order of time.
    ticks : sequence of float [s]
        Equally far apart; the command is called at all but the last.
    delay : float [s]
    before : array, shape (m,) or (m, N)
        What acts until the first control arrives.
    first : array, optional
        What the command returned at the first tick, if it was called there.
    """

    def __init__(
        self,
        command: Policy,
        ticks: Sequence[float],
        delay: float,
        before: np.ndarray,
        *first: np.ndarray,
    ) -> None:
        self._command, self._ticks, self._before = command, ticks, before
        self._period, self._delay = ticks[1] - ticks[0], delay
        self._commands = list(first)
        self._values: list[np.ndarray] = []
        self._times: list[float] = []

    def sample(self, x: np.ndarray, t: float) -> np.ndarray:
        """What acts at a sample of a plant in discrete time; called at each of them."""
        since = t - self._ticks[0]
        k = round(since / self._period)
        if len(self._commands) == k < len(self._ticks) - 1:
            if abs(since - k * self._period) <= _ROUNDING * self._period:
                self._commands.append(self._command(x, t))
        arrived = math.floor((since - self._delay) / self._period + _ROUNDING)
        latest = min(arrived, len(self._commands) - 1)
        return self._commands[latest] if arrived >= 0 else self._before

    def stretches(self, control: Callable[..., np.ndarray], steps: Steps) -> Iterator[Stretch]:
        """The stretches of a run, each with what acts in it; control(u, x, t) evaluates a u."""
        lag = math.floor(self._delay / self._period + _ROUNDING)
        part = self._delay - lag * self._period
        for k, (start, end) in enumerate(itertools.pairwise(self._ticks)):
            if k or not self._commands:
                self._commands.append(control(self._command, steps.state, start))
            pieces = [(start, end, k - lag)]
            if part > _ROUNDING * self._period:
                pieces = [(start, start + part, k - lag - 1), (start + part, end, k - lag)]
            for a, self._end, j in pieces:
                self._times.append(a)
                self._values.append(self._commands[j] if j >= 0 else self._before)
                yield Stretch(a, self._end, held(self._values[-1]))

    def control(self) -> Control:
        """What acted until now, as a plan."""
        shape, values = self._before.shape, np.stack(self._values)
        times = np.array([*self._times, self._end])
        if values.size and np.isfinite(values).all():
            plan = ControlTrajectory(times, values.reshape(1, len(values), -1))
            return of_plan(plan, shape[0], shape[1:])
        return Control(
            shape[0], shape[1:], None, lambda x, t: values[interval_of(np.float64(t), times)]
        )
