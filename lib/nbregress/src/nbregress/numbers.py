"""The numbers of a text, and the words around them."""

import math
import re
from dataclasses import dataclass

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
# python-control aligns numbers in LaTeX by splitting them over columns.
_LATEX_COLUMNS = re.compile(r"(?:\\phantom\{\.\})?&\\hspace\{-1em\}(?:\\phantom\{\\cdot\})?")

_NUMBER = re.compile(
    r"""
    # Kept as text, digits and all: versions, section numbers, requirements, 1.2.3, 12:30:01.5,
    # and the hash of a commit, which may look like 9e12345.
    (?P<exact>
        \b(?:v|(?i:version|release|python|numpy|scipy|matplotlib)[ =:]*
            |(?i:section|chapter|figure|fig|table|equation|eq)[.]?\ )\d+(?:\.\d+)+
      | \b[A-Za-z][\w.-]{0,60}==\d[\w.]*
      | (?<![\w.])\d+(?:\.\d+){2,}\w*
      | (?<![\w.])\d+(?::\d+)+(?:\.\d+)?
      | (?<![\w.])0[xX][0-9A-Fa-f]+
      | (?<![\w.])\d[\w.]*_[\w.]*
      | (?<![\w.+-])(?=\d*[a-f])[0-9a-f]{7,64}(?![\w.])
      | (?<!\d)\d+(?:\.\d+)+(?![eE]\d+j?\b)[A-Za-z]+\d\w*
      | (?<!\d)\d+\.\d+\.[A-Za-z]\w*
    )
  | (?P<number>
        (?:[-+]\ ?|(?<![\w.]))
        (?:
            (?:(?P<mantissa>\d+(?:\.\d*)?|\.\d+)\s?
                (?:\\cdot|\\times|&times;|&middot;|\u00d7|\u00b7|\*)\s?)?10\s?
                (?:\^\s?\{?(?P<power>[-+]?\d+)\}?
                  |<sup>(?P<hpower>[-+]?\d+)</sup>
                  |(?P<upower>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+))
          | (?P<plain>\d+(?:\.\d*)?|\.\d+)
            (?:[eE](?P<e>[-+]?\d{1,3}(?!\d)))?(?![\d_]|[eE][-+]?\d)
          | \b(?:inf|nan)(?=j?\b)
        )
    )
    """,
    re.VERBOSE,
)


@dataclass(frozen=True)
class Number:
    """A number as it was printed.

    Parameters
    ----------
    text : str
    line : int
        Line of the text that it stands in, from 1.
    value : float
    integer : bool
        Whether it was printed without a point and without an exponent.
    """

    text: str
    line: int
    value: float
    integer: bool


def split_numbers(text: str) -> tuple[list[str], list[Number]]:
    """The words around the numbers of a text, and the numbers.

    Parameters
    ----------
    text : str

    Returns
    -------
    words : list of str
        One more than there are numbers.
    numbers : list of Number

    Examples
    --------
    >>> split_numbers("x = 1.5 m")[0]
    ['x = ', ' m']
    """
    text = _LATEX_COLUMNS.sub("", text.replace("\u2212", "-"))
    words, numbers, position, line = [], [], 0, 1
    for match in _NUMBER.finditer(text):
        if match["exact"]:
            continue
        number = _number(match, line)
        if number is None:
            continue
        word = text[position : match.start()]
        line += word.count("\n")
        words.append(word)
        numbers.append(Number(number.text, line, number.value, number.integer))
        position = match.end()
    words.append(text[position:])
    return words, numbers


def _number(match: re.Match[str], line: int) -> Number | None:
    text = match["number"].replace(" ", "")
    sign = -1.0 if text.startswith("-") else 1.0
    mantissa = match["mantissa"] or match["plain"]
    exponent = match["power"] or match["hpower"] or match["upower"] or match["e"]
    if mantissa is None and exponent is None:
        return Number(text, line, sign * float(text.lstrip("+-")), False)
    mantissa = mantissa or "1"
    shift = int(exponent.translate(_SUPERSCRIPTS)) if exponent else 0
    integer = exponent is None and "." not in mantissa
    value = float(f"{mantissa}e{shift}") if not integer or len(mantissa) < 300 else math.nan
    if math.isinf(value) or (value == 0.0 and re.search(r"[1-9]", mantissa)):
        return None  # no number that was computed, but a word that looks like one
    return Number(text, line, sign * value, integer)
