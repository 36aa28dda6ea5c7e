"""A V4L2 camera through the server's loop: poses, times, and a cable that is pulled out."""

import time
from dataclasses import replace

import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.codec import decode_frame_report, decode_odometry
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Clock, Message
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.camera import v4l2_camera
from tests.service.nobody import Nobody
from tests.sources.v4l2.stand_in import MONOTONIC_AT_START, StandInCamera, StandInSystem
from tests.sources.v4l2.stand_in import Frame as Buffer

FILM, PULLED, ALL = 4, 6, 12  # frames: of the film, solved before the cable is pulled, and in all
SIZE = (1280, 1024)
EXPOSURE_US = 500.0


class Served:
    """What the server made of the simulator's frames, from a camera that comes back elsewhere."""

    def __init__(self) -> None:
        self.rig = replace(load_rig(DEMO_RIG), capture=Capture(exposure_us=EXPOSURE_US))
        scene = Scene(self.rig, 0)
        self.film = [scene.render(k, scene.truth(k, k / 60)).tobytes() for k in range(FILM)]
        self.camera = self._plugged()
        self.system = StandInSystem(video0=self.camera)
        self.stamps_ns: list[int] = []
        self.said: list[str] = []
        self.solved: list[tuple[Frame, list[Message]]] = []
        source = v4l2_camera("0", self.rig, self.said.append, self.system)
        source.retry_s = 0.001
        self.stop, self.clock = Stop(), source.clock
        self.run = Run(self.rig, source, Outlets(Nobody(), others=(self,)), self.stop, source.clock)
        self.run.serve()

    def _plugged(self) -> StandInCamera:
        controls = {abi.EXPOSURE_AUTO: [0, 3, 1, 3], abi.EXPOSURE_ABSOLUTE: [1, 1000, 1, 200]}
        return StandInCamera(
            formats={"GREY": {SIZE: [60.0]}}, controls=controls, size=SIZE, rate=60.0, endless=self._frame
        )

    def _frame(self, number: int) -> Buffer:
        time.sleep(0.005)  # in the source's thread
        stamp_ns = time.monotonic_ns() // 1000 * 1000 - 3_000_000  # drivers tell microseconds
        self.stamps_ns.append(stamp_ns)
        return Buffer(self.film[number % FILM], stamp_ns, 2 * number, MONOTONIC_AT_START)  # every other one is lost

    def write(self, messages: list[Message], frame: Frame) -> None:
        self.solved.append((frame, messages))
        if len(self.solved) == PULLED:
            self.camera.unplug()
            self.system.cameras = {"/dev/video3": self._plugged()}
        if len(self.solved) == ALL:
            self.stop.set()

    def between(self, messages: list[Message]) -> None:
        """Not looked at."""

    def take_rig(self, rig: Rig) -> None:
        """It stays as it is."""

    def close(self) -> None:
        """Nothing is held."""


@pytest.fixture(scope="module")
def served() -> Served:
    return Served()


def test_poses_are_those_of_the_images_bit_for_bit(served: Served) -> None:
    tracks, found = Tracks.none(), set()
    for frame, messages in served.solved:
        assert frame.image.tobytes() in served.film
        result, tracks = localize(frame, served.rig, tracks)
        told = [decode_odometry(message.payload) for message in messages if message.kind is ODOMETRY]
        for pose in told:
            answer = result.answers[pose.robot]
            assert isinstance(answer, PoseEstimate)
            assert pose.pose.position.tolist() == answer.position.tolist()
            assert pose.covariance.tolist() == answer.covariance.tolist()  # which turns with the orientation
        found.update(pose.robot for pose in told)
    assert found == {robot.id for robot in served.rig.robots}


def _stamp_ns(served: Served, frame: Frame) -> int:
    """The driver's stamp that a frame's time rests on."""
    return frame.exposed_ns - round(EXPOSURE_US * 500) - served.clock.at_ns(0, frame.session)


def test_every_frame_has_mid_exposure_by_its_driver(served: Served) -> None:
    for frame, messages in served.solved:
        assert _stamp_ns(served, frame) in served.stamps_ns
        (report,) = (decode_frame_report(message.payload) for message in messages if message.kind is FRAME_REPORT)
        assert (report.clock, report.exposed_ns) == (Clock.DRIVER, frame.exposed_ns)


def test_the_cable_is_said_and_the_lost_frames_are_counted(served: Served) -> None:
    assert [line for line in served.said if "lost on their way" not in line] == [
        "/dev/video0: the camera vanished; waiting for it",
        "/dev/video0: the camera is /dev/video3 by now",
        "/dev/video0: the camera is back",
    ]
    assert served.run.health.frames_dropped >= ALL - 2  # one before each, but for the first of a stream
    assert served.run.health.problem == ""
    assert served.system.cameras["/dev/video3"].controls[abi.EXPOSURE_ABSOLUTE][3] == 5
