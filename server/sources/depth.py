"""How many of a 16-bit image's bits are the camera's, where nobody said.

Cameras of 10, 12 and 14 bits come in pixels of 16, and most of them in the lower bits: taken for 16 such an image is
all but black. The first image's brightest pixel tells; a later one that does not fit is an error, since half of a film
in one scale and half in another would be wrong in silence.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.server.sources.source import Say

USUAL = (10, 12, 14)  # bits of cameras' pixels in 16


class Depth:
    """Remembers the bits of a source's 16-bit images. ``bits`` is what the rig or a person says; None: look."""

    def __init__(self, bits: int | None, say: Say) -> None:
        self._told = bits
        self._found: int | None = None
        self._say = say

    def bits_of(self, image: NDArray[Any], name: str) -> int | None:
        """Significant bits of one image. Raises InputError for one that holds more than the first one showed."""
        if self._told is not None or image.dtype != np.uint16:
            return self._told
        brightest = int(image.max())
        if self._found is None:
            self._found = next((bits for bits in USUAL if brightest < 1 << bits), 16)
            if self._found != 16:
                self._say(
                    f"{name}: values up to {brightest} in 16 bits: taken for a camera of {self._found} bits; "
                    "if that is wrong, say locate --bits N, or capture.bits in the rig"
                )
        if brightest >= 1 << self._found:
            raise InputError(
                f"{name}: values up to {brightest}, more than the {self._found} bits that the first image showed; say "
                "how many there are: locate --bits N, or capture.bits in the rig"
            )
        return self._found
