"""Verdicts on matrices whose spectrum is known, in floating point and in exact arithmetic."""

from fractions import Fraction

import control
import mpmath
import numpy as np
import pytest
import scipy
import sympy

import statebook as sb
from constructed import construct
from statebook.verdict import level_sets
from statebook.verdict.blocks import decompose
from statebook.verdict.clusters import _is_single, _reach, clusters, separated
from statebook.verdict.exact import as_rational
from statebook.verdict.level_sets import _stays_off, boundary_distance, is_near_boundary

STABLE, MARGINAL, UNSTABLE = "asymptotically stable", "marginally stable", "unstable"
UNDECIDABLE = "undecidable in double precision"
F = Fraction


def orthogonal(n, seed):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0]


def similar(D, condition, seed):
    n = len(D)
    V = orthogonal(n, seed) * np.geomspace(1, condition, n) @ orthogonal(n, seed + 1)
    return V @ D @ np.linalg.inv(V)


def jordan(eigenvalue, size):
    return eigenvalue * np.eye(size) + np.eye(size, k=1)


# Clusters


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("spectrum", "dt", "verdict"),
    [
        ([0, -1, -2, -3, -4], None, MARGINAL),
        ([-1, -2, -3, -4, -5, -6, -7], None, STABLE),
        ([1, 0, -1, -2, -3], None, UNSTABLE),
        ([0, 0, -1, -2, -3, -4, -5], None, MARGINAL),
        ([1, 0.75, 0.5, 0.25, 0, -0.25, -0.5], True, MARGINAL),
        ([1, -1, 0.875, 0.5, -0.5, 0], True, MARGINAL),
        ([0.875, 0.75, 0.5, 0, -0.5, -0.875], True, STABLE),
        ([1.125, 1, 0.875, 0.75, 0], True, UNSTABLE),
    ],
)
def test_evenly_spaced_spectra(spectrum, dt, verdict, seed):
    D = np.diag(np.array(spectrum, dtype=float))
    Q = orthogonal(len(D), seed)
    for A in (Q @ D @ Q.T, similar(D, 50.0, seed), 1e6 ** (dt is None) * similar(D, 10.0, seed)):
        report = sb.stability(A, dt=dt)
        assert report.verdict == verdict
        scale = np.linalg.norm(A, 2) / np.linalg.norm(D, 2)
        found = np.sort(report.eigenvalues.real)
        unit = 1e6 if report.eigenvalues.real.min() < -1e3 else 1.0
        assert found / unit == pytest.approx(np.sort(spectrum), abs=1e-9 * scale)
        if verdict == MARGINAL:
            assert "to within tolerance" in report.reason
            assert 0 < report.tolerance < 1e-10 * unit * scale


@pytest.mark.parametrize("seed", range(3))
def test_companion_matrices_of_integer_roots(seed):
    for roots, verdict in (([0, -1, -2, -3, -4], MARGINAL), ([-1, -2, -3, -4], STABLE)):
        A = np.diag(np.ones(len(roots) - 1), 1)
        A[-1] = -np.poly(roots)[:0:-1]
        Q = orthogonal(len(A), seed)
        for B in (A, A.T, Q @ A @ Q.T):
            assert sb.stability(B).verdict == verdict


def test_constructed_matrices_are_never_contradicted():
    rng = np.random.default_rng(13)
    doubted = decided = 0
    for _ in range(400):
        case = construct(rng)
        A = case.floats(rng)
        report = sb.stability(A, dt=case.dt)
        doubt = UNDECIDABLE in report.reason
        assert doubt or report.verdict == case.verdict, A
        if case.margin == 0:
            assert "to within tolerance" in report.reason
        if abs(case.margin) > 1e-6 * np.linalg.norm(A, 2):
            assert doubt or abs(report.spectral_margin - case.margin) <= 1e-6 * np.abs(A).max()
            decided, doubted = decided + 1, doubted + doubt
    assert decided > 150 and doubted <= 0.01 * decided


