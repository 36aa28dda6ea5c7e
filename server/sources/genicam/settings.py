"""The rig's `capture`, set in a GenICam camera: what it accepts is asked of it before, what it took is read back."""

from typing import NamedTuple

from asterism.protocol.capture import ACTION, FREE, SOFTWARE, Capture
from asterism.protocol.errors import InputError
from asterism.server.sources.genicam.aravis import AravisError
from asterism.server.sources.genicam.aravis_camera import EXPOSURE, GAIN, RATE, ArvCamera, Steps
from asterism.server.sources.genicam.link_rate import most_hz
from asterism.server.sources.genicam.pixel_formats import BY_NAME
from asterism.server.sources.source import Say

_UNITS = {EXPOSURE: " us", GAIN: "", RATE: " Hz"}
_KEYS = {EXPOSURE: "exposure_us", GAIN: "gain", RATE: "rate"}
_AUTOMATIC = {EXPOSURE: "ExposureAuto", GAIN: "GainAuto"}
_BINNING = ("BinningHorizontal", "BinningVertical")
_ROUNDED = 0.01  # by which a camera may round what it is asked for
_KEY_OF_ACTION = {"ActionDeviceKey": 1, "ActionGroupKey": 1, "ActionGroupMask": 1}


class Applied(NamedTuple):
    """What the camera does now."""

    width: int
    height: int
    pixel_format: str
    exposure_ns: int  # 0 where it does not tell
    rate_hz: float | None  # by itself; None where it waits for a trigger, or does not tell
    trigger: str | None  # what it waits for


def apply_settings(camera: ArvCamera, capture: Capture, size: tuple[int, int] | None, name: str, say: Say) -> Applied:
    """Set what ``capture`` asks for, and the image's ``size`` (width, height px; None leaves it).

    Raises InputError with a sentence for everything that the camera refuses: what, and what it accepts.
    """
    camera.clear_triggers()  # of whoever had it before
    refused = _binning(camera, capture.binning) or [
        *_region(camera, capture, size),
        *_pixel_format(camera, capture.pixel_format),
        *_value(camera, EXPOSURE, capture.exposure_us),
        *_value(camera, GAIN, capture.gain),
    ]
    free = capture.trigger in (None, FREE)
    if free and not refused:
        refused += _rate(camera, capture.rate_hz)
    elif not free:
        refused += _trigger(camera, str(capture.trigger))
    if refused:
        raise InputError("; ".join(f"{name}: {sentence}" for sentence in refused))
    _say_rounded(camera, capture, name, say)
    return _applied(camera, None if free else str(capture.trigger))


def _applied(camera: ArvCamera, trigger: str | None) -> Applied:
    _, _, width, height = camera.region()
    exposure = camera.value(EXPOSURE) if camera.can(EXPOSURE) else 0.0
    rate = camera.value(RATE) if trigger is None and camera.can(RATE) else None
    return Applied(width, height, camera.pixel_format(), round(1e3 * exposure), rate or None, trigger)


def _binning(camera: ArvCamera, asked: int | None) -> list[str]:
    """Before the region, whose bounds it changes."""
    if asked is None:
        return []
    for feature in _BINNING:
        if not camera.has(feature):
            return [] if asked == 1 else [f"capture.binning {asked}: the camera has no such setting ({feature})"]
        try:
            camera.set_whole(feature, asked)
        except AravisError as problem:
            return [f"capture.binning {asked}: the camera does not take it ({problem})"]
        if (got := camera.whole(feature)) != asked:
            return [f"capture.binning {asked}: the camera made {got} of it ({feature})"]
    return []


def _region(camera: ArvCamera, capture: Capture, size: tuple[int, int] | None) -> list[str]:
    x, y, *before = camera.region()
    refused = []
    if size is not None and list(size) != before:
        key = "capture.size" if capture.size is not None else "the calibration's size"
        refused = _size(camera, size, f"{key} {list(size)}: the camera")
    if refused:
        return refused
    if capture.offset is not None:
        return _offset(camera, capture.offset, capture.binning or 1)
    # A calibration of the camera's own region is of its own offset.
    if camera.can_offset() and not _misfit(camera.steps("x_offset"), x) and not _misfit(camera.steps("y_offset"), y):
        camera.set_region(x, y, *camera.region()[2:])
    return []


def _size(camera: ArvCamera, size: tuple[int, int], what: str) -> list[str]:
    if camera.can_offset():
        camera.set_region(0, 0, *camera.region()[2:])  # else the offset limits the size
    sides = zip(("width", "height"), size, strict=True)
    refused = [f"{what}'s {side} is {told} px" for side, asked in sides if (told := _misfit(camera.steps(side), asked))]
    if refused:
        return refused
    camera.set_region(-1, -1, *size)
    got = camera.region()[2:]
    return [] if got == size else [f"{what} made {got[0]}x{got[1]} of it"]


