"""Pictures that carry no data compared by their pixels, sounds by their samples."""

import base64
import binascii
import io

import numpy as np

# Share of the pixels that may differ by more than this many of 255 levels, and mean level.
_SHARE, _LEVEL, _MEAN = 5e-4, 24, 0.5


def pictures_difference(stored: str, new: str) -> str | None:
    """What differs between two pictures, or None.

    Parameters
    ----------
    stored, new : str
        Files in base64: PNG, JPEG, GIF, WebP or whatever Pillow reads.

    Returns
    -------
    message : str or None
        None too if the pixels hardly differ: one in 2000 by more than a tenth, half a level
        of 255 on the average.
    """
    a, b = _file(stored), _file(new)
    if a is None or b is None:
        return None if stored.strip() == new.strip() else "is not base64, and differs"
    if a == b:
        return None
    if a[8:12] == b[8:12] == b"WAVE":
        return _sounds_difference(a, b)
    try:
        from PIL import Image, ImageChops, ImageSequence
    except ImportError:
        return "pixels cannot be compared without the package pillow; the files differ"
    try:
        with Image.open(io.BytesIO(a)) as first, Image.open(io.BytesIO(b)) as second:
            if first.size != second.size:
                return "{} x {} pixels, stored {} x {}".format(*second.size, *first.size)
            frames = [getattr(picture, "n_frames", 1) for picture in (first, second)]
            if frames[0] != frames[1]:
                return f"{frames[1]} frames, stored {frames[0]}"
            pairs = zip(ImageSequence.Iterator(first), ImageSequence.Iterator(second), strict=True)
            for number, (old, frame) in enumerate(pairs, start=1):
                mode = "RGBA" if "A" in old.mode + frame.mode or "P" in old.mode else "RGB"
                change = ImageChops.difference(old.convert(mode), frame.convert(mode))
                counts = np.reshape(change.histogram(), (-1, 256))  # a row for each band
                pixels, worst = counts[0].sum(), counts[:, _LEVEL + 1 :].sum(axis=1).max()
                mean = counts.sum(axis=0) @ np.arange(256) / counts.sum()
                if worst > _SHARE * pixels or mean > _MEAN:
                    place = f"frame {number}: " if frames[0] > 1 else ""
                    return f"{place}{worst / pixels:.1%} of the pixels differ, by {mean:.2g} of 255"
    except Exception as error:  # whatever Pillow finds wrong with a stranger's file
        return f"cannot be read ({type(error).__name__}: {error}), and the files differ"
    return None


def _sounds_difference(stored: bytes, new: bytes) -> str | None:
    a, b = (np.frombuffer(file[44:], "<i2").astype(int) for file in (stored, new))
    if stored[:44] != new[:44] or len(a) != len(b):
        return "another rate, length or kind of sound"
    count = np.count_nonzero(abs(a - b) > 1)  # of 32768: rounding
    return f"{count} of {len(a)} samples of the sound differ" if count else None


def _file(encoded: str) -> bytes | None:
    try:
        return base64.b64decode("".join(encoded.split()).replace("\\n", ""), validate=True)
    except (binascii.Error, ValueError):
        return None
