"""What of a covariance stays from frame to frame: what the rig has wrong, and where the camera is."""

from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.rig import load_rig
from asterism.server.chain.stays import Told, what_stays
from asterism.server.simulation.demo_rig import DEMO_RIG

RIG = load_rig(DEMO_RIG)
PLACE = np.array([[0.1, 0.05, 0.0], [-0.2, 0.1, 0.05]])


def covariances(rng: np.random.Generator) -> np.ndarray:  # type: ignore[type-arg]
    half = rng.standard_normal((2, 6, 6)) * [1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-4]
    return np.swapaxes(half, 1, 2) @ half


def test_where_nothing_is_known_to_be_wrong_all_is_noise(rng: np.random.Generator) -> None:
    told = Told(PLACE, covariances(rng), np.full(2, 1e-4), np.zeros(2))
    assert not what_stays(told, RIG).any()


def test_errors_of_leds_as_large_as_the_spots_noise_are_half_of_it(rng: np.random.Generator) -> None:
    depths = 1.3 - PLACE[:, 2]
    misfits = 0.01 * depths / RIG.camera.matrix[0, 0]
    told = Told(PLACE, covariances(rng), np.full(2, 1e-4), misfits)
    np.testing.assert_allclose(what_stays(told, RIG), 0.5 * told.covariances, rtol=1e-6, atol=1e-20)


def test_the_cameras_place_stays_as_a_whole(rng: np.random.Generator) -> None:
    """Its covariance, carried to the robots: what moves with a camera that is off by a draw of it."""
    spread = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4]) ** 2
    T = Pose.from_matrix(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.3]))
    moved = []
    for error in rng.standard_normal((4000, 6)) * 1e-4:
        off = Pose.from_matrix(exp_rotation(error[3:]) @ T.rotation, T.position + error[:3]) @ T.inverse()
        moved.append(np.concatenate([off.map(PLACE) - PLACE, np.tile(error[3:], (2, 1))], axis=1))
    expected = np.einsum("kni,knj->nij", moved, moved) / len(moved)
    own = covariances(rng)
    stays = what_stays(Told(PLACE, own + expected, np.full(2, 1e-4), np.zeros(2)), RIG, (T, spread))
    scale = 1e-4 * np.array([1.5, 1.5, 1.0, 1.0, 1.0, 1.0])
    assert np.abs((stays - expected) / np.outer(scale, scale)).max() < 0.15


def test_a_rig_without_a_place_is_seen_from_the_camera(rng: np.random.Generator) -> None:
    rig = replace(RIG, T_world_camera=None)
    told = Told(np.array([[0.0, 0.0, 1.3]]), covariances(rng)[:1], np.full(1, 1e-4), np.full(1, 0.01 * 1.3 / 1400))
    np.testing.assert_allclose(what_stays(told, rig), 0.5 * told.covariances, rtol=1e-3, atol=1e-20)
