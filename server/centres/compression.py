"""Whether a picture was compressed hard: then what is beside a spot may be the compression's own.

JPEG from about 80 downwards, and H.264 at any common rate, round the noise of a dark background away: neighbours there
are equal nearly everywhere: at JPEG 75 93 %, with H.264 99 %. Few sensors are so quiet: with read noise of half a grey
level it is at most 70 %, with a whole one 27 %. One that is, or that cuts its background off at zero, cannot be told
from compression, and counts as such.
"""

import numpy as np
from numpy.typing import NDArray

ROWS = 32  # that are looked at
EVERY_PIXEL = 16  # of them, for the median
LEVELS = 40  # grey levels above the median, up to which a pixel is background
EQUAL = 0.9  # of neighbours, from which on no sensor made them


def is_compressed(image: NDArray[np.uint8]) -> bool:
    """Whether the noise of the background of an (h, w) uint8 image was rounded away."""
    rows = image[:: max(len(image) // ROWS, 1)]
    median = int(np.median(rows[:, ::EVERY_PIXEL]))
    background = rows[:, 1:] <= min(median + LEVELS, 254)
    equal = (rows[:, 1:] == rows[:, :-1]) & background
    counted, most = int(background.sum()), int(equal.sum())
    return most > EQUAL * max(counted, 1)
