"""A V4L2 camera set as the rig wants it. What it makes of every setting is read back; where that is something else,
one sentence tells.
"""

import errno
import math
from dataclasses import dataclass

from asterism.protocol.capture import FREE, Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.server.sources.source import Say
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.node import Node
from asterism.server.sources.v4l2.offers import NEARLY, Choice, choose, rates_text, read_offers
from asterism.server.sources.v4l2.pixels import FORMATS, Layout


@dataclass(frozen=True, slots=True)
class InForce:
    """How the camera is set now."""

    layout: Layout
    rate_hz: float | None  # None: the driver does not say
    exposure_us: float | None  # None: not known, or the camera's own business


def refuse_what_v4l2_lacks(capture: Capture, name: str) -> None:
    """Raises InputError for settings that V4L2 has no word for."""
    if capture.trigger not in (None, FREE):
        raise InputError(f"{name}: capture.trigger {capture.trigger}: V4L2 knows no triggers, expected {FREE} or none")
    if any(capture.offset or ()):
        raise InputError(
            f"{name}: capture.offset: V4L2 cameras give their image from its first pixel on, expected none"
        )


def apply_settings(node: Node, capture: Capture, size: tuple[int, int] | None, name: str, say: Say) -> InForce:
    """Set pixel format, size, rate, exposure and gain; ``size`` None leaves the camera's own.

    Raises InputError for a format or size that the camera lacks, OSError as the driver has it.
    """
    if size is None:
        now = node.layout()
        size = now.width, now.height
    choice = choose(read_offers(node, size), name, capture.pixel_format, size, capture.rate_hz)
    layout = _set_layout(node, choice, capture.bits, name)
    rate_hz = _set_rate(node, choice, capture.rate_hz, name, say)
    if capture.exposure_us is not None:
        _set_exposure(node, capture.exposure_us, name, say)
    if capture.gain is not None:
        _set_gain(node, capture.gain, name, say)
    if FORMATS[layout.fourcc].bits == 16 and capture.bits is None:
        say(f"{name}: pixels are taken for all of their 16 bits; if images are dark, say in the rig: capture.bits")
    return InForce(layout, rate_hz, _exposure_us(node))


def _set_layout(node: Node, choice: Choice, bits: int | None, name: str) -> Layout:
    size = choice.mode.size
    got = node.set_layout(choice.fourcc, size)
    fourcc = abi.fourcc_name(got.pixelformat)
    if (got.width, got.height) != size:
        raise InputError(
            f"{name}: the camera made {got.width}x{got.height} of {size[0]}x{size[1]}; expected a size that it has"
        )
    if fourcc != choice.fourcc:
        raise WorldError(f"{name}: the camera said that it has pixel format {choice.fourcc}, and set {fourcc}")
    return Layout(fourcc, got.width, got.height, got.bytesperline, bits)


def _set_rate(node: Node, choice: Choice, wanted_hz: float | None, name: str, say: Say) -> float | None:
    if wanted_hz is None:
        return node.rate()
    got_hz = node.set_rate(wanted_hz)
    if (priority := node.control(abi.EXPOSURE_AUTO_PRIORITY)) is not None:
        _settle(node, priority, 0)  # or the rate sinks where it is dark
    if got_hz is None:
        say(f"{name}: capture.rate {wanted_hz:g}: the camera takes no rate; its own stays")
        return node.rate()
    if abs(got_hz / wanted_hz - 1.0) > 1.0 - NEARLY:
        mode = choice.mode
        has = f"; as {choice.fourcc} of {mode.width}x{mode.height} it has {rates_text(mode)}" if mode.rates else ""
        say(f"{name}: capture.rate {wanted_hz:g}: the camera set {got_hz:.4g} Hz{has}")
    return got_hz


def _set_exposure(node: Node, wanted_us: float, name: str, say: Say) -> None:
    where = f"{name}: capture.exposure_us {wanted_us:g}"
    if (automatic := node.control(abi.EXPOSURE_AUTO)) is not None:
        _settle(node, automatic, abi.EXPOSURE_MANUAL)
        if node.value(abi.EXPOSURE_AUTO) != abi.EXPOSURE_MANUAL:
            say(f"{where}: the camera's automatic exposure cannot be switched off")
            return
    control = node.control(abi.EXPOSURE_ABSOLUTE)
    if control is None:
        say(f"{where}: the camera has no exposure that can be set; its own stays")
        return
    unit = abi.EXPOSURE_UNIT_US
    got_us = _settle(node, control, wanted_us / unit) * unit
    if not math.isclose(got_us, wanted_us, rel_tol=1e-6):
        bounds = f"{control.minimum * unit:g} to {control.maximum * unit:g} in steps of {max(control.step, 1) * unit:g}"
        say(f"{where}: the camera set {got_us:g} us; it takes {bounds}")


def _set_gain(node: Node, wanted: float, name: str, say: Say) -> None:
    where = f"{name}: capture.gain {wanted:g}"
    if (automatic := node.control(abi.AUTOGAIN)) is not None:
        _settle(node, automatic, 0)
    control = node.control(abi.GAIN) or node.control(abi.ANALOGUE_GAIN)
    if control is None:
        say(f"{where}: the camera has no gain that can be set; its own stays")
        return
    got = _settle(node, control, wanted)
    if got != wanted:
        bounds = f"{control.minimum} to {control.maximum} in steps of {max(control.step, 1)}"
        say(f"{where}: the camera set {got}; it takes {bounds}")


def _settle(node: Node, control: abi.ControlQuery, wanted: float) -> int:
    """Set a control to the nearest whole value within its bounds; returns what the camera made of it, if anything."""
    value = min(max(round(wanted), control.minimum), control.maximum)
    try:
        node.set_value(control.id, value)
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise
    return node.value(control.id)


def _exposure_us(node: Node) -> float | None:
    if node.control(abi.EXPOSURE_ABSOLUTE) is None:
        return None
    automatic = node.control(abi.EXPOSURE_AUTO)
    if automatic is not None and node.value(abi.EXPOSURE_AUTO) != abi.EXPOSURE_MANUAL:
        return None
    return node.value(abi.EXPOSURE_ABSOLUTE) * abi.EXPOSURE_UNIT_US
