"""Frames of which only windows around spots are kept: much smaller, and solved again as before."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.codec import stamped
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.recordings.spots import CHANGED, REFRESH, Spots, SpotWindows
from asterism.server import Frame, Tracks, localize
from asterism.server.chain.report import report
from asterism.server.pose.solve import PoseEstimate
from asterism.server.segmentation import background
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.helpers import shared

START_NS = 1_795_398_896_000_000_000
SMALLER = 30
NO_SPOTS = Spots(np.empty(0), np.empty(0), np.empty(0), np.empty(0, int))


def record(folder: Path, rig: Rig, images: list[NDArray[np.uint8]]) -> list[dict[str, object]]:
    """Record windows; returns the answers of the whole frames."""
    recorder = Recorder(folder, rig, "test", FramesKept(spots=True), wait=True)
    tracks, answers = Tracks.none(), []
    for index, image in enumerate(images):
        frame = Frame(image, START_NS + index * 16_666_667, index)
        result, tracks = localize(frame, rig, tracks)
        messages = [stamped(m, frame.exposed_ns) for m in report(frame, result, rig, frame.exposed_ns)]
        recorder.write(messages, image, frame.exposed_ns, index)
        answers.append(dict(result.answers))
    recorder.close({})
    return answers


def off_sigmas(was: PoseEstimate, now: PoseEstimate) -> float:
    """The largest difference of a component of a pose, in its sigma."""
    turned = now.pose.rotation @ was.pose.rotation.T
    turn = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    off = np.concatenate([now.pose.position - was.pose.position, turn])
    if not off[:3].any() and np.abs(turn).max() < 1e-15:
        return 0.0
    return float((np.abs(off) / np.sqrt(np.diag(was.covariance))).max())


def farthest(rig: Rig, recording: Recording, before: list[dict[str, object]]) -> float:
    """The largest difference of a component of a pose from before, in its own sigma, solved again from windows."""
    tracks, worst = Tracks.none(), 0.0
    for image, exposed_ns, index in recording.frames():
        result, tracks = localize(Frame(image, exposed_ns, index), rig, tracks)
        for robot, answer in result.answers.items():
            was = before[index][robot]
            assert isinstance(was, PoseEstimate) == isinstance(answer, PoseEstimate)
            if isinstance(was, PoseEstimate) and isinstance(answer, PoseEstimate):
                worst = max(worst, off_sigmas(was, answer))
    return worst


def test_windows_are_solved_as_the_whole_frames_and_are_much_smaller(tmp_path: Path) -> None:
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig, 3)
    images = [scene.render(index, scene.truth(index, index / 60)) for index in range(30)]
    before = record(tmp_path, rig, images)
    (folder,) = tmp_path.iterdir()
    size = sum(file.stat().st_size for file in folder.glob("frames-*"))
    assert size < sum(image.nbytes for image in images) / SMALLER
    assert farthest(rig, Recording(folder), before) < 0.1


# Clutter has a hundred lights on a sloping background; of a few frames, the text of twenty robots counts too.
@pytest.mark.parametrize(
    ("sample", "smaller"), [("clutter", 14), ("ghosts", 30), ("fleet", 25), ("dim", 30), ("occluded", 30), ("film", 30)]
)
def test_in_clutter_and_in_the_dark_as_well(tmp_path: Path, sample: str, smaller: int) -> None:
    rig = load_rig(shared("samples", sample, "rig.yaml"))
    files = sorted(shared("samples", sample, "frames").iterdir())
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    before = record(tmp_path, rig, images)  # type: ignore[arg-type]
    (folder,) = tmp_path.iterdir()
    size = sum(file.stat().st_size for file in folder.glob("frames-*"))
    assert size < sum(image.nbytes for image in images) / smaller  # type: ignore[union-attr]
    assert farthest(rig, Recording(folder), before) < 0.1


@pytest.mark.parametrize(("height", "width"), [(1024, 1280), (480, 640), (97, 301), (20, 30), (40, 2000)])
def test_the_background_that_is_told_is_that_of_the_image(height: int, width: int, rng: np.random.Generator) -> None:
    image = np.clip(rng.normal(9.0, 2.0, (height, width)) + np.linspace(0.0, 30.0, width), 0, 255).astype(np.uint8)
    told = SpotWindows(height, width).keep(image, NO_SPOTS)
    level, noise = background.background_of(image)
    level_told, noise_told = background.background_of(told)
    np.testing.assert_allclose(level_told, level, atol=0.5)
    np.testing.assert_allclose(noise_told, noise, rtol=0.02, atol=0.02)
    # What is plain is above no threshold: nothing is found where nothing was.
    assert np.all(told <= image.max())


def test_the_background_follows_the_light(rng: np.random.Generator) -> None:
    image = rng.normal(9.0, 2.0, (256, 256)).round().astype(np.uint8)
    windows = SpotWindows(256, 256)
    before = windows.keep(image, NO_SPOTS).copy()
    np.testing.assert_array_equal(windows.keep(image, NO_SPOTS), before)
    brighter = image + np.uint8(np.ceil(CHANGED) + 10)
    assert windows.keep(brighter, NO_SPOTS).mean() > before.mean() + 9.0
    assert REFRESH > 1


@pytest.mark.parametrize(("height", "width"), [(1024, 1280), (600, 803)])
def test_dots_tell_tiles_about_spots_as_their_pixels_do(height: int, width: int, rng: np.random.Generator) -> None:
    image = np.clip(rng.normal(9.0, 2.0, (height, width)) + np.linspace(0.0, 15.0, width), 0, 255).astype(np.uint8)
    windows = SpotWindows(height, width)
    windows.keep(image, NO_SPOTS)
    # Spots everywhere, so that dots are drawn; the light has become another, a little, since the background was drawn.
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(70.0, width, 100.0), np.arange(50.0, height, 90.0)))
    x, y = np.append(x, width - 1.0), np.append(y, height - 1.0)
    now = rng.permutation(image, axis=0)
    now = np.clip(now * 1.02 + rng.normal(0.0, 0.8, now.shape), 0, 255).astype(np.uint8)
    told = windows.keep(now, Spots(x, y, np.full(len(x), 3.0), np.ones(len(x), int)))
    level, noise = background.background_of(now)
    level_told, noise_told = background.background_of(told)
    np.testing.assert_array_equal(level_told, level)
    np.testing.assert_allclose(noise_told, noise, rtol=0.003)
    assert np.count_nonzero(told == now) < 0.5 * now.size
