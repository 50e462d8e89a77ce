"""Draw the front page's film and figures anew: python book/pictures.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter

import statebook as sb

HERE = Path(__file__).parent / "_static"


def swing_up(pendulum: sb.Pendulum, weight: float) -> sb.Trajectory:
    """Run the swing-up with a motor of 0.35 of the weight's torque."""
    law = sb.SwingUp(pendulum, 0.35 * weight)
    return sb.simulate_clocked(pendulum, [-np.pi / 2, 0.0], law, period=0.02, duration=8.5)


def film(run: sb.Trajectory, weight: float) -> None:
    """Film the mass and the torque that moves it."""
    figure, (ax, below) = plt.subplots(2, 1, figsize=(3.6, 4.2), height_ratios=[3.4, 1], dpi=90)
    times = run.times[:-1]
    (trail,) = ax.plot([], [], color="0.8", linewidth=1)
    (rod,) = ax.plot([], [], color="C0", linewidth=4)
    (mass,) = ax.plot([], [], "o", color="C0", markersize=18)
    ax.plot(0, 1, "s", color="C1", markersize=8)
    ax.plot(0, 0, "s", color="0.3", markersize=7)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25), aspect="equal")
    ax.axis("off")
    (torque,) = below.plot([], [], color="C1", drawstyle="steps-post")
    for limit in (-0.35, 0.35):
        below.axhline(limit, linestyle="--", color="0.5", linewidth=1)
    below.set(xlim=times[[0, -1]], ylim=(-0.45, 0.45), xlabel="time [s]")
    below.set_ylabel("torque [m g L]", fontsize="small")

    def draw(k: int) -> None:
        angle = run.states[0, : k + 1]
        recent = angle[-240:]
        trail.set_data(np.cos(recent), np.sin(recent))
        rod.set_data([0, np.cos(angle[-1])], [0, np.sin(angle[-1])])
        mass.set_data([np.cos(angle[-1])], [np.sin(angle[-1])])
        torque.set_data(times[: k + 1], run.controls[0, : k + 1] / weight)

    frames = np.searchsorted(times, np.arange(0, times[-1], 1 / 12))
    writer = PillowWriter(fps=12)
    FuncAnimation(figure, draw, frames).save(HERE / "swing_up.gif", writer=writer)


def gains(pendulum: sb.Pendulum, weight: float) -> None:
    """Draw which gains hold the pendulum up, by the eigenvalues of the linearized loop."""
    kp, kd = np.linspace(0, 3, 61), np.linspace(0, 2, 41)
    rate = np.sqrt(pendulum.g / pendulum.L)

    p, d = np.meshgrid(kp, kd)
    rows = [[0 * p, 0 * p + 1], [rate**2 * (1 - p), -rate * d]]
    loops = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    margins = -np.linalg.eigvals(loops).real.max(axis=-1) / rate
    figure, ax = plt.subplots(figsize=(4.2, 3.2))
    filled = ax.contourf(kp, kd, margins, levels=np.linspace(-1.8, 1.8, 13), cmap="RdBu")
    ax.contour(kp, kd, margins, levels=[0], colors="k")
    ax.set(xlabel="$k_P$ [m g L]", ylabel="$k_D$ [m g L / rate]")
    figure.colorbar(filled, label="spectral margin [rate]")
    figure.savefig(HERE / "gains.png")


def timed_path() -> None:
    """Draw a path's speed below what its limits allow."""
    waypoints = [[0.0, 1.0, 1.0, 2.0], [0.0, 0.0, 1.0, 1.0]]
    path = sb.Path.through(waypoints, kind="linear", blend=0.1)
    motion = sb.time_scale(path, velocity=1.0, acceleration=4.0)
    times = np.linspace(0, motion.duration, 500)
    figure, (above, below) = plt.subplots(2, 1, figsize=(4.2, 3.2), sharex=True)
    above.plot(times, motion.velocity(times).T)
    below.plot(times, motion.acceleration(times).T)
    for ax, limit, label in ((above, 1.0, "rad/s"), (below, 4.0, "rad/s$^2$")):
        for sign in (-1, 1):
            ax.axhline(sign * limit, linestyle="--", color="0.4", linewidth=1)
        ax.set_ylabel(f"[{label}]")
    below.set_xlabel("time [s]")
    figure.savefig(HERE / "timed_path.png")


if __name__ == "__main__":
    sb.use_style()
    pendulum = sb.Pendulum(m=1.0, L=1.0, g=9.8, damping=0.0)
    weight = pendulum.m * pendulum.g * pendulum.L
    film(swing_up(pendulum, weight), weight)
    gains(pendulum, weight)
    timed_path()
