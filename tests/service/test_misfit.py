"""What is said of robots that are found, but not where the rig has their LEDs: once, and what to run."""

from dataclasses import replace

import numpy as np

from asterism.protocol.rig import Rig
from asterism.server import Frame, Tracks, localize
from asterism.server.service.adviser import Adviser
from asterism.server.service.tally import Tally
from asterism.server.simulation.simulate import Scene
from tests.rigs import make_camera, make_rig

TRUE = make_rig(3, seed=9, camera=make_camera(960, 720))


def said(told: Rig, true: Rig = TRUE, frames: int = 8) -> list[str]:
    """What a run over a film says of a rig, in all."""
    rng = np.random.default_rng(3)
    scene, tally, words = Scene(true, 4), Tally(robot.id for robot in told.robots), list[str]()
    adviser = Adviser(told, tally, words.append)
    for index in range(frames):
        image = scene.render(index, scene.truth(index, float(rng.uniform(0, 30))))
        frame = Frame(image, 1 + index, index)
        tally.add(frame, localize(frame, told, Tracks.none())[0])
        adviser.look()
    last = [line for line in adviser.summary() if "off by" in line]
    assert not [line for line in adviser.summary() if "off by" in line], "said twice"
    return words + last


def test_nothing_is_said_of_a_good_rig() -> None:
    assert said(TRUE) == []


def test_one_bad_plate_is_named_with_what_to_run() -> None:
    leds = TRUE.robots[1].leds + 0.5e-3 * np.random.default_rng(8).normal(size=(6, 3)) * [1, 1, 0]
    told = replace(TRUE, robots=(TRUE.robots[0], replace(TRUE.robots[1], leds=leds), TRUE.robots[2]))
    (sentence,) = said(told)
    assert sentence.startswith("r01: its LEDs are off by 0.")
    assert " px from where the rig has them: run " in sentence
    assert "calibrate leds RIG RECORDING --robot r01 -o OUT" in sentence


def test_a_lens_that_is_not_told_is_named_once_for_all() -> None:
    wide = make_rig(3, seed=9, camera=make_camera(960, 720, 600.0), range_m=(0.35, 0.8))
    bent = replace(wide, camera=replace(wide.camera, distortion=np.array([-0.3, 0.05, 0.0, 0.0, 0.0])))
    straight = replace(wide, camera=replace(wide.camera, distortion=np.zeros(5)))
    (sentence,) = said(straight, bent)
    assert sentence.startswith("all robots' LEDs are off by")
    assert "calibrate camera" in sentence
