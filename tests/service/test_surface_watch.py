"""A surface that is not where the rig has it is said within ten frames, when robots agree; a lifted one is no cause."""

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.solve import Lost, OnSurface, PoseEstimate
from asterism.server.service.surface_watch import SurfaceWatch
from tests.on_surface import BENT, places, rig_on, stood

LIGHT_M, LIGHT_RAD = 2e-4, 1e-3  # one sigma of what light alone says
NO_BLOBS = cast(Blobs, None)  # nobody looks at them
STAND_M, STAND_RAD = 5e-5, np.radians(0.05)


def film(
    rig: Rig, truth: Callable[[int, int], Pose], frames: int, rng: np.random.Generator, begin: int = 0
) -> list[FrameResult]:
    """What light alone says of robots that stand so, ``truth`` by frame and robot, against the rig's surface."""
    assert rig.surface is not None
    results = []
    for index in range(begin, begin + frames):
        answers: dict[str, PoseEstimate | Lost] = {}
        for k, robot in enumerate(rig.robots):
            pose = truth(index, k)
            turn = exp_rotation(np.array([*rng.normal(0.0, LIGHT_RAD, 2), 0.0]))
            seen = Pose.from_matrix(
                turn @ pose.rotation, pose.position + rng.normal(0.0, LIGHT_M) * np.array([0.0, 0.0, 1.0])
            )
            touch = rig.surface.touch(seen.map(robot.points["tool"])[None])
            tilt = float(np.arccos(min(touch.normals[0] @ seen.rotation[:, 2], 1.0)))
            off = OnSurface(
                "ON_SURFACE", "", float(touch.distances[0]), float(np.hypot(LIGHT_M, STAND_M)), tilt,
                float(np.hypot(LIGHT_RAD, STAND_RAD)), seen, np.eye(6),
            )  # fmt: skip
            nothing = np.zeros((0, 2))
            answers[robot.id] = PoseEstimate(
                seen.position, seen.orientation, np.eye(6), (), (), nothing, 0.0, None, surface=off
            )
        time_ns = (index + 1) * 16_666_667
        results.append(FrameResult(index, time_ns, NO_BLOBS, answers, np.zeros(len(rig.robots))))
    return results


def standing(rig: Rig, rng: np.random.Generator, lift: Callable[[int, int], float]) -> Callable[[int, int], Pose]:
    """Robots that drive on BENT, each lifted by so much in a frame."""
    at = places(rng, len(rig.robots))

    def truth(index: int, k: int) -> Pose:
        x, y, heading = at[k]
        return stood(BENT, x + 1e-3 * index, y, heading, lift(index, k))

    return truth


def said_in(watch: SurfaceWatch, words: list[str], results: list[FrameResult]) -> int:
    """The frame in which something is said, counted from 1; 0 where nothing is."""
    for number, result in enumerate(results, start=1):
        watch.add(result)
        if words:
            return number
    return 0


def moved(rig: Rig, by: Pose) -> Rig:
    assert rig.surface is not None
    return replace(rig, surface=replace(rig.surface, T_world_surface=by))


def lifted_by(height_m: float) -> Pose:
    return Pose(np.array([0.0, 0.0, height_m]), np.array([0.0, 0.0, 0.0, 1.0]))


@pytest.mark.parametrize("robots", [1, 5])
@pytest.mark.parametrize(("by", "what"), [(lifted_by(1e-3), "lower"), (lifted_by(-1e-3), "higher")])
def test_a_surface_that_is_wrong_by_a_millimetre_is_said_within_ten_frames(
    robots: int, by: Pose, what: str, rng: np.random.Generator
) -> None:
    words: list[str] = []
    rig = moved(rig_on(robots=robots), by)
    watch = SurfaceWatch(rig, words.append)
    assert 0 < said_in(watch, words, film(rig, standing(rig, rng, lambda *_: 0.0), 12, rng)) <= 10
    assert f" mm {what}" in words[0]
    assert "calibrate surface RIG SOURCE, or check `surface`" in words[0]
    assert what in watch.problem


