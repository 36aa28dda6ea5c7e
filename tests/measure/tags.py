"""The same robots with a fiducial tag on top instead of LEDs, and two well-known detectors: peers for the benchmark.

Tags of the family 36h11, as large as the robots' discs, seen without lens distortion (which favours the detectors).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.simulation.simulate import Truth

TAG_M = 0.1  # outer side of the black frame: the diameter of the robots' discs
CELLS = 8  # of a tag of this family, frame included
BLACK, WHITE, TABLE = 9.0, 170.0, 60.0  # grey levels
FINER = 4
PSF_PX, READ, GAIN = 0.8, 1.2, 0.03
_DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
# Corners of the black frame in the tag's plane, m, in the order of cv2.aruco: seen from above, clockwise.
CORNERS = 0.5 * TAG_M * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def render(rig: Rig, truth: list[Truth], seed: int) -> NDArray[np.uint8]:
    """The image (h, w) uint8 of a frame in which robot k carries tag k, flat on its LEDs' plane."""
    camera, rng = rig.camera, np.random.default_rng(seed)
    image = np.full((camera.height, camera.width), TABLE, np.float32)
    for k, entry in enumerate(truth):
        pose = entry.T_camera_robot @ rig.robots[k].T_robot_plane
        turn, t = pose.rotation, pose.position
        to_image = camera.matrix @ np.column_stack([turn[:, 0], turn[:, 1], t])
        # One white cell around the tag; texture pixels to the plane, m.
        texture = np.pad(cv2.aruco.generateImageMarker(_DICTIONARY, k, CELLS * 16), 16, constant_values=255)
        per = TAG_M / (CELLS * 16)
        half = 0.5 * texture.shape[0]
        to_plane = np.array([[per, 0.0, (0.5 - half) * per], [0.0, -per, -(0.5 - half) * per], [0.0, 0.0, 1.0]])
        reach = 0.8 * TAG_M * camera.matrix[0, 0] / t[2] + 6
        x, y = camera.matrix[:2] @ t / t[2]
        x0, y0, size = round(x - reach), round(y - reach), round(2 * reach)
        corner = 0.5 * FINER - 0.5 - FINER * np.array([x0, y0])
        fine = np.array([[FINER, 0.0, corner[0]], [0.0, FINER, corner[1]], [0.0, 0.0, 1.0]])
        shape = (size * FINER, size * FINER)
        light = cv2.warpPerspective(texture, fine @ to_image @ to_plane, shape, flags=cv2.INTER_AREA, borderValue=0)
        cover = cv2.warpPerspective(np.full_like(texture, 255), fine @ to_image @ to_plane, shape, borderValue=0)
        grey = TABLE + cover / 255.0 * (BLACK + light / 255.0 * (WHITE - BLACK) - TABLE)
        patch = cv2.GaussianBlur(grey.astype(np.float32), None, PSF_PX * FINER)
        patch = patch.reshape(size, FINER, size, FINER).mean(axis=(1, 3))
        left, top = max(-x0, 0), max(-y0, 0)
        right, bottom = min(size, camera.width - x0), min(size, camera.height - y0)
        if left < right and top < bottom:
            image[y0 + top : y0 + bottom, x0 + left : x0 + right] = patch[top:bottom, left:right]
    noisy = image + rng.standard_normal(image.shape) * np.sqrt(READ**2 + GAIN * image)
    exposed: NDArray[np.uint8] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return exposed


def _pose(corners: Floats, matrix: Floats) -> Pose | None:
    good, turn, t = cv2.solvePnP(CORNERS, corners.reshape(4, 1, 2), matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return Pose.from_matrix(cv2.Rodrigues(turn)[0], t.ravel()) if good else None


class Aruco:
    """OpenCV's ArUco detector with sub-pixel corners."""

    name = "OpenCV ArUco (tags)"

    def __init__(self, rig: Rig) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(_DICTIONARY, parameters)
        self._matrix = rig.camera.matrix

    def locate(self, image: NDArray[np.uint8]) -> dict[int, Pose]:
        """T_camera_tag of every tag that it finds."""
        corners, ids, _ = self._detector.detectMarkers(image)
        poses = {}
        for number, four in zip([] if ids is None else ids.ravel().tolist(), corners, strict=True):
            pose = _pose(np.asarray(four, np.float64), self._matrix)
            if pose is not None:
                poses[number] = pose
        return poses


class AprilTags:
    """The AprilTag 3 detector (pupil-apriltags), one thread, full resolution."""

    name = "pupil-apriltags (tags)"

    def __init__(self, rig: Rig) -> None:
        import pupil_apriltags

        # Its destructor damages the heap (release 1.0.4): the detector lives as long as the program.
        pupil_apriltags.Detector.__del__ = lambda _: None
        self._detector = pupil_apriltags.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
        self._matrix = rig.camera.matrix

    def locate(self, image: NDArray[np.uint8]) -> dict[int, Pose]:
        """T_camera_tag of every tag that it finds."""
        poses = {}
        for tag in self._detector.detect(image):
            # Its corners run the other way round, and its pixels begin at the corner of the top-left one.
            pose = _pose(np.asarray(tag.corners, np.float64)[[1, 0, 3, 2]] - 0.5, self._matrix)
            if pose is not None:
                poses[int(tag.tag_id)] = pose
        return poses
