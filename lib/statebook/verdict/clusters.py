"""Which eigenvalues rounding cannot tell apart, and what is certain of each group of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from statebook.verdict.blocks import Block, assemble, inverse, rounding, spectral_norm
from statebook.verdict.level_sets import is_near_boundary, margin, project

TINY = float(np.finfo(float).tiny)
# A Jordan coupling this many times above rounding is beyond doubt.
_CLEAR = 1e3
# Unit eigenvectors are independent if each has this share that the others do not have.
_INDEPENDENT = 1e-3
# Neighbours whose distances agree to this are equally near.
_AS_NEAR = 1 + 1e-6


@dataclass(frozen=True)
class Cluster:
    """Eigenvalues that rounding may mix with one another or with the boundary, and no others.

    Attributes
    ----------
    block : int
        Number of the block.
    members : array of int
        Their places on the diagonal of the block's Schur form.
    point : complex
        Where they are, without the blur: their mean, or the boundary if the mean is on it.
    side : int
        -1 inside, 0 on the boundary, 1 beyond.
    single : bool
        They are within rounding of one eigenvalue, a multiple one if there are several.
    defective : bool
        They are on the boundary and have a Jordan block of size two or more.
    clear : bool
        Rounding cannot change side and defective.
    spread : float
        How far rounding may move the eigenvalue, or the mean of several.
    share : array, shape (k,)
        Of each of the block's states in their invariant subspace.
    """

    block: int
    members: np.ndarray
    point: complex
    side: int
    single: bool
    defective: bool
    clear: bool
    spread: float
    share: np.ndarray


class Group(NamedTuple):
    """Eigenvalues of a block that rounding keeps apart from all others.

    Their places in its Schur form, a basis of their invariant subspace, the rows that project
    on it, T on it, the norm of the projector, and the size of perturbations of T that rounding
    amounts to.
    """

    members: np.ndarray
    basis: np.ndarray
    dual: np.ndarray
    T: np.ndarray
    sensitivity: float
    radius: float


def clusters(blocks: list[Block], discrete: bool) -> tuple[np.ndarray, list[Cluster]]:
    """Find how far rounding moves each eigenvalue, and the clusters that are not plain.

    An eigenvalue that is separated from all others and from the boundary is plain.

    References
    ----------
    Separation: discs of radius proportional to perturbation times sensitivity, of which a
    connected component keeps its number of eigenvalues (Wilkinson, *The Algebraic Eigenvalue
    Problem*, chapter 2; Demmel, *Applied Numerical Linear Algebra*, theorem 4.5), for several
    eigenvalues in their block form (Feingold and Varga, Pacific J. Math. 12 (1962) 1241). What
    is not separated is joined with its nearest neighbour (Bavely and Stewart, SIAM J. Numer.
    Anal. 16 (1979) 359). Multiplicity and Jordan blocks: the backward error of a staircase
    form (Kagstrom and Ruhe, ACM Trans. Math. Software 6 (1980) 398).
    """
    spreads, found = [], []
    for number, block in enumerate(blocks):
        tol = block.tolerance(discrete)
        spread, groups = separated(block, tol, np.abs(margin(block.T.diagonal(), discrete)))
        for group in groups:
            found.append(_judged(number, block, group, discrete))
            spread[group.members] = found[-1].spread
        spreads.append(spread)
    return np.concatenate(spreads), found


def separated(block: Block, tol: float, margins: np.ndarray) -> tuple[np.ndarray, list[Group]]:
    """Smallest groups of eigenvalues that every perturbation up to tol keeps apart.

    It returns how far each eigenvalue may move, and those groups that are not one eigenvalue
    with a larger margin than that.

    Let V hold orthonormal bases of k invariant subspaces. In X (A + E) V with X the inverse
    of V the rows of group i in X E V are at most ``k tol norm(X_i)``, and norm(X_i) is the
    norm of the spectral projector. With the rows divided by k and the columns multiplied,
    a group whose region at ``2 k tol norm(X_i)`` meets no other's keeps its eigenvalues
    where ``sigma_min(T_i - z I) <= 2 tol norm(X_i)``.
    """
    n = len(block.index)
    vectors, dual = block.modes
    values = block.T.diagonal()
    # Where eigenvectors are parallel their inverse is huge: its square must not overflow.
    sensitivity = np.linalg.norm(np.minimum(np.abs(dual), 1e100), axis=1)
    radius = min(n, 2) * tol * sensitivity
    means, reach, spread = values, n * radius, np.zeros(n)
    members = [np.array([i]) for i in range(n)]
    bases, duals = np.hsplit(block.Q @ vectors, n), np.vsplit(dual @ block.Q.conj().T, n)
    parts = np.hsplit(values[None], n)
    known = dict(zip(map(bytes, members), zip(bases, parts, strict=True), strict=True))
    while True:
        distance = np.abs(means[:, None] - means)
        np.fill_diagonal(distance, np.inf)
        meet = distance <= reach[:, None] + reach
        if not meet.any():
            break
        # Of two that meet, the more sensitive one is joined with what is nearest to it.
        blurred = (meet & (sensitivity[:, None] >= sensitivity)).any(axis=1)
        nearest = distance <= _AS_NEAR * distance.min(axis=1, keepdims=True)
        # What lies within a group can never be kept apart from it.
        links = (nearest & blurred[:, None]) | (distance <= spread[:, None])
        count, labels = scipy.sparse.csgraph.connected_components(links, directed=False)
        joined = [np.flatnonzero(labels == label) for label in range(count)]
        members = [np.sort(np.concatenate([members[i] for i in part])) for part in joined]
        bases, parts = map(list, zip(*(_invariant(block, m, known) for m in members), strict=True))
        whole = bases[0].conj().T if count == 1 else inverse(np.hstack(bases))
        duals = np.split(whole, np.cumsum([len(m) for m in members])[:-1])
        sensitivity = np.array([spectral_norm(dual) for dual in duals])
        means = np.array([T.diagonal().mean() for T in parts])
        spread = np.array([_spread(T) for T in parts])
        sizes = 2 * count * tol * sensitivity
        reach = np.array([_reach(*pair) for pair in zip(parts, sizes, strict=True)])
    groups = []
    for group in zip(members, bases, duals, parts, sensitivity, strict=True):
        place, size = group[0], float(min(len(members), 2) * tol * group[-1])
        radius[place] = size
        if len(place) > 1 or margins[place[0]] <= size:
            groups.append(Group(*group, size))
    return radius, groups


def _invariant(
    block: Block, members: np.ndarray, known: dict[bytes, tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis of the invariant subspace of some eigenvalues, and T on it."""
    key = bytes(members)
    if key not in known:
        # A real matrix has its conjugate pairs side by side; with one subspace the other is known.
        mirrored = members + np.sign(block.T.diagonal()[members].imag).astype(int)
        pair = known.get(bytes(np.sort(mirrored))) if np.isrealobj(block.matrix) else None
        known[key] = (pair[0].conj(), pair[1].conj()) if pair else _orthonormal(block, members)
    return known[key]


