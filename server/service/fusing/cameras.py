"""All cameras that are heard, and the fleet of those that fit together."""

from collections.abc import Callable, Iterable, Sequence

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_event, decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.keys import FUSED
from asterism.server.fusing.fitting import refuse_unlike_robots
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.reported import LATEST_NS
from asterism.server.fusing.sighting import Sighting, sighting_of
from asterism.server.service.fusing.answer import Answer
from asterism.server.service.fusing.camera import HeardCamera

MOST_CAMERAS = 64
MOST_SAID = 200  # sentences, each once
EARLY_NS = 1_000_000_000  # by which a camera's clock may be ahead of its host's


class Cameras:
    """One thread feeds it; times are of the monotonic clock, ns. ``say`` tells a person, each thing once.

    ``wanted`` are the names of those that are to be joined, none: all. ``changed`` is called with a camera's name where
    what was remembered of it holds no longer.
    """

    def __init__(self, wanted: Iterable[str], say: Callable[[str], None], changed: Callable[[str], None]) -> None:
        self.fleet = Fleet.of([])
        self.heard: dict[str, HeardCamera] = {}
        self._wanted = tuple(wanted)
        self._say = say
        self._said: set[str] = set()
        self._changed = changed

    def token(self, name: str, ear: int, there: bool, now_ns: int) -> None:
        """A server's liveliness token came or went."""
        camera = self._camera(name, ear, now_ns)
        if camera is None:
            return
        if there != camera.alive:
            self._say(f"camera '{name}' is {'back' if there else 'gone'}")
        elif there:
            camera.ear = ear
        camera.alive = there
        if there:
            camera.want(now_ns)

    def event(self, name: str, ear: int, payload: bytes, now_ns: int) -> None:
        """Something happened to a camera: its rig may be another one."""
        camera = self._camera(name, ear, now_ns)
        try:
            event = decode_event(payload)
        except InputError as error:
            self._say_once(f"camera '{name}': {error}; ignored")
            return
        if camera is not None and event.happening == pb.RIG_READ and event.session == camera.session:
            camera.want(now_ns, event.sequence)

    def report(self, name: str, ear: int, payload: bytes, now_ns: int) -> "tuple[Sighting, pb.FrameReport] | None":
        """A frame report came: what it shows, if it is one to go by."""
        camera = self._camera(name, ear, now_ns)
        if camera is None:
            return None
        before = camera.session
        try:
            report = decode_frame_report(payload)
            _refuse_future(report)
            takes = camera.takes(report.session, report.sequence, report.exposed_ns, now_ns)
            if camera.session != before:
                self._changed(name)
            if not takes or camera.view is None:
                return None
            return sighting_of(report, camera.view), report
        except InputError as error:
            self._say_once(f"camera '{name}': {error}; not joined")
            return None

    def asks(self, now_ns: int) -> list[HeardCamera]:
        """Those that are to be asked for their rigs now."""
        return [camera for camera in self.heard.values() if camera.asks(now_ns)]

    def answered(self, name: str, answers: Sequence[Answer]) -> bool:
        """What came of asking; returns whether the fleet is another one for it."""
        camera = self.heard.get(name)
        answer = None if camera is None else camera.answered(answers)
        if camera is None or answer is None or (camera.view is not None and answer.texts == camera.texts):
            return False
        before, camera.view, camera.texts, camera.problem = camera.view, answer.view, answer.texts, answer.problem
        if answer.view is not None:
            try:
                refuse_unlike_robots(answer.view, self._others_of(name))
            except InputError as error:
                camera.view, camera.texts, camera.problem = None, (), str(error)
        if camera.problem:
            self._say_once(f"camera '{name}' is not joined: {camera.problem}")
        elif camera.view is not None:
            count = len(camera.view.rig.robots)
            again = "" if before is None else ", by another rig"
            self._say(f"camera '{name}' is joined{again}: {count} robot{'s' * (count > 1)}")
        return self._take_fleet(name)

    def problems(self, now_ns: int) -> list[str]:
        """What is wrong with cameras now, in sentences."""
        missing = [name for name in self._wanted if name not in self.heard]
        told = [f"camera '{name}' is not heard" for name in missing]
        for _, camera in sorted(self.heard.items()):
            rivals = camera.rivals(now_ns)
            for sentence in rivals:
                self._say_once(sentence)
            told += [*camera.problems(now_ns), *rivals]
        return told

    def _others_of(self, name: str) -> list[View]:
        """The views that a camera has to fit with: of those that are there."""
        return [
            camera.view
            for other, camera in self.heard.items()
            if other != name and camera.view is not None and camera.alive
        ]

    def _take_fleet(self, name: str) -> bool:
        """Those that fit; of one that is gone the rig holds as long as it fits those that are there."""
        there = [camera.view for camera in self.heard.values() if camera.view is not None and camera.alive]
        for camera in self.heard.values():
            if camera.view is not None and not camera.alive:
                try:
                    refuse_unlike_robots(camera.view, there)
                except InputError:
                    camera.view, camera.texts = None, ()
        views = {one: camera.view for one, camera in sorted(self.heard.items()) if camera.view is not None}
        if views == self.fleet.views:
            return False
        self.fleet = Fleet.of(list(views.values()))
        self._changed(name)
        return True

    def _camera(self, name: str, ear: int, now_ns: int) -> HeardCamera | None:
        if name == FUSED or (self._wanted and name not in self._wanted):
            return None
        camera = self.heard.get(name)
        if camera is None and len(self.heard) < MOST_CAMERAS:
            camera = self.heard[name] = HeardCamera(name, ear, now_ns)
        elif camera is None:
            self._say_once(f"more than {MOST_CAMERAS} cameras are heard; the others are not joined")
        return camera

    def _say_once(self, text: str) -> None:
        if text not in self._said and len(self._said) < MOST_SAID:
            self._said.add(text)
            self._say("".join(char if char.isprintable() else "?" for char in text)[:600])


def _refuse_future(report: "pb.FrameReport") -> None:
    """By the camera's own clock nothing is told before it was exposed: such a time would make all others late."""
    if report.exposed_ns > (report.published_ns or LATEST_NS) + EARLY_NS:
        raise InputError(
            f"its frames are exposed {(report.exposed_ns - report.published_ns) * 1e-9:.3g} s after they were published"
        )
