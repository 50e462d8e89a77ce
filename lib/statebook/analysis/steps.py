"""Steps of a notebook that wait for one another and say in a sentence what is wrong."""

import ast
import inspect
import re
import traceback
from collections.abc import Callable
from typing import Any


class Waiting:
    """The result of a step that has none yet; it shows nothing."""

    def __repr__(self) -> str:
        return "not there yet"

    def _ipython_display_(self) -> None:
        pass


def step(function: Callable[..., Any]) -> Any:
    """Do one step of an analysis at once; its result takes the function's name.

    Its arguments are names of the notebook: the model and results of other steps. If one is
    not there, or the step fails, one line says so, and the steps after it wait.

    Parameters
    ----------
    function : callable

    Returns
    -------
    object
        What the function returns, or a Waiting.

    Examples
    --------
    >>> @step
    ... def rest(missing):
    ...     return 1
    rest waits for missing.
    >>> rest
    not there yet
    """
    names, around = inspect.signature(function).parameters, function.__globals__
    missing = [n for n in names if isinstance(around.get(n, Waiting()), Waiting)]
    name = function.__name__.replace("_", " ")
    if missing:
        print(f"{name} waits for {missing[0].replace('_', ' ')}.")
        return Waiting()
    try:
        return function(**{n: around[n] for n in names})
    except Exception as error:
        print(f"{name} failed: {error or type(error).__name__}")
        return Waiting()


def begin() -> None:
    """Let the cell that assigns ``model`` fail in a sentence, and leave no model behind.

    Steps then wait for it, instead of using the one before; other cells are as they were.
    """
    from IPython import get_ipython

    shell = get_ipython()
    if shell is not None:
        shell.input_transformers_post.append(_parsing)
        shell.ast_transformers.append(_Guarded())


_FAILED = "model = __import__('importlib').import_module('statebook.analysis.steps').failed"


class _Guarded(ast.NodeTransformer):
    """Wrap a cell that assigns model; what it shows at its end stays outside."""

    def visit_Module(self, node: ast.Module) -> ast.Module:
        names = (part for part in ast.walk(node) if isinstance(part, ast.Name))
        if not any(n.id == "model" and isinstance(n.ctx, ast.Store) for n in names):
            return node
        end = len(node.body) - isinstance(node.body[-1], ast.Expr)
        guard = ast.parse(f"try:\n    pass\nexcept Exception as e:\n    {_FAILED}(e)").body[0]
        assert isinstance(guard, ast.Try)
        guard.body = node.body[:end]
        node.body = [guard, *node.body[end:]]
        return ast.fix_missing_locations(node)


def _parsing(lines: list[str]) -> list[str]:
    """Replace a cell that assigns model and is no Python by one that says so."""
    cell = "".join(lines)
    try:
        ast.parse(cell)
    except SyntaxError as error:
        if re.search(r"^model *=", cell, re.MULTILINE):
            said = f"line {error.lineno}: SyntaxError: {error.msg}"
            return [f"{_FAILED}({said!r})\n"]
    return lines


def failed(error: Exception | str) -> Waiting:
    """Say what is wrong with the cell of the model, and return what stands for it."""
    said = str(error)
    if isinstance(error, Exception):
        deepest: BaseException = error
        while deepest.__cause__ is not None:
            deepest = deepest.__cause__
        frames = [f for e in (error, deepest) for f in traceback.extract_tb(e.__traceback__)]
        line = [f.lineno for f in frames if f.filename == frames[0].filename][-1]
        said = f"line {line}: {type(error).__name__}: {error}"
    print(f"The model is not there yet; {said}")
    return Waiting()
