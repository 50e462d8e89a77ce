"""Verdicts on matrices whose truth is known by construction, and what a verdict costs.

    python benchmarks/verdicts.py constructed --count 10000
    python benchmarks/verdicts.py margins
    python benchmarks/verdicts.py bodies
    python benchmarks/verdicts.py cost [--largest N] [--figure FILE]
    python benchmarks/verdicts.py files FILE.mat ...

`constructed` draws whole steps and eighths of the circle (tests/constructed.py), rotated or
randomly similar, and as fractions; `margins` a margin from 1e-14 to 1e-2 beside ill-conditioned
eigenvectors; `bodies` chains of masses and rings of generators with rigid-body modes; `cost`
compares with numpy.linalg.eig; `files` judges the matrix A of MATLAB files, such as those of the
SLICOT and COMPleib collections, which are not kept here. --seed draws other matrices.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import statebook as sb  # noqa: E402
from constructed import construct  # noqa: E402

STABLE, MARGINAL, UNSTABLE = "asymptotically stable", "marginally stable", "unstable"


def outcome(report: sb.StabilityReport, verdict: str) -> str:
    if "undecidable" in report.reason:
        return "undecidable"
    return "right" if report.verdict == verdict else "WRONG"


def constructed(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    floats: Counter[str] = Counter()
    exact: Counter[str] = Counter()
    for _ in range(count):
        case = construct(rng)
        A = case.floats(rng)
        result = outcome(report := sb.stability(A, dt=case.dt), case.verdict)
        if case.margin == 0:
            floats[f"on the boundary: {result}"] += 1
            floats["on the boundary, to within tolerance"] += "to within tolerance" in report.reason
        else:
            clear = abs(case.margin) > 1e-6 * np.linalg.norm(A, 2)
            floats[f"margin {'above' if clear else 'below'} 1e-6 norm(A): {result}"] += 1
        fractions = case.fractions(rng).tolist()
        exact[outcome(sb.stability(fractions, dt=case.dt, exact=True), case.verdict)] += 1
    print(f"{count} matrices in floating point")
    show(floats)
    print("the same as fractions, exactly")
    show(exact)


def margins(count: int = 500) -> None:
    rng = np.random.default_rng(1)
    for condition in (1.0, 50.0, 1e3, 1e5):
        seen: Counter[str] = Counter()
        for _ in range(count):
            n = int(rng.integers(2, 9))
            margin = rng.choice([-1, 1]) * 10 ** rng.uniform(-14, -2)
            D = np.diag([-margin, *-rng.uniform(0.1, 3, n - 1)])
            U, W = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
            V = U * np.geomspace(1, condition, n) @ W
            report = sb.stability(V @ D @ np.linalg.inv(V))
            result = outcome(report, STABLE if margin > 0 else UNSTABLE)
            if result == "WRONG" and report.verdict == MARGINAL:
                within = abs(margin) <= report.tolerance
                result = "marginal, within its tolerance" if within else "WRONG"
            seen[result] += 1
        print(f"margins 1e-14 to 1e-2, condition {condition:g}")
        show(seen)


def bodies() -> None:
    for n in (4, 20, 100, 300):
        for name, A, verdict in body_matrices(n):
            start = time.perf_counter()
            report = sb.stability(A)
            print(
                f"n = {n:4}  {name:28} {outcome(report, verdict):12} {report.verdict:24}"
                f" margin {report.spectral_margin:.3g} tolerance {report.tolerance:.2g}"
                f" {time.perf_counter() - start:.3f} s"
            )


def body_matrices(n: int) -> Iterator[tuple[str, np.ndarray, str]]:
    m = n // 2
    zero, one = np.zeros((m, m)), np.eye(m)
    rng = np.random.default_rng(n)
    chain = 2 * one - np.eye(m, k=1) - np.eye(m, k=-1)
    chain[0, 0] = chain[-1, -1] = 1
    mass = rng.uniform(0.5, 2, m)[:, None]
    for name, K, C, verdict in (
        ("chain, free", chain, 0.01 * chain, UNSTABLE),
        ("chain, dampers to the ground", chain, 0.01 * chain + 0.02 * one, MARGINAL),
        ("chain, no damping, wall", chain + np.diag(np.eye(m)[0]), zero, MARGINAL),
        ("chain, wall and dampers", chain + np.diag(np.eye(m)[0]), 0.01 * chain, STABLE),
    ):
        yield name, np.block([[zero, one], [-K / mass, -C / mass]]), verdict
    # Swing equations: angles count as differences only; frequencies are damped.
    links = np.abs(rng.normal(size=(m, m)))
    network = np.diag((links + links.T).sum(axis=1)) - links - links.T
    inertia, damping = rng.uniform(2, 10, m)[:, None], rng.uniform(0.5, 2, m)
    swing = np.block(
        [[zero, 2 * np.pi * 50 * one], [-network / inertia, -np.diag(damping) / inertia]]
    )
    yield "generators", swing, MARGINAL
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    yield "generators, rotated", Q @ swing @ Q.T, MARGINAL


def cost(figure: str | None, largest: int) -> None:
    sizes = [n for n in (2, 4, 10, 30, 100, 300, 1000) if n <= largest]
    kinds: dict[str, Callable[[int], np.ndarray]] = {
        "random": lambda n: np.random.default_rng(n).normal(size=(n, n)) / n**0.5 - 1.2 * np.eye(n),
        "chain of masses": lambda n: next(A for k, A, _ in body_matrices(n) if "wall and" in k),
        **{
            name: (lambda n, make=make: rotated(make(n)))
            for name, make in {
                "Grcar": lambda n: toeplitz(n, 1, -3, -1, -1, -1),
                "Grcar, nearer": lambda n: toeplitz(n, 1, -1.5, -1, -1, -1),
                "convection": lambda n: toeplitz(n, 1.5, -2, 0.5),
                "chain (s + 1)^n": lambda n: toeplitz(n, 0, -1, 1),
                "ones above -1": lambda n: toeplitz(n, 0, -1, *np.ones(n - 1)),
            }.items()
        },
    }
    rows = []
    for kind, make in kinds.items():
        for n in sizes:
            A = make(n)
            repeats = max(1, 1000 // n**2 * 20 if n < 30 else 1000 // n)
            ours, numpys = (timed(f, A, repeats) for f in (sb.stability, np.linalg.eig))
            rows.append((kind, n, ours, numpys))
            print(f"{kind:16} n = {n:5}  stability {1e3 * ours:10.3f} ms  numpy.linalg.eig"
                  f" {1e3 * numpys:10.3f} ms  ratio {ours / numpys:6.1f}")  # fmt: skip
    if figure:
        draw(rows, figure)


def draw(rows: list[tuple[str, int, float, float]], figure: str) -> None:
    """Time of a verdict and of numpy.linalg.eig against the number of states, in one figure."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    for (kind, rest), marker in zip(groupby(rows, key=itemgetter(0)), "osv^D<>", strict=False):
        n, ours, numpys = np.array([row[1:] for row in rest]).T
        (line,) = ax.loglog(n, ours, marker=marker, ms=5, lw=1.2, label=kind)
        ax.loglog(n, numpys, "--", color=line.get_color(), lw=0.9)
    ax.plot([], [], "k-", label="solid: statebook.stability")
    ax.plot([], [], "k--", label="dashed: numpy.linalg.eig")
    ax.set(xlabel="number of states $n$", ylabel="processor time [s]")
    ax.grid(alpha=0.3)
    ax.legend(fontsize="small")
    fig.savefig(figure, dpi=110)


