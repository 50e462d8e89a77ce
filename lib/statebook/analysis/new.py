"""A new notebook for the analysis of one's own model."""

import json
import re
from importlib.resources import files
from pathlib import Path

_RESERVED = r"(?i)con|prn|aux|nul|com\d|lpt\d"  # names that Windows keeps for devices


def new_notebook(name: str, folder: Path) -> Path:
    """Write an analysis notebook from the template.

    Parameters
    ----------
    name : str
        Letters, digits, "_" and "-", beginning with a letter or digit.
    folder : Path
        It is made where it does not exist.

    Returns
    -------
    Path
        The notebook.

    Raises
    ------
    ValueError
        The name would make no file.
    FileExistsError
        There is such a notebook already; it is left alone.
    """
    name = name.removesuffix(".ipynb")
    if not re.fullmatch(r"[A-Za-z0-9][\w-]{0,79}", name, re.ASCII) or re.fullmatch(_RESERVED, name):
        raise ValueError(f"NAME must be letters, digits, _ and -, as in quarter_car, got {name!r}")
    path = folder / f"{name}.ipynb"
    text = files("statebook.analysis").joinpath("template.ipynb").read_text(encoding="utf-8")
    notebook = json.loads(text.replace("MODEL_NAME", name))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
    except FileExistsError:
        raise FileExistsError(
            f"{path} exists already and is left alone; take another NAME"
        ) from None
    return path
