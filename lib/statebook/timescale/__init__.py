"""Time scaling: how fast a path can be driven within limits.

`path` and `grid` hold the geometry, `bounds`, `limits` and `dynamics` the limits, `rows` turns
these into linear inequalities (with `bernstein`), `stages` solves them by TOPP-RA, `solve` and
`refine` choose the grid, `profile` is the motion found, `audit` checks it, `explain` says why there
is none, `scaling` is the whole; `timed_path` and `plane` are for looking at the result.
"""

from statebook.timescale.audit import Audit, Use
from statebook.timescale.path import Path
from statebook.timescale.scaling import time_scale
from statebook.timescale.timed_path import TimedPath

__all__ = ["Audit", "Path", "TimedPath", "Use", "time_scale"]
