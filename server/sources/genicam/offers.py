"""What a GenICam camera gives: pixel formats, sizes, rates, as `asterism cameras` lists them."""

from asterism.server.sources.background import in_background
from asterism.server.sources.genicam.aravis import AravisError
from asterism.server.sources.genicam.aravis_camera import RATE, ArvCamera
from asterism.server.sources.genicam.gvcp import taken_by
from asterism.server.sources.genicam.pixel_formats import BY_NAME


def offers_of(which: str, address: str) -> tuple[tuple[str, ...], str]:
    """A line for the formats that can be read, one for those that can't; or none, and why it can't be asked.

    ``which`` and ``address`` as `ArvCamera` takes them. A camera that somebody has is left alone.
    """
    if address and (owner := taken_by(address)) is not None:
        return (), f"in use by {owner}"
    try:
        camera = ArvCamera(which, address)
    except AravisError as problem:
        return (), f"does not open ({problem})"
    try:
        return tuple(_lines(camera)), ""
    except AravisError as problem:
        return (), f"does not tell what it gives ({problem})"
    finally:
        in_background(camera.close)


def _lines(camera: ArvCamera) -> list[str]:
    formats = camera.pixel_formats()
    width, height = (
        camera.whole(told) if camera.has(told) else camera.steps(side).most
        for told, side in (("WidthMax", "width"), ("HeightMax", "height"))
    )
    rate = f" at up to {camera.bounds(RATE)[1]:.4g} Hz as it is set" if camera.can(RATE) else ""
    read = [name for name in formats if name in BY_NAME]
    unread = [name for name in formats if name not in BY_NAME]
    lines = [f"{' '.join(read)}: up to {width}x{height}{rate}"] if read else []
    return [*lines, *([f"not read: {' '.join(unread)}"] if unread else [])]
