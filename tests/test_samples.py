"""The figures of the issue on the team's sample frames and photographs, each frame alone; skipped where they are not."""

import json
from typing import Any

import cv2
import numpy as np
import pytest

from asterism.protocol.geometry import Pose, angle_between
from asterism.protocol.rig import load_rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.plan import LARGEST_SPOT
from tests.helpers import shared
from tests.test_segmentation import blobs_of

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


def located(folder: str) -> list[tuple[dict[str, Any] | None, PoseEstimate | None, str]]:
    """(truth or None, answer or None, where) of every robot of the rig and every robot in view, frame by frame."""
    path = shared("samples", folder)
    rig, found = load_rig(path / "rig.yaml"), []
    for entry in json.loads((path / "truth.json").read_text()):
        image = cv2.imread(str(path / "frames" / entry["frame"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        result, _ = localize(Frame(np.asarray(image, np.uint8), 1, 0), rig, Tracks.none())
        truth = {robot["id"]: robot for robot in entry["robots"]}
        for robot, answer in result.answers.items():
            estimate = answer if isinstance(answer, PoseEstimate) else None
            found.append((truth.get(robot), estimate, f"{folder}/{entry['frame']} {robot}"))
    return found


@pytest.mark.parametrize("folder", SHARES)
def test_robots_are_found_and_nothing_is_wrong_in_silence(folder: str) -> None:
    least, share = SHARES[folder]
    visible = seen = 0
    for truth, answer, where in located(folder):
        if truth is not None and truth["visible"] >= least:
            visible += 1
            seen += answer is not None
        if answer is None:
            continue
        assert truth is not None, f"{where}: a robot that is not there"
        right = Pose(np.array(truth["position"]), np.array(truth["orientation"]))
        assert np.linalg.norm(answer.position - right.position) < 0.02, where
        turned = angle_between(answer.pose.rotation, right.rotation)
        other = answer.alternative
        said = other is not None and angle_between(other.pose.rotation, right.rotation) < np.radians(5)
        sigma = float(np.sqrt(np.linalg.eigvalsh(answer.covariance[3:, 3:])[-1]))
        assert turned < np.radians(5) or said or turned < 3 * sigma, where
    assert seen >= share * visible


def test_the_clean_frames_accuracy() -> None:
    lateral, depth = [], []
    for truth, answer, _ in located("clean"):
        assert truth is not None
        assert answer is not None
        off = answer.position - np.array(truth["position"])
        lateral += [abs(off[0]), abs(off[1])]
        depth.append(abs(off[2]))
    assert np.median(lateral) <= 0.05e-3
    assert np.median(depth) <= 0.25e-3


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
