"""Notebook regression that survives another machine.

- ``pytest --nb`` with this package installed: numbers agree within a tolerance
  and figures by their data, and nothing passes because it was never compared;
- ``nbregress refresh|execute|diff``: run notebooks and store their outputs
  reproducibly, or compare two as they are stored.

Both load this package into the kernel, where every Matplotlib figure and every
array, data frame or system that a cell shows then carries a digest of its data.
A notebook needs no line for it; ``%load_ext nbregress`` does the same by hand.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from IPython.core.interactiveshell import InteractiveShell


def load_ipython_extension(shell: "InteractiveShell") -> None:
    """Called by the runner, and by ``%load_ext nbregress``."""
    from nbregress.figures import install

    install(shell)
