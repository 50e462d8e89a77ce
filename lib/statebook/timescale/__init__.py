"""Time scaling: how fast a path can be driven within limits.

`path`, `blend` and `grid` hold the geometry, `limits` and `torques` the limits, `rows` turns these
into linear inequalities (with `bernstein`), `stages` solves them by TOPP-RA, `solve` chooses the
grid, `profile` is the motion found and its audit, `jerk` the one with bounded jerk, which
`jerk_search` finds by programs of `jerk_program`, `scaling` is the whole, `timed_path` the result.
"""

from statebook.timescale.path import Path
from statebook.timescale.profile import Audit, Use
from statebook.timescale.scaling import time_scale
from statebook.timescale.timed_path import TimedPath

__all__ = ["Audit", "Path", "TimedPath", "Use", "time_scale"]
