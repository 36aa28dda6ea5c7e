"""Messages drawn into rerun: the same for a recording under review and for a live server.

robots                        a table: where each robot is, how it stands, how sure that is
world/origin                  the world's axes, where the rig knows a world
world/camera                  its axes and name
world/camera/image            frustum and frame; spots with their fates, plates, names, residuals (enlarged); where
                              the surface ends
world/surface                 what the robots work on, coloured by how well it is known; its edge
world/robots/<id>             axes, plate, LEDs, named points and name of every robot
world/alternatives/<id>       the other plate, where two tilts explain the spots
world/without/<id>            by light alone, of a robot whose pose rests on the surface as well
world/paths/<id>              where it went; of one that stands on the surface where its tool did, as long as it stood
plots/position/<id>/x         m, in the parent frame; likewise y, z
plots/angles/<id>/roll        degrees, in the parent frame (without a world: in the camera's turned to face the robots,
                              x right, y up, z towards the camera); likewise pitch, yaw
plots/residual/<id>           px
plots/latency                 ms
states/<id>                   TRACKED, TILT_AMBIGUOUS, IDENTITY_AMBIGUOUS, LOST; where the surface is contradicted also
                              how, "TRACKED, LIFTED" for one: LIFTED, SUNK, TILTED, BEYOND
events                        what happened, as sentences

Of several cameras: entities.py.
"""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.event_text import is_loss, sentence
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.recordings import overlay
from asterism.recordings.entities import ALONE, Entities, part
from asterism.recordings.plates import TO_THE_CAMERA, plate_outline, roll_pitch_yaw_deg
from asterism.recordings.png_image import png
from asterism.recordings.robot_table import robot_table
from asterism.recordings.scene import name_place, place_scene, place_transform, robot_colours
from asterism.recordings.states import STATE_COLOURS, TRACKED, state_of
from asterism.recordings.trail import Trail
from asterism.recordings.without import axes_without

APPLICATION = "asterism"
HALF_TURN_DEG = 180.0  # an angle that jumps so far has gone once around


