"""Verdicts on rational matrices in exact arithmetic: a proof, without a tolerance."""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from math import lcm
from typing import Any

import numpy as np
import scipy

from statebook.verdict.judgement import (
    ASYMPTOTICALLY_STABLE,
    MARGINALLY_STABLE,
    UNSTABLE,
    Judgement,
    explain,
    judge,
)
from statebook.verdict.level_sets import margin, project

# Beyond this the numbers become long: seconds turn into minutes.
LARGEST = 30
_DIGITS = (20, 80, 320, 1280)
# An eigenvalue farther from the boundary than this, relatively, is beyond doubt there.
_CERTAIN = 1e-6


@dataclass(frozen=True)
class RationalMatrix:
    """A square matrix of complex rational numbers.

    Attributes
    ----------
    real, imag : tuple of tuple of fractions.Fraction
        Its entries, row by row; imag is empty if all are real.
    """

    real: tuple[tuple[Fraction, ...], ...]
    imag: tuple[tuple[Fraction, ...], ...] = ()

    def floats(self) -> np.ndarray:
        """The nearest array of floats."""
        try:
            parts = [np.array(part, dtype=float) for part in (self.real, self.imag) if part]
        except OverflowError as error:
            raise ValueError(
                "system_or_A must hold numbers below 1.8e308; choose another unit"
            ) from error
        return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]


def as_rational(value: Any, *, floats: bool = False) -> RationalMatrix | None:
    """Return a matrix as it was written, or None where it holds floats.

    Parameters
    ----------
    value : array_like, or a SymPy matrix
        Integers, `fractions.Fraction`, `decimal.Decimal` and SymPy's rationals are exact.
    floats : bool
        Take floats at their word: 0.1 is 3602879701896397 / 2^55.

    Returns
    -------
    RationalMatrix or None
        None also where the value is no square matrix of finite numbers.

    Raises
    ------
    ValueError
        A SymPy entry has a free symbol or is irrational.

    Examples
    --------
    >>> as_rational([[1, Fraction(1, 3)], [0, -1]]).real[0]
    (Fraction(1, 1), Fraction(1, 3))
    >>> as_rational([[0.5]]) is None
    True
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in "fc" and not floats:
        return None
    rows = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(rows, list | tuple) or len(rows) == 0:
        return None
    rows = [row.tolist() if hasattr(row, "tolist") else row for row in rows]
    if not all(isinstance(row, list | tuple) and len(row) == len(rows) for row in rows):
        return None
    found = [[_entry(number, floats) for number in row] for row in rows]
    entries = [[entry for entry in row if entry is not None] for row in found]
    if entries != found:
        return None
    real, imag = (tuple(tuple(entry[k] for entry in row) for row in entries) for k in (0, 1))
    return RationalMatrix(real, imag if any(map(any, imag)) else ())


def _entry(number: Any, floats: bool) -> tuple[Fraction, Fraction] | None:
    """Real and imaginary part of an entry, or None if it is not exact."""
    if isinstance(number, numbers.Rational):
        return Fraction(int(number.numerator), int(number.denominator)), Fraction(0)
    if isinstance(number, Decimal) and number.is_finite():
        return Fraction(number), Fraction(0)
    if isinstance(number, numbers.Complex):
        number = complex(number)
        finite = floats and np.isfinite(number)
        return (Fraction(number.real), Fraction(number.imag)) if finite else None
    if not hasattr(number, "free_symbols"):
        return None
    if number.free_symbols:
        names = ", ".join(sorted(map(str, number.free_symbols)))
        raise ValueError(
            f"system_or_A must hold numbers, got the free symbols {names} in the entry {number};"
            " give them values first: matrix.subs({...})"
        )
    parts = [part if part.is_Float else part.simplify() for part in number.as_real_imag()]
    if not all(part.is_Rational or part.is_Float for part in parts):
        raise ValueError(
            f"system_or_A must hold rational numbers, got the entry {number}, which is none;"
            " for its nearest float, pass numpy.array(matrix, dtype=float)"
        )
    if any(part.is_Float for part in parts):
        return _entry(complex(number), floats)
    return Fraction(int(parts[0].p), int(parts[0].q)), Fraction(int(parts[1].p), int(parts[1].q))


def judge_exactly(matrix: RationalMatrix, discrete: bool) -> Judgement:
    """Judge a rational matrix by exact arithmetic.

    Eigenvalues inside, on and beyond the boundary are counted, from square-free factors of the
    characteristic polynomial. What a factor shares with its mirror image (s to -s, z to 1/z)
    are roots on the boundary, which Sturm's theorem counts, and pairs of which one is beyond;
    the rest is Cauchy's index of the boundary's image. For maps, z = (1 + s) / (1 - s), with
    z = -1 taken out before. A multiple eigenvalue on the boundary is semisimple if its
    factor's simple power has the null space of the whole, that is if it is a simple factor of
    the minimal polynomial.

    Raises
    ------
    ValueError
        The matrix is larger than 30 x 30.

    References
    ----------
    Gantmacher, *The Theory of Matrices*, volume 2, chapter XV (Routh's problem and its
    singular cases); Jury, *Theory and Application of the z-Transform Method*, chapter 3.
    """
    n = len(matrix.real)
    if n > LARGEST:
        raise ValueError(
            f"exact=True is for matrices up to {LARGEST} x {LARGEST}, got {n} x {n}: beyond, its"
            " long integers take minutes; leave it out for a verdict in double precision"
        )
    A = matrix.floats()
    judged = judge(A, discrete, check_distance=False)
    if n == 0:
        return judged
    M, unit, factors = _factors(matrix)
    counts = [_count(factor, discrete) for factor, _ in factors]
    total = np.array(counts).T @ [multiplicity for _, multiplicity in factors]
    total = total * n // total.sum()  # complex matrices are judged beside their conjugates
    values, margins = _placed(judged.eigenvalues, total, discrete) or _computed(
        judged.eigenvalues, factors, counts, discrete
    )
    repeated = [found for found in factors if found[1] > 1 and total[2] == 0]
    jordan = [z for found in repeated for z in _jordan_points(M, unit, *found, values, discrete)]
    if total[2] or jordan:
        verdict = UNSTABLE
    else:
        verdict = MARGINALLY_STABLE if total[1] else ASYMPTOTICALLY_STABLE
    size = float(margins.min())
    worst = np.array(jordan) if jordan else values[margins == size]
    reason = explain(verdict, worst, size, 0.0, values, discrete, exact=True)
    reason += " Proved in exact arithmetic."
    return Judgement(verdict, reason, values, judged.participations, size, jordan=tuple(jordan))


def _placed(
    values: np.ndarray, count: np.ndarray, discrete: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """Eigenvalues in double precision and their margins, if they agree with the exact count."""
    margins = margin(values, discrete)
    nearest = np.argsort(np.abs(margins), kind="stable")
    on, rest = nearest[: count[1]], nearest[count[1] :]
    if np.any(np.abs(margins[rest]) <= _CERTAIN * np.abs(values).max()):
        return None
    if (np.sum(margins[rest] > 0), np.sum(margins[rest] < 0)) != (count[0], count[2]):
        return None
    values = values.copy()
    values[on] = project(values[on], discrete)
    margins[on] = 0.0
    return values, margins


def _computed(
    guesses: np.ndarray,
    factors: list[tuple[Any, int]],
    counts: list[tuple[int, int, int]],
    discrete: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues as the roots of their polynomials, in the order of the guesses."""
    found = [
        np.repeat(_roots(factor, guesses, count, discrete), multiplicity, axis=1)
        for (factor, multiplicity), count in zip(factors, counts, strict=True)
    ]
    values, margins = np.hstack(found)
    _, order = scipy.optimize.linear_sum_assignment(np.abs(guesses[:, None] - values))
    return values[order], margins[order].real


