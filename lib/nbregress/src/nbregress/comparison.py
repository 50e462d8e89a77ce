"""What a comparison needs at every depth: the settings, and which noise it met."""

import re
from dataclasses import dataclass, field

from nbregress.patterns import strip_noise, strip_today
from nbregress.settings import Settings
from nbregress.textdiff import text_difference


@dataclass
class Comparison:
    """One comparison of stored and new outputs.

    Parameters
    ----------
    settings : Settings
    noise : set of str
        Gets the names of the noise patterns that matched.

    Examples
    --------
    >>> Comparison(Settings()).text("<A at 0x7f0123456789>", "<A at 0x7f0123456788>")
    """

    settings: Settings
    noise: set[str] = field(default_factory=set)

    def text(self, stored: str, new: str, *, beside: float = 0.0) -> str | None:
        """What differs between two texts that are free of the named noise, or None.

        Parameters
        ----------
        stored, new : str
        beside : float >= 0
            The largest number of the array that the texts are a part of.

        Returns
        -------
        message : str or None
        """
        if stored == new:
            return None
        off = self.settings.compare
        for regex, replacement in self.settings.sanitize:
            stored, new = (re.sub(regex, replacement, text) for text in (stored, new))
        stored, new = (strip_noise(text, off, self.noise) for text in (stored, new))
        stored, new = strip_today(stored, new, off, self.noise)
        return text_difference(stored, new, self.settings, beside=beside)
