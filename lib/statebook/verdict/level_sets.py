"""Level sets of the smallest singular value on the stability boundary."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from statebook.verdict.blocks import EPS

# Level sets are taken this far below the best value, so that the sets are not empty by rounding.
_BELOW = 1e-10
# How far from the boundary, relative to the norm, an eigenvalue may lie and count as on it.
# Too generous costs a few evaluations, too strict would miss a piece of the level set.
_ON_BOUNDARY = 1e-6
# The search starts opposite this many eigenvalues, the nearest.
_STARTS = 8


def margin(eigenvalues: Any, discrete: bool) -> Any:
    """Distance of eigenvalues from the boundary, positive inside."""
    return 1 - np.abs(eigenvalues) if discrete else -np.real(eigenvalues)


def project(eigenvalues: Any, discrete: bool) -> Any:
    """Nearest points of the boundary: the imaginary axis or the unit circle."""
    if not discrete:
        return 1j * np.imag(eigenvalues)
    radius = np.abs(eigenvalues)
    return np.where(radius > 0, eigenvalues, 1.0) / np.where(radius > 0, radius, 1.0)


def boundary_distance(A: np.ndarray, discrete: bool, enough: float = 0.0) -> float:
    """Smallest singular value of A - z I over the boundary, by level sets.

    The level set ``sigma_min = r`` is found exactly, from the eigenvalues on the boundary of a
    Hamiltonian matrix (continuous) or symplectic pencil (discrete) of twice the size. So a
    local minimum cannot deceive the search: a level with no points is below the minimum.
    Each level is below the one before, the more so the farther it is from the minimum; the
    search ends early at a value of at most `enough`.
    """
    scale = 0.0 if discrete else float(np.abs(A).max())
    # Powers of two: the units of time (or of the map) cancel without rounding.
    unit = float(np.exp2(np.round(np.log2(scale)))) if scale > 0 else 1.0
    A = A / unit
    eigenvalues = np.linalg.eigvals(A)
    nearest = eigenvalues[np.argsort(margin(eigenvalues, discrete))[:_STARTS]]
    best = np.inf
    for start in dict.fromkeys(project(nearest, discrete).tolist()):
        best = min(best, _lowest(A, np.array([start])))
        if unit * best <= enough:
            break
    while unit * best > enough:
        # Invariant: best is sigma_min at a point of the boundary; the level is just below it.
        crossings = _level_set(A, best * (1 - _BELOW), discrete)
        if len(crossings) == 0:
            break  # certainly the minimum
        value = _lowest(A, _midpoints(crossings, discrete))
        if value >= best * (1 - _BELOW):
            break
        best = value
    return unit * best


def is_near_boundary(A: np.ndarray, discrete: bool, radius: float) -> bool:
    """Whether a perturbation within radius puts an eigenvalue on the boundary; if not, by proof.

    Lyapunov's: where ``T^H P + P T = -R`` (``T^H P T - P = -R`` for maps) with R > 0 no
    eigenvalue of T is there, nor of T + E if R is larger than what norm(E) <= radius adds. It
    costs a triangular equation, and however P was computed, R is what counts. Level sets have
    the last word where it falls short.
    """
    T = scipy.linalg.schur(A, output="complex")[0] if np.tril(A, -1).any() else A.astype(complex)
    with np.errstate(all="ignore"):
        proved = np.all(margin(T.diagonal(), discrete)) and _stays_off(T, discrete, radius)
    return not proved and boundary_distance(T, discrete, radius) <= radius


def _stays_off(T: np.ndarray, discrete: bool, radius: float) -> bool:
    """Whether P for R = I proves that T, triangular, keeps off the boundary."""
    n, one = len(T), np.eye(len(T))
    F, C = T, one
    if discrete:
        # The same P for (T - I)(T + I)^-1.
        W = scipy.linalg.solve_triangular(T + one, one, check_finite=False)
        F, C = one - 2 * W, 2 * W.conj().T @ W
    X, scale, _ = scipy.linalg.lapack.ztrsyl(F, F, -C, trana="C")
    P = (X + X.conj().T) / (2 * scale)
    R = P - T.conj().T @ P @ T if discrete else -T.conj().T @ P - P @ T
    # A bound of the 2-norm of T with its entries made positive, which bounds rounding in R.
    size = float(np.linalg.norm(T, 1) * np.linalg.norm(T, np.inf)) ** 0.5
    growth = 2 * size + radius if discrete else 2.0
    blur = growth * radius + 4 * n * EPS * (1 + size**2 if discrete else size)
    return bool(np.linalg.norm(R - one) + blur * np.linalg.norm(P) < 1)


def _lowest(A: np.ndarray, points: np.ndarray) -> float:
    shifted = A - points[:, None, None] * np.eye(len(A))
    return float(np.linalg.svd(shifted, compute_uv=False)[:, -1].min())


def _level_set(A: np.ndarray, level: float, discrete: bool) -> np.ndarray:
    """Sorted positions (frequency or angle) at which level is a singular value."""
    identity, zero = np.eye(len(A)), np.zeros(A.shape)
    if discrete:
        left = np.block([[A, -level * identity], [zero, identity]])
        right = np.block([[identity, zero], [-level * identity, A.conj().T]])
        z = scipy.linalg.eigvals(left, right)
        z = z[np.isfinite(z)]
        return np.sort(np.angle(z[np.abs(np.abs(z) - 1) <= _ON_BOUNDARY]))
    s = scipy.linalg.eigvals(np.block([[A, -level * identity], [level * identity, -A.conj().T]]))
    return np.sort(s.imag[np.abs(s.real) <= _ON_BOUNDARY * max(np.abs(s).max(), 1.0)])


def _midpoints(positions: np.ndarray, discrete: bool) -> np.ndarray:
    if discrete:
        positions = np.append(positions, positions[0] + 2 * np.pi)
        return np.exp(1j * (positions[1:] + positions[:-1]) / 2)
    if len(positions) == 1:
        return 1j * positions
    return 1j * (positions[1:] + positions[:-1]) / 2