def _orthonormal(block: Block, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = len(members)
    if p == len(block.T):
        return block.Q, block.T
    V, R = np.linalg.qr(block.modes[0][:, members])
    if np.abs(R.diagonal()).min() > _INDEPENDENT:
        return block.Q @ V, np.triu(R * block.T.diagonal()[members] @ np.linalg.inv(R))
    # Eigenvectors do not span it, or not well: the Schur form does.
    T, Q = _leading(block, members)
    return Q[:, :p], T[:p, :p]


def _reach(T: np.ndarray, size: float) -> float:
    """Radius around the mean beyond which sigma_min(T - z I) > size.

    With U the strict upper triangle and d the distance from the diagonal, 1 / sigma_min is at
    most the sum of ``norm(U)^l / d^(l + 1)`` over l < p.
    """
    p = len(T)
    share = 1 / (np.arange(p) + 1)
    terms = (p * size) ** share * scipy.linalg.norm(np.triu(T, 1)) ** (1 - share)
    return _spread(T) + float(terms.max())


def _spread(T: np.ndarray) -> float:
    return float(np.abs(T.diagonal() - T.diagonal().mean()).max())


def _leading(block: Block, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Schur form of a block with some eigenvalues moved to the front."""
    select = np.zeros(len(block.T), dtype=np.int32)
    select[members] = 1
    T, Q, *_ = scipy.linalg.lapack.ztrsen(select, block.T, block.Q, job="N")
    return T, Q


def _judged(number: int, block: Block, group: Group, discrete: bool) -> Cluster:
    T, p, radius = group.T, len(group.T), group.radius
    values = T.diagonal()
    mean = complex(values.mean())
    if np.isrealobj(block.matrix) and abs(mean.imag) <= 1e-3 * np.ptp(values.imag):
        mean = complex(mean.real)
    single = p == 1 or _is_single(T - mean * np.eye(p), radius)
    worst = float(np.min(margin(mean if single else values, discrete)))
    point, side, defective = mean, -1 if worst > 0 else 1, False
    on_boundary = complex(project(mean, discrete))
    inside = margin(mean, discrete)
    # The mean stays beyond, or all of them inside.
    certain = -inside > radius or inside > _reach(T, radius)
    if certain or (p > 1 and worst > 0 and not is_near_boundary(T, discrete, radius)):
        clear = True
    elif not single or abs(mean - on_boundary) > _blur(block, group, discrete):
        clear = False
    else:
        couplings = np.linalg.svd(T - on_boundary * np.eye(p), compute_uv=False)
        point, side, defective = on_boundary, 0, bool(couplings[0] > radius) and p > 1
        if defective:
            clear = bool(couplings[-1] <= radius and couplings[-2] > _CLEAR * radius)
        else:
            # A last digit of every entry moves it by no more than rounding of the matrix.
            moved = _moved(group, np.abs(block.matrix))
            clear = moved <= rounding(block.norm, len(block.T), 1.0)
    spread = radius if single else _reach(T, radius)
    share = np.abs((group.basis * group.dual.T).sum(axis=1))
    return Cluster(number, group.members, point, side, single, defective, clear, spread, share)


def _is_single(N: np.ndarray, radius: float) -> bool:
    """Whether N is nilpotent to within radius: null vector by null vector, by staircase."""
    largest = np.abs(N).max()
    if largest <= radius / len(N):
        return True
    N, radius = N / largest, radius / largest
    size = len(N) ** 0.5 * radius
    # With N - E nilpotent trace(N^2) is trace(E (2 N - E)), and norm_F(E) at most this size.
    if abs(np.sum(N * N.T)) > size * (2 * np.linalg.norm(N) + size):
        return False
    start = np.random.default_rng(0).normal(size=len(N)).astype(complex)
    while n := len(N):
        lu, pivots, _ = scipy.linalg.lapack.zgetrf(N)
        pivot = lu.diagonal()
        np.fill_diagonal(lu, np.where(np.abs(pivot) > 1e-3 * radius, pivot, 1e-3 * radius))
        x, chain, k = start[:n], np.zeros((n, n), complex, order="F"), 0
        for adjoint in (2, 0, 2):
            x, _ = scipy.linalg.lapack.zgetrs(lu, pivots, x / np.linalg.norm(x), trans=adjoint)
        # A null vector of N, then those of what N is across the ones before: its chain.
        while k < n:
            found = chain[:, :k]
            x, _ = scipy.linalg.lapack.zgetrs(lu, pivots, x / np.linalg.norm(x))
            for _ in range(2):
                x = x - found @ (x.conj() @ found).conj()
            x /= np.linalg.norm(x)
            rest = N @ x
            rest = np.linalg.norm(rest - found @ (rest.conj() @ found).conj())
            # A chain's errors add up: a new start costs less than they would.
            if rest > (0.03 * radius if k else radius):
                break
            chain[:, k], k = x, k + 1
        if k == 0:
            return False
        across = np.linalg.qr(chain[:, :k], mode="complete")[0][:, k:]
        N = across.conj().T @ N @ across
    return True


def _moved(group: Group, size: np.ndarray) -> float:
    """How far entries that change by 1 part in size move the mean, to first order.

    It is trace(projector E) / p. Entries of a graded matrix may keep it far sharper than the
    norm of E does.
    """
    shares = (np.abs(group.dual) @ size) * np.abs(group.basis).T
    return float(shares.sum()) / len(group.members)


def _blur(block: Block, group: Group, discrete: bool) -> float:
    """What rounding does to the mean of a group as a rule, errors being random."""
    moved = min(_moved(group, block.size), block.norm * group.sensitivity)
    return rounding(max(moved, 1.0) if discrete else moved, len(block.T), block.precision)


def shared_jordan_points(
    A: np.ndarray, blocks: list[Block], found: list[Cluster]
) -> list[tuple[complex, bool]]:
    """Boundary points at which a coupling between blocks makes a Jordan block.

    The clusters are semisimple by themselves, so the null space of G = A - point I is as
    large as they are together if and only if the Schur complement
    ``S = G_mm - G_mo G_oo^-1 G_om`` vanishes (m their directions, o all others). It comes with
    each point whether S is clearly more than rounding of the whole matrix.
    """
    points = []
    rest = [cluster for cluster in found if cluster.side == 0 and not cluster.defective]
    while rest:
        first, *rest = rest
        group = [first] + [c for c in rest if abs(c.point - first.point) <= c.spread + first.spread]
        rest = [c for c in rest if not any(c is member for member in group)]
        strength = _coupling(A, blocks, group) if len(group) > 1 else 0.0
        if strength > 0:
            points.append((first.point, strength > rounding(1.0, len(A))))
    return points


@np.errstate(over="ignore", invalid="ignore")  # with a defective eigenvalue at the point: no matter
def _coupling(A: np.ndarray, blocks: list[Block], group: list[Cluster]) -> float:
    """Largest entry of S, relative to the norm of A; 0 if all are rounding of their own terms."""
    blocks = list(blocks)
    for cluster in group:
        block = blocks[cluster.block]
        T, Q = _leading(block, cluster.members)
        blocks[cluster.block] = replace(block, T=T, Q=Q)
    T, Q, B = assemble(A, blocks)
    start = np.concatenate([[0], np.cumsum([len(block.index) for block in blocks])])
    m = np.concatenate([start[c.block] + np.arange(len(c.members)) for c in group])
    o = np.setdiff1d(np.arange(len(T)), m)
    home = np.searchsorted(start, m, side="right")
    G = T - group[0].point * np.eye(len(T))
    size = np.abs(Q).T @ np.abs(B) @ np.abs(Q)
    # An eigenvalue elsewhere that is blurred onto the point must not divide by zero.
    inverse = scipy.linalg.solve_triangular(G[np.ix_(o, o)] + TINY * np.eye(len(o)), np.eye(len(o)))
    S = G[np.ix_(m, m)] - G[np.ix_(m, o)] @ inverse @ G[np.ix_(o, m)]
    bound = size[np.ix_(m, m)] + size[np.ix_(m, o)] @ np.abs(inverse) @ size[np.ix_(o, m)]
    real = np.abs(S) > rounding(1.0, len(T), blocks[0].precision) * bound
    entries = np.abs(S)[real & (home[:, None] != home)]
    return float(entries.max(initial=0.0) / np.linalg.norm(B)) if len(entries) else 0.0
