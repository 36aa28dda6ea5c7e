"""Cameras number their frames: what is missing between two numbers."""

SHORT = (
    65_535  # GigE Vision counts from 1 to this and begins again at 1; its second version, and USB3 Vision, in 64 bits
)
_HALF = SHORT // 2


def missed_between(before: int | None, now: int) -> int:
    """How many frames lie between two that came one after the other; 0 where the later one is not later, or where a
    camera has begun to count anew.
    """
    if before is None or now == before:
        return 0
    if now > before:
        # One of the last round that is late.
        late = now <= SHORT and now - before > _HALF
        return 0 if late else now - before - 1
    wrapped = now + SHORT - before
    return wrapped - 1 if before <= SHORT and now > 0 and wrapped <= _HALF else 0
