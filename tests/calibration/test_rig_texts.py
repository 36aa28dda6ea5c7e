"""Rigs that calibrations write, where the robots stand in a file that other rigs share."""

from pathlib import Path

import numpy as np

from asterism.protocol.rig import load_rig
from asterism.server.calibration.rig_texts import RigTexts, told_of
from tests.protocol.test_shared_robots import SHARED, folder

__all__ = ["folder"]
LEDS = [[0.051, 0, 0.012], [0.021, 0.041, 0.012], [-0.03, 0.035, 0.012], [-0.045, -0.012, 0.012],
        [-0.01, -0.047, 0.012], [0.03, -0.022, 0.012]]  # fmt: skip


def test_new_leds_go_into_a_file_of_the_new_rig_and_the_shared_one_stays(folder: Path) -> None:
    rig, place = load_rig(folder / "left.yaml"), ("robots", "alpha", "leds")
    before = (folder / "all/robots.yaml").read_text()
    (folder / "new").mkdir()
    texts = RigTexts.of(rig, folder / "left.yaml").rewritten({place: LEDS, ("range",): [1.0, 2.0]})
    texts = texts.annotated(place, "a test", ["moved"])
    texts.check(rig.camera_text, Path("there"))
    written = texts.write(folder / "new/rig2.yaml", force=False)
    assert [path.name for path, _ in written] == ["rig2.yaml", "rig2-robots.yaml"]
    found = load_rig(folder / "new/rig2.yaml")  # its relative paths lead to the same files
    np.testing.assert_array_equal(found.robot("alpha").leds, LEDS)
    np.testing.assert_array_equal(found.robot("bravo").leds, rig.robot("bravo").leds)
    assert found.robot("alpha").led_offset is not None
    assert (found.range_m, found.camera.name) == ((1.0, 2.0), rig.camera.name)
    assert "  # a test: moved\n  leds:" in (folder / "new/rig2-robots.yaml").read_text()
    assert (folder / "all/robots.yaml").read_text() == before
    assert told_of(written, rig)[1].endswith(
        "rig2-robots.yaml; other rigs with the robots of all/robots.yaml take them over with robots: rig2-robots.yaml"
    )


def test_a_rig_whose_robots_do_not_change_names_the_same_file(folder: Path) -> None:
    rig = load_rig(folder / "left.yaml")
    (folder / "new").mkdir()
    texts = RigTexts.of(rig, folder / "left.yaml").rewritten({("range",): [1.0, 2.0]})
    assert texts.write(folder / "new/rig2.yaml", force=False) == [(folder / "new/rig2.yaml", None)]
    found = load_rig(folder / "new/rig2.yaml")
    assert found.robots_name == "../all/robots.yaml"
    assert found.files[found.robots_name] == SHARED.replace("led: {", "led: {offset: glass/led.yaml, ", 1)
