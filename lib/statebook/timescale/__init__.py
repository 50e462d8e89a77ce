"""Time scaling: how fast a path can be driven within limits."""

from statebook.timescale.audit import Audit, Use
from statebook.timescale.path import Path
from statebook.timescale.scaling import time_scale
from statebook.timescale.timed_path import TimedPath

__all__ = ["Audit", "Path", "TimedPath", "Use", "time_scale"]
