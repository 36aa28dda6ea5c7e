"""Where films are cut, so that all cores have work to the end.

A piece costs what its memory takes to be that of the whole: some blocks of what is learned (`forgetting`). So short
films stay whole, and so do those that cannot begin anywhere: videos, bags, stacks of images; films that are to be
smoothed; and those of a camera that is followed.
"""

from collections.abc import Sequence
from itertools import pairwise

LEAST_S = 30.0  # of film, in a piece
LEAST_FRAMES = 300
PIECES = 2  # for every core, of all films together

Piece = tuple[int, int | None]  # first place, and the one behind the last; None: whole, however long
WHOLE: list[Piece] = [(0, None)]


def cuts(
    lengths: Sequence[int | None], places: Sequence[int | None], rates_hz: Sequence[float], cores: int
) -> list[list[Piece]]:
    """The pieces of every film; ``lengths`` in frames, ``places`` where it can begin anywhere, else None.

    One core alone gains nothing by cutting.
    """
    if cores == 1:
        return [WHOLE for _ in lengths]
    share = max(sum(length or 0 for length in lengths) / (PIECES * cores), 1.0)
    return [_pieces(held, rate_hz, share) for held, rate_hz in zip(places, rates_hz, strict=True)]


def _pieces(places: int | None, rate_hz: float, share: float) -> list[Piece]:
    if places is None:
        return WHOLE
    least = max(LEAST_FRAMES, round(LEAST_S * rate_hz))
    count = max(1, min(round(places / share), places // least))
    if count == 1:
        return WHOLE
    edges = [round(k * places / count) for k in range(count + 1)]
    return list(pairwise(edges))
