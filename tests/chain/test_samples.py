"""The figures on the team's sample frames and photographs, each frame alone; skipped where they are not."""

import cv2
import numpy as np
import pytest

from asterism.server.identity.plan import LARGEST_SPOT
from tests.chain.judging import judge
from tests.helpers import shared
from tests.segmentation.test_segmentation import blobs_of

# Of the robots with that many LEDs visible, this share is found.
SHARES = {
    "clean": (6, 1.0),
    "fleet": (6, 1.0),
    "tilted": (6, 1.0),
    "saturated": (6, 1.0),
    "dim": (6, 1.0),
    "strangers": (6, 1.0),
    "clutter": (5, 0.9),
    "occluded": (5, 0.9),
    "ghosts": (5, 0.9),
    "empty": (6, 0.0),
    "film": (5, 1.0),
}


@pytest.mark.parametrize("folder", SHARES)
def test_robots_are_found_and_nothing_is_wrong_in_silence(folder: str) -> None:
    least, share = SHARES[folder]
    visible = seen = 0
    for robot in judge(shared("samples", folder)):
        visible += robot.visible >= least
        seen += robot.visible >= least and robot.answer is not None
        assert not robot.wrong, f"{robot.where}: a wrong pose"
        assert not robot.silent_tilt, f"{robot.where}: a wrong tilt in silence"
    assert seen >= share * visible


def test_the_clean_frames_accuracy() -> None:
    errors = np.abs([robot.error[:3] for robot in judge(shared("samples", "clean"))])
    assert np.median(errors[:, :2]) <= 0.05e-3
    assert np.median(errors[:, 2]) <= 0.25e-3


# Centres, px, of the LEDs that a person counts on the front plate of the headset (the same in all eight photographs).
FRONT_PLATE = [
    (234, 128), (329, 154), (397, 130), (479, 168), (134, 174), (505, 227), (135, 253),
    (353, 247), (452, 275), (258, 296), (439, 331), (295, 353), (141, 379),
]  # fmt: skip


def test_every_led_on_the_headsets_front_plate_is_kept() -> None:
    for path in sorted(shared("real", "hdk_ir").glob("*.png")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        blobs = blobs_of(np.asarray(image, np.uint8), largest=LARGEST_SPOT * np.hypot(640, 480))
        kept = blobs.centres_px[blobs.kept]
        for x, y in FRONT_PLATE:
            assert np.hypot(kept[:, 0] - x, kept[:, 1] - y).min() < 6, f"{path.name}: the LED at {x}, {y}"
