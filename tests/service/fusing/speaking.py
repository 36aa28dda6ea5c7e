"""Cameras' servers without cameras: they publish frame reports of spots that are drawn, on a port of their own."""

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_rig, to_bytes
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import EVENT, FRAME_REPORT, Fate, Happening, Message
from asterism.protocol.network import open_server
from asterism.protocol.rig import Rig, parse_rig
from asterism.server.fusing.fleet import View
from asterism.server.fusing.report import rig_words
from asterism.server.fusing.sighting import Sighting
from asterism.server.service.publish import Publisher
from asterism.server.sources.session_clock import SessionClock
from tests.fusing.drawn import Seen, sighting
from tests.servers import free_endpoint


def with_texts(rig: Rig) -> Rig:
    """The same rig as files would have it."""
    camera, place = rig.camera, rig.T_world_camera
    world = None if place is None else {"position": place.position.tolist(), "orientation": place.orientation.tolist()}
    words = {"camera": "camera.yaml", "robots": {robot.id: rig_words(robot) for robot in rig.robots}}
    text = {
        "camera_name": camera.name,
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_model": camera.model,
        "distortion_coefficients": {"rows": 1, "cols": len(camera.distortion), "data": camera.distortion.tolist()},
    }
    return parse_rig(json.dumps(words | ({"world": world} if world else {})), json.dumps(text), camera.name)


def report_of(seen: Sighting, sequence: int = 0, session: int = 0) -> "pb.FrameReport":
    """The frame report that a sighting would be of."""
    report = pb.FrameReport(sequence=sequence, exposed_ns=seen.exposed_ns, session=session, frame_id="world")
    spots = report.spots
    spots.x.extend(seen.centres_px[:, 0].tolist())
    spots.y.extend(seen.centres_px[:, 1].tolist())
    for k, column in enumerate((spots.covariance_xx, spots.covariance_xy, spots.covariance_yy)):
        column.extend(seen.covariances_px2[:, k].tolist())
    spots.fate.extend(np.where(seen.robots >= 0, int(Fate.LED), int(Fate.UNEXPLAINED)).tolist())
    spots.brightness.extend([100.0] * len(seen.robots))
    spots.radius.extend([2.0] * len(seen.robots))
    spots.robot.extend(seen.robots.tolist())
    spots.led.extend(seen.leds.tolist())
    report.robots.extend(seen.told.values())
    report.learned.led_misfit.extend(seen.misfits_m.values())
    return report


class Speaker:
    """One camera's server, whose clock is ``ahead_ns`` of this machine's."""

    def __init__(
        self,
        rig: Rig,
        rng: np.random.Generator,
        endpoint: str | None = None,
        ahead_ns: int = 0,
        join: str | None = None,
    ) -> None:
        self.rig, self.endpoint = with_texts(rig), join or endpoint or free_endpoint()
        self.clock = SessionClock(wall=lambda: SessionClock().now_ns() + ahead_ns) if ahead_ns else SessionClock()
        session = open_server(connect=join) if join else open_server(self.endpoint)
        self.publisher = Publisher(session, rig.camera.name, encode_rig(self.rig), self.clock)
        self.sequence = 0
        self._rng = rng
        self._closed = False

    @property
    def name(self) -> str:
        return self.rig.camera.name

    def tell(self, poses: Mapping[str, Pose], exposed_ns: int | None = None, seen: Seen | None = None) -> int:
        """A frame in which the robots stand there; when it was exposed."""
        exposed_ns = self.clock.now_ns() if exposed_ns is None else exposed_ns
        placed = View(replace(self.rig, T_world_camera=self.rig.T_world_camera or Pose.identity()))
        shown = sighting(placed, poses, exposed_ns, self._rng, seen)
        report = report_of(shown, self.sequence, self.clock.session)
        message = Message(keys.frame(self.name), FRAME_REPORT, to_bytes(report), exposed_ns, 0, self.sequence)
        self.publisher.publish([message])
        self.sequence += 1
        return exposed_ns

    def reads_rig(self, rig: Rig) -> None:
        """From the next frame on another rig is in force, which is told."""
        self.rig = with_texts(rig)
        self.publisher.rig_payload = encode_rig(self.rig)
        event = pb.Event(
            happening=Happening.RIG_READ, since_ns=self.clock.now_ns(), sequence=self.sequence, number=1,
            session=self.clock.session,
        )  # fmt: skip
        self.publisher.publish(
            [Message(keys.event(self.name), EVENT, to_bytes(event), event.since_ns, 0, self.sequence)]
        )

    def as_protocol(self, number: int) -> None:
        """Speak another version of the messages."""
        self.publisher.rig_payload = encode_rig(self.rig) + to_bytes(pb.RigReport(protocol=number))

    def close(self) -> None:
        """End, once."""
        if not self._closed:
            self._closed = True
            self.publisher.close()


def placeless(rig: Rig) -> Rig:
    """The same without a world."""
    return replace(rig, T_world_camera=None)
