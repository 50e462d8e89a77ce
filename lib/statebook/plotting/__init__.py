"""Figures in one style. Every function takes an Axes, or makes one, and returns it."""

from statebook.plotting.complex_plane import eigenvalues, stability_region
from statebook.plotting.explore import Player, explore, film
from statebook.plotting.phase_plane import arrows, flow, phase_portrait
from statebook.plotting.style import use_style
from statebook.plotting.timing import timed_path

__all__ = [
    "Player",
    "arrows",
    "eigenvalues",
    "explore",
    "film",
    "flow",
    "phase_portrait",
    "stability_region",
    "timed_path",
    "use_style",
]
