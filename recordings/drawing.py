"""Messages drawn into rerun: the same for a recording under review and for a live server.

world/camera/image            the frame, its spots with their fates, names, and residuals (enlarged)
world/robots/<id>             axes, LEDs and named points of every robot
world/paths/<id>              where it went
plots/...                     position, residual, latency
states/<id>                   TRACKED, TILT_AMBIGUOUS, IDENTITY_AMBIGUOUS, LOST
"""

import zlib
from collections import deque
from struct import pack

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import State
from asterism.protocol.rig import Rig

APPLICATION = "asterism"
RESIDUAL_SCALE = 500.0  # a residual of 0.02 px is drawn 10 px long
NAME_ABOVE_PX = 70.0  # a name stands that far above its robot
TRAIL = 600  # positions kept of every robot's path
AXIS_M = 0.06
_COLOURS = np.array(
    [
        [86, 180, 233], [230, 159, 0], [0, 158, 115], [240, 228, 66], [204, 121, 167],
        [213, 94, 0], [0, 114, 178], [160, 160, 160],
    ],
    np.uint8,
)  # fmt: skip
_FATE_COLOURS = {pb.LED: (60, 255, 90), pb.UNEXPLAINED: (255, 210, 40)}
_CIRCLE = np.array([[np.cos(angle), np.sin(angle)] for angle in np.linspace(0, 2 * np.pi, 17)])  # (17, 2)
_REJECTED = (255, 70, 70)
_STATES = {
    "TRACKED": 0x2E9E4FFF,
    "TILT_AMBIGUOUS": 0xE0B020FF,
    "IDENTITY_AMBIGUOUS": 0xB050C0FF,
    "LOST": 0xD04040FF,
}


