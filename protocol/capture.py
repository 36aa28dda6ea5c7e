"""The rig's `capture`: how the camera is set, and when light fell by the stamps that it gives."""

from dataclasses import dataclass

from asterism.protocol.rig_hints import CAPTURE_WORDS
from asterism.protocol.yaml_file import Section

LONGEST_LINE_US = 1000.0  # of a rolling shutter; sensors take 5 to 70
LONGEST_DELAY_US = 1e6  # from mid-exposure to the stamp
STAMPS = ("start", "middle", "end")  # of the exposure; the first is the default
FREE, SOFTWARE, ACTION = "free", "software", "action"  # triggers beside the camera's own lines


@dataclass(frozen=True, slots=True)
class Capture:
    """Camera settings; None leaves the camera's own."""

    rate_hz: float | None = None
    exposure_us: float | None = None
    gain: float | None = None
    size: tuple[int, int] | None = None  # width, height
    bits: int | None = None  # of a 16-bit frame's pixels; None: all 16
    line_time_us: float = 0.0  # of a rolling shutter, from one row to the next, downwards; 0: all rows at once
    offset: tuple[int, int] | None = None  # of the image's top-left pixel on the sensor
    pixel_format: str | None = None  # as the camera names it
    trigger: str | None = None  # `free`, `software`, `action` (GigE Vision's action command), or a line by its name
    stamp: str = STAMPS[0]  # what of the exposure the camera's stamp tells
    stamp_given: bool = False  # whether the rig says so; V4L2's drivers say it themselves
    delay_us: float = 0.0  # from there to the stamp
    binning: int | None = None  # pixels of the calibrated sensor that are joined to one, across and down


def read_capture(section: Section) -> Capture:
    """The `capture` of a rig. Raises InputError with file, key, what was found and what is accepted."""
    keys = ("rate", "exposure_us", "gain", "size", "bits", "line_time_us")
    section.only((*keys, "offset", "pixel_format", "trigger", "stamp", "delay_us", "binning"), CAPTURE_WORDS)
    return Capture(
        rate_hz=section.number("rate", above=0) if "rate" in section else None,
        exposure_us=section.number("exposure_us", above=0) if "exposure_us" in section else None,
        gain=section.number("gain", least=0) if "gain" in section else None,
        size=_pixels(section, "size", 1, "width, height px") if "size" in section else None,
        bits=section.integer("bits", 8, 16) if "bits" in section else None,
        line_time_us=_line_time(section) if "line_time_us" in section else 0.0,
        offset=_pixels(section, "offset", 0, "x, y px of the first pixel") if "offset" in section else None,
        pixel_format=section.text("pixel_format") if "pixel_format" in section else None,
        trigger=section.text("trigger") if "trigger" in section else None,
        stamp=section.text("stamp", STAMPS) if "stamp" in section else STAMPS[0],
        stamp_given="stamp" in section,
        delay_us=_delay(section) if "delay_us" in section else 0.0,
        binning=section.integer("binning", 1, 16) if "binning" in section else None,
    )


def _pixels(section: Section, key: str, least: int, what: str) -> tuple[int, int]:
    first, second = section.numbers(key, 2, what)
    if not (first.is_integer() and second.is_integer() and min(first, second) >= least):
        raise section.error(key, f"[{first:g}, {second:g}], expected two whole numbers of px, at least {least}")
    return int(first), int(second)


def _line_time(section: Section) -> float:
    time = section.number("line_time_us", least=0)
    if time > LONGEST_LINE_US:
        raise section.error(
            "line_time_us",
            f"{time:g}, expected us from one row to the next, at most {LONGEST_LINE_US:g}; is that ns, or the time of "
            "all rows?",
        )
    return time


def _delay(section: Section) -> float:
    delay = section.number("delay_us")
    if abs(delay) > LONGEST_DELAY_US:
        raise section.error(
            "delay_us",
            f"{delay:g}, expected us from mid-exposure to the stamp, at most {LONGEST_DELAY_US:g}; is that ns?",
        )
    return delay
