"""What is said where no robot is found: from counts, and from frames in which one thing is wrong."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame, Tracks, localize
from asterism.server.service.advice import REJECTED, Wider, advice
from asterism.server.service.adviser import AFTER_S, Adviser
from asterism.server.service.tally import Seen, Tally
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene
from tests.rigs import make_rig

RIG = load_rig(DEMO_RIG)
RANGE_M = (0.8, 2.0)

Image = NDArray[np.uint8]


class Clock:
    """Time that passes when it is told to."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def picture(look: Look | None = None) -> Image:
    scene = Scene(RIG, 0, look)
    return scene.render(0, scene.truth(0, 0.0))


@pytest.fixture(scope="module")
def image() -> Image:
    return picture()


def told(image: Image, rig: Rig, frames: int = 2) -> list[str]:
    """What a run over some frames of the same image says at its end."""
    tally = Tally(robot.id for robot in rig.robots)
    for index in range(frames):
        frame = Frame(np.ascontiguousarray(image), index, index)
        tally.add(frame, localize(frame, rig, Tracks.none())[0])
    return Adviser(rig, tally, lambda _: None).last()


@pytest.mark.parametrize(
    ("spots", "brightest", "saturated", "words"),
    [
        ({}, 12.0, 0.0, "the image is dark (its brightest pixel 12 of 255): are the LEDs on"),
        ({"TOO_FAINT": 3.0}, 30.0, 0.0, "the image is dark"),
        ({}, 255.0, 0.6, "60% of the image is saturated: expose for a shorter time"),
        ({"UNEXPLAINED": 30.0}, 255.0, 0.2, "20% of the image is saturated"),
        ({}, 120.0, 0.0, "no spot looks like LEDs, a robot needs 4"),
        ({"UNEXPLAINED": 2.0}, 200.0, 0.0, "only 2.0 spots a frame look like LEDs, a robot needs 4"),
        ({"UNEXPLAINED": 12.0}, 200.0, 0.01, "12 spots a frame look like LEDs, but no robot of this rig fits them"),
        ({"UNEXPLAINED": 6.0, "TOO_SMALL": 90.0}, 200.0, 0.0, "6 spots a frame look like LEDs, but no robot"),
        ({"UNEXPLAINED": 6.0, "TOO_LARGE": 24.0}, 255.0, 0.01, "of 30 spots a frame 24 are TOO_LARGE, larger than"),
        *(({name: 8.0, "UNEXPLAINED": 1.0}, 200.0, 0.0, f"of 9 spots a frame 8 are {name}, ") for name in REJECTED),
    ],
)
def test_counts_become_a_sentence(spots: dict[str, float], brightest: float, saturated: float, words: str) -> None:
    assert words in advice(Seen(10, spots, brightest, saturated), (), RANGE_M)


@pytest.mark.parametrize(
    ("distance_m", "mirrored", "words"),
    [
        (1.2, True, "alpha is there as its mirror image"),
        (2.9, False, "alpha is there, 2.9 m away, but the rig's range is 0.8 to 2 m: change `range`"),
        (0.4, False, "alpha is there, 0.4 m away, but the rig's range is 0.8 to 2 m: change `range`"),
        (12.0, False, "alpha would be 12 m away, but the rig's range is 0.8 to 2 m: are its LEDs' positions right"),
        (0.12, False, "are its LEDs' positions right, and in m?"),
        (1300.0, False, "are its LEDs' positions in mm? Expected m"),
        (0.0013, False, "are its LEDs' positions in mm? Expected m"),
        (1.2, False, "its spots are not as large as `led.radius` says"),
    ],
)
def test_a_robot_that_the_rigs_limits_hide_is_told(distance_m: float, mirrored: bool, words: str) -> None:
    seen = Seen(10, {"UNEXPLAINED": 6.0}, 200.0, 0.0)
    assert words in advice(seen, [Wider("alpha", distance_m, mirrored)], RANGE_M)


