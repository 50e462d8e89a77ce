"""Why no motion satisfies the limits: the inequality that stands in the way."""

from __future__ import annotations

import numpy as np
import scipy

from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid
from statebook.timescale.stages import Rows, StuckError


def explain(rows: Rows, grid: Grid, stuck: StuckError) -> InfeasiblePathError:
    """Return the error that names the limit that cannot be met.

    At the interval that has no solution, the violation of all inequalities is made as small as it
    can be; the one with the largest multiplier is named.
    """
    i = stuck.interval
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
    if stuck.x is None:
        reason = f"there is no speed at s = {s:.6g} from which the rest of the path can be driven"
    else:
        reason = (
            f"at s = {s:.6g} the path is reached with a speed from which it cannot be continued"
        )
    return InfeasiblePathError(
        f"the path cannot be driven within the limits: {reason}; the {name} stands in the way. "
        "Raise that limit, or change the path or the speeds at its ends",
        constraint=name,
        s=s,
    )