def _offset(camera: ArvCamera, of_sensor: tuple[int, int], binning: int) -> list[str]:
    """A camera counts its offset in the pixels that it gives."""
    what = f"capture.offset {list(of_sensor)}: the camera"
    if any(value % binning for value in of_sensor):
        return [f"capture.offset {list(of_sensor)}: expected multiples of the binning, {binning}"]
    asked = of_sensor[0] // binning, of_sensor[1] // binning
    if not camera.can_offset():
        return [f"{what}'s image always begins at the sensor's corner"]
    for side, value in zip(("x_offset", "y_offset"), asked, strict=True):
        if told := _misfit(camera.steps(side), value):
            return [f"{what}'s {side[0]} is {told} px with this size"]
    _, _, width, height = camera.region()
    camera.set_region(*asked, width, height)
    got = camera.region()[:2]
    return [] if got == asked else [f"{what} made [{got[0]}, {got[1]}] of it"]


def _misfit(steps: Steps, asked: int) -> str:
    """'' where it fits, else what is accepted."""
    if steps.least <= asked <= steps.most and (asked - steps.least) % steps.step == 0:
        return ""
    return f"{steps.least} to {steps.most}" + (f" in steps of {steps.step}" if steps.step > 1 else "")


def _pixel_format(camera: ArvCamera, asked: str | None) -> list[str]:
    has = camera.pixel_formats()
    readable = [one for one in has if one in BY_NAME]
    if asked is None:
        if camera.pixel_format() in BY_NAME:
            return []
        if not readable:
            return [f"the camera has no grey pixel format that can be read, only {', '.join(has)}"]
        asked = readable[0]
    if asked not in readable:
        other = " is no grey that can be read" if asked in has else " is none of the camera's"
        return [f"capture.pixel_format {asked}:{other}; it has {', '.join(readable) or 'no grey one'}"]
    camera.set_pixel_format(asked)
    got = camera.pixel_format()
    return [] if got == asked else [f"capture.pixel_format {asked}: the camera made {got} of it"]


def _value(camera: ArvCamera, what: str, asked: float | None) -> list[str]:
    """Exposure, gain or rate."""
    if asked is None:
        return []
    key, unit = f"capture.{_KEYS[what]} {asked:g}", _UNITS[what]
    if not camera.can(what):
        return [f"{key}: the camera has no such setting"]
    automatic = _AUTOMATIC.get(what, "")
    if camera.has(automatic):
        camera.set_text(automatic, "Off")
    least, most = camera.bounds(what)
    if not least <= asked <= most:
        return [f"{key}: the camera accepts {least:g} to {most:g}{unit}" + (" as it is set" if what == RATE else "")]
    camera.set_value(what, asked)
    got = camera.value(what)
    # Gain in steps of a decibel is rounded by more than its own size.
    if abs(got - asked) > max(_ROUNDED * asked, 0.5 if what == GAIN else 0.0) + 1e-9:
        return [f"{key}: the camera made {got:g}{unit} of it"]
    return []


def _rate(camera: ArvCamera, asked: float | None) -> list[str]:
    if asked is not None and (most := most_hz(camera)) is not None and asked > most.rate_hz:
        return [f"capture.rate {asked:g}: {most.why}"]
    if camera.has("AcquisitionFrameRateEnable") and asked is not None:
        camera.set_flag("AcquisitionFrameRateEnable", True)  # some show their bounds only then
    return _value(camera, RATE, asked)


def _trigger(camera: ArvCamera, asked: str) -> list[str]:
    has = camera.trigger_sources()
    actions = [one for one in has if one.startswith("Action")]
    source = {SOFTWARE: "Software", ACTION: actions[0] if actions else ""}.get(asked, asked)
    if source not in has:
        lines = [one for one in has if one != "Software" and one not in actions]
        accepted = [FREE, *([SOFTWARE] if "Software" in has else []), *([ACTION] if actions else []), *lines]
        return [f"capture.trigger {asked}: is none of the camera's; it accepts {', '.join(accepted)}"]
    if asked == ACTION:
        for feature, value in _KEY_OF_ACTION.items():
            if camera.has(feature):
                camera.set_whole(feature, value)
    try:
        camera.set_trigger(source)
    except AravisError as problem:
        return [f"capture.trigger {asked}: the camera does not take it ({problem})"]
    return []


def _say_rounded(camera: ArvCamera, capture: Capture, name: str, say: Say) -> None:
    asked = {EXPOSURE: capture.exposure_us, GAIN: capture.gain}
    for what, value in asked.items():
        if value is not None and abs((got := camera.value(what)) - value) > 1e-3 * max(value, 1.0):
            say(f"{name}: capture.{_KEYS[what]} {value:g} is {got:g}{_UNITS[what]} in this camera")
