"""A matrix as blocks that do not feed back into one another, each in Schur form."""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import TopologicalSorter

import numpy as np
import scipy

EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
# Differences in the units of states are undone up to this ratio; more is no choice of units.
_UNIT_SPAN = 1e24


def rounding(norm: float, n: int, precision: float = EPS) -> float:
    """Norm of the perturbations to which n x n arithmetic is blind: 8 n eps norm."""
    return 8 * n * precision * norm


@dataclass(frozen=True)
class Block:
    """One strongly connected set of states, balanced, as ``matrix = Q T Q^H``.

    Attributes
    ----------
    index : array of int
        The states.
    matrix : array, shape (k, k)
        The balanced diagonal block.
    T, Q : array, shape (k, k), complex
        Its Schur form and basis.
    scale : array, shape (k,)
        Units of the balanced states.
    precision : float
        Relative error of the matrix: eps, or more if it was measured or differenced.
    """

    index: np.ndarray
    matrix: np.ndarray
    T: np.ndarray
    Q: np.ndarray
    scale: np.ndarray
    precision: float = EPS


def decompose(A: np.ndarray, precision: float = EPS) -> list[Block]:
    """Split a matrix into its irreducible diagonal blocks, block upper triangular in order.

    Zeros that are exact decouple exactly: the eigenvalues of a chain of integrators are then
    zeros, and not the cube root of rounding.
    """
    return [_block(A, index, precision) for index in _strong_components(A)]


def _strong_components(A: np.ndarray) -> list[np.ndarray]:
    count, labels = scipy.sparse.csgraph.connected_components(A != 0, connection="strong")
    before: dict[int, set[int]] = {label: set() for label in range(count)}
    for row, column in zip(labels[np.nonzero(A)[0]], labels[np.nonzero(A)[1]], strict=True):
        if row != column:
            before[column].add(row)
    return [np.flatnonzero(labels == label) for label in TopologicalSorter(before).static_order()]


def weak_components(A: np.ndarray) -> list[np.ndarray]:
    """States that share no coupling at all, in either direction, fall into different sets."""
    count, labels = scipy.sparse.csgraph.connected_components(A != 0, directed=False)
    return [np.flatnonzero(labels == label) for label in range(count)]


def _block(A: np.ndarray, index: np.ndarray, precision: float) -> Block:
    matrix, (scale, _) = scipy.linalg.matrix_balance(
        A[np.ix_(index, index)], permute=False, separate=True
    )
    if np.iscomplexobj(matrix):
        T, Q = scipy.linalg.schur(matrix, output="complex")
    else:
        R, Z = scipy.linalg.schur(matrix)
        T, Q = scipy.linalg.rsf2csf(R, Z)
        # Conjugate pairs exactly, from the standardized 2 x 2 blocks [[a, b], [c, a]], b c < 0.
        for k in np.flatnonzero(np.diag(R, -1)):
            omega = np.sqrt(abs(R[k, k + 1])) * np.sqrt(abs(R[k + 1, k]))
            T[k, k], T[k + 1, k + 1] = R[k, k] + 1j * omega, R[k, k] - 1j * omega
    return Block(index, matrix, T, Q, scale, precision)


def assemble(A: np.ndarray, blocks: list[Block]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return T = Q^H B Q, Q and B: the whole matrix, balanced, its blocks in Schur form."""
    index = np.concatenate([block.index for block in blocks])
    scale = np.concatenate([block.scale for block in blocks])
    B = A[np.ix_(index, index)] * (scale / scale[:, None])
    Q = scipy.linalg.block_diag(*[block.Q for block in blocks])
    T = np.triu(Q.conj().T @ B @ Q)
    end = 0
    for block in blocks:
        start, end = end, end + len(block.index)
        T[start:end, start:end] = block.T
    return T, Q, B


def with_comparable_couplings(A: np.ndarray, blocks: list[Block], discrete: bool) -> np.ndarray:
    """Choose units in which couplings between blocks are as large as the blocks.

    Balancing has no say on one-way couplings: it could make them as small as it liked. The
    units minimize the sum of squares of log(coupling / largest block), or of log(coupling) for
    a map, whose measure is the unit circle.
    """
    end = np.cumsum([len(block.index) for block in blocks])
    owner = np.searchsorted(end, np.arange(end[-1]), side="right")
    _, _, B = assemble(A, blocks)
    rows, columns = np.nonzero(B * (owner[:, None] != owner))
    if len(rows) == 0:
        return B
    logs = np.log(np.abs(B[rows, columns]))
    rate = 1.0 if discrete else max(np.linalg.norm(block.matrix, 2) for block in blocks)
    target = np.log(rate) if rate > 0 else logs.mean()
    equations = np.zeros((len(rows), len(blocks)))
    equations[np.arange(len(rows)), owner[rows]] += 1
    equations[np.arange(len(rows)), owner[columns]] -= 1
    normal = equations.T @ equations, equations.T @ (target - logs)
    unit = np.linalg.lstsq(*normal, rcond=None)[0]
    span = np.ptp(unit)
    if span > np.log(_UNIT_SPAN):
        unit *= np.log(_UNIT_SPAN) / span
    unit = np.exp2(np.round(unit / np.log(2)))[owner]
    return B * (unit[:, None] / unit)
