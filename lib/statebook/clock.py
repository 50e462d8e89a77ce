"""A sampled controller: what acts on the plant between the ticks of a clock."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from statebook.control_trajectory import ControlTrajectory
from statebook.dense_output import Steps
from statebook.policies import Control, Stretch, held, of_plan, shaped
from statebook.times import tick

_ROUNDING = 1e-9  # periods


class Clock:
    """Calls a policy once a tick, and holds what it returned from `delay` later on.

    Parameters
    ----------
    command : callable
        u(x, t), called in order of time.
    period : float [s]
    count : int
        Number of periods.
    delay : float [s]
    before : array, shape (m,) or (m, N)
        What acts until the first control arrives.
    first : array
        What the policy returned at 0.
    """

    def __init__(
        self,
        command: Callable[[np.ndarray, float], Any],
        period: float,
        count: int,
        delay: float,
        before: np.ndarray,
        first: np.ndarray,
    ) -> None:
        self._command, self._period, self._count, self._delay = command, period, count, delay
        self._m, self._batch = len(before), before.shape[1:]
        self._before = before
        self._commands: list[np.ndarray] = []
        self._times: list[float] = []
        self._values: list[np.ndarray] = []
        self._take(first)
        self.acting = self._acting(0.0)

    def sample(self, x: np.ndarray, t: float) -> np.ndarray:
        """What acts on a plant in discrete time; called at each of its samples."""
        k = round(t / self._period)
        if 0 < k < self._count and abs(t - k * self._period) <= _ROUNDING * self._period:
            self._take(self._command(x, t))
        return self._acting(t)

    def stretches(self, steps: Steps) -> Iterator[Stretch]:
        """The stretches of a plant in continuous time, each with the control that acts in it."""
        for k in range(self._count):
            start, end = tick(0.0, self._period, k), tick(0.0, self._period, k + 1)
            if k:
                self._take(self._command(steps.state, start))
            slack = _ROUNDING * self._period
            arrival = start + self._delay % self._period
            inside = [arrival] if start + slack < arrival < end - slack else []
            for a, b in itertools.pairwise([start, *inside, end]):
                self.acting = self._acting(a)
                self._times.append(a)
                self._values.append(self.acting)
                yield Stretch(a, b, held(self.acting))
        self._times.append(end)

    def control(self) -> Control:
        """What acted until now, as a plan."""
        count = next((k for k, u in enumerate(self._values) if not np.isfinite(u).all()), None)
        values = self._values[:count]
        if not values or self._m == 0:
            return Control(self._m, self._batch, None, held(self.acting))
        times = self._times[: len(values) + 1]
        if len(times) == len(values):  # the run ended within a stretch
            times = [*times, tick(0.0, self._period, int(times[-1] / self._period) + 2)]
        coefficients = np.stack(values).reshape(1, len(values), -1)
        return of_plan(ControlTrajectory(np.array(times), coefficients), self._m, self._batch)

    def _take(self, command: Any) -> None:
        value = shaped("policy(x, t)", command, self._m, self._batch).copy()
        self._commands.append(value)

    def _acting(self, t: float) -> np.ndarray:
        """The last control that has arrived at a time."""
        arrived = math.floor((t - self._delay) / self._period + _ROUNDING)
        arrived = min(arrived, len(self._commands) - 1)  # at the end none is taken
        return self._commands[arrived] if arrived >= 0 else self._before
