"""One view of every kind of system: x' = f(x, u), or x_next = f(x, u)."""

from statebook.systems.adapter import as_system
from statebook.systems.system import System

__all__ = ["System", "as_system"]
