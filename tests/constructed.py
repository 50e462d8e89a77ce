"""Matrices whose verdict is known by construction, as fractions and in other coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

STABLE, MARGINAL, UNSTABLE = "asymptotically stable", "marginally stable", "unstable"
# Points of the unit circle, and a frequency in eighths or a rate, are rational here.
CIRCLE = [(Fraction(3, 5), Fraction(4, 5)), (Fraction(-5, 13), Fraction(12, 13)), (0, 1)]


@dataclass(frozen=True)
class Constructed:
    """A block diagonal matrix of fractions, what is true of it, and whether it is a map."""

    matrix: np.ndarray
    discrete: bool
    verdict: str
    margin: float
    jordan: bool

    @property
    def dt(self) -> bool | None:
        return True if self.discrete else None

    def floats(self, rng: np.random.Generator) -> np.ndarray:
        """The matrix rotated, or under a random similarity of condition up to 50."""
        D = self.matrix.astype(float)
        n = len(D)
        U = np.linalg.qr(rng.normal(size=(n, n)))[0]
        if rng.random() < 0.5:
            return U @ D @ U.T
        W = np.linalg.qr(rng.normal(size=(n, n)))[0]
        V = U * np.geomspace(1, 50 ** rng.random(), n) @ W
        return V @ D @ np.linalg.inv(V)

    def fractions(self, rng: np.random.Generator) -> np.ndarray:
        """The matrix under a similarity by integers of determinant 1."""
        n = len(self.matrix)
        V, inverse = (np.eye(n, dtype=int).astype(object) for _ in range(2))
        for _ in range(2 * n if n > 1 else 0):
            i, j = rng.choice(n, 2, replace=False)
            factor = int(rng.integers(-1, 2))
            V[i] += factor * V[j]
            inverse[:, j] -= factor * inverse[:, i]
        return V @ self.matrix @ inverse


def construct(rng: np.random.Generator) -> Constructed:
    """Draw up to 8 eigenvalues: whole steps, or eighths of the circle's radius.

    Half of the matrices have eigenvalues on the boundary, a tenth have Jordan blocks.
    """
    discrete = bool(rng.random() < 0.5)
    n = int(rng.integers(1, 9))
    step = Fraction(1, 8) if discrete else Fraction(10) ** int(rng.integers(-3, 4))
    boundary, beyond = rng.random() < 0.5, rng.random() < 0.2
    blocks: list[list[list[Fraction | int]]] = []

    def room() -> int:
        return n - sum(map(len, blocks))

    def number(on: bool) -> Fraction | int:
        if on:
            return int(rng.choice([-1, 1])) if discrete else 0
        return step * int(rng.integers(-7, 8)) if discrete else -step * int(rng.integers(1, 9))

    def pair(on: bool) -> list[list[Fraction | int]]:
        if discrete:
            re, im = CIRCLE[rng.integers(3)]
            size = 1 if on else step * int(rng.integers(1, 8))
            re, im = size * re, size * im
        else:
            re, im = 0 if on else number(False), step * int(rng.integers(1, 9))
        return [[re, im], [-im, re]]

    def plain(on: bool) -> None:
        blocks.append(pair(on) if room() > 1 and rng.random() < 0.4 else [[number(on)]])

    jordan = bool(rng.random() < 0.1 and n > 1)
    on_circle = jordan and boundary and rng.random() < 0.7
    if jordan:
        link = 1 if discrete else step
        if n > 3 and rng.random() < 0.4:
            (a, b), (c, d) = pair(bool(on_circle))
            blocks.append([[a, b, link, 0], [c, d, 0, link], [0, 0, a, b], [0, 0, c, d]])
        else:
            size, z = int(rng.integers(2, min(n, 3) + 1)), number(bool(on_circle))
            rows = [
                [z if i == j else link * (j == i + 1) for j in range(size)] for i in range(size)
            ]
            blocks.append(rows)
    if boundary and not on_circle and room():
        plain(True)
    on = boundary and (on_circle or len(blocks) > jordan)
    beyond = bool(beyond and room())
    if beyond:
        blocks.append([[step * 9 if discrete else step * int(rng.integers(1, 9))]])
    while room():
        plain(bool(on and rng.random() < 0.2))
    matrix = np.zeros((n, n), dtype=object)
    end = 0
    for block in blocks:
        matrix[end : end + len(block), end : end + len(block)] = block
        end += len(block)
    values = np.linalg.eigvals(matrix.astype(float))
    margin = 1 - np.abs(values).max() if discrete else -values.real.max()
    margin = 0.0 if on and not beyond else float(margin)
    verdict = UNSTABLE if beyond or on_circle else MARGINAL if on else STABLE
    return Constructed(matrix, discrete, verdict, margin, jordan)
