"""Texts: the same words, numbers within a tolerance."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nbregress.comparison import Comparison
from nbregress.settings import Settings


def compare(stored, new, rtol=1e-5, atol=0.0):
    return Comparison(Settings(rtol=rtol, atol=atol)).text(stored, new)


SAME = {
    "last digit": ("x = 0.30000000000000004", "x = 0.3"),
    "last of eight digits": ("0.33333333", "0.33333334"),
    "a zero dropped by %g": ("1.5", "1.500000001"),
    "negative zero": ("[-0.  1.]", "[0. 1.]"),
    "rounding beside larger numbers": ("[1.0, -1.2e-17]", "[1.0, 3.4e-17]"),
    "noise where zero was, in an array": ("[[2. 0.]\n [0. 1.]]", "[[2.0e+00 2.2e-16]\n [0. 1.]]"),
    "wrapped array": ("[0.1 0.2\n 0.3 0.4]", "[0.1 0.2 0.3\n 0.4]"),
    "wrapped array with commas": ("array([ 0.1,  0.2,\n        0.3])", "array([0.1, 0.2, 0.3])"),
    "widened columns": ("[[ 1.  -0. ]\n [ 0.   2. ]]", "[[1. 0.]\n [0. 2.]]"),
    "complex noise": ("(1000+1e-10j)", "(1000-1e-10j)"),
    "complex negative zero": ("[-0.-1.j  1.+0.j]", "[ 0.-1.j  1.-0.j]"),
    "inf and nan": ("inf -inf nan", "inf -inf nan"),
    "LaTeX exponent": (r"1.2345678 \cdot 10^{-3}", r"1.2345679 \cdot 10^{-3}"),
    "LaTeX to %e": (r"1.5 \times 10^{3}", "1.5e+03"),
    "HTML exponent": ("1.25&times;10<sup>-3</sup>", "1.2500001&times;10<sup>-3</sup>"),
    "unicode exponent and minus": ("\u22121.25\u00d710⁻³", "-1.25e-3"),
    "python-control's LaTeX": (
        r"-9.&\hspace{-1em}81&\hspace{-1em}\cdot10^{3}&0\phantom{.}&\hspace{-1em}",
        r"-9.&\hspace{-1em}81000001&\hspace{-1em}\cdot10^{3}&0\phantom{.}&\hspace{-1em}",
    ),
    "number with a unit": ("T = 1.23400s, m = 2.0kg", "T = 1.23401s, m = 2.0kg"),
    "positive exponent": ("1.50000001e10 2.5e+06j", "1.5e10 2.50000001e+06j"),
    "a speed is no version": ("v = 1.50000001", "v = 1.5"),
    "address": ("<f at 0x7f12345678>", "<f at 0x7f98765432>"),
    "column of a table": ("a |  0.5 | -0.0", "a | 0.5 | 0.0"),
}

DIFFERENT = {
    "sign": ("0.25", "-0.25"),
    "sign of a complex part": ("(1.5+2.5j)", "(1.5-2.5j)"),
    "one per cent": ("1.2345", "1.2468"),
    "a step of a short number": ("0.97", "0.96"),
    "a step of a gain": ("K = 1.0", "K = 1.1"),
    "a step in an array": ("[10. 20. 30.]", "[11. 20. 30.]"),
    "a step with an exponent": ("5.0e+03", "5.1e+03"),
    "a step of the fourth digit": ("0.3333", "0.3334"),
    "a small capacitance": ("C = 4.7e-13 F", "C = 9.4e-13 F"),
    "a tiny probability": ("p = 3.2e-300", "p = 8.1e-13"),
    "lone rounding noise": ("0.0", "2.2e-16"),
    "a small imaginary part": ("(1000+0.001j)", "(1000+0.009j)"),
    "a small entry beside a large one": ("[1000.0, 0.001]", "[1000.0, 0.009]"),
    "a quoted version": ('"2.1"', '"2.2"'),
    "a commit": ("commit 9e12345", "commit 9e12346"),
    "a commit without letters but e": ("commit 1e99999", "commit 2e99999"),
    "a value in another column": (
        "name   low  high\na      1.5\nb      2.5  3.5",
        "name   low  high\na           1.5\nb      2.5  3.5",
    ),
    "an indentation": ("if x:\n    y\n    z", "if x:\n    y\nz"),
    "an address that is none": ("0x7f12", "0x7f13"),
    "integer": ("n = 3", "n = 4"),
    "integer to float": ("5", "5.0"),
    "exponent": ("1.5e3", "1.5e4"),
    "power of ten": (r"10^{3}", r"10^{4}"),
    "LaTeX exponent": (r"1.2 \cdot 10^{-3}", r"1.2 \cdot 10^{-2}"),
    "HTML exponent": ("1.2&times;10<sup>-3</sup>", "1.2&times;10<sup>3</sup>"),
    "inf": ("inf", "-inf"),
    "nan": ("nan", "1.0"),
    "date": ("2024-01-05", "2024-01-06"),
    "time": ("12:30:01.5", "12:30:01.6"),
    "version": ("1.2.3", "1.2.4"),
    "short version": ("numpy 2.1", "numpy 2.2"),
    "tag": ("v3.1 2.0rc1", "v3.1 2.0rc2"),
    "identifier": ("x1.5 run_07", "x1.5 run_08"),
    "section": ("Section 13.2", "Section 13.3"),
    "word": ("stable", "unstable"),
    "boolean": ("True", "False"),
    "reordered dictionary": ("{'a': 1.0, 'b': 2.0}", "{'b': 2.0, 'a': 1.0}"),
    "swapped entries": ("[1.0 2.0]", "[2.0 1.0]"),
    "additional line": ("a 1.0\n", "a 1.0\nb 2.0\n"),
    "missing entry": ("[1.0 2.0 3.0]", "[1.0 2.0]"),
    "array shape": ("[[1. 2.]\n [3. 4.]]", "[1. 2. 3. 4.]"),
    "moved decimal": ("12.5", "1.25"),
    "lines outside of an array": ("1.0\n2.0", "1.0 2.0"),
    "unit of measure": ("1.5 m", "1.5 mm"),
}


@pytest.mark.parametrize(("stored", "new"), SAME.values(), ids=SAME)
def test_agree(stored, new):
    assert compare(stored, new) is None
    assert compare(new, stored) is None


@pytest.mark.parametrize(("stored", "new"), DIFFERENT.values(), ids=DIFFERENT)
def test_differ(stored, new):
    assert compare(stored, new)
    assert compare(new, stored)


def test_message_says_where_and_by_how_much():
    message = compare("first\nx = 1.5, y = 2.0", "first\nx = 1.5, y = 2.5")
    assert message == "line 2: 2.5, stored 2.0 (difference 0.5, allowed 2.5e-05)"


@pytest.mark.parametrize("piece", [".", "1", "1.2.", "a.b", " ", "/a", "1:", "[", "a, "])
def test_a_long_line_takes_no_time_that_grows_with_its_square(piece):
    text = piece * 30_000  # a pattern that looked at each pair of places would take minutes
    assert len(compare(text + "x", text + "y")) < 1000


def test_bars_without_a_total_pass_whatever_their_speed():
    assert not compare("12it [00:01, 9.3it/s]", "12it [00:03, 4.1it/s]")
    assert compare("12it [00:01, 9.3it/s]", "13it [00:01, 9.3it/s]")


def test_tolerances():
    assert compare("1.0000", "1.0100") and not compare("1.0000", "1.0100", rtol=0.02)
    assert compare("1.0e-5", "3.0e-5") and not compare("1.0e-5", "3.0e-5", atol=1e-4)
    assert compare("3", "4", rtol=1.0, atol=10.0), "integers are exact whatever the tolerance"


floats = st.floats(allow_nan=False, allow_infinity=False)


@given(floats, st.sampled_from([repr, "{:.6e}".format, "{:.4f}".format, "{:+.9g}".format]))
def test_any_number_agrees_with_itself_and_not_with_its_double(value, show):
    assert compare(show(value), show(value)) is None
    if abs(value) > 1e-3 and math.isfinite(2.0 * value):
        assert compare(show(value), show(2.0 * value))


@given(st.text(max_size=40), st.text(max_size=40))
def test_any_text_is_compared(a, b):
    assert compare(a, a) is None
    message = compare(a, b)
    assert message is None or message
    if not any(c.isdigit() or c.isspace() for c in a + b) and "n" not in a + b:
        assert (message is None) == (a.replace("\u2212", "-") == b.replace("\u2212", "-"))


# Words and numbers as notebooks print them, in the places where they stand.
significant = st.floats(1e-3, 1e6).flatmap(lambda x: st.sampled_from([x, -x]))
PLACES = (
    "{}",
    "x = {}",
    "[{}]",
    "mass {} kg, T = 2.0 s",
    "({}, 'a')",
    "a | {} | b",
    "${} \\cdot m$",
)
DIGITS = ("{:.6g}", "{:.8e}", "{:.10f}", "{!r}")
tokens = st.sampled_from(
    [
        "0.5",
        "-0.5",
        "1.25e-3",
        "3",
        "nan",
        "[1. 2.]",
        "a",
        "True",
        "\n",
        "  ",
        "0.50000001",
        "|",
        "(",
    ]
)


@given(significant, st.floats(-1e-7, 1e-7), st.sampled_from(PLACES), st.sampled_from(DIGITS))
def test_noise_in_the_last_digits_passes_either_way(value, noise, place, digits):
    shown = [digits.format(x) for x in (value, value * (1 + noise))]
    assume(not any(text.lstrip("-").isdigit() for text in shown))  # integers are exact
    stored, new = map(place.format, shown)
    if digits == "{:.10f}" or "e" in stored + new or len(stored) == len(new):
        assert compare(stored, new) is None and compare(new, stored) is None


@given(st.data(), significant, st.sampled_from(PLACES), st.sampled_from(DIGITS))
def test_a_changed_leading_digit_never_passes(data, value, place, digits):
    shown = digits.format(value)
    first = next(k for k, c in enumerate(shown) if c in "123456789")
    other = data.draw(st.sampled_from(sorted(set("123456789") - {shown[first]})))
    changed = shown[:first] + other + shown[first + 1 :]
    assert compare(place.format(shown), place.format(changed))
    assert compare(place.format(changed), place.format(shown))


@given(st.lists(tokens, max_size=9), st.lists(tokens, max_size=9))
def test_who_is_stored_and_who_is_new_does_not_matter(a, b):
    a, b = " ".join(a), " ".join(b)
    assert (compare(a, b) is None) == (compare(b, a) is None)


@given(st.lists(tokens, min_size=1, max_size=9), st.data())
def test_what_is_added_or_missing_never_passes(words, data):
    place = data.draw(st.integers(0, len(words)))
    more = [*words[:place], data.draw(st.sampled_from(["0.5", "7", "new"])), *words[place:]]
    assert compare(" ".join(words), " ".join(more)) and compare(" ".join(more), " ".join(words))


@settings(deadline=None, max_examples=10)
@given(st.text("0123456789.eE+-[](), \n:/a|<>&;", min_size=1, max_size=6))
def test_no_piece_repeated_takes_time_that_grows_with_its_square(piece):
    text = piece * (30_000 // len(piece))
    assert compare(text, text) is None
    compare(text + "x", text + "y")
