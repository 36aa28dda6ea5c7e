"""rig.yaml: what is read, what is refused and in which words."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import rig, rig_hints
from asterism.protocol.errors import InputError
from asterism.protocol.rig import hidden_led_warnings, load_rig
from asterism.protocol.surface_file import STANDS_KEYS, SURFACE_KEYS
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import shared
from tests.protocol.test_camera import TEXT as CAMERA

RIG = """\
camera: camera.yaml
range: [0.8, 2.0]
masks: [[0, 0, 200, 80]]
centre: grey-square
capture: {rate: 60, exposure_us: 500, gain: 0, size: [1280, 1024], bits: 10}
world:
  position: [0.0, 0.0, 1.3]
  orientation: [1.0, 0.0, 0.0, 0.0]
robots:
  alpha:
    leds:
      - [0.050, 0.000, 0.012]
      - [0.021, 0.040, 0.012]
      - [-0.030, 0.035, 0.012]
      - [-0.045, -0.012, 0.012]
      - [-0.010, -0.047, 0.012]
      - [0.030, -0.022, 0.012]
    led: {radius: 0.0025, axis: [0, 0, 2]}
    points: {tool: [0.0, 0.0, -0.03]}
    normal: {world: [0, 0, 1], within_deg: 40}
  bravo:
    leds:
      - [0.045, 0.010, 0.0]
      - [0.000, 0.050, 0.0]
      - [-0.045, 0.005, 0.0]
      - [-0.020, -0.040, 0.0]
      - [0.005, -0.005, 0.0]
      - [0.035, -0.035, 0.0]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "camera.yaml").write_text(CAMERA)
    return tmp_path


def refusal(folder: Path, text: str) -> str:
    (folder / "rig.yaml").write_text(text)
    with pytest.raises(InputError, match="yaml") as caught:
        load_rig(folder / "rig.yaml")
    said = str(caught.value)
    assert "\n" not in said
    assert said.startswith(str(folder))
    return said


def test_everything_is_read(folder: Path) -> None:
    (folder / "rig.yaml").write_text(RIG)
    rig = load_rig(folder / "rig.yaml")
    alpha, bravo = rig.robots
    assert (alpha.id, bravo.id, rig.parent_frame) == ("alpha", "bravo", "world")
    assert (rig.range_m, rig.masks, rig.centre) == ((0.8, 2.0), ((0, 0, 200, 80),), "grey-square")
    assert (rig.capture.rate_hz, rig.capture.exposure_us, rig.capture.size) == (60, 500, (1280, 1024))
    assert rig.capture.bits == 10
    assert rig.capture.line_time_us == 0.0
    assert (alpha.led_radius, alpha.axis.tolist()) == (0.0025, [0, 0, 1])
    assert alpha.points["tool"].tolist() == [0, 0, -0.03]
    assert alpha.normal is not None
    assert alpha.normal.within_rad == pytest.approx(np.radians(40))
    assert (bravo.led_radius, bravo.normal, bravo.points) == (None, None, {})
    assert rig.rig_text == RIG
    assert rig.camera_text == CAMERA
    np.testing.assert_allclose(alpha.T_robot_plane.map(alpha.leds_plane), alpha.leds, atol=1e-12)


def test_the_cameras_stamp_and_what_stands_still_are_read(folder: Path) -> None:
    text = RIG.replace("bits: 10", "trigger: Line1, pixel_format: Mono12p, offset: [8, 16], stamp: end, delay_us: -40")
    text = text.replace("world:", "world:\n  follow: true", 1)
    still = "    fixed: {position: [0.4, 0.3, 0.0], orientation: [0, 0, 0, 1]}\n"
    (folder / "rig.yaml").write_text(text.replace("    points:", still + "    points:", 1))
    rig = load_rig(folder / "rig.yaml")
    capture = rig.capture
    assert (capture.trigger, capture.pixel_format, capture.offset) == ("Line1", "Mono12p", (8, 16))
    assert (capture.stamp, capture.stamp_given, capture.delay_us) == ("end", True, -40.0)
    alpha, bravo = rig.robots
    assert rig.follows_world
    assert alpha.T_world_fixed is not None
    assert alpha.T_world_fixed.position.tolist() == [0.4, 0.3, 0.0]
    assert bravo.T_world_fixed is None


