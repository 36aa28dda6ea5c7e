"""Compressed pictures are told from what sensors make; and no other light is looked for in them."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.server.centres.compression import is_compressed
from tests.centres.rendering import Canvas
from tests.chain.frames import alone, draw, estimates, poses_apart
from tests.rigs import make_rig


def jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


@pytest.mark.parametrize("read", [0.5, 1.2, 4.0])
@pytest.mark.parametrize("background", [0.0, 3.0, 40.0])
def test_no_sensor_is_taken_for_compression(rng: np.random.Generator, read: float, background: float) -> None:
    image = Canvas.of(400, 600, background=background).ellipse(300, 200, 4.0).expose(rng, read=read)
    assert not is_compressed(image)


@pytest.mark.parametrize("quality", [40, 60])
def test_hard_compression_is_told(rng: np.random.Generator, quality: int) -> None:
    image = Canvas.of(400, 600, slope=(0.02, 0.01)).ellipse(300, 200, 4.0).expose(rng)
    assert is_compressed(jpeg(image, quality))
    # A film's decoder may leave the background at zero.
    assert is_compressed(np.maximum(jpeg(image, quality), 20) - np.uint8(20))


def test_an_overexposed_image_is_no_compressed_one() -> None:
    assert not is_compressed(np.full((400, 600), 255, np.uint8))


def test_poses_from_hard_compressed_pictures_own_up(rng: np.random.Generator) -> None:
    rig = make_rig(4, seed=3)
    for quality in (60, 40):
        poses = poses_apart(rig, rng)
        found = estimates(alone(jpeg(draw(rig, poses).expose(rng), quality), rig))
        assert len(found) >= 3
        for name, answer in found.items():
            off = answer.position - poses[name].position
            assert off @ np.linalg.solve(answer.covariance[:3, :3], off) < 30.0
