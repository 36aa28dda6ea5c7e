"""`asterism fuse` live against real sessions: what is heard of several servers goes out as one."""

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
import zenoh

from asterism.clients import PoseClient
from asterism.clients.received_pose import ReceivedPose
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import report_pose, to_bytes
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.network import client_config
from asterism.protocol.rig import Rig
from asterism.server.command import fuse_live
from asterism.server.service.on_air import Place
from asterism.server.service.stop import Stop
from tests.fusing.drawn import Seen
from tests.helpers import assert_poses_close
from tests.servers import free_endpoint, open_router
from tests.service.fusing.listener import TIMEOUT_S, Listener, until
from tests.service.fusing.speaking import Speaker, placeless
from tests.several import Drive, facing_pair, rigs_at

RIGS = rigs_at(facing_pair())
ROBOTS = tuple(robot.id for robot in RIGS[0].robots)
DRIVE = Drive(ROBOTS)
NONE: dict[str, tuple[int, ...]] = dict.fromkeys(ROBOTS, ())


class Hall:
    """Two cameras, one that joins them, one that listens; closed at the end of a test."""

    def __init__(self, stack: ExitStack, rng: np.random.Generator) -> None:
        self.stack = stack
        self.rng = rng
        self.speakers: list[Speaker] = []

    def serve(self, rig: Rig, **options: object) -> Speaker:
        speaker = Speaker(rig, self.rng, **options)  # type: ignore[arg-type]
        self.stack.callback(speaker.close)
        self.speakers.append(speaker)
        return speaker

    def fuse(self, *cameras: str, join: str | None = None) -> Listener:
        """Begin to join what the speakers tell; who listens to it."""
        listen = join or free_endpoint()
        hears = () if join else tuple(dict.fromkeys(one.endpoint for one in self.speakers))
        joined = fuse_live.Joined(hears, Place(None if join else listen, join, joining="--join"), cameras)
        stop, failed = Stop(), queue.SimpleQueue[BaseException]()

        def run() -> None:
            try:
                fuse_live.join_until(stop, joined)
            except BaseException as error:
                failed.put(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()

        def end() -> None:
            stop.set()
            thread.join(TIMEOUT_S)
            assert failed.empty(), failed.get()

        self.stack.callback(end)
        listener = Listener(listen)
        self.stack.callback(listener.close)
        return listener

    def tell_until(
        self, listener: Listener, holds: Callable[["pb.FrameReport"], bool], seen: Sequence[Seen | None] = ()
    ) -> "pb.FrameReport":
        """The speakers tell of frames, one after the other, until one that is joined holds."""
        for _ in range(2000):
            now_ns = self.speakers[0].clock.now_ns()
            for speaker, of in zip(self.speakers, seen or [None] * len(self.speakers), strict=True):
                speaker.tell(DRIVE(0.0), now_ns, of)
            try:
                while True:
                    report = listener.frames.get(timeout=0.02)
                    if holds(report):
                        return report
            except queue.Empty:
                continue
        raise AssertionError("it did not come about")


@pytest.fixture
def hall(rng: np.random.Generator) -> Iterator[Hall]:
    with ExitStack() as stack:
        yield Hall(stack, rng)


def of_both(report: "pb.FrameReport") -> bool:
    return all(list(robot.cameras) == ["left", "right"] for robot in report.robots) and bool(report.robots)


def test_two_cameras_are_one_for_clients(hall: Hall) -> None:
    for rig in RIGS:
        hall.serve(rig)
    listener = hall.fuse()
    report = hall.tell_until(listener, of_both)
    for robot in report.robots:
        assert_poses_close(report_pose(robot.pose), DRIVE(0.0)[robot.id], 2e-4, 2e-3)
    assert report.frame_id == "world"
    told = listener.rig()
    assert (told.camera, [robot.id for robot in told.robots], list(told.camera_matrix)) == ("fused", list(ROBOTS), [])
    with PoseClient(str(listener.endpoint), camera="fused") as client:
        poses: queue.SimpleQueue[ReceivedPose] = queue.SimpleQueue()
        client[ROBOTS[0]].on_pose(poses.put)
        hall.tell_until(listener, lambda report: of_both(report) and not poses.empty())
        pose = until(lambda: poses.get(timeout=TIMEOUT_S), lambda pose: pose.cameras == ("left", "right"))
        assert (pose.camera, pose.frame_id) == ("fused", "world")
        assert 0.0 < pose.age_s < 10.0
        assert client.alive
    status = listener.status(lambda one: one.rate_hz > 0)
    assert (status.source, status.problem) == ("left, right", "")
    assert dict(status.robots) == {"TRACKED": len(ROBOTS)}
    found = listener.event(lambda event: event.robot == ROBOTS[0])
    assert (found.happening, found.before) == (pb.STATE_CHANGED, pb.STATE_UNSPECIFIED)


def test_a_robot_that_one_camera_sees_passes_through(hall: Hall) -> None:
    for rig in RIGS:
        hall.serve(rig)
    listener = hall.fuse()
    seen = [None, Seen(lit={ROBOTS[1]: ()})]

    def holds(report: "pb.FrameReport") -> bool:
        return [list(robot.cameras) for robot in report.robots] == [["left", "right"], ["left"]]

    assert hall.tell_until(listener, holds, seen).robots[1].state == pb.TRACKED


def test_a_camera_that_ends_leaves_its_robots_to_the_others_and_comes_back(hall: Hall) -> None:
    _, right = (hall.serve(rig) for rig in RIGS)
    listener = hall.fuse()
    sequence = hall.tell_until(listener, of_both).sequence
    hall.speakers.remove(right)
    right.close()
    alone = hall.tell_until(listener, lambda report: all(list(robot.cameras) == ["left"] for robot in report.robots))
    assert alone.sequence > sequence
    assert all(robot.state == pb.TRACKED for robot in alone.robots)
    told = listener.status(lambda status: "camera 'right' is gone" in status.problem)
    assert told.source == "left, right"  # its robots are not forgotten
    hall.serve(RIGS[1], endpoint=right.endpoint)
    hall.tell_until(listener, of_both)
    hall.tell_until(listener, lambda _: listener_is_well(listener))


def listener_is_well(listener: Listener) -> bool:
    try:
        return not listener.states.get_nowait().problem
    except queue.Empty:
        return False


def test_a_camera_without_a_place_is_not_joined_and_said(hall: Hall) -> None:
    hall.serve(RIGS[0])
    hall.serve(placeless(RIGS[1]))
    listener = hall.fuse()
    report = hall.tell_until(listener, lambda report: len(report.robots) == len(ROBOTS), [None, Seen(lit=NONE)])
    assert [list(robot.cameras) for robot in report.robots] == [["left"]] * len(ROBOTS)
    told = listener.status(lambda status: bool(status.problem))
    assert "camera 'right': the rig has no `world`, expected where its camera stands" in told.problem


def test_another_rig_is_gone_by_from_the_frame_on_that_tells_of_it(hall: Hall) -> None:
    left, _ = (hall.serve(rig) for rig in RIGS)
    listener = hall.fuse()
    hall.tell_until(listener, of_both)
    fewer = replace(RIGS[0], robots=RIGS[0].robots[:1])
    left.reads_rig(fewer)
    report = hall.tell_until(listener, lambda report: [list(one.cameras) for one in report.robots][1:] == [["right"]])
    assert list(report.robots[0].cameras) in (["left", "right"], ["right"])
    hall.tell_until(listener, lambda report: list(report.robots[0].cameras) == ["left", "right"])


def test_clocks_that_disagree_are_told_with_what_to_do(hall: Hall) -> None:
    hall.serve(RIGS[0])
    right = hall.serve(RIGS[1], ahead_ns=43_000_000)
    listener = hall.fuse()
    told = []

    def holds(_: "pb.FrameReport") -> bool:
        while not listener.states.empty():
            told.append(listener.states.get().problem)
        return any("clocks of left and right differ by 43 ms" in problem for problem in told)

    hall.tell_until(listener, holds)
    assert "run chrony or PTP on both" in told[-1]
    assert right.clock.now_ns() - hall.speakers[0].clock.now_ns() == pytest.approx(43_000_000, abs=5_000_000)


def test_through_a_router_both_a_cameras_poses_and_the_joined_are_there(hall: Hall) -> None:
    with open_router() as (router, _):
        for rig in RIGS:
            hall.serve(rig, join=router)
        listener = hall.fuse(join=router)
        hall.tell_until(listener, of_both)
        with pytest.raises(InputError, match="asterism fuse is running already, by process"):
            fuse_live.join_until(Stop(), fuse_live.Joined((), Place(connect=router, joining="--join")))
        hall.stack.close()


def test_nobody_else_speaks_where_it_listens(hall: Hall) -> None:
    for rig in RIGS:
        hall.serve(rig)
    listener = hall.fuse()
    sequence = hall.tell_until(listener, of_both).sequence
    forged = to_bytes(pb.FrameReport(sequence=1 << 40, exposed_ns=1))
    with zenoh.open(client_config(listener.endpoint)) as other:
        other.put(keys.frame(keys.FUSED), forged)
        after = hall.tell_until(listener, lambda report: report.sequence > sequence + 20)
    assert after.sequence < 1 << 40


def test_it_says_where_it_cannot_be(hall: Hall) -> None:
    here = hall.serve(RIGS[0])
    with pytest.raises(InputError, match=r"already in use .* expected a free one: --listen .*, or --join tcp"):
        fuse_live.join_until(Stop(), fuse_live.Joined((here.endpoint,), Place(here.endpoint, joining="--join")))
    nowhere = free_endpoint()
    with pytest.raises(WorldError, match=f"{nowhere}: no server answers there"):
        fuse_live.join_until(Stop(), fuse_live.Joined((nowhere,), Place(free_endpoint(), joining="--join")))
    with pytest.raises(InputError, match="--listen and --join exclude each other"):
        fuse_live.join_until(Stop(), fuse_live.Joined((), Place(nowhere, here.endpoint, joining="--join")))
