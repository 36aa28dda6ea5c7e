"""What of a pose's covariance stays the same from frame to frame, and so does not average out.

A pose's covariance holds errors of three kinds. Where the camera stands (`world: {follow: true}`) and what a correction
of Z leaves are added to it as they are, and are taken out as they are. The rest is carried through the pose from
its spots, each of which is off by its own noise, new in every frame, and by what the rig has wrong of its LED.
The second is learned frame by frame (`FrameResult.learned`), and by both variances the rest is divided.

A pose that rests on the surface as well (`pose.standing`) says itself what the spots make of its covariance: the rest
is the surface's, which stays.

What is not known of an LED's light (`led_doubt`) and light beside all LEDs (`common_shift`) are counted as noise.
"""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.chain.turns import hats
from asterism.server.pose.track import LEAST_SHARE

# By how many sigmas what the rig has wrong of a robot's LEDs changes with the robot, by its own axes: per rad of turn,
# and per m of way. As six LEDs in a plane are seen from 1.3 m above, each off by as much.
BY_TURN, BY_WAY = 3.0, 4.0


class Told(NamedTuple):
    """What a frame tells of n poses: ``positions`` (n, 3) m, ``covariances`` (n, 6, 6), the mean variance of a
    coordinate of their spots, ``own_px2`` (n,), and how far off the rig has their LEDs, ``misfits`` (n,) m, 0 where
    that is not known; ``by_spots`` (n, 6, 6), the part of the covariances that comes from the spots, where poses say
    that, else nan or None.
    """

    positions: Floats
    covariances: Floats
    own_px2: Floats
    misfits: Floats
    by_spots: Floats | None = None


def what_stays(told: Told, rig: Rig, camera: tuple[Pose, Floats] | None = None) -> Floats:
    """The part (n, 6, 6) of the covariances that is the same in the next frame; ``camera`` is T_world_camera with its
    covariance (6, 6) where the camera's place is followed.
    """
    T = camera[0] if camera is not None else rig.T_world_camera or Pose.identity()
    from_camera = told.positions - T.position
    by_rig = np.zeros_like(told.covariances)
    if rig.z_correction is not None:
        along = T.rotation[:, 2]
        corrected = from_camera @ T.rotation
        before = corrected.copy()
        for _ in range(2):  # it was looked up where the poses were without it
            before[:, 2] = corrected[:, 2] - rig.z_correction.at(before).dz
        variances = rig.z_correction.at(before).variances
        by_rig[:, :3, :3] += variances[:, None, None] * np.outer(along, along)
    if camera is not None:
        by_place = np.tile(np.eye(6), (len(from_camera), 1, 1))
        by_place[:, :3, 3:] = -hats(from_camera)
        by_rig += by_place @ camera[1] @ np.swapaxes(by_place, 1, 2)
    focal = np.sqrt(rig.camera.matrix[0, 0] * rig.camera.matrix[1, 1])
    depths = from_camera @ T.rotation[:, 2]
    misfit_px2 = np.square(told.misfits * focal / depths)
    share = np.maximum(told.own_px2 / (told.own_px2 + misfit_px2), LEAST_SHARE)
    stays: Floats = by_rig + (1.0 - share)[:, None, None] * (told.covariances - by_rig)
    if told.by_spots is not None:
        stays = np.where(np.isnan(told.by_spots), stays, told.covariances - share[:, None, None] * told.by_spots)
    return stays


def drifts(twists: Floats, rotations: Floats, stays: Floats) -> Floats:
    """What the change of what ``stays`` (n, 6, 6) adds to the covariances (n, 6, 6) of ``twists`` (n, 6), both in the
    robots' own axes: a robot that turns or drives is seen from elsewhere, and its pose drifts as if it moved so.
    """
    rate2 = BY_WAY**2 * np.sum(twists[:, :3] ** 2, axis=1) + BY_TURN**2 * np.sum(twists[:, 3:] ** 2, axis=1)
    back = np.zeros_like(stays)
    back[:, :3, :3] = back[:, 3:, 3:] = np.swapaxes(rotations, 1, 2)
    drift: Floats = rate2[:, None, None] * (back @ stays @ np.swapaxes(back, 1, 2))
    return drift
