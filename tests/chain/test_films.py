"""Films in bad light: the exposure changes between two frames, a patch of sun moves over the robots."""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, angle_between
from asterism.server import Frame, FrameResult, Lost, PoseEstimate, Tracks, localize
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.chain.frames import alone, estimates
from tests.rigs import make_rig

RATE = 60
IN_VIEW = 8
RIG = make_rig(12, seed=21)  # the last four are elsewhere
SHOWN = replace(RIG, robots=RIG.robots[:IN_VIEW])


def followed(image: NDArray[np.uint8], index: int, tracks: Tracks) -> tuple[FrameResult, Tracks]:
    return localize(Frame(image, exposed_ns=1 + index * 10**9 // RATE, index=index), RIG, tracks)


def right(answer: PoseEstimate | Lost, truth: Pose) -> bool:
    """Located, where it is; the other tilt if that is said to be possible."""
    if not isinstance(answer, PoseEstimate) or np.linalg.norm(answer.position - truth.position) > 0.005:
        return False
    said = [answer.pose, *([answer.alternative.pose] if answer.alternative else [])]
    return any(angle_between(pose.rotation, truth.rotation) < np.radians(3) for pose in said)


@pytest.mark.parametrize(
    ("factors", "missing"), [((1.0, 0.5), 0), ((1.0, 0.5), 1), ((0.5, 1.0), 0), ((0.5, 1.0), 1), ((1.0, 0.25), 0)]
)
def test_an_exposure_that_changes_costs_no_robot_a_frame(factors: tuple[float, float], missing: int) -> None:
    before, after = (Scene(SHOWN, 3, Look(brightness=factor * 180.0, background=factor * 16.0)) for factor in factors)
    tracks = Tracks.none()
    for index in range(12):
        scene = before if index < 6 else after
        truth = [
            replace(entry, lit=tuple(led >= missing for led in range(6))) for entry in scene.truth(index, index / RATE)
        ]
        result, tracks = followed(scene.render(index, truth), index, tracks)
        for entry in truth:
            assert right(result.answers[entry.robot], entry.T_camera_robot), (index, entry.robot)
        assert len(estimates(result)) == IN_VIEW


def sunlit(image: NDArray[np.uint8], x: int, y: int) -> NDArray[np.uint8]:
    """The image with a saturated patch of 300x200 px from (x, y) on, as sharp as the lens."""
    light = np.zeros(image.shape, np.float32)
    light[max(y, 0) : max(y + 200, 0), max(x, 0) : max(x + 300, 0)] = 600.0
    light = cv2.GaussianBlur(light, None, 0.9)
    lit: NDArray[np.uint8] = np.clip(image + light, 0, 255).astype(np.uint8)
    return lit


def clear_leds(entry: Truth, x: int, y: int) -> int:
    """How many LEDs of the robot the patch leaves alone."""
    pixels: Floats = RIG.camera.project(entry.T_camera_robot.map(RIG.robot(entry.robot).leds))
    beside = np.maximum(np.abs(pixels - [x + 149.5, y + 99.5]) - [150, 100], 0).max(axis=1)
    return int((beside > 8).sum())


def test_a_patch_of_sun_costs_only_the_robots_it_covers() -> None:
    scene, tracks = Scene(SHOWN, 5), Tracks.none()
    met = Counter[int]()
    for index in range(45):
        x, y = 40 * index - 350, 18 * index - 60
        truth = scene.truth(index, index / RATE)
        image = sunlit(scene.render(index, truth), x, y)
        result, tracks = followed(image, index, tracks)
        for located in (result, alone(image, RIG)):
            assert set(estimates(located)) <= {entry.robot for entry in truth}, index
            for entry in truth:
                answer, leds = located.answers[entry.robot], clear_leds(entry, x, y)
                met[leds] += 1
                if isinstance(answer, PoseEstimate) or leds >= 5:
                    assert right(answer, entry.T_camera_robot), (index, entry.robot, leds, answer)
    # The patch has met them all: covered, half covered, in the clear.
    assert met[0] > 5
    assert sum(met[k] for k in range(1, 6)) > 5
    assert met[6] > 400
