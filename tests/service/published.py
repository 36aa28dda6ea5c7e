"""Frames of the demo's rig as a server publishes them, without a network."""

from collections.abc import Iterator

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import report
from asterism.server.pose.track import Tracks
from asterism.server.sources.simulated import Simulated
from tests.service.nobody import Nobody


def published(rig: Rig, count: int) -> Iterator[tuple[list[Message], Frame]]:
    """Messages and frame, of so many frames."""
    tracks = Tracks.none()
    for frame in Simulated(rig, count=count).frames():
        result, tracks = localize(frame, rig, tracks)
        yield Nobody().publish(report(frame, result, rig, frame.exposed_ns + 1)), frame
