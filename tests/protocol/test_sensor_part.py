"""Calibrations for a part of the sensor: rays stay what they are, and what is ambiguous is not guessed."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.sensor_part import binning_of, part_of, whole_of
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.rigs import make_camera


def test_a_part_sees_every_ray_where_it_lies_in_it(rng: np.random.Generator) -> None:
    """The edges of pixels are the same places: of 2x2 joined ones the outer."""
    whole, offset = make_camera(), (208, 96)
    part = part_of(whole, offset, (400, 300), (2, 2))
    points = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), rng.uniform(0.8, 2.0, 50)])
    np.testing.assert_allclose((part.project(points) + 0.5) * 2 + offset, whole.project(points) + 0.5, atol=1e-9)
    np.testing.assert_allclose(whole_of(part.matrix, offset, (2, 2)), whole.matrix, atol=1e-9)


def test_sizes_tell_by_how_much_they_would_be_binned() -> None:
    whole = (1280, 1024)
    assert [binning_of(whole, size) for size in [(640, 512), (320, 256), (640, 480), (1280, 1024), (427, 341)]] == [
        *(2, 4),
        *(None, None, None),
    ]


def rig_with(tmp_path: Path, capture: str) -> Rig:
    """The demo's rig, 1280x1024 calibrated, with another `capture`."""
    (tmp_path / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    lines = [line for line in DEMO_RIG.read_text().splitlines() if not line.startswith("capture:")]
    (tmp_path / "rig.yaml").write_text("\n".join([*lines, f"capture: {capture}"]) + "\n")
    return load_rig(tmp_path / "rig.yaml")


@pytest.mark.parametrize(
    ("capture", "size", "centre"),
    [
        ("{}", (1280, 1024), (0, 0)),
        ("{size: [1280, 1024]}", (1280, 1024), (0, 0)),
        # What was calibrated is the region itself.
        ("{size: [1280, 1024], offset: [320, 200]}", (1280, 1024), (0, 0)),
        ("{size: [640, 512], offset: [320, 256]}", (640, 512), (-320, -256)),
        ("{binning: 2}", (640, 512), None),
        ("{binning: 2, size: [640, 512]}", (640, 512), None),
        ("{binning: 2, size: [320, 256], offset: [100, 50]}", (320, 256), None),
    ],
)
def test_the_rig_says_what_images_show(
    tmp_path: Path, capture: str, size: tuple[int, int], centre: tuple[int, int] | None
) -> None:
    whole = load_rig(DEMO_RIG).camera
    rig = rig_with(tmp_path, capture)
    assert (rig.camera.width, rig.camera.height) == size
    if centre is not None:
        np.testing.assert_allclose(rig.camera.matrix[:2, 2], whole.matrix[:2, 2] + centre)
    else:
        assert rig.camera.focal_px == pytest.approx(whole.focal_px / 2)


@pytest.mark.parametrize(
    ("capture", "words"),
    [
        ("{size: [640, 512]}", "is that binned, or a region? For pixels that are joined say binning: 2, for a region"),
        (
            "{size: [800, 600]}",
            r"say where that is, for a region, offset: [x, y] (in the middle it would be [240, 212])",
        ),
        ("{size: [2560, 2048]}", "expected at most that; calibrate the camera for it"),
        ("{size: [640, 512], offset: [700, 0]}", "640x512 px from (700, 0) on lead beyond the 1280x1024 px"),
        ("{binning: 2, size: [800, 600], offset: [0, 0]}", "800x600 px, binned 2x2, from (0, 0) on lead beyond"),
        ("{binning: 2, size: [320, 256]}", "say where that is"),
        ("{binning: 99}", "capture.binning: 99, expected a whole number from 1 to 16"),
        ("{roi: [0, 0]}", "unknown key 'roi'; did you mean 'offset'?"),
    ],
)
def test_what_may_mean_two_things_is_refused_with_what_to_write(tmp_path: Path, capture: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        rig_with(tmp_path, capture)
    assert words in str(caught.value)