def test_without_world_poses_are_in_the_cameras_frame(folder: Path) -> None:
    text = RIG[: RIG.index("world:")] + RIG[RIG.index("robots:") :].replace(
        "    normal: {world: [0, 0, 1], within_deg: 40}\n", ""
    )
    (folder / "rig.yaml").write_text(text)
    assert load_rig(folder / "rig.yaml").parent_frame == "cam"


LED = "      - [0.050, 0.000, 0.012]\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("range:", "rnage:", "unknown key 'rnage'; did you mean 'range'? Accepted: camera, range, masks"),
        ("    points:", "    pionts:", "robots.alpha: unknown key 'pionts'; did you mean 'points'?"),
        ("radius:", "raduis:", "robots.alpha.led: unknown key 'raduis'; did you mean 'radius'?"),
        (LED, "", "robots.alpha.leds: 5 positions, expected 6"),
        (LED, LED + "      - [0.0, 0.0, 0.012]\n", "robots.alpha.leds: 7 positions, expected 6"),
        (LED, "      - [0.050, 0.000, 0.022]\n", "mm off the common plane, expected coplanar LEDs"),
        (LED, "      - [0.050, 0.000]\n", "robots.alpha.leds[0]: 2 values, expected 3 numbers"),
        (LED, "      - [0.050, 0.000, zero]\n", "robots.alpha.leds[0]: 'zero' is among the values"),
        (LED, "      - [0.021, 0.0401, 0.012]\n", "LEDs 0 and 1 are 0.1 mm apart"),
        ("camera: camera.yaml", "camera: other.yaml", "camera: there is no file"),
        ("range: [0.8, 2.0]", "range: [2.0, 0.8]", "range: [2, 0.8], expected 0 < nearest < farthest"),
        ("[[0, 0, 200, 80]]", "[[0, 0, 2000, 80]]", "masks[0]: [0.0, 0.0, 2000.0, 80.0], expected whole numbers"),
        ("grey-square", "centroid", "centre: 'centroid', expected one of edge-model, grey-square"),
        ("rate: 60", "rate: 0", "capture.rate: 0, expected a number above 0"),
        ("bits: 10", "bits: 20", "capture.bits: 20, expected a whole number from 8 to 16"),
        ("bits: 10", "line_time_us: -1", "capture.line_time_us: -1, expected a number, 0 or more"),
        ("bits: 10", "line_time_us: fast", "capture.line_time_us: 'fast', expected a number, 0 or more"),
        (
            "bits: 10",
            "line_time_us: 14800",
            "capture.line_time_us: 14800, expected us from one row to the next, at most 1000; is that ns, or the time "
            "of all rows?",
        ),
        ("bits: 10", "delay_us: 2e9", "capture.delay_us: 2e+09, expected us from mid-exposure to the stamp"),
        ("bits: 10", "stamp: begin", "capture.stamp: 'begin', expected one of start, middle, end"),
        ("bits: 10", "offset: [8, -8]", "capture.offset: [8, -8], expected two whole numbers of px, at least 0"),
        ("world:", "world:\n  follow: 'yes'", "world.follow: 'yes', expected true or false"),
        (
            "    points:",
            "    fixed: {position: [0.4, 0.3, 0.0]}\n    points:",
            "robots.alpha.fixed.orientation: is missing",
        ),
        ("[1.0, 0.0, 0.0, 0.0]", "[1.0, 0.0, 0.0, 1.0]", "world.orientation: a quaternion of length 1.41421"),
        ("axis: [0, 0, 2]", "axis: [0, 0, 0]", "robots.alpha.led.axis: [0, 0, 0] has no direction"),
        ("axis: [0, 0, 2]", "axis: [1, 0, 0]", "expected led.axis to point out of it"),
        ("radius: 0.0025", "radius: 2.5", "robots.alpha.led.radius: 2.5, expected m, at most a quarter"),
        ("radius: 0.0025", "radius: 2.5", "is that mm? For example 0.0025"),
        ("within_deg: 40", "within_deg: 400", "robots.alpha.normal.within_deg: 400, expected at most 180"),
        ("  bravo:", "  bra/vo:", "the robot's id 'bra/vo' holds '/'"),
        ("  bravo:", "  '*':", "the robot's id '*' holds '*'"),
        ("  bravo:", "  '':", "the robot's id '' is empty"),
        ("  bravo:", "  7:", "robots: key 7 is no text, expected text; put it in quotes"),
        ("  bravo:", "  alpha:", "key 'alpha' is given twice"),
        ("robots:", "robots: []\nrobot:", "unknown key 'robot'; did you mean 'robots'?"),
    ],
)
def test_a_wrong_rig_is_refused_in_one_sentence(folder: Path, old: str, new: str, words: str) -> None:
    assert old in RIG
    assert words in refusal(folder, RIG.replace(old, new, 1))


