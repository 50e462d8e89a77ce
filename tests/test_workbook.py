"""The chapters against the ledger and against the rules for stored notebooks."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from pathlib import Path

import pytest

from claims import swaps
from ledger import (
    CHAPTERS,
    NOTEBOOKS,
    Row,
    checks_of,
    faults,
    gaps,
    parts_of,
    read_ledger,
    read_notebook,
    unprinted,
)
from pattern import BUDGETS, departures, kind_of, measures
from statebook.checking import Claim

LEDGER = read_ledger()


def test_ledger_has_every_item_and_erratum():
    assert list(LEDGER) == [str(i) for i in range(1, 95)] + [f"E{i}" for i in range(1, 29)]
    assert {row.kind for row in LEDGER.values()} == {"computed", "editorial", "exercise"}


def test_there_are_chapters():
    assert CHAPTERS, "no chapter found: the tests below would pass for want of anything to test"


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_chapter_covers_its_rows(path):
    assert not gaps(path.stem[:2], [read_notebook(part) for part in parts_of(path)], LEDGER)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: "/".join(path.parts[-2:]))
def test_notebook_is_cleanly_executed(path):
    assert not faults(read_notebook(path))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: "/".join(path.parts[-2:]))
def test_notebook_is_after_the_pattern(path):
    assert not departures(read_notebook(path), kind_of(path))


with_errata = [
    path
    for path in NOTEBOOKS
    if any(
        row[0] == "E" and LEDGER[row].kind == "computed" for row in checks_of(read_notebook(path))
    )
]


@pytest.mark.parametrize("path", with_errata, ids=lambda path: "/".join(path.parts[-2:]))
def test_errata_fail_with_the_two_forms_exchanged(path):
    script = Path(__file__).with_name("claims.py")
    command = [sys.executable, str(script), str(path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr[-3000:]
    assert json.loads(result.stdout.splitlines()[-1]) == []


# ---- the tests above must be able to fail ----


def code(source, count=1, *, printed=(), **metadata):
    """A code cell whose checks printed these names."""
    lines = "".join(f"ok  {name}: 1\n" for name in printed)
    outputs = [{"output_type": "stream", "name": "stdout", "text": [lines]}] if lines else []
    return {
        "cell_type": "code",
        "source": source,
        "execution_count": count,
        "metadata": metadata,
        "outputs": outputs,
    }


def prose(*rows):
    return {"cell_type": "markdown", "source": "text", "metadata": {"covers": list(rows)}}


def notebook(*cells):
    return {"cells": list(cells)}


SMALL = {
    "1": Row("1", ("00",), "editorial", "a word"),
    "2": Row("2", ("00",), "computed", "a number"),
    "94": Row("94", ("00",), "exercise", "exercises"),
    "E1": Row("E1", ("00",), "computed", "a slip"),
}
COMPLETE = notebook(
    prose("1"),
    code("...", printed=["a", "b"], covers={"2": ["a"]}),
    code("...", 2, printed=["printed"], covers={"E1": ["printed"]}),
    code("...", 3, printed=["right"], covers={"E1": ["right"]}),
    code("sb.summary()", 4),
)


def test_complete_chapter_passes():
    assert gaps("00", [COMPLETE], SMALL) == []
    assert gaps("01", [notebook()], SMALL) == []
    assert faults(COMPLETE) == []


def test_rows_may_be_covered_in_the_deeper_part():
    core, deeper = (notebook(*COMPLETE["cells"][i:j]) for i, j in ((0, 2), (2, 5)))
    assert gaps("00", [core, deeper], SMALL) == []
    assert len(gaps("00", [core], SMALL)) == 1


@pytest.mark.parametrize(
    ("dropped", "row"), [(0, "row 1"), (1, "row 2"), (2, "row E1"), (3, "row E1")]
)
def test_uncovered_row_is_found(dropped, row):
    cells = [cell for i, cell in enumerate(COMPLETE["cells"]) if i != dropped]
    problems = gaps("00", [notebook(*cells)], SMALL)
    assert len(problems) == 1 and problems[0].startswith(row)


def test_prose_does_not_cover_a_computed_row():
    cells = [prose("1", "2"), *COMPLETE["cells"][2:]]
    assert [p[:5] for p in gaps("00", [notebook(*cells)], SMALL)] == ["row 2"]


def test_unknown_row_is_found():
    extra = code("...", printed=["c"], covers={"95": ["c"]})
    problems = gaps("00", [notebook(*COMPLETE["cells"], extra)], SMALL)
    assert problems == ["no row 95 in the ledger"]


def test_a_check_that_was_not_printed_is_found():
    cell = code("...", printed=["a b"], covers={"2": ["a"]})
    assert unprinted(notebook(cell)) == [
        "the check 'a' named for row 2 is not in its cell's output"
    ]
    cell["outputs"][0]["text"] = ["FAILED  a: 1 == 2 does not hold\n"]
    assert len(unprinted(notebook(cell))) == 1


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"execution_count": None}, "was not executed"),
        ({"execution_count": 7}, "counts are not 1 to 4"),
        ({"source": "x = 1\n" * 26}, "26 lines"),
        ({"outputs": [{"output_type": "error", "ename": "KeyError"}]}, "holds an error"),
        (
            {"outputs": [{"output_type": "stream", "name": "stderr", "text": ["beware"]}]},
            "holds a warning: beware",
        ),
        (
            {"outputs": [{"output_type": "stream", "name": "stdout", "text": ["FAILED  a: 1"]}]},
            "holds a check that failed",
        ),
        ({"source": "check('a', 1, 1, covers=('2',))"}, "names rows of the ledger in its code"),
    ],
)
def test_fault_is_found(change, problem):
    broken = copy.deepcopy(COMPLETE)
    broken["cells"][1] |= change
    assert problem in faults(broken)[0]


def test_a_notebook_without_a_summary_is_found():
    assert "sb.summary()" in faults(notebook(*COMPLETE["cells"][:-1]))[0]


def test_a_name_that_two_cells_check_is_found():
    again = code("...", 4, printed=["a"])
    cells = [*COMPLETE["cells"][:-1], again, code("sb.summary()", 5)]
    assert faults(notebook(*cells)) == ["two cells check 'a': names must tell checks apart"]


def test_expected_error_is_no_fault():
    wanted = code("1 / 0", tags=["raises-exception"])
    wanted["outputs"] = [{"output_type": "error"}]
    assert faults(notebook(wanted, code("sb.summary()", 2))) == []


# ---- and so must the pattern ----


def figure(count, alt="what is seen", **data):
    meta = {"mystnb": {"image": {"alt": alt}}} if alt else {}
    output = {"output_type": "display_data", "data": {"image/png": "...", **data}}
    return code("plt.show()", count, **meta) | {"outputs": [output]}


def text(source):
    return {"cell_type": "markdown", "source": source, "metadata": {}}


TOP = text(
    "# 00. A title\n\n*About 30 minutes.*\n\n**Before you start:** nothing\n\n"
    "**You will be able to**\n\n1. read"
)
BODY = "\n\nPredict: what?\n\n<details><summary>What you see</summary>\n\nThat.\n\n</details>"
END = "## Where this breaks\n\n## Summary\n\n## Next\n\n## Your turn\n\n" + "word " * 950
PATTERN = [TOP, code("x = 1"), figure(2), text("*Figure 1. A line.*" + BODY), text(END)]


def changed(place, cell):
    return [cell if i == place else old for i, old in enumerate(PATTERN)]


def test_a_chapter_after_the_pattern_passes():
    assert departures(notebook(*PATTERN), "chapter") == []


@pytest.mark.parametrize(
    ("cells", "problem"),
    [
        (changed(2, figure(2, alt="")), "figure 1 has no alt text"),
        (changed(3, text("A line." + BODY)), "figure 1 has no caption"),
        (changed(3, text("*Figure 2. A line.*" + BODY)), "figure 1 has no caption"),
        (
            changed(3, text("*Figure 1.*\n\nPredict: it falls.")),
            "no question: 'Predict: it falls.'",
        ),
        (changed(3, text("*Figure 1.*")), "nothing to predict"),
        (changed(3, text("*Figure 1.*\n\nPredict: what?")), "1 times Predict, fewer answers"),
        (changed(4, text(END.replace("## Next", ""))), "the section 'Next' is missing"),
        (changed(4, text(END[:60])), "words: "),
        (changed(0, text("# 00. A title")), "'**Before you start' is missing"),
        (changed(1, code("x = 1\n" * 151)), "lines: 152, at most 150"),
        ([*PATTERN, *[code("x = 1", k) for k in range(3, 23)]], "cells: 22, at most 20"),
        ([*PATTERN, *[code("x = 1\n" * 9, k) for k in (3, 4, 5)]], "median: 9, at most 8"),
    ],
)
def test_a_departure_is_found(cells, problem):
    assert any(problem in found for found in departures(notebook(*cells), "chapter"))


def test_folded_code_does_not_count_as_in_view():
    folded = code("x = 1\n" * 200, 3, tags=["hide-input"])
    assert departures(notebook(*PATTERN, folded), "chapter") == []
    assert measures(notebook(*PATTERN, folded))["cells"] == 3


def test_each_notebook_has_the_budget_of_its_kind():
    kinds = {path: kind_of(path) for path in NOTEBOOKS}
    assert set(kinds.values()) <= {*BUDGETS, ""}
    assert all(kinds[path] == "chapter" for path in CHAPTERS if int(path.stem[:2]) < 80)


# ---- and so must the exchange of forms ----


def claim(name, value, expected, relation):
    tolerances = {"rtol": 1e-9, "atol": 0.0, "run": 0, "failure": ""}
    return Claim(name=name, value=value, expected=expected, relation=relation, **tolerances)


@pytest.mark.parametrize(
    ("printed", "right", "problem"),
    [
        (claim("p", 2, 1, "differs"), claim("r", 1, 1, "=="), None),
        (claim("p", 2, 1, "differs"), claim("r", 3, 3, "=="), "'p' holds for the other form"),
        (claim("p", 2, 1.5, ">"), claim("r", [1, 2], [1, 2], "=="), None),
        (claim("p", [2, 2], 1, ">"), claim("r", [1, 2, 3], [1, 2, 3], "=="), "do not compare"),
        (claim("p", 1, 1, "=="), claim("r", 1, 1, "=="), "needs one check of the printed form"),
    ],
)
def test_exchange_of_forms(printed, right, problem):
    cells = notebook(code("...", printed=["p", "r"], covers={"E1": ["p", "r"]}))
    problems = swaps(cells, [printed, right], SMALL)
    assert (problems == []) if problem is None else problem in problems[0]
