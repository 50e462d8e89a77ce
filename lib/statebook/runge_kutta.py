"""Runge-Kutta methods: tableaus, stability functions, amplification matrices."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from statebook import _validate

SEMI_IMPLICIT_EULER = "semi_implicit_euler"


@dataclass(frozen=True, repr=False)
class ButcherTableau:
    """A Runge-Kutta method, given by its coefficients.

    One step of length h is
    ``k_i = f(x + h sum_j A_ij k_j, t + c_i h)``, ``x_next = x + h sum_i b_i k_i``.
    Coefficients are kept as exact fractions, so that the stability function is exact too.

    Parameters
    ----------
    name : str
        Name of the method.
    A : sequence of s sequences of s numbers
        Weights of the stages in each stage; fractions, "1/3" and floats are all taken exactly.
    b, c : sequence of s numbers
        Weights of the stages in the step, and their times in units of the step.
    order : int > 0
        Order of convergence: the error at a fixed time is O(h^order).
    b_embedded : sequence of s numbers, optional
        Weights of a second solution of lower order, whose difference from the first estimates
        the error (an embedded pair).

    References
    ----------
    Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, section II.1.

    Examples
    --------
    >>> rk4 = METHODS["rk4"]
    >>> rk4
    ButcherTableau('rk4', 4 stages, order 4, explicit)
    >>> (rk4.numerator * [1, 1, 2, 6, 24]).tolist()
    [1.0, 1.0, 1.0, 1.0, 1.0]
    """

    name: str
    A: Sequence[Sequence[Any]]
    b: Sequence[Any]
    c: Sequence[Any]
    order: int
    b_embedded: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        _validate.integer("order", self.order, 1)
        A = tuple(_fractions("A", row) for row in self.A)
        names = ("b", "c") if self.b_embedded is None else ("b", "c", "b_embedded")
        vectors = {name: _fractions(name, getattr(self, name)) for name in names}
        vars(self).update(A=A, **vectors)
        lengths = [len(row) for row in (*A, *vectors.values())]
        if set(lengths) != {len(A)}:
            raise ValueError(
                f"a tableau of {len(A)} stages needs rows of A, b and c of that length, "
                f"got lengths {lengths}"
            )

    def __repr__(self) -> str:
        kind = "explicit" if self.explicit else "implicit"
        stages = f"{self.stages} stage{'s' if self.stages > 1 else ''}"
        return f"ButcherTableau({self.name!r}, {stages}, order {self.order}, {kind})"

    @property
    def stages(self) -> int:
        """Number of stages s."""
        return len(self.b)

    @property
    def explicit(self) -> bool:
        """True if each stage needs only the stages before it."""
        return not any(self.A[i][j] for i in range(self.stages) for j in range(i, self.stages))

    @cached_property
    def numerator(self) -> np.ndarray:
        """Coefficients of det(I - z A + z e b^T), ascending powers of z."""
        return _determinant(np.array(self.A) - np.array(self.b))

    @cached_property
    def denominator(self) -> np.ndarray:
        """Coefficients of det(I - z A), ascending powers of z."""
        return _determinant(np.array(self.A))

    def stability_function(self, z: complex | np.ndarray) -> complex | np.ndarray:
        """Growth factor R(z) of one step on x' = lambda x, z = h lambda.

        ``R(z) = det(I - z A + z e b^T) / det(I - z A)``, infinite at a pole.

        Parameters
        ----------
        z : complex or array
            Step times eigenvalue.

        Returns
        -------
        complex or array
            R(z), of the shape of z; real for real z.

        References
        ----------
        Hairer and Wanner, *Solving Ordinary Differential Equations II*, section IV.3.

        Examples
        --------
        >>> METHODS["euler"].stability_function(-2.0)
        -1.0
        """
        z = np.asarray(_validate.array("z", z))
        top = np.polynomial.polynomial.polyval(z, self.numerator)
        bottom = np.polynomial.polynomial.polyval(z, self.denominator)
        pole = bottom == 0
        ratio = np.where(pole, np.inf, top / np.where(pole, 1.0, bottom))
        return ratio if ratio.ndim else ratio.item()


def _fractions(name: str, values: Any) -> tuple[Fraction, ...]:
    try:
        return tuple(Fraction(value) for value in values)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{name} must hold finite numbers, got {values!r}") from error


def _determinant(M: np.ndarray) -> np.ndarray:
    """Coefficients of det(I - z M), ascending, by Faddeev and LeVerrier in exact fractions."""
    coefficients, product = [Fraction(1)], 0 * M
    for power in range(1, len(M) + 1):
        # Invariant: product = M^(p-1) + c_1 M^(p-2) + ... + c_(p-1) I, then multiplied by M.
        product = M @ (product + np.diag([coefficients[-1]] * len(M)))
        coefficients.append(-np.trace(product) / power)
    while coefficients[-1] == 0:
        coefficients.pop()
    result = np.array(coefficients, dtype=float)
    result.setflags(write=False)
    return result


_DORMAND_PRINCE = ButcherTableau(
    "dopri5",
    [
        [0, 0, 0, 0, 0, 0, 0],
        ["1/5", 0, 0, 0, 0, 0, 0],
        ["3/40", "9/40", 0, 0, 0, 0, 0],
        ["44/45", "-56/15", "32/9", 0, 0, 0, 0],
        ["19372/6561", "-25360/2187", "64448/6561", "-212/729", 0, 0, 0],
        ["9017/3168", "-355/33", "46732/5247", "49/176", "-5103/18656", 0, 0],
        ["35/384", 0, "500/1113", "125/192", "-2187/6784", "11/84", 0],
    ],
    ["35/384", 0, "500/1113", "125/192", "-2187/6784", "11/84", 0],
    [0, "1/5", "3/10", "4/5", "8/9", 1, 1],
    order=5,
    b_embedded=["5179/57600", 0, "7571/16695", "393/640", "-92097/339200", "187/2100", "1/40"],
)

_TABLEAUS = (
    ButcherTableau("euler", [[0]], [1], [0], order=1),
    ButcherTableau("midpoint", [[0, 0], ["1/2", 0]], [0, 1], [0, "1/2"], order=2),
    ButcherTableau("heun", [[0, 0], [1, 0]], ["1/2", "1/2"], [0, 1], order=2),
    ButcherTableau(
        "rk4",
        [[0, 0, 0, 0], ["1/2", 0, 0, 0], [0, "1/2", 0, 0], [0, 0, 1, 0]],
        ["1/6", "1/3", "1/3", "1/6"],
        [0, "1/2", "1/2", 1],
        order=4,
    ),
    _DORMAND_PRINCE,
    ButcherTableau("backward_euler", [[1]], [1], [1], order=1),
    ButcherTableau("implicit_midpoint", [["1/2"]], [1], ["1/2"], order=2),
)
#: The Runge-Kutta methods by name.
METHODS = MappingProxyType({tableau.name: tableau for tableau in _TABLEAUS})


def as_tableau(method: str | ButcherTableau) -> ButcherTableau:
    """The tableau of a method's name (a tableau is its own)."""
    if isinstance(method, ButcherTableau):
        return method
    if method == SEMI_IMPLICIT_EULER:
        raise ValueError(
            f"{SEMI_IMPLICIT_EULER} is a partitioned method: it has an amplification_matrix, but "
            "neither a tableau nor a stability function"
        )
    return METHODS[_validate.choice("method", method, (*METHODS, SEMI_IMPLICIT_EULER))]