def scaled(by: float) -> Rig:
    return replace(RIG, robots=tuple(replace(robot, leds=by * robot.leds) for robot in RIG.robots))


def test_what_is_wrong_with_frames_is_found_in_them(image: Image) -> None:
    far, near = replace(RIG, range_m=(2.5, 4.0)), replace(RIG, range_m=(0.2, 0.4))
    for shown, rig, words in (
        (np.zeros_like(image), RIG, "no robot was found: the image is dark (its brightest pixel 0 of 255)"),
        (np.full_like(image, 255), RIG, "100% of the image is saturated"),
        (image[:, ::-1], RIG, "as its mirror image"),
        (image, far, "alpha is there, 1.3 m away, but the rig's range is 2.5 to 4 m: change `range`"),
        (image, near, "m away, but the rig's range is 0.2 to 0.4 m: change `range`"),
        (image, scaled(10.0), "would be 13 m away"),
        (image, scaled(100.0), "are its LEDs' positions in mm? Expected m"),
        (cv2.blur(image, (1, 41)), RIG, "are ELONGATED, streaks: expose for a shorter time"),
        (image, make_rig(2, seed=9, camera=RIG.camera), "spots a frame look like LEDs, but no robot of this rig"),
    ):
        (sentence,) = told(shown, rig)  # type: ignore[arg-type]
        assert words in sentence


def test_of_robots_that_are_found_nothing_is_said(image: Image) -> None:
    assert told(image, RIG) == []
    assert told(picture(Look(psf_px=9.0, brightness=1500.0)), RIG) == []  # far out of focus, they are found as well


def test_a_robot_that_alone_is_never_found_is_told_where_it_fits(image: Image) -> None:
    alpha, *others = RIG.robots
    rig = replace(RIG, robots=(replace(alpha, leds=10.0 * alpha.leds, led_radius=None), *others))
    (sentence,) = told(image, rig)
    assert sentence.startswith("alpha would be 13 m away")
    # One that is not in the image is only counted.
    stranger = make_rig(1, seed=9, camera=RIG.camera).robots[0]
    assert told(image, replace(RIG, robots=(*others, stranger))) == []


def test_while_it_lasts_it_is_said_once_and_again_when_it_comes_back(image: Image) -> None:
    clock, said = Clock(), list[str]()
    tally = Tally((robot.id for robot in RIG.robots), clock)
    adviser = Adviser(RIG, tally, said.append)

    def frames(shown: Image, seconds: float) -> None:
        for index in range(round(seconds / 0.5)):
            frame = Frame(shown, index, index)
            tally.add(frame, localize(frame, RIG, Tracks.none())[0])
            clock.now += 0.5
            adviser.look()

    dark = np.zeros_like(image)
    frames(image, 2.0)
    frames(dark, AFTER_S - 1.0)
    assert said == []
    frames(dark, 3.0)
    assert len(said) == 1
    assert said[0].startswith("no robot is found: the image is dark")
    frames(dark, 10.0)
    frames(image, 1.0)
    assert len(said) == 1
    frames(dark, AFTER_S + 1.0)
    assert len(said) == 2


def test_a_tally_counts_states_and_keeps_the_most_frequent_reason(image: Image) -> None:
    clock = Clock()
    tally = Tally((robot.id for robot in RIG.robots), clock)
    for index, shown in enumerate((image, image, np.zeros_like(image))):
        frame = Frame(shown, index, index)
        tally.add(frame, localize(frame, RIG, Tracks.none())[0])
        clock.now += 0.25
    assert (tally.frames, tally.rate_hz(), set(tally.newest().values())) == (3, 3.0, {"LOST"})
    assert tally.lines()[0] == "alpha    2 TRACKED, 1 LOST: none of its LEDs is visible"
    assert tally.missing() == []
    clock.now += 5.0
    assert tally.rate_hz() == 0.0
