"""Recordings of several cameras joined: the same function as live, exposure by exposure, without a clock."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.rig import Rig
from asterism.server.fusing.fitting import refuse_unlike_robots, view_of
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import Fused
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import sighting_of


class Exposure(NamedTuple):
    """What was fused at one time: the cameras' frame numbers, by name, that were exposed then, and who was there."""

    fused: Fused
    frames: dict[str, int]
    fleet: Fleet


class Watching:
    """The cameras by the rigs that are in force for them, and where those are from, for sentences."""

    def __init__(self) -> None:
        self.fleet = Fleet.of([])
        self._views: dict[str, View] = {}

    def take(self, rig: Rig, where: str) -> None:
        """A camera's rig is in force. Raises InputError where it does not fit the others'."""
        name = rig.camera.name
        if name in self._views and self._views[name].rig is rig:
            return
        view = view_of(rig, where)
        refuse_unlike_robots(view, (other for other in self._views.values() if other.camera != name))
        self._views[name] = view
        self.fleet = Fleet.of([self._views[each] for each in sorted(self._views)])

    def view(self, camera: str) -> View:
        """Of a camera that was taken."""
        return self._views[camera]


def fused_offline(
    watching: Watching, exposures: "Iterable[Sequence[tuple[str, pb.FrameReport, Rig]]]"
) -> Iterator[Exposure]:
    """Every exposure in turn, told by camera, frame report and the rig in force; ``watching`` has taken the rigs of all
    cameras at the beginning.

    Raises InputError for cameras that do not fit together, and for a report that does not fit its rig.
    """
    joint = Joint.none()
    for exposure in exposures:
        for camera, _, rig in exposure:
            watching.take(rig, f"camera '{camera}'")
        sightings = [sighting_of(report, watching.view(camera)) for camera, report, _ in exposure]
        fused, joint = fuse(sightings, watching.fleet, joint)
        yield Exposure(fused, {camera: report.sequence for camera, report, _ in exposure}, watching.fleet)
