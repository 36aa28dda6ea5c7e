"""Rewriting a rig: every character stays that nobody asked to change."""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from asterism.protocol.errors import InputError
from asterism.protocol.rig import parse_rig
from asterism.server.calibration.rewrite import annotate, relocate, rewrite, without
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.protocol.test_rig import RIG

LEDS = ("robots", "alpha", "leds")
NEW = [[0.051, 0.0001, 0.0125], *[[0.02, -0.03, 1e-5]] * 5]

COMMENTED = """\
# top
camera: camera.yaml      # the lens
range: [8.0e-1, 2]       # m
robots:
  # before alpha
  alpha:
    led: {radius: 0.00250}
    leds:    # drilled
      # a hole
      - [0.050, +0.000, 12e-3]   # first
      - - 0.021
        - 0.040   # y
        - 0.012
      - [-0.030, 0.035,
         0.012]
      - [-0.045, -0.012, 0.012]
      - [-0.010, -0.047, 0.012]
      - [0.030, -0.022, 0.012]   # last
    # after
# end
"""


def values(text: str) -> dict[str, object]:
    loaded: dict[str, object] = YAML(typ="safe", pure=True).load(text)
    return loaded


def test_numbers_change_in_their_places_and_nothing_else() -> None:
    new = rewrite(COMMENTED, {LEDS: NEW}, "rig.yaml")
    assert values(new)["robots"]["alpha"]["leds"] == NEW  # type: ignore[index]
    for word in ("# drilled", "# a hole", "# first", "# y", "# last", "# after", "# end", "8.0e-1, 2]       # m"):
        assert word in new
    old_lines, new_lines = COMMENTED.splitlines(), new.splitlines()
    assert len(old_lines) == len(new_lines)
    changed = [old for old, line in zip(old_lines, new_lines, strict=True) if old != line]
    assert all("0.0" in line or "12e-3" in line for line in changed)
    assert old_lines[:8] == new_lines[:8]


def test_what_is_not_there_is_added() -> None:
    world = {"position": [0.0, 0.5, 1.3], "orientation": [1.0, 0.0, 0.0, 0.0]}
    changes = {("world",): world, ("robots", "alpha", "led", "offset"): "led: 5.yaml"}
    new = rewrite(COMMENTED, changes, "rig.yaml")
    assert values(new)["world"] == world
    assert values(new)["robots"]["alpha"]["led"] == {"radius": 0.0025, "offset": "led: 5.yaml"}  # type: ignore[index]
    assert [line for line in new.splitlines() if line not in COMMENTED] == [
        "world: {position: [0.0, 0.5, 1.3], orientation: [1.0, 0.0, 0.0, 0.0]}",
        "    led: {radius: 0.00250, offset: 'led: 5.yaml'}",
    ]
    # A mapping that holds blocks only; a mapping that is missing as a whole; no newline at the end.
    text = "robots:\n  a:\n    leds:\n      - 1\n"
    assert values(rewrite(text, {("robots", "a", "led", "offset"): "x.yaml"}, ""))["robots"] == {
        "a": {"leds": [1], "led": {"offset": "x.yaml"}}
    }
    assert values(rewrite("camera: a.yaml", {("world",): {"x": 1.0}}, "")) == {"camera": "a.yaml", "world": {"x": 1.0}}


def test_a_world_that_is_there_is_changed_in_place() -> None:
    """Whatever the order of its keys."""
    swapped = RIG.replace(
        "  position: [0.0, 0.0, 1.3]\n  orientation: [1.0, 0.0, 0.0, 0.0]\n",
        "  orientation: [1.0, 0.0, 0.0, 0.0] # quat\n  position: [0.0, 0.0, 1.3] # m\n",
    )
    assert swapped != RIG
    world = {"position": [0.1, 0.2, 1.5], "orientation": [0.0, 1.0, 0.0, 0.0]}
    for text in (RIG, swapped):
        new = rewrite(text, {("world",): world}, "rig.yaml")
        assert values(new) == {**values(text), "world": world}
        assert new.count("#") == text.count("#")
        assert len(new.splitlines()) == len(text.splitlines())


