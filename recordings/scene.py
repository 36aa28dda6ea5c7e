"""What does not change while a recording is drawn: the camera and its frustum, plates, and how plots look."""

import numpy as np
import rerun as rr

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.recordings.entities import ALONE, Entities, part
from asterism.recordings.plates import plate_outline
from asterism.recordings.states import STATE_COLOURS
from asterism.recordings.surface_scene import place_surface

Colour = tuple[int, int, int]
# Okabe and Ito (2008), brightened for a dark background: told apart by the colour-blind as well.
_COLOURS: tuple[Colour, ...] = (
    (86, 180, 233), (230, 159, 0), (0, 190, 140), (240, 228, 66), (214, 140, 185), (235, 110, 30), (110, 140, 240),
    (190, 190, 190),
)  # fmt: skip
AXES = ((255, 90, 90), (90, 220, 90), (110, 155, 255))  # x, y, z; roll, pitch, yaw
LATENCIES = {"exposure to network, ms": (230, 159, 0), "solving, ms": (86, 180, 233)}
LED_PX = 2.5  # radius on the screen: seen from wherever one looks
AXIS = 0.8  # of a robot's extent
NAME_ABOVE = 1.6  # of a robot's extent, from its plate
STOREY = 0.8  # of a robot's extent, from one name to the next
NEAR_IMAGE = 0.3  # of the nearest working distance, where the images of several cameras stand


def robot_colours(rig: Rig) -> dict[str, Colour]:
    """A colour for every robot, the same in image, space and plots."""
    return {robot.id: _COLOURS[k % len(_COLOURS)] for k, robot in enumerate(rig.robots)}


def place_scene(stream: rr.RecordingStream, rig: Rig, entities: Entities = ALONE) -> None:
    """Log what is static: entities as drawing.py lists them."""
    _place_world(stream, rig)
    if entities.camera:
        _place_camera(stream, rig, entities)
    place_surface(stream, rig, entities)
    if entities.told is None:
        return
    for robot_id, colour in robot_colours(rig).items():
        _place_robot(stream, rig.robot(robot_id), colour, entities)
        _place_plots(stream, robot_id, colour, entities)
    for name, colour in LATENCIES.items():
        path = f"{entities.told}plots/latency/{name.partition(',')[0].replace(' ', '_')}"
        stream.log(path, rr.SeriesLines(names=name, colors=colour), static=True)


def working_range(rig: Rig) -> tuple[float, float]:
    """Nearest and farthest distance at which robots are expected, m."""
    return rig.range_m or (1.0, 1.5)


def name_place(robot: Robot, storey: int = 0) -> Floats:
    """Where a robot's name stands, (3,) m in its frame: above its plate, and above names of lower storeys."""
    return robot.T_robot_plane.map(np.array([0.0, 0.0, (NAME_ABOVE + STOREY * storey) * robot.extent]))


def place_transform(pose: Pose) -> rr.Transform3D:
    """A pose as the viewer takes it."""
    return rr.Transform3D(translation=pose.position, quaternion=rr.Quaternion(xyzw=pose.orientation))


def _place_world(stream: rr.RecordingStream, rig: Rig) -> None:
    if rig.T_world_camera is None:
        stream.log("world", rr.ViewCoordinates.RDF, static=True)
    else:
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("world/origin", rr.TransformAxes3D(0.1), static=True)


def _place_camera(stream: rr.RecordingStream, rig: Rig, entities: Entities) -> None:
    camera, (near, far) = rig.camera, working_range(rig)
    if rig.T_world_camera is not None:
        # A static place would hide those of frames in which the camera was followed.
        stream.log(entities.camera, place_transform(rig.T_world_camera), static=not rig.follows_world)
    stream.log(
        entities.image,
        rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=NEAR_IMAGE * near if entities.several else far,
            color=[255, 255, 255],
            line_width=0.002 * near,
        ),
        static=True,
    )
    # Else the viewer draws one as long as the frustum.
    stream.log(entities.image, rr.TransformAxes3D(0.1 * near), static=True)
    name = rr.Points3D(
        [0.0, 0.0, 0.0], radii=rr.Radius.ui_points(0.5), colors=[255, 255, 255], labels=[camera.name], show_labels=True
    )
    stream.log(f"{entities.camera}/name", name, static=True)


def _place_robot(stream: rr.RecordingStream, robot: Robot, colour: Colour, entities: Entities) -> None:
    path, outline = entities.robot("robots", robot.id), plate_outline(robot)
    edge = np.vstack([outline, outline[:1]])
    mast = np.stack([robot.T_robot_plane.position, name_place(robot, entities.storey)])
    fan = [(0, k, k + 1) for k in range(1, len(outline) - 1)]
    logged = {
        path: rr.TransformAxes3D(AXIS * robot.extent),
        f"{path}/plate": rr.Mesh3D(vertex_positions=outline, triangle_indices=fan, albedo_factor=[*colour, 190]),
        f"{path}/outline": rr.LineStrips3D([edge, mast], colors=colour, radii=rr.Radius.ui_points([1.5, 0.7])),
        f"{path}/leds": rr.Points3D(
            robot.leds,
            radii=rr.Radius.ui_points(LED_PX),
            colors=[255, 255, 255],
            labels=[f"LED {k}" for k in range(len(robot.leds))],
            show_labels=False,
        ),
    }
    if robot.points:
        logged[f"{path}/points"] = rr.Points3D(
            np.array(list(robot.points.values())),
            radii=rr.Radius.ui_points(LED_PX),
            colors=[200, 200, 200],
            labels=[f"{robot.id}/{name}" for name in robot.points],
            show_labels=False,
        )
    for entity, archetype in logged.items():
        stream.log(entity, archetype, static=True)


def _place_plots(stream: rr.RecordingStream, robot: str, colour: Colour, entities: Entities) -> None:
    own = _COLOURS[entities.storey % len(_COLOURS)]

    def line(path: str, name: str, tint: Colour) -> None:
        # Of one of several cameras the line is told by the camera.
        names, colours = (entities.by, own) if entities.by else (name, tint)
        stream.log(f"{entities.told}{path}", rr.SeriesLines(names=names, colors=colours), static=True)

    for name, tint in zip("xyz", AXES, strict=True):
        line(f"plots/position/{part(robot)}/{name}", f"{name}, m", tint)
    for name, tint in zip(("roll", "pitch", "yaw"), AXES, strict=True):
        line(f"plots/angles/{part(robot)}/{name}", f"{name}, deg", tint)
    line(f"plots/residual/{part(robot)}", f"{robot}: rms, px", colour)
    states = list(STATE_COLOURS)
    looks = rr.StateConfiguration(values=states, labels=states, colors=np.array(list(STATE_COLOURS.values()), np.uint8))
    stream.log(f"{entities.told}states/{part(robot)}", looks, static=True)
