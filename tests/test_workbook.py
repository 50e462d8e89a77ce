"""The chapters against the ledger and against the rules for stored notebooks."""

from __future__ import annotations

import copy

import pytest

from ledger import CHAPTERS, Row, claims, faults, gaps, read_ledger, read_notebook

LEDGER = read_ledger()


def test_ledger_has_every_item_and_erratum():
    assert list(LEDGER) == [str(i) for i in range(1, 95)] + [f"E{i}" for i in range(1, 29)]
    assert {row.kind for row in LEDGER.values()} == {"computed", "editorial", "exercise"}


def test_there_are_chapters():
    assert CHAPTERS, "no chapter found: the tests below would pass for want of anything to test"


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_chapter_covers_its_rows(path):
    assert not gaps(path.stem[:2], read_notebook(path), LEDGER)


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_chapter_is_cleanly_executed(path):
    assert not faults(read_notebook(path))


# ---- the tests above must be able to fail ----


def code(source, count=1, **cell):
    outputs = cell.pop("outputs", [])
    return {
        "cell_type": "code",
        "source": source,
        "execution_count": count,
        "metadata": cell,
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
    code('check("a", 1, 1, covers=("2",))'),
    code('%load_ext x\ncheck("printed", 2, 1, relation="differs", covers=("E1",))', 2),
    code('sb.check("right", 1, 1, covers=("E1",))', 3),
)


def test_complete_chapter_passes():
    assert gaps("00", COMPLETE, SMALL) == []
    assert gaps("01", notebook(), SMALL) == []
    assert faults(COMPLETE) == []


@pytest.mark.parametrize(
    ("dropped", "row"), [(0, "row 1"), (1, "row 2"), (2, "row E1"), (3, "row E1")]
)
def test_uncovered_row_is_found(dropped, row):
    cells = [cell for i, cell in enumerate(COMPLETE["cells"]) if i != dropped]
    problems = gaps("00", notebook(*cells), SMALL)
    assert len(problems) == 1 and problems[0].startswith(row)


def test_prose_does_not_cover_a_computed_row():
    cells = [prose("1", "2"), *COMPLETE["cells"][2:]]
    assert [p[:5] for p in gaps("00", notebook(*cells), SMALL)] == ["row 2"]


def test_unknown_row_is_found():
    extra = code('check("a", 1, 1, covers=("95",))')
    assert gaps("00", notebook(*COMPLETE["cells"], extra), SMALL) == ["no row 95 in the ledger"]


@pytest.mark.parametrize("covers", ['"12"', "(1, 2)"])
def test_covers_must_be_a_tuple_of_strings(covers):
    with pytest.raises(ValueError, match="tuple of strings"):
        claims(notebook(code(f'check("a", 1, 1, covers={covers})')))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"execution_count": None}, "was not executed"),
        ({"execution_count": 7}, "counts are not 1 to 3"),
        ({"source": "x = 1\n" * 26}, "26 lines"),
        ({"outputs": [{"output_type": "error", "ename": "KeyError"}]}, "holds an error"),
        (
            {"outputs": [{"output_type": "stream", "name": "stderr", "text": ["beware"]}]},
            "holds a warning: beware",
        ),
    ],
)
def test_fault_is_found(change, problem):
    broken = copy.deepcopy(COMPLETE)
    broken["cells"][1] |= change
    assert problem in faults(broken)[0]


def test_expected_error_is_no_fault():
    wanted = code("1 / 0", tags=["raises-exception"], outputs=[{"output_type": "error"}])
    assert faults(notebook(wanted)) == []
