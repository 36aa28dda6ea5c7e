"""Commands on files of other programs: what the same images give from a folder, with the times of the bag."""

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.camera import load_camera
from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.calibration.lens.boards import Lens, chessboard, poses, render
from tests.sources.foreign.foreign_files import ros_image, ros_text, write_bag2, write_mcap

BEGAN_NS, STEP_NS, FRAMES = 1_700_000_000_000_000_001, 16_666_667, 3


def bag(path: Path, images: list[NDArray[np.uint8]], topic: str = "/cam/image") -> Path:
    """A rosbag2 folder with the images on one of two image topics, and talk."""
    messages: list[tuple[str, int, Any]] = [("/chatter", BEGAN_NS, ros_text("hello"))]
    for k, image in enumerate(images):
        at_ns = BEGAN_NS + k * STEP_NS
        messages += [("/preview", at_ns, ros_image(image[::4, ::4].copy(), at_ns))]
        messages += [(topic, at_ns + 9_000_000, ros_image(image, at_ns))]
    return write_bag2(path, messages, "mcap")


def folder(path: Path, images: list[NDArray[np.uint8]]) -> Path:
    path.mkdir()
    for k, image in enumerate(images):
        cv2.imwrite(str(path / f"{k:06d}.png"), image)
    return path


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_poses_are_those_of_the_same_images_in_a_folder(tmp_path: Path) -> None:
    scene = Scene(load_rig(DEMO_RIG), 4)
    images = [scene.render(k, scene.truth(k, k / 60.0)) for k in range(FRAMES)]
    film, plain = bag(tmp_path / "bag", images), folder(tmp_path / "frames", images)
    for source, out in ((film, "a.jsonl"), (plain, "b.jsonl")):
        topic = ["--topic", "/cam/image"] if source is film else []
        words = ["locate", str(DEMO_RIG), str(source), *topic, "-o", str(tmp_path / out), "--independent"]
        assert main(words) == 0
    found, expected = lines_of(tmp_path / "a.jsonl"), lines_of(tmp_path / "b.jsonl")
    assert [line["exposed_ns"] for line in found] == [BEGAN_NS + k * STEP_NS for k in range(FRAMES)]
    assert [line["robots"] for line in found] == [line["robots"] for line in expected]
    assert len(found[0]["robots"]) == 5


def test_a_camera_is_calibrated_from_a_bag(tmp_path: Path, rng: np.random.Generator) -> None:
    printed, box = chessboard(9, 6, 0.025)
    lens, out = Lens(), tmp_path / "cam.yaml"
    middle = np.array([0.1, 0.0625, 0.0])
    views = [render(lens, pose, printed, box, rng) for pose in poses(rng, 12, middle, lens, 0.5, 0.35, 0.7, 0.6)]
    words = [str(bag(tmp_path / "bag", views)), "--topic", "/cam/image", "--target", "chessboard:9x6:0.025"]
    assert main(["calibrate", "camera", *words, "--model", "plumb_bob", "-o", str(out)]) == 0
    found = load_camera(out).matrix
    assert np.abs(found[[0, 1], [0, 1]] - lens.focal).max() < 3.0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["bag"], "several topics with images; choose by --topic: /cam/image (sensor_msgs/Image), /preview"),
        (["bag", "--topic", "/chatter"], "topic /chatter is std_msgs/String (cdr), expected images: foxglove.RawImage"),
        (["bag", "--topic", "/cam/imag"], "has no topic /cam/imag; it has /cam/image"),
        (["talk.mcap"], "has no topic with images"),
        (["frames", "--topic", "/cam/image"], "--topic /cam/image: frames has no topics"),
    ],
)
def test_wrong_topics_are_refused_in_a_sentence(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    sentence: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    image = np.zeros((1024, 1280), np.uint8)
    bag(tmp_path / "bag", [image])
    folder(tmp_path / "frames", [image])
    write_mcap(tmp_path / "talk.mcap", [("/chatter", 1, ros_text("a"))])
    assert main(["locate", str(DEMO_RIG), *words, "-o", "out.jsonl"]) == 2
    told = capsys.readouterr().err
    assert sentence in told
    assert told.count("\n") == 1


def test_without_the_extra_it_is_said_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag2(tmp_path / "bag", [("/i", 1, ros_image(np.zeros((4, 4), np.uint8), 1))])
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert main(["locate", str(DEMO_RIG), str(path), "-o", str(tmp_path / "out.jsonl")]) == 2
    told = capsys.readouterr().err
    assert "locate needs the module rosbags, which is not installed; install it with: pip install" in told
    assert "asterism-localization[ros]" in told