def test_several_keys_may_be_added_and_blocks_of_another_shape_replaced() -> None:
    text = "a: {}\nb:\n  - 1\n  - x: 2\n    y: 3   # last\nc: 4\n"
    changes = {("a", "one"): 1.0, ("a", "two"): 2.0, ("d", "e"): 5.0, ("d", "f"): 6.0, ("b",): [7.0, 8.0, 9.0]}
    new = rewrite(text, changes, "")
    assert values(new) == {"a": {"one": 1, "two": 2}, "b": [7, 8, 9], "c": 4, "d": {"e": 5, "f": 6}}
    assert "   # last\n" in new


def test_small_numbers_are_written_out() -> None:
    assert "[0.0000121, -0.5]" in rewrite("a: [1, 2]", {("a",): [1.21e-5, -0.5]}, "")


def test_values_shared_by_an_anchor_are_refused() -> None:
    text = "robots:\n  a:\n    leds: &six [1, 2]\n  b:\n    leds: *six\n"
    with pytest.raises(InputError, match=r"rig\.yaml: robots\.b\.leds: is shared by an anchor"):
        rewrite(text, {("robots", "b", "leds"): [3.0, 4.0]}, "rig.yaml")


def test_paths_lead_to_the_same_files_from_elsewhere(tmp_path: Path) -> None:
    text = "camera: lens/camera.yaml  # here\nrobots:\n  a:\n    led: {offset: led.yaml}\n  b: {led: {radius: 1}}\n"
    old, new = tmp_path / "rigs" / "rig.yaml", tmp_path / "out" / "deep" / "rig.yaml"
    moved = relocate(text, old, new)
    assert moved == text.replace("lens/camera.yaml", "../../rigs/lens/camera.yaml").replace(
        "led.yaml", "../../rigs/led.yaml"
    )
    assert relocate(text, old, old.with_name("other.yaml")) == text
    absolute = text.replace("lens/", "/lens/").replace("led.yaml", "/led.yaml")
    assert relocate(absolute, old, new) == absolute


def test_the_demonstrations_rig_stays_a_rig() -> None:
    rig_text, camera_text = DEMO_RIG.read_text(), (DEMO_RIG.parent / "camera.yaml").read_text()
    before = parse_rig(rig_text, camera_text, "demo")
    leds = [row.round(6).tolist() for row in before.robot("bravo").leds + 1e-4]
    after = parse_rig(rewrite(rig_text, {("robots", "bravo", "leds"): leds}, "demo"), camera_text, "demo")
    assert (after.robot("bravo").leds == leds).all()
    assert (after.robot("alpha").leds == before.robot("alpha").leds).all()


def test_a_key_is_taken_out_with_its_block_and_nothing_else() -> None:
    head, tail = "# a rig\ncamera: c.yaml  # lens\n", "robots:   # all\n  a: {leds: [1]}\n"
    block = "z_correction:   # from a survey\n  kind: plane\n  spread:\n    - [1, 2]\n    - [3, 4]  # last\n"
    assert without(head + block + tail, "z_correction") == head + tail
    assert without(head + tail + block, "z_correction") == head + tail
    assert without(head + tail + block.rstrip("\n"), "z_correction") == head + tail
    assert without(head + tail, "z_correction") == head + tail
    assert without(head + "z_correction: {kind: plane}\n" + tail, "z_correction") == head + tail


def test_every_tag_has_its_own_lines_above_a_key() -> None:
    """And a person's lines stay, wherever among them they stand."""
    text = "a:\n  # mine\n  b: {c: 1, d: 2}\n"
    for _ in range(2):
        for tag, key in (("first", "c"), ("second", "d")):
            text = annotate(text, ("a", "b", key), tag, [f"of {key}"])
    assert text == "a:\n  # mine\n  # first: of c\n  # second: of d\n  b: {c: 1, d: 2}\n"
