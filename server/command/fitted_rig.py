"""A source for a rig, and the rig for its images: where these are exactly half as large as calibrated, a quarter, ...,
they are taken for binned, which is said.
"""

from dataclasses import replace
from itertools import islice

from asterism.protocol.camera import parse_camera
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig, parse_rig
from asterism.protocol.sensor_part import binning_of
from asterism.server.calibration.rewrite import rewrite
from asterism.server.sources.open_source import is_endless, open_source
from asterism.server.sources.source import Say, Source


def open_fitting(
    text: str, rig: Rig, say: Say, topic: str | None = None, ros_domain: int | None = None
) -> tuple[Rig, Source]:
    """The source that ``text`` names, as `open_source` has it, and the rig that its images go with.

    Raises InputError and WorldError as `open_source` does.
    """
    rig = fitting(text, rig, say, topic)
    return rig, open_source(text, rig, say, topic=topic, ros_domain=ros_domain or 0)


def fitting(text: str, rig: Rig, say: Say, topic: str | None = None) -> Rig:
    """The rig for the images of a source; it says what was scaled."""
    told = parse_camera(rig.camera_text, "camera.yaml") if rig.camera_text else rig.camera
    whole, served = (told.width, told.height), (rig.camera.width, rig.camera.height)
    if served != whole:
        say(_part(rig, whole))
        return rig
    if is_endless(text) or rig.masks or rig.capture.size or rig.capture.offset:
        return rig
    size = _first_size(text, topic)
    if size is None or (binning := binning_of(whole, size)) is None:
        return rig
    say(
        f"{text}: images of {size[0]}x{size[1]} px, where {whole[0]}x{whole[1]} are calibrated: taken for binned "
        f"{binning}x{binning}, as if the rig said capture: {{binning: {binning}}}. Say that there; or, if they are a "
        f"region, capture: {{size: [{size[0]}, {size[1]}], offset: [x, y]}}"
    )
    text_of_it = rewrite(rig.rig_text, {("capture", "binning"): binning}, "rig")
    fitted = parse_rig(text_of_it, rig.camera_text, "rig", rig.offset_texts, rig.files)
    capture = replace(rig.capture, binning=binning)
    return replace(rig, camera=fitted.camera, capture=capture, rig_text=text_of_it)


def _part(rig: Rig, whole: tuple[int, int]) -> str:
    """What the rig's `capture` makes of the calibration."""
    binning, (x, y) = rig.capture.binning or 1, rig.capture.offset or (0, 0)
    return (
        f"the calibration of {whole[0]}x{whole[1]} px was scaled to the images: {rig.camera.width}x{rig.camera.height} "
        f"px, binned {binning}x{binning}, from ({x}, {y}) on"
    )


def _first_size(text: str, topic: str | None) -> tuple[int, int] | None:
    """Width and height of the first image that can be read; whatever is wrong is said when the source is opened."""
    try:
        for frame in islice(open_source(text, None, lambda _: None, topic=topic).frames(), 1):
            return frame.image.shape[1], frame.image.shape[0]
    except (InputError, WorldError):
        pass
    return None
