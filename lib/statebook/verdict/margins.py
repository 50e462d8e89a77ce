"""Margins of a loop round a linear system, by python-control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.verdict.level_sets import margin
from statebook.verdict.locus import eigenvalue_locus

_LARGEST = 1e4  # factor of the gain that is asked about


@dataclass(frozen=True)
class Margins:
    """How much of an error a loop bears.

    Attributes
    ----------
    stable : bool
        The closed loop is asymptotically stable; the others then say how far from not being so.
    gain : (float, float)
        Factors, below and above 1, between which the loop's gain may lie: 0 or inf for none
        between 1e-4 and 1e4.
    phase : float [deg]
        By which the loop may lag or lead; inf where its gain never is 1.
    delay : float [s]
        By which it may be late (in samples where dt is True).
    modulus : float
        Least distance of the Nyquist curve from -1, ``min abs(1 + L)``; NaN if not stable.
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
    """Return the margins of an open loop, a control.StateSpace with one input and output.

    Gains are where eigenvalues of the closed loop cross, the modulus is 1 / norm(S), S = 1 / (1 +
    L); crossovers and norm are those in continuous time, by z = (1 + w) / (1 - w).
    """
    import control

    discrete = _validate.is_discrete(loop.dt)
    stable = bool((margin(control.feedback(loop, 1).poles(), discrete) > 0).all())
    plane = _continuous(loop) if discrete else loop
    crossover, phases = _crossovers(plane)
    if discrete:
        crossover = 2 * np.arctan(crossover) / float(loop.dt)  # True: time is in samples
    lags = np.mod(phases, 2 * np.pi)[crossover > 0] / crossover[crossover > 0]
    modulus = np.nan
    if stable:
        slowest = np.abs(control.feedback(1, plane).poles().real).min(initial=np.inf)
        unit = 1 / slowest if np.isfinite(slowest) else 1.0  # of time: the norm has none
        same = control.ss(unit * plane.A, unit * plane.B, plane.C, plane.D, 0)
        modulus = 1 / control.system_norm(control.feedback(1, same), "inf", tol=1e-9)
    return Margins(
        stable,
        (1 / _room(loop, -1), _room(loop, 1)),
        float(np.rad2deg(np.abs(phases).min(initial=np.inf))),
        float(lags.min(initial=np.inf)),
        float(modulus),
        tuple(crossover.tolist()),
    )


def _room(loop: Any, way: int) -> float:
    """Return by which factor the gain may grow (way = 1) or fall (-1) until poles cross."""
    A, B, C, D = (np.asarray(M) for M in (loop.A, loop.B, loop.C, loop.D))
    last = float(_LARGEST)
    if way == 1 and -D[0, 0] * _LARGEST > 1:  # there the loop has no solution
        last = min(last, (1 - 1e-9) / -float(D[0, 0]))

    def closed(factor: float) -> np.ndarray:
        gain = factor**way
        return A - B @ C * (gain / (1 + gain * D[0, 0]))

    grid = np.geomspace(1.0, last, 25)
    found = eigenvalue_locus(closed, {"factor": grid}, dt=loop.dt).crossings if len(A) else ()
    return found[0].value if found else np.inf if last == _LARGEST else last


def _continuous(loop: Any) -> Any:
    """Return the same response in continuous time, by z = (1 + w) / (1 - w)."""
    import control

    A, B, C, D = (np.asarray(M) for M in (loop.A, loop.B, loop.C, loop.D))
    one = np.eye(len(A))
    inverse = np.linalg.inv(A + one)
    return control.ss(inverse @ (A - one), inverse @ B, 2 * C @ inverse, D - C @ inverse @ B, 0)


def _crossovers(loop: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies at which abs(L) is 1, and by how much the phase is then beyond -pi.

    They are the zeros of 1 - L(-s) L(s) on the imaginary axis, in units that balance L.
    """
    import control

    whole = np.block([[loop.A, loop.B], [loop.C, loop.D]])
    scale = scipy.linalg.matrix_balance(whole, permute=False, separate=True)[1][0]
    unit = scale[:-1] / scale[-1]
    A, B, C = loop.A * unit / unit[:, None], loop.B / unit[:, None], loop.C * unit
    zeros = (1 - control.ss(-A.T, -C.T, B.T, loop.D) * control.ss(A, B, C, loop.D)).zeros()
    omega = np.sort(zeros.imag[zeros.imag >= 0])
    values = np.atleast_1d(loop(1j * omega, warn_infinite=False))
    there = np.abs(np.abs(values) - 1) <= 1e-6
    return omega[there], np.angle(-values[there])
