"""Two texts compared: the same words, numbers within a tolerance."""

import math
import re
from dataclasses import dataclass

# One unit in the last printed place is no difference, as long as it is at most this part
# of the number: 0.3333 may print as 0.3334, but 0.5 is not 0.6.
_UNIT_PART = 0.1
# %g drops zeros at the end, so that one number of a pair shows fewer places. The unit in
# the last place of the longer one is then excused from this many digits on.
_UNIT_DIGITS = 4
_SHOWN = 5

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
# python-control aligns numbers in LaTeX by splitting them over columns.
_LATEX_COLUMNS = re.compile(r"(?:\\phantom\{\.\})?&\\hspace\{-1em\}(?:\\phantom\{\\cdot\})?")
_ADDRESS = re.compile(r"\bat 0x[0-9A-Fa-f]+")

_NUMBER = re.compile(
    r"""
    # Kept as text, digits and all: versions, section numbers, requirements, 1.2.3, 12:30:01.5
    (?P<exact>
        \b(?i:version|release|python|numpy|scipy|matplotlib)[ =:]*\d+(?:\.\d+)+
      | \b(?i:section|chapter|figure|fig|table|equation|eq)[.]?\ \d+(?:\.\d+)+
      | \b[A-Za-z][\w.-]*==\d[\w.]*
      | (?<![\w.])\d+(?:\.\d+){2,}\w*
      | (?<![\w.])\d+(?::\d+)+(?:\.\d+)?
      | (?<![\w.])0[xX][0-9A-Fa-f]+
      | (?<![\w.])\d[\w.]*_[\w.]*
      | \d+(?:\.\d+)+(?![eE]\d+j?\b)[A-Za-z]+\d\w*
      | \d+\.\d+\.[A-Za-z]\w*
    )
  | (?P<number>
        (?:[-+]\ ?|(?<![\w.]))
        (?:
            (?:10\s?(?:\^\s?\{?(?P<power>[-+]?\d+)\}?
                |<sup>(?P<hpower>[-+]?\d+)</sup>
                |(?P<upower>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+)))
          | (?P<mantissa>\d+\.\d*|\.\d+|\d+)
            (?:[eE](?P<e>[-+]?\d+)
              |\s?(?:\\cdot|\\times|&times;|&middot;|\u00d7|\u00b7|\*)\s?10\s?
                (?:\^\s?\{?(?P<lexp>[-+]?\d+)\}?
                  |<sup>(?P<hexp>[-+]?\d+)</sup>
                  |(?P<uexp>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+)))?
            (?![\d_])
          | \b(?:inf|nan)(?=j?\b)
        )
    )
    """,
    re.VERBOSE,
)


@dataclass(frozen=True)
class _Number:
    text: str
    line: int
    value: float
    places: int  # digits after the point of the mantissa
    digits: int  # digits of the mantissa, leading zeros apart
    unit: float  # one unit in the last printed place; 0 for inf and nan
    integer: bool


def text_difference(stored: str, new: str, *, rtol: float, atol: float) -> str | None:
    """What differs between two texts, or None.

    Words, integers, dates, versions and identifiers must be the same. A number with a
    point or an exponent may differ by ``atol`` plus ``rtol`` times its modulus (that of the
    complex number it is part of), or by one unit in the last printed place. Arrays may
    wrap lines differently.

    Parameters
    ----------
    stored, new : str
    rtol, atol : float >= 0

    Returns
    -------
    message : str or None

    Examples
    --------
    >>> text_difference("x = 0.3333", "x = 0.3334", rtol=1e-6, atol=1e-12)
    >>> text_difference("x = 0.25 m", "x = -0.25 m", rtol=1e-6, atol=1e-12)
    'line 1: -0.25, stored 0.25 (difference 0.5, allowed 2.5e-07)'
    """
    if stored == new:
        return None
    old_words, old_numbers = _split(stored)
    new_words, new_numbers = _split(new)
    if old_words != new_words:
        return _words_difference(stored, new)
    messages = []
    scales = _moduli(old_words, old_numbers, new_numbers)
    for a, b, scale in zip(old_numbers, new_numbers, scales, strict=True):
        allowed = atol + rtol * scale
        if not _same(a, b, allowed):
            messages.append(_number_message(a, b, allowed))
    more = f"\n... and {len(messages) - _SHOWN} more numbers" if len(messages) > _SHOWN else ""
    return "\n".join(messages[:_SHOWN]) + more if messages else None


