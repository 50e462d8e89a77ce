"""Stability of linear systems and of equilibria: verdicts with their evidence."""

from statebook.stability.distance import distance_to_instability
from statebook.stability.maps import eigenvalue_map
from statebook.stability.report import Mode, StabilityReport
from statebook.stability.steps import critical_step
from statebook.stability.verdict import stability

__all__ = [
    "Mode",
    "StabilityReport",
    "critical_step",
    "distance_to_instability",
    "eigenvalue_map",
    "stability",
]