@pytest.mark.parametrize("condition", [1.0, 30.0, 1e3])
def test_small_margins_are_decided_or_doubted(condition):
    """A margin is certain only where the true one is within tolerance."""
    rng = np.random.default_rng(7)
    seen = set()
    for k in range(150):
        n = int(rng.integers(2, 9))
        margin = rng.choice([-1, 1]) * 10 ** rng.uniform(-14, -2)
        D = np.diag([-margin, *-rng.uniform(0.1, 3, n - 1)])
        report = sb.stability(similar(D, condition, 2 * k))
        truth = STABLE if margin > 0 else UNSTABLE
        if UNDECIDABLE in report.reason:
            seen.add("doubted")
        elif report.verdict == MARGINAL:
            assert abs(margin) <= report.tolerance
        else:
            assert report.verdict == truth
            assert report.spectral_margin == pytest.approx(margin, abs=report.tolerance)
            seen.add(truth)
    assert seen == {"doubted", STABLE, UNSTABLE}


@pytest.mark.parametrize("seed", range(6))
def test_an_eigenvalue_beyond_reach_of_its_conditioning_is_doubted(seed):
    """-1e-10 under a similarity of condition 1e3: rounding of A moves it as far."""
    report = sb.stability(similar(np.diag([-1e-10, -1.0, -2.0, -3.0]), 1e3, seed))
    assert UNDECIDABLE in report.reason or report.verdict == STABLE
    assert "tolerance" in report.reason or report.tolerance <= report.spectral_margin


def test_no_eigenvalue_is_printed_as_zero_where_it_is_not():
    for size in (1e-6, 1e-10, 3e-13):
        report = sb.stability(orthogonal(3, 1) @ np.diag([size, -1, -5.0]) @ orthogonal(3, 1).T)
        assert report.verdict == UNSTABLE
        assert "the eigenvalue 0 lies" not in report.reason
    report = sb.stability(np.array([[1 + 1e-11, 1.0], [0, 0.5]]), dt=True)
    assert "the eigenvalue 1 lies 1e-11 outside" in report.reason


@pytest.mark.parametrize("size", [2, 3, 4, 6])
def test_a_jordan_block_among_others_is_one_cluster(size):
    """The blur of a block of size k is the k-th root of rounding, far from its neighbours."""
    D = scipy.linalg.block_diag(jordan(-1.0, size), [[-2.0]], [[-2.5]], [[-3.0]])
    report = sb.stability(orthogonal(len(D), size) @ D @ orthogonal(len(D), size).T)
    assert report.verdict == STABLE and UNDECIDABLE not in report.reason
    expected = np.array([-1.0] * size + [-2.0, -2.5, -3.0])
    assert report.eigenvalues == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("sizes", [(60,), (20, 7), (12, 12, 1)])
def test_long_chains_are_one_eigenvalue_however_far_rounding_throws_it(sizes):
    """Rounding throws the eigenvalue of a chain of 60 by eps^(1/60) = 0.55."""
    D = scipy.linalg.block_diag(*(jordan(-1.0, size) for size in sizes))
    sharp = 0
    for seed in range(11, 15):
        Q = orthogonal(len(D), seed)
        report = sb.stability(Q @ D @ Q.T)
        assert np.ptp(np.linalg.eigvals(Q @ D @ Q.T).real) > 0.05
        assert report.verdict == STABLE and UNDECIDABLE not in report.reason
        assert abs(report.spectral_margin - 1) <= report.tolerance
        if report.tolerance < 1e-11:  # else rounding hid the chain, and an equation proved it
            sharp += 1
            assert np.ptp(report.eigenvalues) == 0
    assert sharp >= 2


def test_what_is_within_a_radius_of_a_nilpotent_matrix():
    """The nearest one to [[d, 1], [0, -d]] is about d^2 away."""
    near = np.array([[1e-3, 1], [0, -1e-3]], dtype=complex)
    assert _is_single(near, 1e-5) and not _is_single(near, 1e-7)
    Q = orthogonal(9, 3)
    chains = scipy.linalg.block_diag(jordan(0, 5), jordan(0, 3), [[0]])
    for size in (1e-200, 1.0, 1e200):
        N = scipy.linalg.schur(Q @ chains @ Q.T, output="complex")[0] * size
        assert _is_single(N, 1e-13 * size)
        assert not _is_single(N + np.diag(np.arange(9)) * 1e-6 * size, 1e-13 * size)
    # Cube roots of 1, of which sum and sum of squares vanish.
    roots = scipy.linalg.schur(np.roll(np.eye(3), 1, axis=0), output="complex")[0]
    assert not _is_single(roots, 0.1)
    assert all(_is_single(np.zeros((3, 3), dtype=complex), radius) for radius in (1e-300, 1e-12))


