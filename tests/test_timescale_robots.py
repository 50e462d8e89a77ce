"""Torques of real arms, through Pinocchio and their URDF files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest

import statebook as sb

pytest.importorskip("toppra")
pinocchio = pytest.importorskip("pinocchio", reason="the extra robots is not installed")

ARMS = ["ur_description/urdf/ur5_robot.urdf", "panda_description/urdf/panda.urdf"]


def arm(name: str) -> tuple[np.ndarray, Callable[..., Any], list[int]]:
    """Torque limits and inverse dynamics of an arm, in the model's own buffer; and its calls."""
    folder = File(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
    if not (folder / name).is_file():
        pytest.skip(f"example-robot-data has no {name}: install statebook[robots]")
    model = pinocchio.buildModelFromUrdf(str(folder / name))
    fingers = [i for i in range(1, model.njoints) if "finger" in model.names[i]]
    if fingers:
        model = pinocchio.buildReducedModel(model, fingers, pinocchio.neutral(model))
    data, calls = model.createData(), []

    def inverse_dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        calls.append(1)
        pinocchio.rnea(model, data, q, qd, qdd)
        return data.tau

    return np.maximum(model.effortLimit, 1.0), inverse_dynamics, calls


@pytest.mark.parametrize("name", ARMS, ids=["ur5", "panda"])
@pytest.mark.parametrize("count", [5, 20])
def test_the_torques_of_an_arm_are_within_their_limits(name: str, count: int) -> None:
    limit, dynamics, calls = arm(name)
    path = sb.Path.through(np.random.default_rng(count).uniform(-1.5, 1.5, (len(limit), count)))
    timed = sb.time_scale(path, torque=limit, inverse_dynamics=dynamics)
    assert len(calls) < 30_000  # hundreds of thousands without polynomials in s
    t = np.linspace(0, timed.duration, 3001)
    motion = zip(timed.position(t).T, timed.velocity(t).T, timed.acceleration(t).T, strict=True)
    used = np.array([np.abs(dynamics(*state)) / limit for state in motion])
    assert used.max() <= 1 + 1e-9
    assert np.median(used.max(axis=1)) > 0.99  # bang-bang: one limit is always reached
    assert timed.gap < 1e-3