def _same(a: _Number, b: _Number, allowed: float) -> bool:
    if a.integer and b.integer:
        return a.text.lstrip("+") == b.text.lstrip("+")
    if math.isnan(a.value) or math.isnan(b.value):
        return math.isnan(a.value) and math.isnan(b.value)
    if a.value == b.value:
        return a.integer == b.integer
    if math.isinf(a.value) or math.isinf(b.value):
        return False
    distance = abs(a.value - b.value)
    if distance <= allowed:
        return True
    if a.places == b.places and a.integer == b.integer:
        unit = max(a.unit, b.unit)
    elif max(a.digits, b.digits) >= _UNIT_DIGITS:
        unit = min(a.unit, b.unit)
    else:
        return False
    # The slack is for the subtraction of two decimal numbers in binary.
    slack = 1.0 + 1e-6
    modulus = max(abs(a.value), abs(b.value))
    return distance <= unit * slack and unit <= _UNIT_PART * modulus * slack


def _number_message(a: _Number, b: _Number, allowed: float) -> str:
    head = f"line {b.line}: {b.text}, stored {a.text}"
    if a.integer and b.integer:
        return f"{head} (integers are exact)"
    if a.value == b.value:
        return f"{head} (an integer in one, not in the other)"
    distance = abs(a.value - b.value)
    return f"{head} (difference {distance:.3g}, allowed {allowed:.2g})"


def _words_difference(stored: str, new: str) -> str:
    old_lines, new_lines = stored.splitlines(), new.splitlines()
    for number, (old, line) in enumerate(zip(old_lines, new_lines, strict=False), start=1):
        if _split(old)[0] != _split(line)[0]:
            return f"line {number}: {line!r}\n  stored {old!r}"
    common = min(len(old_lines), len(new_lines))
    extra = (new_lines[common:] or old_lines[common:] or ["(the end of the line)"])[0]
    return f"{len(new_lines)} lines, stored {len(old_lines)}; from line {common + 1}: {extra!r}"


def _split(text: str) -> tuple[list[str], list[_Number]]:
    """The words around the numbers, and the numbers: one word more than numbers."""
    text = _ADDRESS.sub("at 0x...", text.replace("\u2212", "-"))
    text = _LATEX_COLUMNS.sub("", text)
    words, numbers, word, position, line = [], [], "", 0, 1
    for match in _NUMBER.finditer(text):
        if match["exact"]:
            continue
        word = text[position : match.start()]
        line += word.count("\n")
        words.append(word)
        numbers.append(_number(match, line))
        position = match.end()
    words.append(text[position:])
    return _plain_spaces(words), numbers


def _number(match: re.Match[str], line: int) -> _Number:
    text = match["number"].replace(" ", "")
    sign = -1.0 if text.startswith("-") else 1.0
    mantissa = match["mantissa"]
    power = match["power"] or match["hpower"] or match["upower"]
    if mantissa is None and power is None:
        return _Number(text, line, sign * float(text.lstrip("+-")), 0, 0, 0.0, False)
    mantissa = mantissa or "1"
    exponent = power or match["e"] or match["lexp"] or match["hexp"] or match["uexp"]
    shift = int(exponent.translate(_SUPERSCRIPTS)) if exponent else 0
    places = len(mantissa.partition(".")[2])
    return _Number(
        text,
        line,
        sign * float(f"{mantissa}e{shift}"),
        places,
        len(mantissa.replace(".", "").lstrip("0")),
        float(f"1e{shift - places}"),
        exponent is None and "." not in mantissa,
    )


def _plain_spaces(words: list[str]) -> list[str]:
    """Words without the spaces that only align numbers, or wrap an array.

    Within brackets every white space is one space, none next to a bracket; elsewhere line
    ends stay. Spaces next to a number go.
    """
    depth = 0
    plain = []
    for index, word in enumerate(words):
        out: list[str] = []
        for character in word:
            if character in "([":
                depth += 1
            elif character in ")]":
                depth = max(depth - 1, 0)
            out.append(" " if depth and character.isspace() else character)
        text = re.sub(r"([(\[]) +", r"\1", re.sub(r" +(?=[)\]\n])", "", "".join(out)))
        text = re.sub(r"\s*,\s+" if depth else r" *, +", ", ", text)
        text = re.sub(r"  +", " ", text)
        if index > 0:
            text = text.lstrip(" ")
        if index < len(words) - 1:
            text = text.rstrip(" ")
        plain.append(text)
    return plain


def _moduli(words: list[str], old: list[_Number], new: list[_Number]) -> list[float]:
    """For each number, the modulus its relative tolerance refers to."""
    moduli = [
        max((abs(n.value) for n in (a, b) if math.isfinite(n.value)), default=0.0)
        for a, b in zip(old, new, strict=True)
    ]
    for k in range(1, len(moduli)):
        # 1.2-0.3j: two numbers with nothing between them and a j behind.
        if words[k] == "" and words[k + 1].startswith("j"):
            moduli[k - 1] = moduli[k] = math.hypot(moduli[k - 1], moduli[k])
    return moduli
