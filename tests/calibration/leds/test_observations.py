"""What calibrations fit to: every robot's labelled centres and its pose in the camera's frame."""

import numpy as np

from asterism.protocol.rig import load_rig
from asterism.server.calibration.leds.observations import LedCentres, observe
from asterism.server.calibration.survey.world import without_world
from asterism.server.chain.frame import Frame
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.helpers import assert_poses_close


def test_sightings_are_in_the_cameras_frame_whatever_the_world() -> None:
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig)
    truth = scene.truth(0, 0.0)
    frame = Frame(scene.render(0, truth), 0, 0, "a")
    ((_, seen),) = observe([frame], rig)
    ((_, plain),) = observe([frame], without_world(rig))
    assert len(seen) == len(plain) == 5
    for sighting, other, true in zip(seen, plain, truth, strict=True):
        assert_poses_close(sighting.pose, true.T_camera_robot, 1e-3, 5e-3)
        assert_poses_close(sighting.pose, other.pose, 1e-9, 1e-7)
        np.testing.assert_allclose(sighting.covariance, other.covariance, rtol=1e-6, atol=1e-15)
        pixels = rig.camera.project(true.T_camera_robot.map(rig.robot(true.robot).leds))
        assert np.abs(sighting.centres.centres_px - pixels).max() < 0.05
        assert (np.linalg.eigvalsh(sighting.centres.covariances_px2) > 0).all()


def test_rows_are_leds_and_what_is_not_seen_is_nan() -> None:
    spots, spreads = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), np.array([[1.0, 0.1, 2.0]] * 3)
    centres = LedCentres.of(spots, spreads, (2, 0), (0, 4))
    assert centres.count == 2
    np.testing.assert_array_equal(centres.centres_px[[0, 4]], [[5.0, 6.0], [1.0, 2.0]])
    np.testing.assert_array_equal(centres.covariances_px2[4], [[1.0, 0.1], [0.1, 2.0]])
    assert np.isnan(centres.centres_px[[1, 2, 3, 5]]).all()
    assert np.isnan(centres.covariances_px2[[1, 2, 3, 5]]).all()