def toeplitz(n: int, below: float, diagonal: float, *above: float) -> np.ndarray:
    first = np.concatenate([[diagonal], above, np.zeros(n)])[:n]
    return scipy.linalg.toeplitz(np.concatenate([[diagonal, below], np.zeros(n)])[:n], first)


def rotated(A: np.ndarray) -> np.ndarray:
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=A.shape))[0]
    return Q @ A @ Q.T


def timed(function: Callable[[np.ndarray], Any], A: np.ndarray, repeats: int) -> float:
    """Median processor time of a call, which a busy machine does not stretch."""
    function(A)
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function(A)
        times.append(time.process_time() - start)
    return float(np.median(times))


def files(paths: list[str]) -> None:
    for path in paths:
        A = scipy.io.loadmat(path)["A"]
        A = A.toarray() if scipy.sparse.issparse(A) else A
        start = time.process_time()
        report = sb.stability(A)
        rightmost = np.linalg.eigvals(A).real.max()
        print(
            f"{Path(path).stem:12} n = {len(A):5}  {report.verdict:22} max Re {rightmost:10.3e}"
            f" tolerance {report.tolerance:.1e} {'?' * ('undecidable' in report.reason):1}"
            f" {time.process_time() - start:.2f} s"
        )


def show(counts: Counter[str]) -> None:
    for name, number in sorted(counts.items()):
        print(f"    {number:6}  {name}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["constructed", "margins", "bodies", "cost", "files"])
    parser.add_argument("paths", nargs="*")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure")
    parser.add_argument("--largest", type=int, default=1000, help="number of states")
    args = parser.parse_args()
    if args.what == "constructed":
        constructed(args.count, args.seed)
    elif args.what == "cost":
        cost(args.figure, args.largest)
    elif args.what == "files":
        files(args.paths)
    else:
        {"margins": margins, "bodies": bodies}[args.what]()
