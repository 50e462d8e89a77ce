"""Why no motion satisfies the limits: the inequality that stands in the way."""

from __future__ import annotations

import numpy as np
import scipy

from statebook.errors import InfeasiblePathError
from statebook.timescale.limits import TorqueLimit
from statebook.timescale.stages import StuckError

_JUMP = 1e-2  # part of a torque limit that is too much for the finest grids


def explain(stuck: StuckError) -> InfeasiblePathError:
    """Return the error that names the limit that cannot be met.

    At the interval that has no solution, the violation of all inequalities is made as small as it
    can be; the one with the largest multiplier is named.
    """
    grid, rows, i = stuck.grid, stuck.rows, stuck.interval

    def at_rest(z: np.ndarray) -> np.ndarray:
        return np.zeros((len(z), len(grid.h)))  # s'' and s'^2

    w, x, c = rows.w[i], rows.x[i], rows.c[i]
    low, high = stuck.following
    count = len(w)
    step = rows.step[i]
    ahead = [[step, 1, -1], [-step, -1, -1]]
    matrix = np.vstack([np.column_stack([w, x, -np.ones(count)]), ahead])
    bound = np.concatenate([-c, [high, -low]])
    fixed = (stuck.x, stuck.x) if stuck.x is not None else (0, None)
    result = scipy.optimize.linprog(
        [0, 0, 1], A_ub=matrix, b_ub=bound, bounds=[(None, None), fixed, (None, None)]
    )
    weights = -np.asarray(result.ineqlin.marginals)[:count]
    worst = int(np.argmax(weights))
    limit, row, side = rows.labels[worst]
    name = limit.name(row, side)
    s = float(grid.s[i])
    advice = "Raise that limit, or change the path or the speeds at its ends"
    if isinstance(limit, TorqueLimit) and limit.misfit(grid, at_rest, at_rest)[i] > _JUMP:
        advice = (
            "The torque of the robot at rest jumps there, or changes too fast: make it smooth, or "
            "time the path in two parts"
        )
    if stuck.x is None:
        reason = "no speed there lets the rest of the path be driven"
    else:
        reason = "there no motion that comes from the start can go on"
    return InfeasiblePathError(
        f"the path cannot be driven within the limits: at s = {s:.6g} the {name} stands in the "
        f"way; {reason}. {advice}",
        constraint=name,
        s=s,
    )
