"""One scene, whole, binned and cropped: the same poses; and what was scaled is said."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.protocol.rig_files import report_path
from asterism.server.calibration.lens.camera_file import refit_report_text
from asterism.server.calibration.lens.lens_error import read_lens_error
from asterism.server.chain.pipeline import localize
from asterism.server.command.calibrate_z import refitted_text
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene

FRAMES = 2
Images = list[NDArray[np.uint8]]


@pytest.fixture(scope="module")
def film() -> Images:
    """The demo's robots, whole."""
    scene = Scene(load_rig(DEMO_RIG), 4)
    return [scene.render(k, scene.truth(k, k / 60.0)) for k in range(FRAMES)]


def binned(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pixels joined as a sensor does: 2x2 to one."""
    height, width = image.shape
    return (image.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3)) + 0.5).astype(np.uint8)


def poses(folder: Path, images: Images, rig: Rig) -> tuple[dict[str, PoseEstimate], list[str], Rig]:
    """The robots of the last image, what was said, and the rig that was taken."""
    folder.mkdir()
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f"{k}.png"), image)
    said: list[str] = []
    rig, source = open_fitting(str(folder), rig, said.append)
    for frame in source.frames():
        result, _ = localize(frame, rig, Tracks.none())
    return {name: found for name, found in result.answers.items() if isinstance(found, PoseEstimate)}, said, rig


def check(found: dict[str, PoseEstimate], whole: dict[str, PoseEstimate], least: int) -> None:
    """The same, as sure as both are."""
    assert len(found) >= least
    for robot, answer in found.items():
        off = answer.pose.position - whole[robot].pose.position
        sigmas = np.sqrt(np.diag(answer.covariance)[:3] + np.diag(whole[robot].covariance)[:3])
        assert (np.abs(off) < 5 * sigmas).all(), (robot, off, sigmas)
        # Off by half a pixel of the whole it would be 0.3 mm across.
        assert np.abs(off[:2]).max() < 1.5e-4


def test_binned_images_give_the_same_poses_and_it_is_said(tmp_path: Path, film: Images) -> None:
    rig = load_rig(DEMO_RIG)
    whole, said, same = poses(tmp_path / "whole", film, rig)
    assert (len(whole), said, same) == (5, [], rig)
    small = [binned(image) for image in film]
    found, said, fitted = poses(tmp_path / "small", small, rig)
    check(found, whole, 5)
    (sentence,) = said
    assert "images of 640x512 px, where 1280x1024 are calibrated: taken for binned 2x2, as if the rig" in sentence
    # What a recording keeps makes the same rig again.
    again = parse_rig(fitted.rig_text, fitted.camera_text, "recording", fitted.offset_texts)
    np.testing.assert_array_equal(again.camera.matrix, fitted.camera.matrix)
    told, said, _ = poses(tmp_path / "told", small, again)
    check(told, whole, 5)
    assert said == ["the calibration of 1280x1024 px was scaled to the images: 640x512 px, binned 2x2, from (0, 0) on"]


def test_cropped_images_give_the_same_poses_where_the_rig_says_where_they_are(tmp_path: Path, film: Images) -> None:
    rig = load_rig(DEMO_RIG)
    whole, _, _ = poses(tmp_path / "whole", film, rig)
    x, y, width, height = 90, 60, 1100, 900
    assert "capture: {rate: 60}" in rig.rig_text
    text = rig.rig_text.replace("{rate: 60}", f"{{size: [{width}, {height}], offset: [{x}, {y}]}}")
    cropped = [image[y : y + height, x : x + width] for image in film]
    found, said, _ = poses(tmp_path / "crop", cropped, parse_rig(text, rig.camera_text, "rig", rig.offset_texts))
    check(found, whole, 3)
    assert said == [
        "the calibration of 1280x1024 px was scaled to the images: 1100x900 px, binned 1x1, from (90, 60) on"
    ]


def test_other_sizes_and_masks_are_refused_with_what_to_write(tmp_path: Path, film: Images) -> None:
    rig = load_rig(DEMO_RIG)
    with pytest.raises(
        InputError, match=r"800x600, expected 1280x1024.*say capture: \{size: \[800, 600\], offset: \[x, y"
    ):
        poses(tmp_path / "a", [image[:600, :800] for image in film], rig)
    # Masks are in px of one of the two.
    with pytest.raises(InputError, match=r"640x512, .*say capture: \{binning: 2\} where pixels are joined, capture"):
        poses(tmp_path / "b", [binned(image) for image in film], replace(rig, masks=((0, 0, 10, 10),)))


def test_what_is_refitted_and_known_of_a_part_is_told_of_the_whole_and_back(tmp_path: Path) -> None:
    rig = load_rig(DEMO_RIG)
    text = rig.rig_text.replace("{rate: 60}", "{binning: 2, size: [500, 400], offset: [100, 60]}")
    part = parse_rig(text, rig.camera_text, "rig", rig.offset_texts, rig.files)
    matrix = part.camera.matrix + np.array([[0.7, 0.0, 0.2], [0.0, 0.6, -0.3], [0.0, 0.0, 0.0]])
    refitted = replace(part, camera=replace(part.camera, matrix=matrix))
    again = parse_rig(text, refitted_text(part, refitted), "rig", rig.offset_texts, rig.files)
    np.testing.assert_allclose(again.camera.matrix, matrix, atol=1e-4)
    # The report beside the camera's file is of the whole sensor.
    path, variances = tmp_path / "camera.yaml", np.arange(1.0, 5.0 + len(rig.camera.distortion))
    path.write_text(rig.camera_text)
    report_path(path).write_text(refit_report_text(rig.camera, np.diag(variances), "a film", 60))
    told = read_lens_error(path, part.camera)
    assert told is not None
    np.testing.assert_allclose(np.diag(told.covariance), [*variances[:4] / 4, *variances[4:]])