@pytest.mark.parametrize("discrete", [False, True])
def test_a_proof_of_stability_contradicts_no_distance(discrete):
    rng = np.random.default_rng(31)
    proved = 0
    for _ in range(60):
        n = int(rng.integers(2, 6))
        T = np.triu(rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n)), 1)
        rate = rng.uniform(0.1, 2, n)
        np.fill_diagonal(T, (np.exp(-rate) if discrete else -rate) * np.exp(1j * rate / 9))
        exact, Q = boundary_distance(T, discrete), orthogonal(n, 8)
        for share in (1e-6, 0.2, 0.9, 1.1, 5.0):
            proof = _stays_off(T, discrete, share * exact)
            proved += proof
            assert not (proof and share > 1) and (proof or share > 1e-6)
            for A in (T, Q @ T @ Q.T):
                assert is_near_boundary(A, discrete, share * exact) == (share > 1)
    assert proved > 65


@pytest.mark.parametrize(("pole", "discrete", "distance"), [(-2.0, False, 2.0), (0.75, True, 0.25)])
def test_the_proof_is_sharp_for_one_state(pole, discrete, distance):
    T = np.array([[pole]], dtype=complex)
    assert _stays_off(T, discrete, 0.999 * distance)
    assert not _stays_off(T, discrete, 1.001 * distance)
    # Nothing is proved where rounding is larger than the margin.
    assert not _stays_off(np.array([[-2e-17 + 1j]]), False, 0.0)
    assert is_near_boundary(np.array([[-1.0, 9], [0, 0.5]]), True, 1e-3)


def toeplitz(n, below, diagonal, above):
    return diagonal * np.eye(n) + below * np.eye(n, k=-1) + sum(
        value * np.eye(n, k=k) for k, value in enumerate(above, 1)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("A", "margin"),
    [
        (toeplitz(60, 1, -3, [-1, -1, -1]), None),
        (toeplitz(60, 1.6e3, -2.6e3, [1e3]), None),
        (toeplitz(60, 0, -1, [0.9]), 1.0),
        (toeplitz(60, 0, -1, [0.9]).T - 0.5 * np.eye(60), 1.5),
    ],
    ids=["Grcar", "convection and diffusion", "chain", "chain, mirrored"],
)
def test_strongly_nonnormal_matrices_are_proved_stable_without_a_search(A, margin, monkeypatch):
    """The symmetric part is negative: so is every real part, and the distance is as large."""
    monkeypatch.setattr(level_sets, "_level_set", None)
    lowest = -np.linalg.eigvalsh((A + A.T) / 2)[-1]
    assert lowest > 1e-3
    Q = orthogonal(len(A), 2)
    for B in (A, Q @ A @ Q.T):
        report = sb.stability(B)
        assert report.verdict == STABLE and UNDECIDABLE not in report.reason
        assert report.spectral_margin >= lowest
        if margin:
            assert report.spectral_margin == pytest.approx(margin, abs=1e-9)


def test_what_no_double_precision_can_decide_is_said_to_be_so_without_a_search(monkeypatch):
    """sigma_min is 2^-n for ones above -1, and less for the companion matrix of (s + 1)^n."""
    monkeypatch.setattr(level_sets, "_level_set", None)
    n = 120
    ones = np.triu(np.ones((n, n)), 1) - np.eye(n)
    Q = orthogonal(n, 5)
    for A in (Q @ ones @ Q.T, scipy.linalg.companion(np.poly(-np.ones(n)))):
        report = sb.stability(A)
        assert UNDECIDABLE in report.reason and report.tolerance >= abs(report.spectral_margin)


@pytest.mark.parametrize("dt", [None, True])
def test_jordan_blocks_on_the_boundary_of_random_similarities(dt):
    pairs = np.kron(jordan(0.0, 2), np.eye(2)) + np.kron(
        np.eye(2), [[0.0, 1.0], [-1.0, 0.0]] if dt is None else [[0.6, -0.8], [0.8, 0.6]]
    )
    double = jordan(0.0 if dt is None else -1.0, 2)
    for seed in range(5):
        for block in (pairs, double):
            D = scipy.linalg.block_diag(block, [[-0.5]], [[-0.25]])
            report = sb.stability(similar(D, 30.0, seed), dt=dt)
            assert report.verdict == UNSTABLE and "with a Jordan block" in report.reason


