"""What the lens' own error does to a camera placed by robots at surveyed places."""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.calibration.lens.bundle import pixels_by_lens
from asterism.server.calibration.lens.lens_error import pose_by_lens
from asterism.server.calibration.survey.world import Sample, WorldFit, camera_by_samples

STEP = 1e-6  # m, of numeric derivatives


def spread_by_lens(fit: WorldFit, rig: Rig, lens: Floats) -> Floats:
    """The part (6, 6) of the covariance of T_world_camera, m and rad about the world's axes, that all samples share,
    since they are seen through one lens; ``lens`` (p, p) is the covariance of its fx, fy, cx, cy and coefficients.
    """
    moved = camera_by_samples(fit, np.array([_seen_by_lens(sample, rig) for sample in fit.samples]))
    return moved @ lens @ moved.T


def _seen_by_lens(sample: Sample, rig: Rig) -> Floats:
    """How the robot's pose in the camera's frame moves (6, p) with the lens that it is seen through."""
    arms = rig.robot(sample.robot).leds @ sample.seen.rotation.T
    points = arms + sample.seen.position
    shifts = STEP * np.eye(3)[:, None]
    by_point = (rig.camera.project(points + shifts) - rig.camera.project(points - shifts)) / (2.0 * STEP)
    by_point = np.moveaxis(by_point, 0, -1)  # (6, 2, 3)
    by_turn = by_point @ np.swapaxes(np.cross(np.eye(3), arms[:, None]), 1, 2)
    by_pose = np.concatenate([by_point, by_turn], axis=-1).reshape(-1, 6)
    return pose_by_lens(by_pose, pixels_by_lens(rig.camera, points).reshape(len(by_pose), -1))
