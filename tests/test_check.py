"""check asserts what it prints."""

from __future__ import annotations

import numpy as np
import pytest

from statebook import check


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
def test_claim_that_does_not_hold_raises(value, expected, relation):
    with pytest.raises(AssertionError, match="does not hold"):
        check("a", value, expected, relation=relation)


@pytest.mark.parametrize(
    ("relation", "message"), [("==", r"at \[1, 2\]: 9.0 == 0.0"), ("<", r"at \[1, 2\]: 9.0 < 0.0")]
)
def test_failure_of_a_large_array_names_its_worst_entry(relation, message):
    value = np.zeros((2, 4))
    value[1, 2] = 9.0
    with pytest.raises(AssertionError, match=message):
        check("a", value, 0.0, relation=relation)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((np.nan, 1), {}, "must be finite"),
        (([], 1), {}, "nothing to compare"),
        ((None, 1), {}, "array of numbers"),
        ((1, 1), {"relation": "<="}, "relation must be one of"),
        ((1, 1), {"rtol": -1}, "rtol must be at least 0"),
        ((1, 1), {"covers": "12"}, "covers must be a sequence"),
        (("a", "b"), {"relation": "<"}, "< needs numbers"),
        ((1 + 2j, 3), {"relation": "<"}, "no order"),
        ((1.0, 3j), {"relation": ">"}, "> needs real numbers"),
        ((np.array([1 + 0j, 2]), [0, 1]), {"relation": ">"}, "compare their real parts"),
        ((np.linalg.eigvals([[0, 1], [-1, 0]]), 1), {"relation": "<"}, "no order"),
    ],
)
def test_what_is_no_claim_is_refused(arguments, options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        check("a", *arguments, **options)


def test_rows_are_printed(capsys):
    check("a", 1, 1, covers=("22", "E3"))
    assert capsys.readouterr().out == "ok  a: 1 (rtol 1e-09)  [22, E3]\n"
