"""Stability of linear systems and of equilibria: verdicts with their evidence."""
