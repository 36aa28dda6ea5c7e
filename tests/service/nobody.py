"""A publisher without a network."""

from collections.abc import Iterable

from asterism.protocol.codec import stamped
from asterism.protocol.messages import Message
from asterism.server.service.publish import Publisher


class Nobody(Publisher):
    """Stamps what is published, and nobody hears it."""

    def __init__(self) -> None:
        self.rig_payload = b""
        self.beats = 7

    def publish(self, messages: Iterable[Message], session: int | None = None) -> list[Message]:
        return [stamped(message, message.log_ns + (1 if session is None else 2)) for message in messages]

    def show_visible(self, robots: Iterable[str]) -> None:
        """Nobody looks."""
        list(robots)
