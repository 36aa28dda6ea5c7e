"""What is said of drift: of the thing that is wrong, once, and taken back; nothing where nothing is."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.server import Frame, Tracks, localize
from asterism.server.service.alarm import GONE_AFTER, RAISED_AFTER, Alarm, Finding, step_of
from asterism.server.service.drift import Drift
from asterism.server.simulation.simulate import Look, Scene
from tests.measure.drawn_frames import Fault, Stage, stage_rig
from tests.rigs import make_camera, make_rig

AT_S = 100
FRAMES = 3  # a second


def watched(
    fault: Fault, robots: int, fixed: int, seconds: int = AT_S + 60, always: str = "drive"
) -> tuple[list[str], Drift]:
    """What is said while robots drive, and the watch."""
    stage, said, now = Stage(stage_rig(robots, fixed, 4), 4, fault, always), list[str](), 0.0
    drift = Drift(stage.told, said.append)
    for _ in range(seconds):
        for _ in range(FRAMES):
            now += 1.0 / FRAMES
            drift.add(stage.frame(now))
        drift.look()
    return said, drift


def tilt(deg: float) -> Floats:
    return np.radians(deg) * np.array([0.6, 0.8, 0.0])


def test_a_second_in_which_nobody_is_seen_is_looked_at_too() -> None:
    rig, said = make_rig(2, camera=make_camera(320, 240, 400.0)), list[str]()
    drift, dark = Drift(rig, said.append), np.zeros((240, 320), np.uint8)
    for second in range(3):
        drift.add(localize(Frame(dark, second * 1_000_000_000, second), rig, Tracks.none())[0])
        drift.look()
    assert (said, drift.problem) == ([], "")


@pytest.mark.parametrize(
    ("fault", "robots", "fixed", "expected"),
    [
        (Fault(AT_S, focal=5e-4), 0, 3, "the lens was touched: its focal length changed by +0.0"),
        (Fault(AT_S, turn=tilt(0.02)), 0, 3, "the camera was moved by "),
        (Fault(AT_S, turn=tilt(0.02)), 0, 1, "the camera, its lens or r00 was moved by "),
        (Fault(AT_S, fixed=1, fixed_moved=np.array([5e-4, 0.0, 0.0])), 0, 3, "r01, which the rig has as fixed, "),
        (Fault(AT_S, led=(0, 2), moved=np.array([8e-5, 6e-5, 0.0])), 1, 0, "r00: LED 2 is 0."),
        (Fault(AT_S, led=(0, 3), dark=True), 1, 0, "r00: LED 3 is not seen, since "),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_once_with_how_much_and_since_when(
    fault: Fault, robots: int, fixed: int, expected: str
) -> None:
    said, drift = watched(fault, robots, fixed)
    (sentence,) = said
    assert sentence.startswith(expected)
    began = datetime.strptime(sentence.split("since ")[1][:8], "%H:%M:%S")
    assert abs((began - datetime(1900, 1, 1, 1, 46, 40)).total_seconds() - AT_S) < 5.0  # frames begin at 10^9 s
    assert drift.problem.startswith(expected)


def test_nothing_is_said_of_robots_that_drive_stand_and_leave_under_a_camera_that_warms_up() -> None:
    said, drift = watched(Fault(), 2, 1, 400, "")
    assert said == []
    assert drift.problem == ""


def test_by_pixels_a_bent_led_is_said_and_nothing_before() -> None:
    rig = make_rig(1, seed=9, camera=make_camera(480, 360, 900.0), range_m=(0.6, 1.2))
    leds = rig.robots[0].leds.copy()
    leds[4] += [-9e-5, 9e-5, 0.0]
    bent = replace(rig, robots=(replace(rig.robots[0], leds=leds),))
    straight, crooked = (Scene(each, 5, Look(glints=1)) for each in (rig, bent))
    said: list[tuple[int, str]] = []
    second, tracks = 0, Tracks.none()
    drift = Drift(rig, lambda text: said.append((second, text)))
    for second in range(AT_S + 30):
        scene = straight if second < AT_S else crooked
        for index in (2 * second, 2 * second + 1):
            image = scene.render(index, scene.truth(index, 0.5 * index))
            result, tracks = localize(Frame(image, round(1e18 + 5e8 * index), index), rig, tracks)
            drift.add(result)
        drift.look()
    (when, sentence), *_ = said
    assert when > AT_S
    assert sentence.startswith("r00: LED 4 is 0.")
    assert drift.problem.startswith("r00: LED 4 is 0.1")


def test_a_camera_that_was_moved_while_nobody_served_is_said() -> None:
    said, drift = watched(Fault(-1.0, shift=np.array([8e-3, 0.0, 0.0])), 1, 2, 50)
    (sentence,) = said
    assert sentence.startswith("what is fixed is seen elsewhere than the rig has it: r00 ")
    assert "calibrate world RIG SOURCE --fixed" in sentence
    assert drift.problem


def test_a_camera_that_moves_where_nothing_is_fixed_cannot_be_told() -> None:
    said, _ = watched(Fault(AT_S, turn=tilt(0.02), focal=5e-4), 1, 0)
    assert said == []


def test_another_rig_keeps_what_was_seen_of_robots_that_are_the_same() -> None:
    _, drift = watched(Fault(AT_S, led=(0, 2), moved=np.array([1e-4, 0.0, 0.0])), 1, 0)
    rig = stage_rig(1, 0, 4)
    stage = Stage(rig, 4)
    assert drift.problem
    assert drift.with_rig(stage.told).problem == drift.problem  # drawn from the same seed: the same rig
    assert drift.with_rig(rig).problem == ""  # its LEDs were measured anew


def test_an_alarm_needs_looks_one_after_the_other_and_goes_likewise() -> None:
    said: list[str] = []
    alarm, wrong = Alarm(), Finding("a", "a is off by 1", "mend it", 3_600_000_000_000)
    for _ in range(3):
        for _ in range(RAISED_AFTER - 1):
            alarm.look(wrong, said.append)
        alarm.look(None, said.append)
    assert said == []
    for _ in range(RAISED_AFTER):
        alarm.look(wrong, said.append)
    alarm.look(wrong._replace(text="a is off by 2", since_ns=0), said.append)
    assert alarm.problem == "a is off by 2, since 01:00:00 UTC"
    for _ in range(GONE_AFTER):
        alarm.look(None, said.append)
    assert said == [
        "a is off by 1, since 01:00:00 UTC; mend it", "no longer: a is off by 2, since 01:00:00 UTC",
    ]  # fmt: skip
    assert alarm.problem == ""


@pytest.mark.parametrize("at", [0, 1, 13, 29])
def test_a_step_is_found_where_it_is(rng: np.random.Generator, at: int) -> None:
    shares = (np.arange(30) >= at) + 0.1 * rng.normal(size=30)
    assert step_of(shares.tolist()) == at