def _factors(matrix: RationalMatrix) -> tuple[Any, int, list[tuple[Any, int]]]:
    """An integer multiple of the matrix, the factor, and what its eigenvalues are roots of."""
    from sympy import QQ, ZZ, Poly, Symbol
    from sympy.polys.matrices import DomainMatrix

    n, x = len(matrix.real), Symbol("x")
    unit = lcm(*(f.denominator for part in (matrix.real, matrix.imag) for r in part for f in r))
    real, imag = (
        [[int(f * unit) for f in row] for row in part] for part in (matrix.real, matrix.imag)
    )
    if imag:
        upper = [a + [-b for b in c] for a, c in zip(real, imag, strict=True)]
        real = upper + [c + a for a, c in zip(real, imag, strict=True)]
        n *= 2
    M = DomainMatrix([[ZZ(i) for i in row] for row in real], (n, n), ZZ)
    # Eigenvalues of the matrix are those of M over unit.
    powers = [c * ZZ(unit) ** (n - k) for k, c in enumerate(M.charpoly())]
    _, factors = Poly(powers, x, domain=ZZ).sqf_list()
    return M.convert_to(QQ), unit, factors


def _mirrored(factor: Any, discrete: bool) -> Any:
    """The polynomial of -s, or of 1/z, for every root s or z (but 0)."""
    one, x = factor.one, factor.one * factor.gen
    return factor.transform(one, x) if discrete else factor.transform(-x, one)


def _on_line(factor: Any) -> Any:
    """The polynomial in s of the roots z = (1 + s) / (1 - s); z = -1 is lost, at infinity."""
    x = factor.one * factor.gen
    return factor.transform(1 + x, 1 - x)


