"""Cameras' frames and robots as the arrays that the compiled code takes."""

from collections.abc import Sequence

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot
from asterism.server.fusing.look import Body, Course, Scene, State
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.covariance import invert, move_origin
from asterism.server.pose.fit import SYSTEMATIC_PX
from asterism.server.pose.spot_shift import OPTICS

LEAST_SYSTEMATIC_PX = 0.03  # nothing is known better than this of a lens
ROOM = 1.5  # times what a robot's LEDs were found to be off


def scene_of(sightings: Sequence[Sighting]) -> Scene:
    """Of cameras, one sighting each."""
    turns = np.array([sighting.T_world_camera.rotation.T for sighting in sightings])
    return Scene(
        turns=np.ascontiguousarray(turns),
        origins=np.array([sighting.T_world_camera.position for sighting in sightings]),
        places=np.array([sighting.place_covariance for sighting in sightings]),
        lenses=np.array([sighting.view.lens for sighting in sightings]),
        sizes=np.array([(s.view.rig.camera.width, s.view.rig.camera.height) for s in sightings], np.float64),
        first=np.cumsum([0, *(len(sighting.rays) for sighting in sightings)]),
        rays=np.concatenate([sighting.rays for sighting in sightings]),
        covariances=np.concatenate([sighting.ray_covariances for sighting in sightings]),
    )


def body_of(robot: Robot, sightings: Sequence[Sighting]) -> Body:
    """A robot as these cameras see it; how far off its LEDs are is what any of them has learned."""
    misfit = max((sighting.misfits_m.get(robot.id, 0.0) for sighting in sightings), default=0.0)
    systematic = LEAST_SYSTEMATIC_PX if misfit > 0.0 else SYSTEMATIC_PX
    nothing = np.zeros(OPTICS)
    focal = np.array([sighting.view.rig.camera.matrix[0, 0] for sighting in sightings])
    return Body(
        layout=robot.leds_plane.copy(),  # for one that is read only kernels would be compiled once more
        optics=np.array([sighting.view.optics.get(robot.id, nothing) for sighting in sightings]),
        misfit=ROOM * misfit,
        systematic=systematic / focal,
    )


def still(cameras: int) -> Course:
    """The course of a robot that is seen by so many cameras at one time."""
    return Course(np.tile(np.eye(3), (cameras, 1, 1)), np.zeros((cameras, 3)), np.zeros((cameras, 2)))


def state_of(pose: Pose, robot: Robot, covariance: Floats | None = None) -> State:
    """T_world_robot with its covariance (6, 6) as of the robot's LEDs' plane; information 0 where none is given."""
    T_world_plane = pose @ robot.T_robot_plane
    information = np.zeros((6, 6))
    if covariance is not None:
        moved = np.array(covariance)
        move_origin(moved, T_world_plane.position - pose.position)
        invert(moved, information)
    return State(T_world_plane.rotation, T_world_plane.position.copy(), information)


def pose_of(state: State, robot: Robot) -> Pose:
    """T_world_robot of a state."""
    return Pose.from_matrix(state.rotation, state.t) @ robot.T_robot_plane.inverse()
