"""From continuous to discrete time."""

from statebook.discretize.methods import discretize, discretize_many, map_eigenvalues
from statebook.discretize.sampled_feedback import critical_sample_time

__all__ = ["critical_sample_time", "discretize", "discretize_many", "map_eigenvalues"]