class Drawing:
    """Draws frame reports and images into one rerun stream."""

    def __init__(self, stream: rr.RecordingStream, rig: Rig, entities: Entities = ALONE) -> None:
        self._stream = stream
        self._rig = rig
        self._entities = entities
        self._colours = robot_colours(rig)
        self._outlines = {robot.id: plate_outline(robot) for robot in rig.robots}
        self._names = {robot.id: name_place(robot, entities.storey) for robot in rig.robots}
        self._T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
        self._trails = {robot.id: Trail(robot) for robot in rig.robots}
        self._states: dict[str, str] = {}
        self._angles: dict[str, Floats] = {}
        self._two_tilts: set[str] = set()  # drawn with both
        self._two_poses: set[str] = set()  # drawn with that of light alone as well
        place_scene(stream, rig, entities)

    def replaced_by(self, rig: Rig) -> "Drawing":
        """Another rig is in force from now on: the robots of this one are drawn nowhere."""
        for robot in self._rig.robots:
            for what in ("robots", "alternatives", "without", "paths"):
                self._stream.log(self._entities.robot(what, robot.id), rr.Clear(recursive=True))
        return Drawing(self._stream, rig, self._entities)

    def image(self, image: NDArray[np.uint8], time_ns: int, sequence: int) -> None:
        """Show an (h, w) frame."""
        self.encoded(png(image), "image/png", time_ns, sequence)

    def encoded(self, contents: bytes, media_type: str, time_ns: int, sequence: int) -> None:
        """Show a frame that is encoded already, as PNG or JPEG."""
        self._at(time_ns, sequence)
        self._stream.log(self._entities.image, rr.EncodedImage(contents=contents, media_type=media_type))

    def report(self, report: "pb.FrameReport") -> None:
        """Show what one frame told, but for robots that the rig does not have: one that was in force later may."""
        self._at(report.exposed_ns, report.sequence)
        robots = [robot for robot in report.robots if robot.id in self._outlines]
        poses = {robot.id: report_pose(robot.pose) for robot in robots if robot.HasField("pose")}
        if report.HasField("camera"):
            place = report_pose(report.camera.pose)
            self._T_camera_parent = place.inverse()
            self._stream.log(self._entities.camera, place_transform(place))
        if self._entities.camera:
            self._over_the_image(report, poses)
        if self._entities.told is not None:
            self._robots(report, poses)

    def _robots(self, report: "pb.FrameReport", poses: dict[str, Pose]) -> None:
        """In space, in plots and in the table."""
        angles = {robot_id: self._angles_of(pose) for robot_id, pose in poses.items()}
        for robot in report.robots:
            if robot.id not in self._outlines:
                continue
            self._state(robot)
            self._alternative(robot)
            self._without(robot)
            if robot.id in poses:
                self._place(robot, poses[robot.id])
                self._plot(robot, poses[robot.id], angles[robot.id])
        self._scalar("plots/latency/solving", (report.solved_ns - report.arrived_ns) * 1e-6)
        self._scalar("plots/latency/exposure_to_network", (report.published_ns - report.exposed_ns) * 1e-6)
        rows = ((robot, poses.get(robot.id), angles.get(robot.id)) for robot in report.robots)
        self._stream.log(f"{self._entities.told}robots", rr.TextDocument(robot_table(rows), media_type="text/markdown"))

    def event(self, event: "pb.Event") -> None:
        """Write down what happened."""
        self._at(event.since_ns, event.sequence)
        self._stream.log(self._entities.events, rr.TextLog(sentence(event), level="WARN" if is_loss(event) else "INFO"))

    def _at(self, time_ns: int, sequence: int) -> None:
        self._stream.set_time("exposed", timestamp=np.datetime64(time_ns, "ns"))
        if not self._entities.several:
            self._stream.set_time("frame", sequence=sequence)

    def _scalar(self, path: str, value: float) -> None:
        self._stream.log(f"{self._entities.told}{path}", rr.Scalars(value))

    def _angles_of(self, pose: Pose) -> Floats:
        turn = pose.rotation if self._rig.T_world_camera is not None else TO_THE_CAMERA @ pose.rotation
        return roll_pitch_yaw_deg(turn)

    def _over_the_image(self, report: "pb.FrameReport", poses: dict[str, Pose]) -> None:
        camera, log = self._rig.camera, self._stream.log
        edges = {
            robot: camera.project((self._T_camera_parent @ pose).map(self._outlines[robot]))
            for robot, pose in poses.items()
        }
        texts = {robot.id: _name_of(robot) for robot in report.robots}
        log(f"{self._entities.image}/spots", overlay.spots(report))
        log(f"{self._entities.image}/plates", overlay.plates(edges, self._colours))
        log(f"{self._entities.image}/names", overlay.names(edges, texts, self._colours, camera.height))
        log(f"{self._entities.image}/residuals", overlay.residuals(report))

    def _state(self, robot: "pb.RobotReport") -> None:
        """What changes with the robot's state: the timeline, its name in space, and whether it is there at all."""
        state, path = state_of(robot), self._entities.robot("robots", robot.id)
        if self._states.get(robot.id) == state:
            return
        self._states[robot.id] = state
        self._stream.log(f"{self._entities.told}states/{part(robot.id)}", rr.StateChange(state=state))
        if robot.HasField("pose"):
            colour = self._colours[robot.id] if state == TRACKED else STATE_COLOURS[state]
            name = rr.Points3D(
                self._names[robot.id],
                radii=rr.Radius.ui_points(0.5),
                colors=colour,
                labels=[_name_of(robot) + (f", {self._entities.by}" if self._entities.by else "")],
                show_labels=True,
            )
            self._stream.log(f"{path}/name", name)
            return
        # No pose: nothing is drawn where the robot was, and no line of a plot leads over the gap.
        self._stream.log(path, rr.Transform3D(scale=[0.0, 0.0, 0.0]))
        self._stream.log(f"{path}/name", rr.Clear(recursive=False))
        for plot in ("position", "angles", "residual"):
            self._stream.log(f"{self._entities.told}plots/{plot}/{part(robot.id)}", rr.Clear(recursive=True))

    def _place(self, robot: "pb.RobotReport", pose: Pose) -> None:
        self._stream.log(
            self._entities.robot("robots", robot.id),
            rr.Transform3D(translation=pose.position, quaternion=rr.Quaternion(xyzw=pose.orientation), scale=1.0),
        )
        trail = self._trails[robot.id]
        trail.go(robot, pose)
        if trail.due:
            path = rr.LineStrips3D(trail.pieces(), colors=self._colours[robot.id], radii=rr.Radius.ui_points(1.0))
            self._stream.log(self._entities.robot("paths", robot.id), path)

    def _alternative(self, robot: "pb.RobotReport") -> None:
        path = self._entities.robot("alternatives", robot.id)
        if not robot.HasField("alternative"):
            if robot.id in self._two_tilts:
                self._two_tilts.remove(robot.id)
                self._stream.log(path, rr.Clear(recursive=False))
            return
        self._two_tilts.add(robot.id)
        edge = report_pose(robot.alternative.pose).map(self._outlines[robot.id])
        self._stream.log(
            path,
            rr.LineStrips3D(
                [np.vstack([edge, edge[:1]])],
                radii=rr.Radius.ui_points(1.0),
                colors=STATE_COLOURS["TILT_AMBIGUOUS"],
                labels=[f"or {robot.id} so, {robot.alternative.odds:.3g} times less likely"],
                show_labels=False,
            ),
        )

    def _without(self, robot: "pb.RobotReport") -> None:
        path = self._entities.robot("without", robot.id)
        if robot.surface.HasField("without"):
            self._two_poses.add(robot.id)
            self._stream.log(path, axes_without(robot, self._rig.robot(robot.id).extent))
        elif robot.id in self._two_poses:
            self._two_poses.remove(robot.id)
            self._stream.log(path, rr.Clear(recursive=False))

    def _plot(self, robot: "pb.RobotReport", pose: Pose, angles: Floats) -> None:
        for axis, value in zip("xyz", pose.position.tolist(), strict=True):
            self._scalar(f"plots/position/{part(robot.id)}/{axis}", value)
        turned = np.abs(angles - self._angles.get(robot.id, angles))
        for name, value, jump in zip(("roll", "pitch", "yaw"), angles.tolist(), turned.tolist(), strict=True):
            path = f"{self._entities.told}plots/angles/{part(robot.id)}/{name}"
            self._stream.log(path, rr.Scalars(value) if jump < HALF_TURN_DEG else rr.Clear(recursive=False))
        self._angles[robot.id] = angles
        self._scalar(f"plots/residual/{part(robot.id)}", robot.rms_px)


def _name_of(robot: "pb.RobotReport") -> str:
    """Its id, and its state where it is not simply tracked."""
    state = state_of(robot)
    return robot.id if state == TRACKED else f"{robot.id}: {state.removeprefix(f'{TRACKED}, ').replace('_', ' ')}"
