"""The house as its imports draw it: rooms of a package, who uses whom, and lines of code."""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def rooms(package: Path) -> dict[str, set[str]]:
    """Return the rooms of a package, its files and folders, and which of them each one uses."""
    names = {p.stem for p in package.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    names -= {"__init__", "__main__"}
    uses: dict[str, set[str]] = {name: set() for name in names}
    for file, module in imports(package):
        room = file.relative_to(package).parts[0].removesuffix(".py")
        for other in names - {room}:
            if room in names and f"{module}.".startswith(f"{package.name}.{other}."):
                uses[room].add(other)
    return uses


def imports(package: Path) -> Iterator[tuple[Path, str]]:
    """Yield each file of a package with each module or name of the package that it imports.

    Imports for type checkers alone are left out: they load nothing.
    """
    for file in sorted(package.rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        skipped = {
            node
            for branch in ast.walk(tree)
            if isinstance(branch, ast.If) and ast.unparse(branch.test) == "TYPE_CHECKING"
            for node in ast.walk(branch)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node not in skipped and node.module:
                if node.module.split(".")[0] == package.name:
                    yield from ((file, f"{node.module}.{alias.name}") for alias in node.names)


def private_names_across(package: Path) -> list[str]:
    """Return imports of another file's private names; a private module is anyone's."""
    return [
        f"{file.relative_to(package).as_posix()}: {name}"
        for file, name in imports(package)
        if name.rpartition(".")[2].startswith("_") and name != f"{package.name}._validate"
    ]


def circles(package: Path) -> list[str]:
    """Return the files that import one another in a circle."""
    files = {
        ".".join((package.name, *f.relative_to(package).with_suffix("").parts)): set()
        for f in package.rglob("*.py")
    }
    for file, name in imports(package):
        importer = ".".join((package.name, *file.relative_to(package).with_suffix("").parts))
        target = name if name in files else name.rpartition(".")[0]
        if target in files and target != importer:
            files[importer].add(target)
    while ends := [name for name, targets in files.items() if not targets & files.keys()]:
        for name in ends:
            del files[name]
    return sorted(files)


def code_lines(file: Path) -> int:
    """Count the lines of a file that are neither blank nor comment nor docstring."""
    text = file.read_text(encoding="utf-8")
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines -= set(range(first.lineno, (first.end_lineno or 0) + 1))
    return len(lines)
