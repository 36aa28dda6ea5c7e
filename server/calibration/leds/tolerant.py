"""Finding a robot whose LEDs are not where its rig says: up to a millimetre or so off.

The chain's own search takes 0.25 px of systematic error for granted. Seen through a camera of fewer, larger pixels the
same search takes that much more, so the spots are measured in the real image and matched in units of coarse pixels.
Only the one robot is looked for. Other robots in view are refused by the fit: constellations differ by far more.
"""

from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.observations import LedCentres
from asterism.server.centres.blobs import find_blobs
from asterism.server.chain.frame import Frame
from asterism.server.identity.cold import find
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import undistort

COARSE = 6.0  # pixels that make a coarse one: 0.25 of these are 1.5 px, which is 1 mm at 0.9 m with f = 1400 px


class TolerantSearch:
    """The search for one robot of a rig, each frame alone."""

    def __init__(self, rig: Rig, robot_id: str) -> None:
        self._rig = rig
        self._robot = rig.robot(robot_id)
        self._plan = plan_for(rig)
        camera = rig.camera
        coarse = replace(camera, matrix=np.diag([1 / COARSE, 1 / COARSE, 1.0]) @ camera.matrix)
        range_m = (self._plan.near, self._plan.far)
        self._coarse = Plan(replace(rig, camera=coarse, robots=(self._robot,), range_m=range_m))

    def find(self, frame: Frame) -> tuple[LedCentres, Pose] | None:
        """The robot's LEDs and its rough T_camera_robot; None where it is not found beyond doubt."""
        plan, coarse = self._plan, self._coarse
        scratch = plan.borrow_scratch()
        image = np.ascontiguousarray(frame.image)
        blobs = find_blobs(image, plan.largest_radius_px, plan.masks, self._rig.centre, scratch)
        plan.return_scratch(scratch)
        rows = blobs.kept
        rays, covariances = np.empty((len(rows), 2)), np.empty((len(rows), 3))
        undistort(plan.lens, blobs.centres_px[rows], blobs.covariances_px2[rows], rays, covariances)
        good = np.isfinite(rays[:, 0])
        rows, rays, covariances = rows[good], rays[good], covariances[good]
        if len(rows) < LEDS:
            return None
        flat = rays * np.array([coarse.focal, -coarse.focal])
        variances = 0.5 * (covariances[:, 0] + covariances[:, 2])
        free = np.ones(len(rows), np.bool_)
        spots = Spots(flat, rays, variances, blobs.heights[rows], blobs.radii_px[rows], free)
        found, _ = find(spots, coarse, np.zeros(1, np.bool_), np.zeros(1))
        if not len(found.robots):
            return None
        labels, rotation, t = found.assignment[0], found.rotations[0], found.ts[0]
        leds = np.flatnonzero(labels >= 0)
        centres = LedCentres.of(blobs.centres_px, blobs.covariances_px2, rows[labels[leds]], leds)
        return centres, Pose.from_matrix(rotation, t) @ self._robot.T_robot_plane.inverse()
