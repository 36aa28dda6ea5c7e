"""When the light of a V4L2 frame fell, by its driver's stamp."""

from asterism.protocol.capture import Capture
from asterism.server.sources.v4l2.abi import (
    STAMP_AT_MASK,
    STAMP_AT_START,
    STAMP_MASK,
    STAMP_MONOTONIC,
)

OLDEST_NS = 5_000_000_000  # that a frame waits in a driver's buffers, however late it is fetched


def no_stamp(stamp_ns: int, flags: int, now_ns: int) -> str:
    """Why a buffer's stamp cannot be used, or "". ``now_ns`` is the host's monotonic clock after it was fetched."""
    if flags & STAMP_MASK != STAMP_MONOTONIC:
        return "are not of the monotonic clock"
    if stamp_ns <= 0:
        return "are zero"
    age_ns = now_ns - stamp_ns
    if age_ns < 0:
        return f"lie in the future, by {-age_ns / 1e6:.3g} ms"
    return f"are {age_ns / 1e9:.3g} s old when frames come" if age_ns > OLDEST_NS else ""


def mid_exposure_ns(stamp_ns: int, flags: int, exposure_us: float | None, capture: Capture) -> int:
    """Mid-exposure on the clock of the stamp: half the exposure from where the rig says that the stamp is taken, and
    where it says nothing, from where the driver's flags do. An exposure that is not known counts as none.
    """
    half_ns = round((exposure_us or 0.0) * 500.0)
    at_start = flags & STAMP_AT_MASK == STAMP_AT_START
    stamped = capture.stamp if capture.stamp_given else "start" if at_start else "end"
    return stamp_ns + {"start": half_ns, "middle": 0, "end": -half_ns}[stamped]
