"""Equilibria and exact linearization of any system."""

from statebook.linearize.equilibrium import Equilibrium, find_equilibrium
from statebook.linearize.jacobians import jacobians
from statebook.linearize.linear_system import linearize

__all__ = ["Equilibrium", "find_equilibrium", "jacobians", "linearize"]
