"""What of a text changes from run to run without being a result: named patterns.

Both texts are stripped of them before they are compared; each pattern can be switched off.
"""

import re
from collections.abc import Collection
from datetime import datetime, timedelta, timezone

_DURATION = r"[\d.,]+(?:e[-+]\d+)?\s*(?:ns|[µμu]s|ms|s|sec(?:ond)?s?|min(?:ute)?s?|h)\b"
_CLOCK = r"\d+:\d\d(?::\d\d)?(?:\.\d+)?"
# Name, pattern, and what stands for a match.
_PATTERNS = {
    "address": (r"\b0x[0-9A-Fa-f]{6,16}\b", "0x..."),
    "uuid": (
        r"\b[0-9a-f]{8}-(?:[0-9a-f]{4}-){3}[0-9a-f]{12}\b|(?<![0-9a-f])[0-9a-f]{32}\b",
        "uuid",
    ),
    "scalar": (r"\bnp\.(?:(?:float64|int64|complex128|str_)\(([^()]*)\)|(True|False)_)", r"\1\2"),
    "process": (
        r"(?<=ipykernel_)\d+(?:[/\\]\d+\.py)?|(?<=<ipython-input-)\d+-[0-9a-f]+"
        r"|\b(?i:pid|process)[ =:#]+\d+\b",
        "#",
    ),
    "timing": (
        rf"(?:Wall time|CPU times): .*"
        rf"|(?<![\d.])[\d.]{{1,12}} [nµμum]?s ± [\d.]{{1,12}} [nµμum]?s per loop.*"
        rf"|(?i:\b(?:elapsed|execution|computation|computing|running|run|cpu|wall[- ]?clock) ?time)"
        rf"(?: is| was| taken| elapsed)?\s*[=:]?\s*(?:{_CLOCK}|{_DURATION})"
        rf"|(?i:\belapsed)\s*[=:]\s*(?:{_CLOCK}|{_DURATION})"
        rf"|---\s*[\d.]+ seconds\s*---",
        "timing",
    ),
    "progress": (
        rf"(?:(?P<bar>(?<!\d)\d{{1,3}}%\|)[^|\n]*\|)?(?P<count>[ \u2007]\S+/\S+)"
        rf"[ \u2007]\[(?:{_CLOCK}|\?)(?:<|&lt;)[^\]\n]*\]"
        rf"|(?P<open>\b\d[\d.kM]{{0,12}}it) \[{_CLOCK}, [^\]\n]*\]",
        r"\g<bar>\g<count>\g<open>",
    ),
    "path": (
        r"(?:/home/|/Users/|(?<![\w/])/root(?=/)|[A-Z]:\\+Users\\+)[^/\\\s\"'<>:]*"
        r"|(?:/private)?/(?:var/folders/\w+/\w+/T|tmp|var/tmp)(?:/[\w.-]+)?(?=[/\s\"'<>:,)]|$)"
        r"|[A-Z]:\\+(?:[^\\\s]+\\+)*?Temp\\+[\w.-]+"
        r"|(?<![^\s\"'<>(=])[^\s\"'<>(=]{0,300}[/\\]lib[/\\]python3\.\d+(?:t)?(?:[/\\](?:site|dist)-packages)?(?=[/\\])"
        r"|(?<![^\s\"'<>(=])[^\s\"'<>(=]{0,300}[/\\](?:site|dist)-packages(?=[/\\])",
        "~",
    ),
}
_COMPILED = {name: (re.compile(text, re.MULTILINE), new) for name, (text, new) in _PATTERNS.items()}
#: Names of all patterns, for settings and reports.
NAMES = (*_PATTERNS, "today", "order of a set")

_MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()
_DATE = re.compile(
    r"\b(?P<y>20\d\d)[-/](?P<m>\d\d)[-/](?P<d>\d\d)\b"
    r"|\b(?:(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun)[a-z]*,? +)?(?P<d2>\d{1,2}) (?P<m2>[A-Z][a-z]{2})[a-z]* "
    r"(?P<y2>20\d\d)\b"
    r"|\b(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun)[a-z]* (?P<m3>[A-Z][a-z]{2}) +(?P<d3>\d{1,2})"
    r"(?P<time> +[\d:]{8}(?: [A-Z]{3,4})?) (?P<y3>20\d\d)\b"
)
_TIME = re.compile(r"(?:<today>[T ]|Time: +)\d\d:\d\d(?::\d\d)?(?:[.,]\d+)?(?:Z|[-+]\d\d:?\d\d)?")
_SET = re.compile(r"\{((?:'[^'{}]*'|\"[^\"{}]*\")(?:, (?:'[^'{}]*'|\"[^\"{}]*\"))+)\}")


def strip_noise(text: str, off: Collection[str], seen: set[str]) -> str:
    """A text without what the named patterns match.

    Parameters
    ----------
    text : str
    off : collection of str
        Names of patterns that are switched off.
    seen : set of str
        Gets the names of the patterns that matched.

    Returns
    -------
    stripped : str

    Examples
    --------
    >>> strip_noise("<Model at 0x7f3aa81c2d90>", (), set())
    '<Model at 0x...>'
    >>> strip_noise("<Model at 0x7f3aa81c2d90>", ("address",), set())
    '<Model at 0x7f3aa81c2d90>'
    """
    for name, (pattern, new) in _COMPILED.items():
        if name not in off:
            text, count = pattern.subn(new, text)
            if count:
                seen.add(name)
    if "order of a set" not in off and _SET.search(text):
        text = _SET.sub(lambda m: "{" + ", ".join(sorted(m[1].split(", "))) + "}", text)
        seen.add("order of a set")
    return text


def strip_today(stored: str, new: str, off: Collection[str], seen: set[str]) -> tuple[str, str]:
    """Two texts without the date and time at which each was made.

    A date is the moment of the run if the new text has one within a day of now where the
    stored one has an earlier date, or the same, written alike. Other dates are results.

    Parameters
    ----------
    stored, new : str
    off : collection of str
        Names of patterns that are switched off.
    seen : set of str
        Gets "today" if there was such a date.

    Returns
    -------
    stored, new : str
    """
    if "today" in off:
        return stored, new
    now = datetime.now(timezone.utc).replace(tzinfo=None)
    old_dates, new_dates = list(_DATE.finditer(stored)), list(_DATE.finditer(new))
    if not new_dates or len(old_dates) != len(new_dates):
        return stored, new
    chosen = [(_moment(a), _moment(b), a, b) for a, b in zip(old_dates, new_dates, strict=True)]
    found = [
        (a, b)
        for was, is_now, a, b in chosen
        if was and is_now and abs(is_now - now) < timedelta(days=2) and was <= is_now
    ]
    if not found:
        return stored, new
    seen.add("today")
    return _without([a for a, _ in found], stored), _without([b for _, b in found], new)


def _without(matches: list[re.Match[str]], text: str) -> str:
    for match in reversed(matches):
        text = f"{text[: match.start()]}<today>{text[match.end() :]}"
    return _TIME.sub("<now>", text)


def _moment(match: re.Match[str]) -> datetime | None:
    year, month, day = (match[c] or match[f"{c}2"] or match[f"{c}3"] for c in "ymd")
    try:
        number = int(month) if month.isdigit() else _MONTHS.index(month) + 1
        return datetime(int(year), number, int(day))
    except ValueError:
        return None


def as_printed(text: str) -> str:
    """A stream as a terminal shows it in the end: without what was overwritten.

    Parameters
    ----------
    text : str

    Returns
    -------
    shown : str

    Examples
    --------
    >>> as_printed("10 %\\r20 %\\rdone\\n")
    'done\\n'
    """
    lines = []
    for line in text.replace("\r\n", "\n").split("\n"):
        while "\b" in line:
            line = re.sub(r"[^\b]\x08|^\x08+", "", line)
        parts = [part for part in line.split("\r") if part.strip()] or [""]
        shown = parts[0]
        for part in parts[1:]:
            shown = part + shown[len(part) :] if len(part) < len(shown) else part
        lines.append(
            re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", shown).rstrip() if "\r" in line else shown
        )
    return "\n".join(lines)
