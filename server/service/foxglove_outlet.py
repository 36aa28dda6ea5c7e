"""What is published, for Foxglove and PlotJuggler: a WebSocket server with the channels that a recording has.

The bytes are those that were published, under the same keys. A client that is slow misses the oldest messages (the SDK
keeps a few frames for each), and holds up nobody: everything happens in threads of its own.
"""

import logging
import time
from collections.abc import Iterable

import foxglove

from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.messages import (
    ANNOTATIONS,
    CALIBRATION,
    COVERAGE,
    EVENT,
    FRAME_REPORT,
    ODOMETRY,
    STATUS,
    TRANSFORMS,
    Kind,
    Message,
)
from asterism.protocol.rig import Rig
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.viewers import Viewers, first_messages
from asterism.server.chain.frame import Frame
from asterism.server.service.live_image import LIVE_IMAGE, SHOWN_HZ, encode_live_image
from asterism.server.service.loopback import HOST, why_taken
from asterism.server.service.say import say
from asterism.server.service.threads import Newest

FRAMES_BEHIND = 8  # that a client may be, before it misses the oldest


class FoxgloveOutlet:
    """Serves on a port of loopback. Raises InputError where that cannot be had."""

    def __init__(self, rig: Rig, port: int) -> None:
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._camera_told = False  # by the frames themselves, where it is followed
        self._rig = rig
        self._take(rig)
        if why := why_taken(port):
            raise InputError(f"--foxglove {port}: cannot be listened on at {HOST} ({why}); expected a free port")
        logging.getLogger("foxglove.websocket").setLevel(logging.CRITICAL)  # it has a line for all who hang up
        self._server = foxglove.start_server(
            name=f"asterism {rig.camera.name}",
            host=HOST,
            port=port,
            context=self._context,
            message_backlog_size=FRAMES_BEHIND * len(self._channels),
        )
        say(f"for Foxglove and PlotJuggler: ws://{HOST}:{port}")
        self._told = Newest(self._tell, "foxglove", waiting=FRAMES_BEHIND)
        self._seen = Newest(self._show, "foxglove-image", low=True)

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on."""
        self._rig = rig

    def write(self, messages: list[Message], frame: Frame) -> None:
        """Hand on what was published of a frame, and its image if it is its turn."""
        self._told.give((messages, self._rig))
        self._seen.give(frame)

    def between(self, messages: list[Message]) -> None:
        """Hand them on."""
        self._told.give((messages, self._rig))

    def close(self) -> None:
        """Let go of all clients, and of the port."""
        self._told.close()
        self._seen.close()
        self._server.stop()

    def _tell(self, told: tuple[list[Message], Rig]) -> None:
        messages, rig = told
        if rig is not self._drawn:
            self._take(rig)
        for message in messages:
            self._log(message)
            if message.kind == FRAME_REPORT and self._anybody((keys.TRANSFORMS, keys.annotations(rig.camera.name))):
                report = decode_frame_report(message.payload)
                self._camera_told = report.HasField("camera")
                for extra in self._viewers.messages(message, report):
                    self._log(extra)
            elif message.kind == STATUS:
                self._repeat(message.log_ns)

    def _repeat(self, time_ns: int) -> None:
        """What does not change, for those who come later; where the camera stands may be in every frame."""
        for message in first_messages(self._drawn, time_ns):
            if not (message.kind == TRANSFORMS and self._camera_told):
                self._log(message)

    def _show(self, frame: Frame) -> None:
        began, camera = time.monotonic(), self._drawn.camera.name
        key = keys.image(camera)
        if self._anybody([key]):
            payload = encode_live_image(frame.exposed_ns, camera, frame.image)
            self._channels[key].log(payload, log_time=frame.exposed_ns)
        time.sleep(max(began + 1.0 / SHOWN_HZ - time.monotonic(), 0.0))

    def _anybody(self, topics: Iterable[str]) -> bool:
        """Whether a client wants one of these."""
        return any(self._channels[topic].has_sinks() for topic in topics)

    def _log(self, message: Message) -> None:
        self._channels[message.key].log(message.payload, log_time=message.log_ns)

    def _take(self, rig: Rig) -> None:
        """Channels of this rig: those of robots that it does not have are closed."""
        self._drawn, self._viewers = rig, Viewers(rig)
        wanted = _channels(rig)
        for key in self._channels.keys() - wanted.keys():
            self._channels.pop(key).close()
        for key in wanted.keys() - self._channels.keys():
            schema = foxglove.Schema(
                name=wanted[key].schema, encoding="protobuf", data=descriptor_set(wanted[key].schema)
            )
            self._channels[key] = foxglove.Channel(
                key, schema=schema, message_encoding="protobuf", context=self._context
            )


def _channels(rig: Rig) -> dict[str, Kind]:
    camera = rig.camera.name
    return {
        **{keys.odometry(camera, robot.id): ODOMETRY for robot in rig.robots},
        keys.frame(camera): FRAME_REPORT,
        keys.status(camera): STATUS,
        keys.event(camera): EVENT,
        **({} if rig.surface is None else {keys.coverage(camera): COVERAGE}),
        keys.TRANSFORMS: TRANSFORMS,
        keys.calibration(camera): CALIBRATION,
        keys.annotations(camera): ANNOTATIONS,
        keys.image(camera): LIVE_IMAGE,
    }
