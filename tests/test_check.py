"""check prints what holds and what does not; summary raises."""

from __future__ import annotations

import numpy as np
import pytest

from statebook import check, checking, summary


@pytest.fixture(autouse=True)
def nothing_recorded():
    checking._claims.clear()
    yield
    checking._claims.clear()


@pytest.mark.parametrize(
    ("value", "expected", "relation", "tolerances", "line"),
    [
        (1 + 1e-10, 1, "==", {}, "ok  a: 1 (rtol 1e-09)"),
        (-3e-13, 0, "==", {"rtol": 0, "atol": 1e-9}, "ok  a: 0 (atol 1e-09)"),
        (2, 2, "==", {"rtol": 0}, "ok  a: 2 (exactly)"),
        (0.5, 1, "<", {}, "ok  a: 0.5 < 1"),
        (3e-16, 1e-12, "<", {}, "ok  a: 0 < 1e-12"),
        ([2.0, 3.0], 1, ">", {}, "ok  a: [2, 3] > 1"),
        (2.0, 1.0, "differs", {}, "ok  a: 2 differs 1 (rtol 1e-09)"),
        ("unstable", "unstable", "==", {}, "ok  a: unstable"),
        (True, True, "==", {}, "ok  a: True"),
        (np.inf, np.inf, "==", {}, "ok  a: inf (rtol 1e-09)"),
        (1 + 2j, 1 + 2j, "==", {}, "ok  a: 1+2j (rtol 1e-09)"),
        (np.ones(9), 1, "==", {}, "ok  a: 9 values, all 1 (rtol 1e-09)"),
        (np.arange(9), np.arange(9), "==", {}, "ok  a: 9 values of size 0 to 8 (rtol 1e-09)"),
        (-0.0, 0, "==", {}, "ok  a: 0 (rtol 1e-09)"),
        (1.0, 1.01, "==", {"atol": 0.1}, "ok  a: 1.01 (atol 0.1)"),
    ],
)
def test_claim_that_holds_prints_one_line(capsys, value, expected, relation, tolerances, line):
    check("a", value, expected, relation=relation, **tolerances)
    assert capsys.readouterr().out == line + "\n"


@pytest.mark.parametrize(
    ("value", "expected", "relation"),
    [
        (1 + 1e-8, 1, "=="),
        ([1, 2], [1, 3], "=="),
        (1, 1, "<"),
        (1, 1, ">"),
        ([0, 2], 1, "<"),
        (1, 1, "differs"),
        ("stable", "unstable", "=="),
        (True, False, "=="),
        (True, True, "differs"),
        (np.inf, 1.0, "=="),
    ],
)
def test_claim_that_does_not_hold_prints_it_and_goes_on(capsys, value, expected, relation):
    check("a", value, expected, relation=relation)
    line = capsys.readouterr().out
    assert line.startswith("FAILED  a: ") and "does not hold" in line
    with pytest.raises(AssertionError, match="1 of 1 checks failed:\n  a: "):
        summary()


@pytest.mark.parametrize(
    ("relation", "message"), [("==", r"at \[1, 2\]: 9.0 == 0.0"), ("<", r"at \[1, 2\]: 9.0 < 0.0")]
)
def test_failure_of_a_large_array_names_its_worst_entry(relation, message):
    value = np.zeros((2, 4))
    value[1, 2] = 9.0
    check("a", value, 0.0, relation=relation)
    with pytest.raises(AssertionError, match=message):
        summary()


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((None, 1), {}, "must be about numbers, texts or truth values, got None"),
        (([[1], [1, 2]], 1), {}, "ragged rows"),
        ((1j, 1), {"relation": "<"}, "needs real numbers, got complex"),
        ((1, 1 + 0j), {"relation": ">"}, "needs real numbers, got complex"),
        ((1, 1), {"relation": "<="}, "relation must be one of"),
        ((1, 1), {"rtol": -1}, "rtol must be at least 0"),
        (("a", "b"), {"relation": "<"}, "< needs numbers"),
        ((1 + 2j, 3), {"relation": "<"}, "complex"),
        ((1.0, 3j), {"relation": ">"}, "> needs real numbers"),
        ((np.array([1 + 0j, 2]), [0, 1]), {"relation": ">"}, "complex"),
        ((np.linalg.eigvals([[0, 1], [-1, 0]]), 1), {"relation": "<"}, "complex"),
    ],
)
def test_what_is_no_claim_is_refused(arguments, options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        check("a", *arguments, **options)


@pytest.mark.parametrize("relation", ["==", "differs", "<", ">"])
@pytest.mark.parametrize(("value", "why"), [([1.0, np.nan], "NaN"), ([], "nothing to compare")])
def test_what_is_no_result_never_holds(capsys, value, why, relation):
    check("a", value, 1.0, relation=relation)
    line = capsys.readouterr().out
    assert line.startswith("FAILED  a: ") and why in line
    check("b", 1.0, value, relation=relation)
    assert capsys.readouterr().out.startswith("FAILED  b: ")


def test_summary_counts_and_starts_anew(capsys):
    check("a", 1, 1)
    check("b", 2, 2)
    capsys.readouterr()
    summary()
    assert capsys.readouterr().out == "All checks hold (2).\n"
    summary()
    assert capsys.readouterr().out == "All checks hold (0).\n"


def test_summary_names_each_failure_and_no_other():
    for name, value in (("a", 1), ("b", 2), ("c", 3)):
        check(name, value, 2)
    with pytest.raises(AssertionError, match="2 of 3 checks failed") as failure:
        summary()
    lines = [line.strip()[:2] for line in str(failure.value).splitlines()]
    assert lines[1:] == ["a:", "c:"]


def test_a_cell_that_runs_again_replaces_its_checks(monkeypatch):
    run = iter([1, 1, 2])
    monkeypatch.setattr(checking, "_run", lambda: next(run))
    check("a", 1, 2)
    check("a", 1, 2)  # in a loop: both count
    assert len(checking.recorded()) == 2
    check("a", 2, 2)
    summary()


def test_recorded_claims_keep_their_sides():
    check("a", [1.0, 2.0], 3.0, relation="<", atol=0.5)
    (claim,) = checking.recorded()
    assert (claim.value, claim.expected, claim.relation, claim.atol) == ([1.0, 2.0], 3.0, "<", 0.5)
