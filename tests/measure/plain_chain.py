"""What one would write with OpenCV in an afternoon: the yardstick of the benchmark.

Threshold, contours, moments; then for every robot all ordered pairs of spots as images of its two LEDs farthest apart:
a similarity from the pair, the other four LEDs predicted, the nearest spots taken; the pair with the smallest residual
wins and solvePnP gives the pose.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig

THRESHOLD = 60
SMALLEST_AREA = 4.0  # px
WORST_RESIDUAL = 0.15  # of the pair's distance


class PlainChain:
    """The chain, prepared for a rig whose LEDs lie in the robots' z = 0 planes."""

    def __init__(self, rig: Rig) -> None:
        camera = rig.camera
        self.matrix, self.distortion = camera.matrix, np.asarray(camera.distortion)
        self.layouts: dict[str, tuple[Floats, Floats]] = {}
        near, far = rig.range_m or (0.3, 3.0)
        self.scale = camera.matrix[0, 0] / far * 0.5, camera.matrix[0, 0] / near  # px per m; half for tilt
        for robot in rig.robots:
            points = robot.leds
            away = np.linalg.norm(points[:, None] - points[None], axis=2)
            a, b = np.unravel_index(np.argmax(away), away.shape)
            order = [a, b, *(k for k in range(6) if k not in (a, b))]
            ordered = points[order]
            plane = ordered[:, 0] + 1j * ordered[:, 1]
            self.layouts[robot.id] = ordered, (plane[2:] - plane[0]) / (plane[1] - plane[0])

    def locate(self, image: NDArray[np.uint8]) -> dict[str, tuple[Floats, Floats]]:
        """(R, t) of T_camera_robot for each robot it finds, camera frame, m."""
        _, mask = cv2.threshold(image, THRESHOLD, 255, cv2.THRESH_BINARY)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        moments = [cv2.moments(contour) for contour in contours]
        spots = np.array([(m["m10"] / m["m00"], m["m01"] / m["m00"]) for m in moments if m["m00"] >= SMALLEST_AREA])
        if len(spots) < 6:
            return {}
        ideal = cv2.undistortPoints(spots.reshape(-1, 1, 2), self.matrix, self.distortion, P=self.matrix).reshape(-1, 2)
        # The camera looks at the LEDs' side, so a constellation appears mirrored with y down.
        flat = ideal[:, 0] - 1j * ideal[:, 1]
        distance = np.abs(flat[:, None] - flat[None])
        found = {}
        for robot, (points, ratios) in self.layouts.items():
            length = np.linalg.norm(points[1] - points[0])
            first, second = np.nonzero((distance > length * self.scale[0]) & (distance < length * self.scale[1]))
            if len(first) == 0:
                continue
            along = flat[second] - flat[first]
            predicted = flat[first][:, None] + along[:, None] * ratios
            away = np.abs(predicted[:, :, None] - flat)
            nearest = away.argmin(axis=2)
            residual = away.min(axis=2).max(axis=1) / np.abs(along)
            best = int(residual.argmin())
            chosen = [first[best], second[best], *nearest[best]]
            if residual[best] > WORST_RESIDUAL or len(set(chosen)) < 6:
                continue
            good, turn, position = cv2.solvePnP(
                points, spots[chosen], self.matrix, self.distortion, flags=cv2.SOLVEPNP_IPPE
            )
            if good:
                found[robot] = cv2.Rodrigues(turn)[0], position.ravel()
        return found
