"""`locate --bits N`: images of 12 bits in 16 say what the same ones of 8 bits say."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene


@pytest.fixture(scope="module")
def images() -> list[NDArray[np.uint8]]:
    """Three frames, the first of which shows nothing bright."""
    scene = Scene(load_rig(DEMO_RIG), 0)
    frames = [scene.render(k, scene.truth(k, k / 60)) for k in range(3)]
    return [np.minimum(frames[0], 40).astype(np.uint8), *frames[1:]]


def located(folder: Path, images: list[NDArray[Any]], *words: str) -> list[dict[str, Any]]:
    (folder / "frames").mkdir(parents=True)
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / "frames" / f"{k}.png"), image)
    out = folder / "out.jsonl"
    assert main(["locate", str(DEMO_RIG), str(folder / "frames"), "-o", str(out), *words]) == 0
    return [json.loads(line) for line in out.read_text().splitlines()]


def test_twelve_bits_in_sixteen_are_read_as_said(tmp_path: Path, images: list[NDArray[np.uint8]]) -> None:
    twelve = [image.astype(np.uint16) << 4 for image in images]
    # The first is so dark that it looks like one of 10 bits.
    assert twelve[0].max() < 1 << 10
    told = located(tmp_path / "12", twelve, "--bits", "12")
    assert told == located(tmp_path / "8", list(images))
    assert len(told[1]["robots"]) == 5


def test_without_it_a_brighter_image_is_asked_about(
    tmp_path: Path, images: list[NDArray[np.uint8]], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "frames").mkdir()
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / "frames" / f"{k}.png"), image.astype(np.uint16) << 4)
    out = str(tmp_path / "out.jsonl")
    assert main(["locate", str(DEMO_RIG), str(tmp_path / "frames"), "-o", out]) == 2
    told = capsys.readouterr().err
    assert "taken for a camera of 10 bits; if that is wrong, say locate --bits N" in told
    assert "more than the 10 bits that the first image showed; say how many there are: locate --bits N" in told


@pytest.mark.parametrize("text", ["7", "17", "twelve", "-12", "12.0", ""])
def test_bits_that_no_camera_has_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["locate", str(DEMO_RIG), "frames", "-o", "-", f"--bits={text}"])
    assert "expected a number of bits, 8 to 16" in capsys.readouterr().err
