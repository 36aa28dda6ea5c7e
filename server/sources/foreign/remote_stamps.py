"""Stamps of a camera program on another host, on this host's monotonic clock.

They are its wall clock's, and nobody knows how that stands to ours: they are mapped by the least delay seen, as a
camera's own clock is. What waited on its way is as old as its stamp says, however late it is.
"""

from asterism.protocol.capture import STAMPS, Capture
from asterism.server.sources.camera_clock import CameraClock

LATE_NS = 500_000_000  # such images waited on their way, ...
SET_NS = 3_000_000_000  # ... unless all for so long come so late: then the clock was set


class RemoteStamps:
    """One for each time the images begin to come."""

    def __init__(self, capture: Capture) -> None:
        self._clock = CameraClock()
        exposure_ns = round((capture.exposure_us or 0.0) * 1e3)
        self._to_middle_ns = {STAMPS[0]: exposure_ns // 2, STAMPS[1]: 0, STAMPS[2]: -exposure_ns // 2}[capture.stamp]
        self._newest_ns = 0
        self._apart_ns: int | None = None  # host's clock less theirs
        self._late_since_ns: int | None = None

    def middle_ns(self, stamp_ns: int, arrived_ns: int) -> int | None:
        """Mid-exposure of an image, ns of the host's monotonic clock, at which it arrived; None where its stamp tells
        nothing: there is none, or it is that of the one before.
        """
        if stamp_ns <= 0 or stamp_ns == self._newest_ns:
            return None
        if self._apart_ns is not None:
            waited = self._waited(arrived_ns - stamp_ns - self._apart_ns, arrived_ns)
            if waited or stamp_ns < self._newest_ns:  # the latter overtaken on its way
                return stamp_ns + self._apart_ns + self._to_middle_ns
        self._newest_ns = stamp_ns
        mapped_ns = self._clock.host_ns(stamp_ns, arrived_ns)
        self._apart_ns = mapped_ns - stamp_ns
        return min(mapped_ns + self._to_middle_ns, arrived_ns)

    def _waited(self, late_ns: int, arrived_ns: int) -> bool:
        if late_ns < LATE_NS:
            self._late_since_ns = None
            return False
        if self._late_since_ns is None:
            self._late_since_ns = arrived_ns
        if arrived_ns - self._late_since_ns < SET_NS:
            return True
        self._late_since_ns, self._newest_ns = None, 0
        return False
