"""Bytes on the wire, in a recording and in a replay of it, as they are compared."""

import base64
from collections import defaultdict
from pathlib import Path
from typing import Any

from asterism.protocol.codec import decode_frame_report, in_session
from asterism.protocol.messages import EVENT, FRAME_REPORT, ODOMETRY, Message
from asterism.recordings.reader import Recording

Keyed = dict[str, list[bytes]]


def received_bytes(received: list[dict[str, Any]]) -> Keyed:
    """The payloads that `servers.Subscriber` wrote down, by key and in order, without a replay's prefix."""
    return _by_key([(entry["key"], base64.b64decode(entry["payload"])) for entry in received])


def recorded_bytes(folder: Path) -> Keyed:
    """Those of a recording that belong on the wire."""
    return _by_key([(m.key, m.payload) for m in Recording(folder).messages() if m.kind.on_wire])


def in_the_session_of(played: Keyed, recorded: Keyed) -> Keyed:
    """What a replay of ``recorded`` tells: every byte of it, and at the end the session of the play, which is one."""
    (session,) = {
        decode_frame_report(payload).session
        for key, payloads in played.items()
        if key.endswith("/frame")
        for payload in payloads
    }
    return {
        key: [in_session(Message(key, _kind(key), payload, 0, 0, 0), session).payload for payload in payloads]
        for key, payloads in recorded.items()
    }


def _kind(key: str) -> Any:
    return {"odometry": ODOMETRY, "event": EVENT}.get(key.rpartition("/")[2], FRAME_REPORT)


def _by_key(pairs: list[tuple[str, bytes]]) -> Keyed:
    """Status and beat are told by the clock, and left out."""
    keyed: Keyed = defaultdict(list)
    for key, payload in pairs:
        if not key.endswith(("/status", "/beat")):
            keyed[key.removeprefix("replay/")].append(payload)
    return dict(keyed)
