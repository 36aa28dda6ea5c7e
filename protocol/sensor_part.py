"""A calibration of a whole sensor, for images that are a part of it, or binned.

A region's top-left pixel is ``offset`` of the sensor; binning joins b x b pixels to one. (0, 0) is the centre of the
top-left pixel in both, so that x of the sensor is (x - offset + 0.5) / b - 0.5 of the image. What a lens does to rays
stays what it was.
"""

from dataclasses import replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.capture import Capture

MOST_BINNING = 16


def part_of(camera: Camera, offset: tuple[int, int], size: tuple[int, int], binning: tuple[int, int]) -> Camera:
    """The camera whose images of ``size`` begin at ``offset``, px of the sensor, ``binning`` px of it to one across and
    down. Raises ValueError, with a sentence, where that leads beyond the sensor.
    """
    for axis, whole in enumerate((camera.width, camera.height)):
        if not 1 <= binning[axis] <= MOST_BINNING:
            raise ValueError(f"binning by {binning[axis]}, expected 1 to {MOST_BINNING}")
        if size[axis] < 1 or offset[axis] < 0 or offset[axis] + size[axis] * binning[axis] > whole:
            by = f", binned {binning[0]}x{binning[1]}," if binning != (1, 1) else ""
            raise ValueError(
                f"{size[0]}x{size[1]} px{by} from ({offset[0]}, {offset[1]}) on lead beyond the {camera.width}x"
                f"{camera.height} px that camera '{camera.name}' is calibrated for"
            )
    matrix = camera.matrix.copy()
    matrix[:2] /= np.array(binning)[:, None]
    matrix[:2, 2] = (camera.matrix[:2, 2] - offset + 0.5) / binning - 0.5
    return replace(camera, width=size[0], height=size[1], matrix=matrix)


def whole_of(matrix: np.ndarray, offset: tuple[int, int], binning: tuple[int, int]) -> np.ndarray:
    """The matrix (3, 3) for the whole sensor, of one for a part of it: the other way round."""
    whole = matrix.copy()
    whole[:2] *= np.array(binning)[:, None]
    whole[:2, 2] = (matrix[:2, 2] + 0.5) * binning - 0.5 + offset
    return whole


def captured(camera: Camera, capture: Capture) -> Camera:
    """The camera as its images show it, where a rig's `capture` makes them a part of what is calibrated.

    Raises ValueError, with a sentence, for a part beyond it, and for one that may lie in several places.
    """
    whole = (camera.width, camera.height)
    binning = capture.binning or 1
    if binning == 1 and capture.size in (None, whole):
        return camera  # also with an offset: then the region itself is what was calibrated
    size = capture.size or (whole[0] // binning, whole[1] // binning)
    covers = size == (whole[0] // binning, whole[1] // binning)
    if capture.offset is None and not (capture.binning and covers):
        raise ValueError(_where(whole, size, capture.binning is None))
    return part_of(camera, capture.offset or (0, 0), size, (binning, binning))


def _where(whole: tuple[int, int], size: tuple[int, int], may_be_binned: bool) -> str:
    """What to write where nobody said where a part lies."""
    told = f"size {size[0]}x{size[1]}, where {whole[0]}x{whole[1]} is calibrated"
    if size[0] > whole[0] or size[1] > whole[1]:
        return f"{told}: expected at most that; calibrate the camera for it"
    centred = [(whole[axis] - size[axis]) // 2 for axis in (0, 1)]
    region = f"for a region, offset: [x, y] (in the middle it would be {centred})"
    step = binning_of(whole, size) if may_be_binned else None
    if step is None:
        return f"{told}: say where that is, {region}"
    return f"{told}: is that binned, or a region? For pixels that are joined say binning: {step}, {region}"


def binning_of(whole: tuple[int, int], size: tuple[int, int]) -> int | None:
    """By how much images of ``size`` would be binned, if they are: by 2, 4, 8 or 16 in both directions."""
    steps = (2, 4, 8, MOST_BINNING)
    return next((step for step in steps if (whole[0] / step, whole[1] / step) == size), None)