def test_no_robots_and_no_mapping_are_refused(folder: Path) -> None:
    assert "robots: is empty, expected at least one robot" in refusal(folder, "camera: camera.yaml\nrobots: {}\n")
    assert "robots: is missing, expected a mapping" in refusal(folder, "camera: camera.yaml\n")
    assert "expected a mapping of keys" in refusal(folder, "- a\n- b\n")


def test_a_normal_needs_the_world(folder: Path) -> None:
    text = RIG[: RIG.index("world:")] + RIG[RIG.index("robots:") :]
    assert "robots.alpha.normal: needs the rig's `world`" in refusal(folder, text)


@pytest.mark.parametrize(
    ("metres", "millimetres", "words"),
    [
        (LED[8:-1], "[50.0, 0.0, 12.0]", "m apart, expected at most 5 m; is that mm? Expected m, for example "),
        (LED[8:-1], "[50.0, 0.0, 12.0]", "[0.05, 0, 0.012]"),
        ("[0.8, 2.0]", "[800, 2000]", "range: [800, 2000], expected at most 100 m each; is that mm? Expected m, for "),
        ("[0.8, 2.0]", "[800, 2000]", "for example [0.8, 2]"),
        ("[0.0, 0.0, 1.3]", "[0, 0, 1300]", "world.position: [0, 0, 1300], expected at most 100 m each; is that mm?"),
        ("[0.0, 0.0, 1.3]", "[0, -1300, 20]", "is that mm? Expected m, for example [0, -1.3, 0.02]"),
        ("[0.0, 0.0, -0.03]", "[0, 0, -30]", "robots.alpha.points.tool: 30.012 m from the LEDs, expected at most 100"),
        ("[0.0, 0.0, -0.03]", "[0, 0, -30]", "is that mm? Expected m, for example [0, 0, -0.03]"),
    ],
)
def test_millimetres_instead_of_metres_are_noticed(folder: Path, metres: str, millimetres: str, words: str) -> None:
    assert metres in RIG
    assert words in refusal(folder, RIG.replace(metres, millimetres, 1))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[0.8, 2.0]", "[15.0, 25.0]"),  # high up under a hall's roof
        ("[0.8, 2.0]", "[0.02, 0.05]"),  # under a microscope
        ("[0.0, 0.0, 1.3]", "[85.0, -40.0, 18.0]"),  # in a long hall's own frame
        ("[0.0, 0.0, -0.03]", "[2.5, 0.0, -1.0]"),  # at the end of a long arm
    ],
)
def test_large_and_small_rigs_that_are_right_are_read(folder: Path, old: str, new: str) -> None:
    assert old in RIG
    (folder / "rig.yaml").write_text(RIG.replace(old, new, 1))
    assert len(load_rig(folder / "rig.yaml").robots) == 2


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0.0, 0.0, 1.3]", "[0.0, 0.0, 1e300]", "1e+300 (beyond 1e+30) is among the values, expected 3 numbers"),
        ("[0.8, 2.0]", "[" * 101 + "]" * 101, "is nested too deeply, expected a YAML mapping of a few levels"),
        ("camera:", "intrinsics:", "unknown key 'intrinsics'; did you mean 'camera'? Accepted: camera, range"),
        ("camera:", "calibration:", "did you mean 'camera'?"),
        ("world:", "extrinsics:", "unknown key 'extrinsics'; did you mean 'world'?"),
        ("world:", "T_world_camera:", "did you mean 'world'?"),
        ("  position:", "  translation:", "world: unknown key 'translation'; did you mean 'position'?"),
        ("  orientation:", "  quaternion:", "world: unknown key 'quaternion'; did you mean 'orientation'?"),
        ("    leds:", "    led_positions:", "robots.alpha: unknown key 'led_positions'; did you mean 'leds'?"),
        ("    leds:", "    positions:", "robots.alpha: unknown key 'positions'; did you mean 'leds'?"),
        ("    leds:", "    LED-positions:", "did you mean 'leds'?"),
        ("    leds:", "    LEDs:", "did you mean 'leds'?"),
        ("    leds:", "    markers:", "did you mean 'leds'?"),
        ("    leds:", "    constellation:", "did you mean 'leds'?"),
        ("    points:", "    led_radius: 0.0025\n    points:", "did you mean 'led.radius'?"),
        ("capture:", "exposure_us: 500\ncapture:", "unknown key 'exposure_us'; did you mean 'capture.exposure_us'?"),
        ("rate: 60", "fps: 60", "capture: unknown key 'fps'; did you mean 'rate'?"),
        ("bits: 10", "line_time: 15", "capture: unknown key 'line_time'; did you mean 'line_time_us'?"),
        ("    points:", "    colour: red\n    points:", "unknown key 'colour'; Accepted: leds, led, points, normal"),
    ],
)
def test_other_words_for_a_key_are_understood(folder: Path, old: str, new: str, words: str) -> None:
    assert old in RIG
    assert words in refusal(folder, RIG.replace(old, new, 1))