def test_a_surface_that_is_turned_is_said_with_its_angle(rng: np.random.Generator) -> None:
    words: list[str] = []
    rig = moved(rig_on(), Pose.from_matrix(exp_rotation(np.radians([0.5, 0.0, 0.0])), np.zeros(3)))
    assert (
        0
        < said_in(SurfaceWatch(rig, words.append), words, film(rig, standing(rig, rng, lambda *_: 0.0), 12, rng))
        <= 10
    )
    angle = float(words[0].partition("turned by ")[2].split()[0])
    assert angle == pytest.approx(0.5, abs=0.06)


def test_nothing_is_said_of_a_good_surface_nor_of_robots_that_are_lifted(rng: np.random.Generator) -> None:
    words: list[str] = []
    rig = rig_on()
    heights = {1: 2e-3, 3: 0.03}  # two of five, at another height each
    truth = standing(rig, rng, lambda index, k: heights.get(k, 0.0) if index > 40 else 0.0)
    assert said_in(SurfaceWatch(rig, words.append), words, film(rig, truth, 90, rng)) == 0
    alone = rig_on(robots=1)
    truth = standing(alone, rng, lambda index, _: 2e-3 if index > 40 else 0.0)
    assert said_in(SurfaceWatch(alone, words.append), words, film(alone, truth, 60, rng)) == 0


@pytest.mark.parametrize("robots", [2, 3])
@pytest.mark.parametrize("lift_m", [3e-4, 1e-3])
def test_one_robot_that_is_lifted_is_no_surface_that_is_wrong(
    robots: int, lift_m: float, rng: np.random.Generator
) -> None:
    words: list[str] = []
    rig = rig_on(robots=robots)
    truth = standing(rig, rng, lambda index, k: lift_m if k == 0 and 15 <= index < 40 else 0.0)
    assert said_in(SurfaceWatch(rig, words.append), words, film(rig, truth, 70, rng)) == 0, words


def test_what_robots_have_in_common_is_known_no_better_than_the_rig_says(rng: np.random.Generator) -> None:
    """Half a millimetre is much against the light of many frames, and nothing against a surface known to 0.4 mm."""
    rig = rig_on()
    assert rig.surface is not None
    for sigma_m, says in ((0.0, True), (4e-4, False)):
        words: list[str] = []
        told = moved(replace(rig, surface=replace(rig.surface, sigma_m=sigma_m)), lifted_by(5e-4))
        results = film(told, standing(told, rng, lambda *_: 0.0), 20, rng)
        for result in results:
            for answer in result.answers.values():
                assert isinstance(answer, PoseEstimate)
                object.__setattr__(answer.surface, "off_sigma_m", float(np.sqrt(LIGHT_M**2 + STAND_M**2 + sigma_m**2)))
        assert bool(said_in(SurfaceWatch(told, words.append), words, results)) is says


def test_it_is_taken_back_when_the_surface_is_right_again(rng: np.random.Generator) -> None:
    words: list[str] = []
    rig = rig_on()
    truth = standing(rig, rng, lambda index, _: 1e-3 if index < 20 else 0.0)
    watch = SurfaceWatch(rig, words.append)
    for result in film(rig, truth, 80, rng):
        watch.add(result)
    assert len(words) == 2
    assert words[1].startswith("no longer: ")
    assert watch.problem == ""


def test_a_rig_without_a_surface_is_not_watched() -> None:
    rig = replace(rig_on(), surface=None)
    assert not SurfaceWatch(rig, print).watches


def test_errors_that_stay_do_not_average(rng: np.random.Generator) -> None:
    """One robot whose light is wrong by two of its sigmas all the time says nothing, in however many frames."""
    words: list[str] = []
    rig = rig_on(robots=1)
    off: Floats = np.array([2.0 * LIGHT_M])
    truth = standing(rig, rng, lambda *_: float(off[0]))
    quiet = np.random.default_rng(1)
    steady = [replace(result) for result in film(rig, truth, 60, quiet)]
    for result in steady:
        for answer in result.answers.values():
            assert isinstance(answer, PoseEstimate)
            object.__setattr__(answer.surface, "off_m", float(off[0]))
    assert said_in(SurfaceWatch(rig, words.append), words, steady) == 0
