"""Functions that workers of a cluster import: nothing heavy comes with them."""

import os

import numpy as np

import statebook as sb

GRID = {"radius": [1.0, 2.0, 3.0], "angle": np.linspace(0, 1, 5)}


def polar(radius, angle):
    return np.array([radius * np.cos(angle), radius * np.sin(angle)])


POLAR = [[polar(r, a) for a in GRID["angle"]] for r in GRID["radius"]]


def inverse(x):
    return 1 / x


def drawn(block, rng):
    """Return sums of ends and of their squares of 50 gusty particles: a block of many runs."""
    noise = sb.HeldNoise.white(0.5, 0.1, seed=rng)
    run = sb.monte_carlo(
        sb.Particle(), [0, 0], number=50, period=0.1, duration=0.5, disturbance=noise,
        G=[[0], [1]], method="rk4",
    )  # fmt: skip
    ends = run.states[0, :, -1]
    return [ends.sum(), (ends**2).sum()]


def gusty(number, seed=3, **options):
    """Simulate particles under gusts, by monte_carlo."""
    noise = sb.HeldNoise.white(0.5, 0.1, seed=seed)
    return sb.monte_carlo(
        sb.Particle(), [0, 0], number=number, period=0.1, duration=0.5, disturbance=noise,
        G=[[0], [1]], **{"progress": False, **options},
    )  # fmt: skip


def leaping(x):
    return x**2


def deadly(x, folder):
    """Note the call; where a file says so, the worker dies at 30, killed by its number."""
    with (folder / f"{x}").open("a") as file:
        file.write("called\n")
    if x == 30 and (folder / "kill").exists():
        (folder / "kill").unlink()
        os.kill(os.getpid(), 9)
    return x**2