CAPTURE_KEYS = ("rate", "exposure_us", "gain", "bits", "size", "line_time_us", "offset", "pixel_format")
CAPTURE_KEYS += ("trigger", "stamp", "delay_us", "binning")


def test_every_word_stands_for_a_key_that_is_accepted() -> None:
    accepted = {
        "RIG_WORDS": {*rig.RIG_KEYS, *(f"capture.{key}" for key in CAPTURE_KEYS)},
        "CAPTURE_WORDS": set(CAPTURE_KEYS),
        "WORLD_WORDS": {"position", "orientation"},
        "ROBOT_WORDS": {"leds", "points", "normal", "led.radius", "led.axis", "led.offset", "stands"},
        "LED_WORDS": {"radius", "axis"},
        "NORMAL_WORDS": {"world", "within_deg"},
        "SURFACE_WORDS": {*SURFACE_KEYS, "frame.position", "frame.orientation"},
        "STANDS_WORDS": set(STANDS_KEYS),
    }
    for name, keys in accepted.items():
        words = getattr(rig_hints, name)
        assert set(words.values()) <= keys, name
        assert not set(words) & keys, name


def robots_text(*layouts: np.ndarray) -> str:
    lines = ["camera: camera.yaml", "robots:"]
    for number, layout in enumerate(layouts):
        lines += [f"  r{number}:", "    leds:", *(f"      - [{x:.9f}, {y:.9f}, 0.0]" for x, y in layout)]
    return "\n".join(lines) + "\n"


def test_two_robots_of_equal_constellation_are_refused_however_turned_and_ordered(
    folder: Path, rng: np.random.Generator
) -> None:
    from tests.rigs import random_layout

    layout = random_layout(rng)
    turn = np.array([[0.28, -0.96], [0.96, 0.28]])
    said = refusal(folder, robots_text(layout, layout[[4, 2, 0, 5, 1, 3]] @ turn.T))
    assert "r0 and r1 have equal constellations" in said or "r1 and r0 have equal constellations" in said


def test_a_symmetric_constellation_is_refused(folder: Path) -> None:
    angles = np.radians(np.arange(6) * 60.0)
    hexagon = 0.05 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert "r0.leds: the constellation looks the same turned" in refusal(folder, robots_text(hexagon))


def test_leds_on_a_line_are_refused(folder: Path) -> None:
    line = np.column_stack([np.linspace(-0.05, 0.05, 6) ** 3 * 400 + np.linspace(-0.05, 0.05, 6), np.zeros(6)])
    assert "the LEDs lie on one line" in refusal(folder, robots_text(line))


def test_robots_alike_with_one_led_hidden_are_warned_of_not_refused(folder: Path, rng: np.random.Generator) -> None:
    from tests.rigs import random_layout

    layout = random_layout(rng)
    other = layout.copy()
    other[2] = -layout[2] * 0.9 + 0.01
    (folder / "rig.yaml").write_text(robots_text(layout, other))
    warnings = hidden_led_warnings(load_rig(folder / "rig.yaml"))
    assert any("with one LED hidden r0 and r1 look alike" in warning for warning in warnings)


def test_the_demonstrations_rig_is_good() -> None:
    rig = load_rig(DEMO_RIG)
    assert [robot.id for robot in rig.robots] == ["alpha", "bravo", "charlie", "delta", "echo"]
    assert hidden_led_warnings(rig) == []


def test_the_sample_rigs_are_read() -> None:
    for path in sorted(shared("samples").glob("*/rig.yaml")):
        assert load_rig(path).robots
