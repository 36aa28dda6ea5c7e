"""Images under a key of zenoh: a camera program, on this host or another, publishes them."""

from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError
from asterism.protocol.keys import PREFIX, REPLAY
from asterism.protocol.rig import Rig
from asterism.protocol.yaml_file import shortened
from asterism.server.sources.foreign.arriving import ArrivingImages
from asterism.server.sources.foreign.image_messages import ENCODINGS, compressed_image, raw_image
from asterism.server.sources.foreign.ros_messages import BadMessage, CompressedTold, RawTold
from asterism.server.sources.image_headers import NoImage, page_sizes
from asterism.server.sources.source import Say

if TYPE_CHECKING:
    import zenoh

SCHEME = "zenoh:"
RAW, COMPRESSED = (f"application/protobuf;foxglove.{name}" for name in ("RawImage", "CompressedImage"))
UNTOLD = ("", "zenoh/bytes", "application/octet-stream", "application/protobuf")  # then the payload tells


class NetworkImages(ArrivingImages):
    """Images published under a key."""

    def __init__(self, key: str, rig: Rig | None, say: Say) -> None:
        """Raises InputError for what is no key of one camera."""
        check_key(key)
        super().__init__(f"{SCHEME}{key}", rig, say)
        self.key = key
        self._subscriber: zenoh.Subscriber[None] | None = None

    def join(self, session: "zenoh.Session", listens: bool) -> None:
        """Take what is published under the key in that session; ``listens``: publishers join its own listener.

        Raises InputError for a key under which nobody is heard there.
        """
        own = self.key.removeprefix(REPLAY).partition("/")[0] == PREFIX
        if listens and own:
            raise InputError(
                f"{self.name}: through a server's own listener nobody else speaks under {PREFIX}/**; publish under "
                "another key, or join the router that carries this one: --connect tcp/HOST:7447"
            )
        self._subscriber = session.declare_subscriber(
            self.key, lambda sample: self.receive(str(sample.encoding), sample)
        )

    def told(self, kind: str, payload: bytes) -> RawTold | CompressedTold:
        """What a message with that encoding says of its image. Raises BadMessage for one that is none."""
        return told_by(kind, payload)

    def leave(self) -> None:
        """Take no more from the session."""
        if self._subscriber is not None:
            self._subscriber.undeclare()
            self._subscriber = None


def check_key(key: str) -> None:
    """Raises InputError for what is no zenoh key, or one of many."""
    import zenoh

    try:
        zenoh.KeyExpr(key)
    except zenoh.ZError:
        raise InputError(f"{SCHEME}{shortened(key)}: is no zenoh key, expected one such as zenoh:cell/camera") from None
    if "*" in key:
        raise InputError(
            f"{SCHEME}{shortened(key)}: is the key of many, expected one camera's such as zenoh:cell/camera"
        )


def told_by(encoding: str, payload: bytes) -> RawTold | CompressedTold:
    """What a message says of its image. Raises BadMessage for a payload that is neither of the two kinds."""
    if encoding == RAW:
        return raw_image(payload)
    if encoding == COMPRESSED:
        return compressed_image(payload)
    if encoding not in UNTOLD:
        raise BadMessage(f"encoding {shortened(encoding)!r}, expected {RAW} or {COMPRESSED}")
    for attempt in (_surely_raw, _surely_compressed):
        if (told := attempt(payload)) is not None:
            return told
    raise BadMessage(f"is neither a foxglove.RawImage nor a CompressedImage; publish it with the encoding {RAW}")


def _surely_raw(payload: bytes) -> RawTold | None:
    try:
        told = raw_image(payload)
    except BadMessage:
        return None
    return told if told.encoding in ENCODINGS and len(told.data) == told.step * told.height > 0 else None


def _surely_compressed(payload: bytes) -> CompressedTold | None:
    try:
        told = compressed_image(payload)
        page_sizes(bytes(told.data))
    except (BadMessage, NoImage):
        return None
    return told
