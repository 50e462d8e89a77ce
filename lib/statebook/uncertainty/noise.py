"""Covariances, and noise held between ticks of a clock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate

_ROUNDING = 1e-10  # of an eigenvalue or a correlation
# Of exp(A h) with |A| h < 1/2, these leave less than rounding.
_SHORT = 0.5
_NODES = 8  # of Gauss-Legendre quadrature: exact up to degree 15
_TERMS = 18  # of the series
PAGE = 8192  # trajectories that draw from one generator
_first = ContextVar("number of the first trajectory", default=0)


@contextmanager
def counted_from(first: int) -> Iterator[None]:
    """Within, the trajectories of every noise begin with this number.

    Parameters
    ----------
    first : int >= 0

    Examples
    --------
    >>> noise = HeldNoise(1.0, 0.1, seed=1)
    >>> with counted_from(2):
    ...     third = noise(0.0)
    >>> bool(third[0] == noise(0.0, number=3)[0, 2])
    True
    """
    token = _first.set(first)
    try:
        yield
    finally:
        _first.reset(token)


def covariance_matrix(name: str, value: Any, size: int | None = None) -> np.ndarray:
    """Return a symmetric, positive semidefinite matrix.

    Parameters
    ----------
    name : str
        The argument's name, for the error message.
    value : float or array, shape (n, n)
        A number is a 1 x 1 matrix.
    size : int, optional
        The required n.

    Returns
    -------
    array, shape (n, n)
        Exactly symmetric.

    Raises
    ------
    TypeError, ValueError
        It is not real, square, of that size, symmetric or positive semidefinite.

    Examples
    --------
    >>> covariance_matrix("Q", 4.0)
    array([[4.]])
    """
    matrix = np.atleast_2d(_validate.real_array(name, value))
    n = len(matrix) if size is None else size
    if matrix.shape != (n, n) or n == 0:
        wanted = "(n, n)" if size is None else f"({n}, {n})"
        raise ValueError(f"{name} must be a covariance of shape {wanted}, got {matrix.shape}")
    return _validate.semidefinite(name, matrix, ": a variance cannot be negative")


def square_root(matrix: np.ndarray) -> np.ndarray:
    """Return a root S of a covariance, S S' = matrix; it may be singular.

    The symmetric root; where that would lose small variances beside large ones, or the matrix is
    singular, D C with the standard deviations D and the symmetric root C of the correlations.
    Unlike factors made of eigenvectors, neither has a sign that could differ between machines.

    Parameters
    ----------
    matrix : array, shape (n, n), symmetric and positive semidefinite

    Returns
    -------
    array, shape (n, n)

    Examples
    --------
    >>> square_root(np.array([[4.0, 0.0], [0.0, 0.0]])).tolist()
    [[2.0, 0.0], [0.0, 0.0]]
    """
    values, vectors = np.linalg.eigh(matrix)
    if values[0] > _ROUNDING * values[-1]:
        return (vectors * np.sqrt(values)) @ vectors.T
    deviations = np.sqrt(np.diag(matrix))
    scale = np.where(deviations > 0, deviations, 1.0)
    values, vectors = np.linalg.eigh(matrix / scale[:, None] / scale)
    values = np.where(values > _ROUNDING, values, 0.0)
    return deviations[:, None] * ((vectors * np.sqrt(values)) @ vectors.T)


@dataclass(frozen=True, eq=False, repr=False)
class HeldNoise:
    """Gaussian noise that is held for a period, as a signal of time.

    w(t) = bias + S z_k for k period <= t < (k + 1) period, with S S' = covariance and every z_k
    standard normal, independent of the others. The noise of trajectory j in period k depends
    on the seed, k and j alone: not on how many trajectories there are, or in which order times
    are asked for.

    Parameters
    ----------
    covariance : float or array, shape (q, q), symmetric and positive semidefinite
        Of one period's value. For white noise of a given intensity use `HeldNoise.white`.
    period : float > 0 [s]
        Time for which each value is held.
    seed : int >= 0 or numpy.random.Generator
        Required. A generator gives one integer, so that several noises may share it.
    bias : float or array, shape (q,), optional
        Mean of the noise: the systematic error.

    Raises
    ------
    TypeError, ValueError
        The covariance is not one, the seed is missing, or bias or period do not fit.

    Examples
    --------
    >>> noise = HeldNoise(0.04, 0.1, seed=1)
    >>> noise
    HeldNoise(covariance=[[0.04]], period=0.1 s, bias=[0])
    >>> noise(0.25, number=3).shape
    (1, 3)
    >>> bool(noise(0.25)[0] == noise(0.21, number=3)[0, 0])
    True
    """

    covariance: Any
    period: float
    seed: Any = field(kw_only=True)
    bias: Any = field(default=0.0, kw_only=True)
    _root: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        covariance = covariance_matrix("covariance", self.covariance)
        q = len(covariance)
        bias = _validate.real_array("bias", self.bias)
        if bias.shape not in ((), (q,)):
            raise ValueError(f"bias must be a number or have shape ({q},), got {bias.shape}")
        period, seed = _validate.positive("period", self.period), _seed(self.seed)
        vars(self).update(covariance=covariance, period=period, seed=seed)
        vars(self).update(bias=np.broadcast_to(bias, (q,)), _root=square_root(covariance))

    @classmethod
    def white(cls, intensity: Any, period: float, *, seed: Any, bias: Any = 0.0) -> HeldNoise:
        """White noise of an intensity, held for a period.

        covariance = intensity / period: then the integral over a time T has the covariance
        intensity T, however short the period.

        Parameters
        ----------
        intensity : float or array, shape (q, q), symmetric and positive semidefinite
            Covariance per unit of bandwidth: [N^2 s] for a force.
        period : float > 0 [s]
            Time for which each value is held; short against the system's time constants.
        seed : int >= 0 or numpy.random.Generator
        bias : float or array, shape (q,), optional

        Returns
        -------
        HeldNoise

        References
        ----------
        Astrom, *Introduction to Stochastic Control Theory*, chapter 3.

        Examples
        --------
        >>> HeldNoise.white(0.5, 0.01, seed=1).covariance
        array([[50.]])
        """
        intensity = covariance_matrix("intensity", intensity)
        return cls(intensity / _validate.positive("period", period), period, seed=seed, bias=bias)

    @property
    def size(self) -> int:
        """Number of components q."""
        return len(self.covariance)

    def __call__(self, t: float, number: int | None = None) -> np.ndarray:
        """Evaluate the noise at a time.

        Parameters
        ----------
        t : float >= 0 [s]
        number : int > 0, optional
            Number of trajectories.

        Returns
        -------
        array, shape (q,) or (q, number)
            Without number, that of the first trajectory.
        """
        t = _validate.non_negative("t", t)
        # A tick k * period must not fall into period k - 1 by rounding.
        tick = int(np.floor(t / self.period * (1 + 1e-12) + 1e-9))
        first, count = _first.get(), 1 if number is None else _validate.integer("number", number, 1)
        rows = []
        for page in range(first // PAGE, -(-(first + count) // PAGE)):
            key = (tick, page) if page else (tick,)
            generator = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
            # One row a trajectory: more of them leave the first ones as they are.
            height = min(first + count - page * PAGE, PAGE)
            rows.append(generator.standard_normal((height, self.size)))
        values = np.concatenate(rows)[first % PAGE :] @ self._root.T + self.bias
        return values[0] if number is None else values.T

    def __repr__(self) -> str:
        style: Any = {"separator": ", ", "formatter": {"float": "{:.4g}".format}}
        shown = (np.array2string(a + 0.0, **style) for a in (self.covariance, self.bias))
        covariance, bias = (" ".join(text.split()) for text in shown)
        return f"HeldNoise(covariance={covariance}, period={self.period:g} s, bias={bias})"


def _seed(seed: Any) -> int:
    if isinstance(seed, np.random.Generator):
        return int.from_bytes(seed.bytes(16), "little")  # so many that none come twice
    if seed is None:
        raise TypeError(
            "seed is required, as noise must be reproducible: give an integer or a"
            " numpy.random.Generator"
        )
    return _validate.integer("seed", seed)


def discretize_noise(A: Any, G: Any, intensity: Any, dt: float) -> np.ndarray:
    """Covariance that white noise adds in one sample of x' = A x + G w.

    Qd = integral of exp(A s) G Q G' exp(A' s) over 0..dt, Q the intensity of w: exact for any dt,
    stiff systems too, and positive semidefinite as it is formed as a square.

    Parameters
    ----------
    A : array, shape (n, n)
    G : array, shape (n, q)
        Where the noise enters.
    intensity : float or array, shape (q, q), symmetric and positive semidefinite
    dt : float > 0 [s]

    Returns
    -------
    array, shape (n, n)

    Raises
    ------
    TypeError, ValueError
        A shape is wrong, the intensity is no covariance, or an unstable system grows beyond
        the largest number within dt.

    Notes
    -----
    A root of the covariance of a short time, from Gauss-Legendre quadrature, is doubled:
    Qd(2 h) = Qd(h) + F Qd(h) F' with F = exp(A h), kept as F - I so that slow modes beside fast
    ones lose nothing. One exponential of (-A, G Q G'; 0, A'), as often printed, holds exp(-A dt)
    and loses all digits of a stable stiff system.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395 (integrals with exponentials, and their
    doubling).

    Examples
    --------
    >>> discretize_noise([[0, 1], [0, 0]], [[0], [1]], 3.0, 2.0).round(9).tolist()
    [[8.0, 6.0], [6.0, 6.0]]
    """
    A = _validate.real_array("A", _validate.square("A", A))
    n = len(A)
    if n == 0:
        raise ValueError("A must have at least one row, got none")
    G = _validate.real_array("G", G, (n, None))
    Q = covariance_matrix("intensity", intensity, G.shape[1])
    dt = _validate.positive("dt", dt)
    # By logarithms, as the product may overflow; |A| <= n max |A_ij|.
    size = np.log2(np.abs(A).max(initial=0.0) or 1e-300) + np.log2(n / _SHORT) + np.log2(dt)
    doublings = max(0, int(np.ceil(size)))
    h = np.ldexp(dt, -doublings)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    G = G @ square_root(Q)
    with np.errstate(all="ignore"):
        at_nodes = [G + _growth(A * (h * (1 + node) / 2)) @ G for node in nodes]
        root = np.hstack([F * np.sqrt(h * w / 2) for F, w in zip(at_nodes, weights, strict=True)])
        D = _growth(A * h)
        # Loop invariant: root root' is the covariance of a time h 2^k, D = exp(A h 2^k) - I.
        for _ in range(doublings):
            root = np.hstack([root + D @ root, root])
            if not np.isfinite(root).all():
                break
            root = np.asarray(np.linalg.qr(root.T, mode="r")).T
            D = 2 * D + D @ D
        Qd = root @ root.T
    if not np.isfinite(Qd).all():
        raise ValueError(f"dt must be shorter: after {dt:g} s the covariance overflows")
    return (Qd + Qd.T) / 2


def _growth(M: np.ndarray) -> np.ndarray:
    """Return exp(M) - I for a small M, each entry to its own precision."""
    term = total = M
    for k in range(2, _TERMS):
        term = term @ M / k
        total = total + term
    return total
