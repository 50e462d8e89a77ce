"""Linear and quadratic functions of the state that f conserves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

_LARGEST = 20  # states, up to which invariants are looked for
_ACCURACY = 1e-9  # of a combination of rates that vanishes, against their size


@dataclass(frozen=True)
class Invariants:
    """Functions c = a x + x' P x, one a row, that are constant along every solution.

    Attributes
    ----------
    a : array, shape (r, n)
    P : array, shape (r, n, n), symmetric
    """

    a: np.ndarray
    P: np.ndarray

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Return c, (r, N), at states and inputs (k, N)."""
        x = z[: self.a.shape[1]]
        return self.a @ x + np.einsum("rij,iN,jN->rN", self.P, x, x)

    def gradient(self, z: np.ndarray) -> np.ndarray:
        """Return d c / d z, (r, k), at one z (k,)."""
        n = self.a.shape[1]
        result = np.zeros((len(self.a), z.size))
        result[:, :n] = self.a + 2 * self.P @ z[:n]
        return result


def invariants(
    change: Callable[[np.ndarray, np.ndarray], np.ndarray],
    z: np.ndarray,
    n: int,
    inputs: Sequence[int],
    discrete: bool,
) -> Invariants | None:
    """Find what a system conserves, whatever its free inputs do.

    The change of c vanishes at every state, which is one linear equation a state for the
    coefficients a and P: those that many random states leave open are the invariants.

    Parameters
    ----------
    change : callable
        Maps x (n, N) and u (m, N) to x', or to x_next - x in discrete time, (n, N).
    z : array, shape (n + m,)
        The guess, (x, u).
    n : int
        Number of states.
    inputs : sequence of int
        Components of z that are free inputs.
    discrete : bool

    Returns
    -------
    Invariants or None
        None where there are none, or too many states to look for them.
    """
    if not 0 < n <= _LARGEST:
        return None
    i, j = np.triu_indices(n)
    number = 2 * (n + i.size) + 10
    rng = np.random.default_rng(0)
    size = np.where(z == 0, 1.0, np.abs(z))
    points = np.repeat(z[:, None], number, axis=1)
    vary = [*range(n), *inputs]
    points[vary] += 0.5 * size[vary, None] * rng.uniform(-1, 1, (len(vary), number))
    x, dx = points[:n], change(points[:n], points[n:])
    good = np.isfinite(dx).all(axis=0)
    if np.count_nonzero(good) < n + i.size + 5:
        return None
    x, dx = x[:, good], dx[:, good]
    moving = np.abs(dx).max(axis=1) > 0  # what never moves is a parameter, and keeps nothing
    after = x + dx if discrete else x
    pairs = x[i] * dx[j] + after[j] * dx[i] if discrete else x[i] * dx[j] + x[j] * dx[i]
    table = np.concatenate([dx, pairs]).T
    used = np.concatenate([moving, moving[i] & moving[j]])
    scale = np.abs(table).max(axis=0)
    unit = np.where(scale > 0, scale, 1.0)
    _, values, V = np.linalg.svd((table / unit)[:, used])
    open_ones = V[np.count_nonzero(values > _ACCURACY * values.max(initial=0.0)) :]
    if len(open_ones) == 0:
        return None
    null = np.zeros((len(open_ones), used.size))
    null[:, used] = open_ones / unit[used]
    null, _ = np.linalg.qr(null.T)  # orthonormal coefficients: what can be told apart is
    a, P = null.T[:, :n], np.zeros((null.shape[1], n, n))
    P[:, i, j] += null.T[:, n:] / 2
    P[:, j, i] += null.T[:, n:] / 2
    return Invariants(a, P)
