"""Print the licences of all that an installation of statebook and nbregress brings.

    python tests/licences.py [EXTRA ...] > DEPENDENCIES.md

reads the metadata of what is installed here, from the two packages' requirements downwards; an
extra of statebook that is not named is left out, a package that is not installed is named.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import PackageNotFoundError, distribution

HEAD = """# What statebook and nbregress stand on

Licences as the packages' own metadata state them, printed by `python tests/licences.py {extras}`.
None of these packages is part of ours: pip installs them.

| package | licence | needed by |
| --- | --- | --- |"""


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def licence_of(name: str) -> str:
    """Return the licence, as its expression, classifiers, field or file say."""
    meta = distribution(name).metadata
    said = meta.get("License-Expression")
    classes = [c.rpartition(" :: ")[2] for c in meta.get_all("Classifier") or () if "License" in c]
    lines = (meta.get("License") or "").strip().splitlines()
    texts = [
        f for f in distribution(name).files or () if re.match("(?i)(licen[cs]e|copying)", f.name)
    ]
    lines = lines or [t for f in texts for t in f.read_text().split("\n") if t.strip(" =-")]
    return (
        said
        or "; ".join(c for c in classes if c != "OSI Approved")
        or (lines or ["?"])[0].strip()[:60]
    )


def requirements(name: str, extras: list[str]) -> list[tuple[str, list[str]]]:
    """Return what a distribution requires here, with these extras."""
    from packaging.requirements import Requirement

    wanted = map(Requirement, distribution(name).requires or ())
    environments = [{"extra": extra} for extra in ["", *extras]]
    return [
        (normal(r.name), sorted(r.extras))
        for r in wanted
        if r.marker is None or any(r.marker.evaluate(e) for e in environments)
    ]


def main(extras: list[str]) -> None:
    print(HEAD.format(extras=" ".join(extras)))
    waiting, users = [("statebook", extras), ("nbregress", [])], {}
    seen = set()
    while waiting:
        name, its_extras = waiting.pop()
        if (name, *its_extras) in seen:
            continue
        seen.add((name, *its_extras))
        try:
            for other, more in requirements(name, its_extras):
                users.setdefault(other, set()).add(name)
                waiting.append((other, more))
        except PackageNotFoundError:
            pass
    for name in sorted(users.keys() - {"statebook", "nbregress"}):
        try:
            licence = licence_of(name)
        except PackageNotFoundError:
            licence = "(not installed where this was printed)"
        by = sorted(users[name])
        shown = ", ".join(by[:3]) + (f" and {len(by) - 3} more" if len(by) > 3 else "")
        print(f"| {name} | {licence.replace('|', '/')} | {shown} |")


if __name__ == "__main__":
    main(sys.argv[1:])