def test_groups_are_kept_apart_by_every_perturbation():
    """The promise of the discs: as many eigenvalues remain within the reach of each group."""
    rng = np.random.default_rng(3)
    D = scipy.linalg.block_diag(jordan(-1.0, 3), [[-1.5]], [[-1.51]], [[0.3, 1], [-1, 0.3]])
    block = decompose(similar(D, 20.0, 5))[0]
    tol = 1e-9 * block.norm
    _, groups = separated(block, tol, np.zeros(len(D)))
    assert sorted(len(group.members) for group in groups) == [1, 1, 1, 1, 3]
    for _ in range(50):
        E = rng.normal(size=D.shape)
        moved = np.linalg.eigvals(block.matrix + tol / np.linalg.norm(E, 2) * E)
        for group in groups:
            lowest = [
                np.linalg.svd(group.T - z * np.eye(len(group.T)), compute_uv=False)[-1]
                for z in moved
            ]
            assert np.sum(np.array(lowest) <= group.radius) == len(group.members)


def test_a_spread_cluster_is_no_multiple_eigenvalue():
    """Eigenvalues 0 and -1e-8 that rounding mixes: not one of -5e-9, and no verdict."""
    A = orthogonal(2, 0) @ np.array([[0.0, 1.0], [0.0, -1e-8]]) @ orthogonal(2, 0).T
    assert UNDECIDABLE in sb.stability(A).reason
    _, found = clusters(decompose(A), discrete=False)
    assert [len(cluster.members) for cluster in found] == [2]
    assert not found[0].clear