def _count(factor: Any, discrete: bool) -> tuple[int, int, int]:
    """How many roots of a square-free polynomial lie inside, on and beyond the boundary."""
    degree = factor.degree()
    on_line = _on_line(factor) if discrete else factor
    on = degree - on_line.degree()
    common = on_line.gcd(_mirrored(on_line, False))
    rest = on_line.quo(common)
    if common.eval(0) == 0:
        on, common = on + 1, common.quo(common.one * common.gen)
    # Even now: a polynomial of s^2, whose negative roots are pairs on the axis.
    even = common.from_list(common.all_coeffs()[::2], common.gen, domain=common.domain)
    pairs = int(even.count_roots(None, 0))
    beyond = even.degree() - pairs
    on += 2 * pairs
    net = _turns(rest)
    beyond += (rest.degree() - net) // 2
    return degree - on - beyond, on, beyond


def _turns(p: Any) -> int:
    """Roots to the left less roots to the right: half turns of p(i omega) along the axis."""
    # i^k is (-1)^(k // 2), times i in the imaginary part.
    signed = [c * (-1) ** (k // 2) for k, c in enumerate(reversed(p.all_coeffs()))]
    odd = p.degree() % 2
    # Where p.degree() is odd the imaginary part has it, and the cotangent is counted.
    chain = [
        p.from_list(
            [c if k % 2 == part else 0 for k, c in enumerate(signed)][::-1], p.gen, domain="QQ"
        )
        for part in (odd, 1 - odd)
    ]
    while not chain[-1].is_zero:
        chain.append(-chain[-2].rem(chain[-1]))
    after = [bool(q.LC() > 0) for q in chain[:-1]]
    before = [positive != q.degree() % 2 for positive, q in zip(after, chain, strict=False)]
    index = sum(a != b for a, b in pairwise(before)) - sum(a != b for a, b in pairwise(after))
    return index if odd else -index


def _roots(
    factor: Any, guesses: np.ndarray, count: tuple[int, int, int], discrete: bool
) -> tuple[list[complex], list[float]]:
    """Roots and their margins, with as many digits as it takes to agree with the count."""
    import mpmath

    coefficients = [int(c) for c in factor.all_coeffs()]
    for digits in _DIGITS:
        with mpmath.workdps(digits):
            starts = sorted(
                map(mpmath.mpmathify, guesses.tolist()),
                key=lambda z: abs(mpmath.polyval(coefficients, z)),
            )[: factor.degree()]
            apart = mpmath.mpf(1e-6) * max(map(abs, starts)) + mpmath.mpf(1e-30)
            starts = [z + k * apart * (1 + 0.1j) for k, z in enumerate(starts)]
            try:
                roots = mpmath.polyroots(
                    coefficients, maxsteps=300, extraprec=4 * digits, roots_init=starts
                )
            except mpmath.libmp.NoConvergence:
                continue
            margins = [1 - abs(root) if discrete else -mpmath.re(root) for root in roots]
            nearest = sorted(range(len(roots)), key=lambda k: abs(margins[k]))
            for k in nearest[: count[1]]:
                margins[k] = mpmath.mpf(0)
                roots[k] = roots[k] / abs(roots[k]) if discrete else 1j * mpmath.im(roots[k])
            found = sum(m > 0 for m in margins), sum(m < 0 for m in margins)
        if found == (count[0], count[2]):
            # A margin that underflows keeps its sign.
            distances = [float(m) or float(mpmath.sign(m)) * 5e-324 for m in margins]
            return [complex(root) for root in roots], distances
    raise RuntimeError(
        f"the eigenvalues were counted ({count[0]} inside, {count[1]} on the boundary,"
        f" {count[2]} beyond) but not found with {_DIGITS[-1]} digits; use exact=False"
    )


def _jordan_points(
    M: Any, unit: int, factor: Any, multiplicity: int, values: np.ndarray, discrete: bool
) -> list[complex]:
    """Boundary eigenvalues, roots of a factor that has none beyond, with Jordan blocks."""
    common = factor.gcd(_mirrored(factor, discrete))
    points: list[complex] = []
    for irreducible, _ in common.factor_list()[1]:
        degree = irreducible.degree()
        if degree and _nullity(irreducible, M, unit) < multiplicity * degree:
            roots, _ = _roots(irreducible, values, (0, degree, 0), discrete)
            points += [z for z in values if np.abs(np.array(roots) - z).min() <= 1e-6 * abs(z)]
    return points


def _nullity(polynomial: Any, M: Any, unit: int) -> int:
    """Dimension of the null space of polynomial(M / unit), by Horner's rule."""
    identity, value = M.eye(M.shape, M.domain), M.zeros(M.shape, M.domain)
    for k, c in enumerate(polynomial.all_coeffs()):
        value = value * M + identity * (M.domain(int(c)) * M.domain(unit) ** k)
    return int(M.shape[0] - value.rank())