def png(image: NDArray[np.uint8]) -> bytes:
    """An (h, w) grey image as PNG, run-length coded: lossless, quick, and what every viewer shows.

    Source: the PNG specification (W3C), colour type 0, filter 0.
    """
    height, width = image.shape
    rows = np.zeros((height, width + 1), np.uint8)
    rows[:, 1:] = image
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    data = packer.compress(rows.tobytes()) + packer.flush()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return pack(">I", len(body)) + kind + body + pack(">I", zlib.crc32(kind + body))

    head = pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def blueprint(rig: Rig) -> rrb.Blueprint:
    """Camera and space on the left, plots per robot on the right."""
    robots = [robot.id for robot in rig.robots]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(
                    origin="world/camera/image",
                    contents="world/camera/image/**",
                    name="camera: spots, names, residuals",
                ),
                rrb.Spatial3DView(
                    origin="world",
                    contents=["+ world/**", "- world/camera/image/**"],
                    name="space",
                    line_grid=rig.T_world_camera is not None,
                    eye_controls=_eye(rig),
                ),
                row_shares=[1, 1],
            ),
            rrb.Vertical(
                rrb.Tabs(
                    *(rrb.TimeSeriesView(origin=f"plots/position/{robot}", name=robot) for robot in robots),
                    name="position, m",
                ),
                rrb.TimeSeriesView(origin="plots/residual", name="residual, px"),
                rrb.TimeSeriesView(origin="plots/latency", name="latency, ms"),
                rrb.StateTimelineView(origin="states", name="state"),
                row_shares=[3, 2, 2, 3],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _eye(rig: Rig) -> rrb.EyeControls3D:
    """Look at the robots from beside the camera, from a little lower."""
    near, far = rig.range_m or (1.0, 1.5)
    distance = 0.5 * (near + far)
    eye, target = np.array([0.45, 0.75, 0.2]) * distance, np.array([0.0, 0.0, distance])
    up = np.array([0.0, 0.0, -1.0])
    if rig.T_world_camera is not None:
        eye, target = rig.T_world_camera.map(eye), rig.T_world_camera.map(target)
        up = np.array([0.0, 0.0, 1.0])
    return rrb.EyeControls3D(position=eye, look_target=target, eye_up=up)


class Drawing:
    """Draws frame reports and images into one rerun stream."""

    def __init__(self, stream: rr.RecordingStream, rig: Rig) -> None:
        self._stream = stream
        self._rig = rig
        self._trails: dict[str, deque[Floats]] = {robot.id: deque(maxlen=TRAIL) for robot in rig.robots}
        self._states: dict[str, str] = {}
        self._place_scene()

    def image(self, image: NDArray[np.uint8], time_ns: int, sequence: int) -> None:
        """Show an (h, w) frame."""
        self._at(time_ns, sequence)
        self._stream.log("world/camera/image", rr.EncodedImage(contents=png(image), media_type="image/png"))

    def report(self, report: "pb.FrameReport") -> None:
        """Show what one frame told."""
        self._at(report.exposed_ns, report.sequence)
        self._spots(report)
        for robot in report.robots:
            self._robot(robot)
        self._scalar("plots/latency/solve", (report.solved_ns - report.arrived_ns) * 1e-6)
        self._scalar("plots/latency/published", (report.published_ns - report.exposed_ns) * 1e-6)

    def _at(self, time_ns: int, sequence: int) -> None:
        self._stream.set_time("exposed", timestamp=np.datetime64(time_ns, "ns"))
        self._stream.set_time("frame", sequence=sequence)

    def _scalar(self, path: str, value: float) -> None:
        self._stream.log(path, rr.Scalars(value))

    def _place_scene(self) -> None:
        rig, log = self._rig, self._stream.log
        camera = rig.camera
        if rig.T_world_camera is None:
            log("world", rr.ViewCoordinates.RDF, static=True)
        else:
            log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            log(
                "world/camera",
                rr.Transform3D(
                    translation=rig.T_world_camera.position,
                    quaternion=rr.Quaternion(xyzw=rig.T_world_camera.orientation),
                ),
                static=True,
            )
        log(
            "world/camera/image",
            rr.Pinhole(
                image_from_camera=camera.matrix,
                resolution=[camera.width, camera.height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.25,
            ),
            static=True,
        )
        log("plots/latency/solve", rr.SeriesLines(names="solve", colors=[86, 180, 233]), static=True)
        log(
            "plots/latency/published",
            rr.SeriesLines(names="exposure to network", colors=[230, 159, 0]),
            static=True,
        )
        for index, robot in enumerate(rig.robots):
            colour = _COLOURS[index % len(_COLOURS)]
            log(f"world/robots/{robot.id}", rr.TransformAxes3D(AXIS_M), static=True)
            log(
                f"world/robots/{robot.id}/leds",
                rr.Points3D(robot.leds, radii=robot.led_radius or 0.0025, colors=colour),
                static=True,
            )
            if robot.points:
                log(
                    f"world/robots/{robot.id}/points",
                    rr.Points3D(
                        np.array(list(robot.points.values())),
                        radii=0.004,
                        colors=[230, 230, 230],
                        labels=[f"{robot.id}/{name}" for name in robot.points],
                        show_labels=False,
                    ),
                    static=True,
                )
            log(f"plots/residual/{robot.id}", rr.SeriesLines(names=robot.id, colors=colour), static=True)
            for axis, tint in zip("xyz", ([255, 80, 80], [80, 220, 80], [90, 140, 255]), strict=True):
                log(f"plots/position/{robot.id}/{axis}", rr.SeriesLines(names=axis, colors=tint), static=True)
            log(
                f"states/{robot.id}",
                rr.StateConfiguration(
                    values=list(_STATES),
                    labels=list(_STATES),
                    colors=np.array(list(_STATES.values()), np.uint32),
                ),
                static=True,
            )

    def _spots(self, report: "pb.FrameReport") -> None:
        spots = report.spots
        if not spots.x:
            self._stream.log("world/camera/image/spots", rr.Clear(recursive=True))
            return
        centres = np.column_stack([spots.x, spots.y])
        names = [
            f"{report.robots[robot].id} {led}" if robot >= 0 else pb.Fate.Name(fate).lower().replace("_", " ")
            for robot, led, fate in zip(spots.robot, spots.led, spots.fate, strict=True)
        ]
        colours = [_FATE_COLOURS.get(fate, _REJECTED) for fate in spots.fate]
        self._stream.log(
            "world/camera/image/spots",
            # Half a pixel: rerun's image begins at the corner of the top-left pixel, ours at its centre.
            rr.LineStrips2D(
                (centres + 0.5)[:, None] + _CIRCLE * (np.array(spots.radius) + 5.0)[:, None, None],
                radii=0.6,
                colors=colours,
                labels=names,
                show_labels=False,
            ),
        )
        tags, places, vectors, origins = [], [], [], []
        for robot in report.robots:
            if not robot.HasField("pose"):
                continue
            own = centres[list(robot.spot)]
            tags.append(robot.id)
            places.append([own[:, 0].mean(), own[:, 1].min() - NAME_ABOVE_PX])
            residuals = np.column_stack([robot.residual_x, robot.residual_y]) * RESIDUAL_SCALE
            vectors.append(residuals)
            origins.append(own + 0.5)
        if not tags:
            self._stream.log("world/camera/image/names", rr.Clear(recursive=False))
            self._stream.log("world/camera/image/residuals", rr.Clear(recursive=False))
            return
        self._stream.log(
            "world/camera/image/names",
            rr.Points2D(places, radii=0.1, colors=[255, 255, 255], labels=tags, show_labels=True),
        )
        self._stream.log(
            "world/camera/image/residuals",
            rr.Arrows2D(
                vectors=np.concatenate(vectors),
                origins=np.concatenate(origins),
                colors=[255, 255, 255],
                radii=0.7,
            ),
        )

    def _robot(self, robot: "pb.RobotReport") -> None:
        state = State.Name(robot.state)
        if self._states.get(robot.id) != state:
            self._states[robot.id] = state
            self._stream.log(f"states/{robot.id}", rr.StateChange(state=state))
        path = f"world/robots/{robot.id}"
        if not robot.HasField("pose"):
            # No pose: nothing is drawn where the robot was.
            self._stream.log(path, rr.Transform3D.from_fields(scale=0.0))
            return
        pose = report_pose(robot.pose)
        self._stream.log(
            path,
            rr.Transform3D(translation=pose.position, quaternion=rr.Quaternion(xyzw=pose.orientation), scale=1.0),
        )
        trail = self._trails[robot.id]
        trail.append(pose.position)
        colour = _COLOURS[[entry.id for entry in self._rig.robots].index(robot.id) % len(_COLOURS)]
        if len(trail) % 5 == 0 or len(trail) == TRAIL:
            self._stream.log(f"world/paths/{robot.id}", rr.LineStrips3D([np.array(trail)], colors=colour, radii=0.0015))
        for axis, value in zip("xyz", pose.position.tolist(), strict=True):
            self._scalar(f"plots/position/{robot.id}/{axis}", value)
        self._scalar(f"plots/residual/{robot.id}", robot.rms_px)
