"""Margins of a loop round a linear system, by python-control."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from statebook import _validate
from statebook.verdict.level_sets import margin


@dataclass(frozen=True)
class Margins:
    """How much of an error a loop bears.

    Attributes
    ----------
    stable : bool
        The closed loop is asymptotically stable; the others then say how far from not being so.
    gain : (float, float)
        Factors, below and above 1, between which the loop's gain may lie: 0 or inf for no bound.
    phase : float [deg]
        By which the loop may lag or lead; inf where its gain never is 1.
    delay : float [s]
        By which it may be late (in samples where dt is True).
    modulus : float
        Least distance of the Nyquist curve from -1, ``min abs(1 + L)``.
    crossover : tuple of float [rad/s]
        Where the loop's gain is 1.
    """

    stable: bool
    gain: tuple[float, float]
    phase: float
    delay: float
    modulus: float
    crossover: tuple[float, ...]

    def __repr__(self) -> str:
        loop = "asymptotically stable" if self.stable else "not stable, so these are no margins"
        low, high = self.gain
        return (
            f"closed loop {loop}: gain {low:.4g} to {high:.4g}, phase {self.phase:.4g} deg,"
            f" delay {self.delay:.4g} s, modulus {self.modulus:.4g}"
        )


def open_loop(plant: Any, K: Any, input: str | None, output: str | None) -> Any:
    """Return the loop's transfer function L as a control.StateSpace, to be closed by -1.

    Parameters
    ----------
    plant : control.StateSpace or None
    K, input, output
        See `StabilityReport.margins`.
    """
    import control

    if plant is None:
        raise ValueError(
            "margins need inputs: ask stability about a system, not about a bare matrix (or one"
            " whose outputs have no derivative)"
        )
    j = _chosen("input", input, plant.input_labels)
    A, B = np.asarray(plant.A), np.asarray(plant.B)
    if not (isinstance(K, control.lti.LTI) or np.ndim(K) == 0):
        if output is not None:
            raise ValueError("output is for a controller of one output; gains K are on the states")
        K = np.atleast_2d(_validate.real_array("K", K))
        if K.shape != (B.shape[1], len(A)):
            raise ValueError(f"K must have shape {(B.shape[1], len(A))}, got {K.shape}")
        others = [i for i in range(B.shape[1]) if i != j]
        rest = A - B[:, others] @ K[others]
        return control.ss(rest, B[:, [j]], K[[j]], [[0.0]], plant.dt, name=f"{plant.name} loop")
    i = _chosen("output", output, plant.output_labels)
    C, D = np.asarray(plant.C)[[i]], np.asarray(plant.D)[[i]][:, [j]]
    chain = control.ss(A, B[:, [j]], C, D, plant.dt)
    law = K if isinstance(K, control.lti.LTI) else control.ss([], [], [], _validate.number("K", K))
    if (law.ninputs, law.noutputs) != (1, 1):
        raise ValueError(f"K must have one input and one output, got {law.ninputs}, {law.noutputs}")
    loop = control.series(control.ss(law), chain)
    loop.name = f"{plant.name} loop"
    return loop


def _chosen(what: str, label: str | None, labels: Sequence[str]) -> int:
    """Return the number of a label; the only one may go unnamed."""
    if label is None and len(labels) > 1:
        raise ValueError(f"{what} must name one of {', '.join(labels)}")
    return labels.index(_validate.choice(what, labels[0] if label is None else label, labels))


def margins_of(loop: Any) -> Margins:
    """Return the margins of an open loop, a control.StateSpace with one input and output."""
    import control

    closed = control.feedback(loop, 1)
    discrete = _validate.is_discrete(loop.dt)
    stable = bool((margin(closed.poles(), discrete) > 0).all())
    dt = float(loop.dt) if discrete else 0.0  # True is one sample, and time is in samples

    def at(omega: np.ndarray) -> np.ndarray:
        s = 1j * np.asarray(omega)
        return np.atleast_1d(loop(np.exp(s * dt) if discrete else s, warn_infinite=False))

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that polynomials lose digits is seen below
        found = control.stability_margins(loop, returnall=True)
        if not np.allclose(np.abs(at(found[4])), 1, rtol=1e-6):
            sizes = np.abs(np.log(loop.poles()) / dt if discrete else loop.poles())
            sizes = np.append(sizes[(sizes > 0) & np.isfinite(sizes)], 1.0)
            top = np.pi / dt if discrete else 1e4 * sizes.max()
            grid = np.geomspace(1e-4 * min(sizes.min(), top), top, 4000)
            response = control.frd(at(grid), grid, smooth=True)
            found = control.stability_margins(response, returnall=True)
        gains, phases, least, _, crossover, _ = map(np.asarray, found)
        ends = [at(np.zeros(1))[0], at(np.full(1, np.pi / dt))[0] if discrete else loop.D[0, 0]]
    lags = np.mod(phases, 360)[crossover > 0] / crossover[crossover > 0]
    return Margins(
        stable,
        (float(gains[gains < 1].max(initial=0.0)), float(gains[gains > 1].min(initial=np.inf))),
        float(np.abs(phases).min(initial=np.inf)),
        float(np.deg2rad(lags.min(initial=np.inf))),
        float(np.nanmin([*least, *np.abs(1 + np.array(ends))])),
        tuple(sorted(crossover.tolist())),
    )
