"""SciPy's solvers, each trajectory of a batch held to its own tolerance."""

import math
from typing import Any

import numpy as np
import scipy

_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 10.0  # of a step, as in SciPy


class _ByColumns:
    """An explicit Runge-Kutta step whose error is the worst one of N trajectories.

    SciPy takes the root mean square over all components: over N trajectories, one alone may
    have sqrt(N) times the tolerance.
    """

    def __init__(self: Any, *args: Any, columns: int, **options: Any) -> None:
        super().__init__(*args, **options)
        self.columns = columns
        self._nodes = self.C.tolist()
        self._before = [self.K[:i] for i in range(len(self.K))]

    def _step_impl(self: Any) -> tuple[bool, str | None]:
        t, y, K, last = float(self.t), self.y, self.K, self.n_stages
        fun, nodes, before = self.fun, self._nodes, self._before
        min_step = 10 * (math.nextafter(t, math.inf) - t)
        h_abs, rejected = max(min(self.h_abs, self.max_step), min_step), False
        while h_abs >= min_step:
            t_new = min(t + h_abs, self.t_bound)
            h = h_abs = t_new - t
            weights = h * self.A
            K[0] = self.f
            for i in range(1, last):
                stage = y + weights[i, :i].dot(before[i])
                K[i] = fun(min(t + nodes[i] * h, t_new), stage)
            y_new = y + (h * self.B).dot(K[:last])
            K[last] = fun(t_new, y_new)
            scale = self.atol + np.maximum(np.abs(y), np.abs(y_new)) * self.rtol
            error = self._worst(h, scale)  # NaN where the dynamics were
            if error < 1:
                factor = min(_GROW, _SAFETY * error**self.error_exponent) if error else _GROW
                self.h_abs = h_abs * (min(1.0, factor) if rejected else factor)
                self.h_previous, self.y_old = h, y
                self.t, self.y, self.f = t_new, y_new, K[last].copy()
                return True, None
            factor = 0.0
            if math.isfinite(error):
                factor = _SAFETY * error**self.error_exponent
            else:
                self._tell(t, y, weights, t_new)
            h_abs, rejected = h_abs * max(_SHRINK, factor), True
        return False, self.TOO_SMALL_STEP

    def _tell(self: Any, t: float, y: np.ndarray, weights: np.ndarray, t_new: float) -> None:
        """Let the first stage that is not finite be explained."""
        bad = ~np.isfinite(self.K[: self.n_stages]).all(axis=1)
        i = int(np.argmax(bad))
        if bad[i] and i:
            stage = y + weights[i, :i].dot(self.K[:i])
            self.explain(min(t + self.C[i] * (t_new - t), t_new), stage)

    def _worst(self: Any, h: float, scale: np.ndarray) -> float:
        """The largest of the columns' error norms, in units of the tolerance."""
        if not hasattr(self, "E5"):
            return h * float(self._squares(self.E, scale).max()) ** 0.5
        fifth, third = self._squares(self.E5, scale), self._squares(self.E3, scale)
        below = np.sqrt(fifth + 0.01 * third)
        return h * float((fifth / (below + (below == 0))).max())

    def _squares(self: Any, weights: np.ndarray, scale: np.ndarray) -> Any:
        """The columns' mean squares of an error."""
        errors = weights.dot(self.K) / scale
        if self.columns == 1:
            return errors.dot(errors) / errors.size
        errors = errors.reshape(-1, self.columns)
        return np.einsum("ij,ij->j", errors, errors) / len(errors)


EXPLICIT = {
    name: type(name, (_ByColumns, getattr(scipy.integrate, name)), {})
    for name in ("RK45", "RK23", "DOP853")
}
SOLVERS = (*EXPLICIT, "Radau", "BDF", "LSODA")
