"""Notebook regression that survives another machine.

Three parts:

- ``%load_ext nbregress`` in a notebook's first cell: every Matplotlib
  figure it shows also stores a small digest of its data;
- ``pytest --nbval`` with this package installed: numbers agree within a tolerance
  and figures by their data, and nothing passes because it was never compared;
- ``python -m nbregress execute|refresh``: run notebooks and store their
  outputs reproducibly.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from IPython.core.interactiveshell import InteractiveShell


def load_ipython_extension(shell: "InteractiveShell") -> None:
    """Called by ``%load_ext nbregress``."""
    from nbregress.figures import install

    install(shell)


def unload_ipython_extension(shell: "InteractiveShell") -> None:
    """Called by ``%unload_ext nbregress``."""
    from nbregress.figures import uninstall

    uninstall(shell)