def stability_function(method: str | ButcherTableau, z: complex | np.ndarray) -> Any:
    """Growth factor R(z) of one step on x' = lambda x, z = h lambda.

    Parameters
    ----------
    method : str or ButcherTableau
        A name in `METHODS`, or a tableau. The partitioned "semi_implicit_euler" has no such
        function: its growth is that of `amplification_matrix`.
    z : complex or array
        Step times eigenvalue.

    Returns
    -------
    complex or array
        R(z), infinite at a pole.

    Examples
    --------
    >>> round(abs(stability_function("rk4", 2j * 2**0.5)), 12)
    1.0
    """
    return as_tableau(method).stability_function(z)


def amplification_matrix(
    A: np.ndarray, dt: float | np.ndarray, method: str | ButcherTableau
) -> np.ndarray:
    """The matrix M of one step x_next = M x of a method on x' = A x.

    ``M = R(dt A)``, the stability function of the method with z replaced by a matrix.
    "semi_implicit_euler" takes the first half of the state for positions q and the second for
    velocities v: ``v_next = v + dt f_v(q, v)``, then ``q_next = q + dt f_q(q, v_next)``.

    Parameters
    ----------
    A : array, shape (..., n, n)
        One matrix or a stack of them.
    dt : float > 0 [s], or array of them
        Step; an array broadcasts against the stack.
    method : str or ButcherTableau
        A name in `METHODS`, "semi_implicit_euler", or a tableau.

    Returns
    -------
    array, shape (..., n, n)
        One-step matrices.

    Raises
    ------
    ValueError
        If A is not square, dt is not positive, n is odd for "semi_implicit_euler", or an
        implicit method has no solution because dt times an eigenvalue is a pole of R.

    Examples
    --------
    >>> amplification_matrix([[0.0, 1.0], [-4.0, 0.0]], 0.5, "semi_implicit_euler").tolist()
    [[0.0, 0.5], [-2.0, 1.0]]
    """
    A = np.asarray(_validate.array("A", A))
    if A.ndim < 2 or A.shape[-1] != A.shape[-2]:
        raise ValueError(f"A must have shape (..., n, n), got {A.shape}")
    dt = np.asarray(_validate.array("dt", dt))
    if np.iscomplexobj(dt) or np.any(dt <= 0):
        raise ValueError(f"dt must be positive, got {dt}")
    Z = dt[..., None, None] * A
    identity = np.broadcast_to(np.eye(A.shape[-1]), Z.shape)
    if method == SEMI_IMPLICIT_EULER:
        half = A.shape[-1] // 2
        if A.shape[-1] % 2:
            raise ValueError(
                f"{SEMI_IMPLICIT_EULER} needs as many positions as velocities, got A {A.shape}"
            )
        kick, drift = identity.copy(), identity.copy()
        kick[..., half:, :] += Z[..., half:, :]
        drift[..., :half, :] += Z[..., :half, :]
        return drift @ kick
    tableau = as_tableau(method)
    top = _matrix_polynomial(tableau.numerator, Z, identity)
    if tableau.explicit:
        return top
    try:
        return np.linalg.solve(_matrix_polynomial(tableau.denominator, Z, identity), top)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"{tableau.name} has no step here: dt times an eigenvalue of A is a pole of R(z); "
            "change dt"
        ) from error


def _matrix_polynomial(coefficients: np.ndarray, Z: np.ndarray, identity: np.ndarray) -> np.ndarray:
    result = coefficients[-1] * identity
    for coefficient in coefficients[-2::-1]:
        result = result @ Z + coefficient * identity
    return result