@pytest.mark.parametrize("n", [20, 60])
def test_rigid_body_modes(n):
    """Masses in a row: free they drift; to dampers in the ground they are marginally stable."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[0, 0] = K[-1, -1] = 1.0
    zero, one = np.zeros((n, n)), np.eye(n)
    for damping, verdict in ((0.1 * K, UNSTABLE), (0.1 * one, MARGINAL), (0.1 * K + one, MARGINAL)):
        A = np.block([[zero, one], [-100 * K, -damping]])
        report = sb.stability(A)
        assert report.verdict == verdict and UNDECIDABLE not in report.reason
        assert report.spectral_margin == 0


# Exact verdicts

RESONANCE = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [0, 0, -1, 0]])
MARKOV = [[F(1, 2), F(1, 2), 0], [F(1, 4), F(1, 2), F(1, 4)], [0, F(1, 2), F(1, 2)]]


@pytest.mark.parametrize(
    ("A", "dt", "verdict", "words"),
    [
        ([[0, 1], [-1, 0]], None, MARGINAL, "1j, -1j on the imaginary axis (exactly) without"),
        ([[0, 1], [0, 0]], None, UNSTABLE, "0 on the imaginary axis (exactly) with a Jordan"),
        ([[F(-1, 10**30)]], None, STABLE, "by 1e-30 or more"),
        ([[F(1, 10**30)]], None, UNSTABLE, "lies 1e-30 to the right"),
        ([[F(-1, 10**400)]], None, STABLE, "or more"),
        (RESONANCE, None, UNSTABLE, "with"),
        ([[0, 1, 0], [0, 0, 1], [-1, -1, -1]], None, MARGINAL, "1j, -1j on"),
        # s^4 + 1 and s^4 + s^2 + 1: symmetric about the axis, with a row of zeros in Routh's table.
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0]], None, UNSTABLE, "0.7071 to"),
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, -1, 0]], None, UNSTABLE, "0.5 to"),
        # s^4 + 2 s^3 + 3 s^2 + 6 s + 5: a zero at the head of a row of Routh's table.
        ([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-5, -6, -3, -2]], None, UNSTABLE, "right"),
        ([[-1]], True, MARGINAL, "-1 on the unit circle (exactly) without"),
        ([[-1, 1], [0, -1]], True, UNSTABLE, "-1 on the unit circle (exactly) with a Jordan"),
        ([[-1, 0], [0, -1]], True, MARGINAL, "without"),
        ([[F(3, 5), F(-4, 5)], [F(4, 5), F(3, 5)]], True, MARGINAL, "0.6 + 0.8j"),
        ([[0, 1, 0], [0, 0, 1], [0, 0, 0]], True, STABLE, "by 1 or more"),
        (MARKOV, 0.1, MARGINAL, "1 on"),
        (np.roll(np.eye(6, dtype=int), 1, 0), True, MARGINAL, "1, "),
        (sympy.Matrix([[sympy.I, 1], [0, sympy.I]]), None, UNSTABLE, "1j on the imaginary axis"),
        (sympy.Matrix([[sympy.I, 0], [0, -1 + sympy.I]]), None, MARGINAL, "1j on"),
        (sympy.Matrix([[sympy.Rational(-1, 3), 5], [0, -2]]), None, STABLE, "0.3333"),
    ],
)  # fmt: skip
def test_exact_verdicts(A, dt, verdict, words):
    report = sb.stability(A, dt=dt)
    assert report.verdict == verdict
    assert words in report.reason and "Proved in exact arithmetic." in report.reason
    assert report.tolerance == 0
    assert (report.spectral_margin > 0) == (verdict == STABLE)


def test_exact_arithmetic_is_right_on_constructed_matrices():
    rng = np.random.default_rng(31)
    seen = set()
    for _ in range(150):
        case = construct(rng)
        A = case.fractions(rng)
        report = sb.stability(A.tolist(), dt=case.dt, exact=True)
        assert report.verdict == case.verdict, A
        assert report.spectral_margin == pytest.approx(case.margin, rel=1e-9, abs=1e-300)
        seen.add((case.verdict, case.discrete, case.jordan))
    assert len(seen) >= 10


def test_floats_at_their_word():
    """0.1 + 0.2 - 0.3 is 5.6e-17 and not 0: exactly, the eigenvalue lies to the right."""
    A = np.array([[0.1 + 0.2 - 0.3, 1.0], [0.0, -1.0]])
    assert sb.stability(A, exact=True).verdict == UNSTABLE
    assert UNDECIDABLE in sb.stability(A).reason
    plant = control.ss([[0.0, 1.0], [-1.0, 0.0]], [[0], [1]], [[1, 0]], [[0]])
    for system in (plant, plant.A):
        assert "exactly" in sb.stability(system, exact=True).reason
        assert "to within tolerance" in sb.stability(system).reason
    assert "to within tolerance" in sb.stability([[0, 1], [-1, 0]], exact=False).reason


def test_eigenvalues_of_an_exact_verdict_have_all_digits():
    """A Jordan block of size 5 blurs by 1e-3; -1e-9 beside -1 needs a proof of its side."""
    D = scipy.linalg.block_diag(-np.eye(5, dtype=int) + np.eye(5, k=1, dtype=int), [[-3]])
    L = np.tril(np.ones((6, 6), dtype=int))
    A = L @ D @ np.round(np.linalg.inv(L)).astype(int)
    assert np.abs(np.linalg.eigvals(A) + 1)[1:].max() > 1e-6
    found = sb.stability(A).eigenvalues
    assert found == pytest.approx(np.array([-1.0] * 5 + [-3.0]), abs=1e-12)
    near = [[F(-1, 10**9), 1], [0, F(-1, 10**9) - F(1, 10**20)]]
    assert sb.stability(near).spectral_margin == pytest.approx(1e-9, rel=1e-12)


@pytest.mark.parametrize(
    ("A", "error", "message"),
    [
        (sympy.Matrix([[sympy.Symbol("k"), 1], [0, -1]]), ValueError, "free symbols k"),
        (sympy.Matrix([[sympy.sqrt(2)]]), ValueError, r"sqrt\(2\)"),
        ([[sympy.pi, 0], [0, 1]], ValueError, "entry pi"),
        (np.eye(31), ValueError, "up to 30 x 30, got 31"),
        ([[10**400]], ValueError, "1.8e308"),
        ([[np.nan]], ValueError, "finite"),
        ([["a"]], TypeError, "numbers"),
        ([[1, 2], [3]], TypeError, "ragged"),
        ([[1, 2, 3], [4, 5, 6]], ValueError, "square"),
        (sb.Pendulum(), ValueError, "Pendulum"),
    ],
)
def test_what_is_not_rational_is_refused_by_name(A, error, message):
    point = [np.pi / 2, 0] if isinstance(A, sb.Pendulum) else None
    with pytest.raises(error, match=message):
        sb.stability(A, point, exact=True)


def test_exactness_of_input():
    assert as_rational([[1, F(1, 2)], [0, 1]]) is not None
    assert as_rational(np.array([[1.0]])) is None and as_rational([[1, 0.5], [0, 1]]) is None
    assert as_rational(np.array([[0.5j]]), floats=True).imag == ((F(1, 2),),)
    assert sb.stability([[F(-1, 2), 0.5], [0, -1]]).spectral_margin == 0.5
    assert sb.stability(-np.eye(31, dtype=int)).verdict == STABLE
    with pytest.raises(TypeError, match="exact must be None, True or False"):
        sb.stability([[1]], exact="yes")
    for function in (sb.distance_to_instability, lambda A: sb.critical_step(A, "euler")):
        assert function([[F(-1, 2)]]) > 0


# Reports


def test_reports_for_a_page():
    report = sb.stability(np.array([[0.0, 1.0], [-10.0, -1.0]]))
    html = report._repr_html_()
    assert "overflow-x:auto" in html and html.count("<tr>") == 3 and "x[0], x[1]" in html
    lines = report.to_markdown().splitlines()
    assert lines[0] == "**asymptotically stable (spectral margin 0.5)**"
    assert lines[4].startswith("| eigenvalue | damping") and lines[5] == "| --- |" + " --- |" * 4
    assert lines[6] == r"| -0.5 + 3.122j | 0.1581 | 3.162 | 2 | x\[0\], x\[1\] |"
    many = sb.stability(-np.diag(np.arange(1.0, 20.0)))
    assert "and 7 more" in many.to_markdown() and "and 7 more" in many._repr_html_()
    names = control.ss([[-1.0]], [[1]], [[1]], [[0]], states=["a<b|c_d"])
    assert "a&lt;b|c_d" in sb.stability(names)._repr_html_()
    assert r"a\<b\|c\_d" in sb.stability(names).to_markdown()
    empty = sb.stability(np.zeros((0, 0)))
    assert "nothing that could grow" in empty.to_markdown() and empty._repr_html_()


def test_what_is_blurred_inside_leaves_no_doubt_about_what_is_on_the_boundary():
    """A chain at -0.15 is thrown by 0.05, and a bound of the throw reaches across: a proof not."""
    Q = orthogonal(10, 3)
    A = scipy.linalg.block_diag(Q @ jordan(-0.15, 10) @ Q.T, [[0.0]])
    report = sb.stability(A)
    assert report.verdict == MARGINAL and UNDECIDABLE not in report.reason


def test_long_arithmetic_finds_roots_only_where_double_precision_leaves_a_doubt(monkeypatch):
    tiny = sb.stability([[F(-1, 10**400)]])
    assert tiny.verdict == STABLE and tiny.spectral_margin == 5e-324
    monkeypatch.setattr(mpmath, "polyroots", None)
    companion = [[0, 1, 0], [0, 0, 1], [-6, -11, -6]]
    assert sb.stability(companion).spectral_margin == pytest.approx(1, rel=1e-12)
    halves = [[F(x, 12) for x in row] for row in [[6, 1, 0], [0, 4, 1], [0, 0, -3]]]
    assert sb.stability(halves, dt=True).spectral_margin == pytest.approx(0.5, rel=1e-12)
    assert sb.stability([[F(1, 2), 5], [0, F(-1, 2)]]).spectral_margin == pytest.approx(-0.5)


@pytest.mark.parametrize("seed", range(6))
def test_beyond_its_reach_no_eigenvalue_is_moved_by_so_little(seed):
    rng = np.random.default_rng(seed)
    p, size = 4, 10.0 ** rng.uniform(-9, -3)
    T = np.triu(rng.normal(size=(p, p)), 1) * 10.0 ** rng.uniform(-2, 2)
    T = T + (0.3 - 0.2j) * np.eye(p)
    for unit in (1e-6, 1.0, 1e6):
        radius = _reach(unit * T, unit * size)
        assert radius == pytest.approx(unit * _reach(T, size), rel=1e-12)
        for z in unit * (0.3 - 0.2j) + 1.001 * radius * np.exp(2j * np.pi * np.arange(8) / 8):
            assert np.linalg.svd(unit * T - z * np.eye(p), compute_uv=False)[-1] > unit * size
