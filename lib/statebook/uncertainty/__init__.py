"""Uncertainty: seeded errors, Monte Carlo over them, and tests of what comes out."""
