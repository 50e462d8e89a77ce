"""The frames of a Matplotlib animation, digested while its film is made."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from nbregress.mime import FIGURE_TYPE

# Films that were made and not shown yet, oldest first.
_films: list[list[dict[str, Any]]] = []
_digest: list[Callable[[Any], dict[str, Any]]] = []


def watch_animations(shell: Any, formatter: Any, digest: Callable[[Any], dict[str, Any]]) -> None:
    """Digest each frame that a film is made of, and show the digests with the film.

    Parameters
    ----------
    shell : IPython.core.interactiveshell.InteractiveShell
    formatter : IPython.core.formatters.MimeBundleFormatter
    digest : callable
        Digest of a figure.
    """
    _digest[:] = [digest]
    formatter.for_type_by_name("IPython.core.display", "HTML", _film_bundle)
    formatter.for_type_by_name("matplotlib.animation", "Animation", _animation_bundle)
    if _prepare not in shell.events.callbacks["pre_run_cell"]:
        shell.events.register("pre_run_cell", _prepare)


def _prepare(info: Any = None) -> None:
    """Before a cell that speaks of animations: have Matplotlib's film writers tell."""
    if "anim" not in str(getattr(info, "raw_cell", "")):
        return
    try:
        from matplotlib.animation import AbstractMovieWriter
    except ImportError:
        return
    if getattr(AbstractMovieWriter.saving, "tells", False):
        return
    original = AbstractMovieWriter.saving

    @contextmanager
    def saving(self: Any, fig: Any, *args: Any, **kwargs: Any) -> Iterator[Any]:
        film: list[dict[str, Any]] = []
        grab = self.grab_frame

        def grab_frame(**options: Any) -> None:
            film.append(_digest[0](fig))
            grab(**options)

        self.grab_frame = grab_frame
        try:
            with original(self, fig, *args, **kwargs) as writer:
                yield writer
        finally:
            del self.grab_frame
            _films.append(film)

    vars(saving)["tells"] = True
    setattr(AbstractMovieWriter, "saving", saving)  # noqa: B010


def _film_bundle(html: Any, **_: Any) -> dict[str, Any] | None:
    data = str(html.data or "")
    if _films and ("<video" in data or "new Animation(" in data):
        return {FIGURE_TYPE: {"frames": _films.pop(0)}}
    return None


def _animation_bundle(animation: Any, **_: Any) -> dict[str, Any] | None:
    html = animation._repr_html_()
    if html and _films:
        return {FIGURE_TYPE: {"frames": _films.pop(0)}, "text/html": html}
    return None
