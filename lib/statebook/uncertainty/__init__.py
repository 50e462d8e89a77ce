"""Uncertainty: seeded errors, Monte Carlo over them, and tests of what comes out."""

from statebook.uncertainty.consistency import consistency
from statebook.uncertainty.monte_carlo import monte_carlo
from statebook.uncertainty.noise import HeldNoise, discretize_noise
from statebook.uncertainty.wrappers import (
    with_actuation_error,
    with_disturbance,
    with_measurement_error,
    with_parameters,
)

__all__ = [
    "HeldNoise",
    "consistency",
    "discretize_noise",
    "monte_carlo",
    "with_actuation_error",
    "with_disturbance",
    "with_measurement_error",
    "with_parameters",
]
