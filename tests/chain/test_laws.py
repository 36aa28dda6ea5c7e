"""Laws of whole frames: what may happen to image, camera and rig together, and what must then happen to the poses.

Frames come from frames.py. Distances between two answers are Mahalanobis distances in the published covariance: 1 is
one sigma in one direction; two independent measurements of the same pose are sqrt(2 * 6) = 3.5 apart.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.constellation import confusions
from asterism.protocol.geometry import Floats, Pose, angle_between, log_rotation
from asterism.protocol.rig import Rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from tests.centres.rendering import Canvas
from tests.chain.frames import alone, draw, estimates, poses_apart, turned_camera, turned_image
from tests.rigs import make_camera, make_rig

FRAMES = 4
RIG = make_rig(6, seed=3)
NAMES = [robot.id for robot in RIG.robots]
# What is the same for the measurement is not for the tiles of the background, nor for the last step of a fit, which
# ends at 0.0003 px: a sixth of a sigma adds 1 % to an error. A verdict on a spot (does other light lean on it?) on its
# threshold may turn out otherwise: then the covariance says so, and it happens to few.
SAME, SAME_COVARIANCE, FEW = 0.15, 0.15, 0.1
TWO_VERDICTS = 3.0  # sigmas of both answers together
# What differs by the order of sums at most.
EQUAL = 1e-3


def distance(a: PoseEstimate, b: Pose, covariance: Floats | None = None) -> float:
    """Mahalanobis distance of two poses in the covariance (of ``a``, if none is given)."""
    off = np.concatenate([a.position - b.position, log_rotation(a.pose.rotation @ b.rotation.T)])
    return float(np.sqrt(off @ np.linalg.solve(a.covariance if covariance is None else covariance, off)))


@cache
def light(frame: int) -> tuple[dict[str, Pose], Canvas]:
    """Six robots, 15 to 45 degrees tilted: their poses, and their light before it is exposed."""
    rng = np.random.default_rng([frame, 20])
    poses = poses_apart(RIG, rng)
    return poses, draw(RIG, poses)


@cache
def shot(frame: int) -> tuple[NDArray[np.uint8], FrameResult]:
    """The frame exposed and located: every robot is found."""
    image = light(frame)[1].expose(np.random.default_rng([frame, 21]))
    result = alone(image, RIG)
    assert list(estimates(result)) == NAMES
    return image, result


def all_found(image: NDArray[np.uint8], rig: Rig) -> dict[str, PoseEstimate]:
    found = estimates(alone(image, rig))
    assert sorted(found) == sorted(robot.id for robot in rig.robots)
    return found


def same(answer: PoseEstimate, pose: Pose, covariance: Floats) -> bool:
    sigmas = np.sqrt(np.diag(covariance))
    off = np.abs(answer.covariance - covariance) / np.outer(sigmas, sigmas)
    return distance(answer, pose) < SAME and bool(off.max() < SAME_COVARIANCE)


def assert_same(pairs: list[tuple[PoseEstimate, Pose, Floats]]) -> None:
    """Every answer is the expected pose with the expected covariance."""
    others = 0
    for answer, pose, covariance in pairs:
        assert distance(answer, pose, answer.covariance + covariance) < TWO_VERDICTS
        others += not same(answer, pose, covariance)
    assert len(pairs) == FRAMES * len(NAMES)
    assert others <= FEW * len(pairs)


@pytest.mark.parametrize("shift", [(8, 0), (0, 64), (3, -5), (-17, 11)])
def test_shifting_image_and_principal_point_changes_no_pose(shift: tuple[int, int]) -> None:
    matrix = RIG.camera.matrix.copy()
    matrix[:2, 2] += shift
    rig = replace(RIG, camera=replace(RIG.camera, matrix=matrix))
    pairs = []
    for frame in range(FRAMES):
        image, before = shot(frame)
        found = all_found(np.roll(image, shift[::-1], axis=(0, 1)), rig)
        pairs += [(found[name], answer.pose, answer.covariance) for name, answer in estimates(before).items()]
    assert_same(pairs)


TURNS = {
    "90": np.array([[0, -1], [1, 0]]),
    "180": np.array([[-1, 0], [0, -1]]),
    "270": np.array([[0, 1], [-1, 0]]),
}
MIRRORS = {
    "left-right": np.array([[-1, 0], [0, 1]]),
    "up-down": np.array([[1, 0], [0, -1]]),
    "transposed": np.array([[0, 1], [1, 0]]),
}


def test_turned_cameras_project_to_turned_pixels(rng: np.random.Generator) -> None:
    # The tests' own tools first: a pixel of the old image is the same light as its place in the turned one.
    points = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 1.6], (20, 3))
    image = rng.integers(0, 255, (RIG.camera.height, RIG.camera.width)).astype(np.uint8)
    for turn in [*TURNS.values(), *MIRRORS.values()]:
        camera, moved = turned_camera(RIG.camera, turn), turned_image(image, turn)
        assert moved.shape == (camera.height, camera.width)
        before = RIG.camera.project(points)
        after = camera.project(np.column_stack([points[:, :2] @ turn.T, points[:, 2]]))
        far = np.where(turn.sum(axis=1) < 0, [camera.width - 1, camera.height - 1], 0)
        np.testing.assert_allclose(after, before @ turn.T + far, atol=1e-9)
        for x, y in ((0, 0), (17, 5), (1279, 1023)):
            u, v = turn @ [x, y] + far
            assert moved[v, u] == image[y, x]


@pytest.mark.parametrize("turn", TURNS)
def test_turning_image_and_camera_turns_the_poses(turn: str) -> None:
    matrix = TURNS[turn]
    rig = replace(RIG, camera=turned_camera(RIG.camera, matrix))
    rotation = np.eye(3)
    rotation[:2, :2] = matrix
    both = np.kron(np.eye(2), rotation)
    pairs = []
    for frame in range(FRAMES):
        image, before = shot(frame)
        found = all_found(turned_image(image, matrix), rig)
        for name, answer in estimates(before).items():
            expected = Pose.from_matrix(rotation @ answer.pose.rotation, rotation @ answer.position)
            pairs.append((found[name], expected, both @ answer.covariance @ both.T))
    assert_same(pairs)


def mirrored_rig(rig: Rig) -> Rig:
    """The same robots as a mirror shows them: x of every LED the other way."""
    robots = tuple(replace(robot, leds=robot.leds * [-1.0, 1.0, 1.0]) for robot in rig.robots)
    return replace(rig, robots=robots)


@pytest.mark.parametrize("mirror", MIRRORS)
def test_a_mirrored_image_shows_no_robot_of_the_rig(mirror: str) -> None:
    # None of these constellations is its own or another's mirror image, even if one LED is missing.
    mirrored = [robot.leds_plane[:, :2] for robot in mirrored_rig(RIG).robots]
    layouts = [robot.leds_plane[:, :2] for robot in RIG.robots]
    nearest = min(
        c.separation
        for c in confusions([*layouts, *mirrored], hidden=1)
        if (c.seen < len(layouts)) != (c.taken < len(layouts))
    )
    assert nearest > 0.3e-3  # 0.3 px, thirty times the centres' noise
    matrix = MIRRORS[mirror]
    rig = replace(RIG, camera=turned_camera(RIG.camera, matrix))
    for frame in range(FRAMES):
        assert estimates(alone(turned_image(shot(frame)[0], matrix), rig)) == {}, frame


@pytest.mark.parametrize("mirror", MIRRORS)
def test_a_mirrored_image_shows_the_mirrored_robots(mirror: str) -> None:
    # The robots are there and can be seen: what keeps them from being found above is that they are mirrored.
    matrix = MIRRORS[mirror]
    rig = mirrored_rig(replace(RIG, camera=turned_camera(RIG.camera, matrix)))
    reflection = np.eye(3)
    reflection[:2, :2] = matrix
    both = np.kron(np.diag([1.0, -1.0]), reflection)  # rotation vectors are axial: a mirror turns them the other way
    pairs = []
    for frame in range(FRAMES):
        image, before = shot(frame)
        found = all_found(turned_image(image, matrix), rig)
        for name, answer in estimates(before).items():
            rotation = reflection @ answer.pose.rotation @ np.diag([-1.0, 1.0, 1.0])
            expected = Pose.from_matrix(rotation, reflection @ answer.position)
            pairs.append((found[name], expected, both @ answer.covariance @ both.T))
    assert_same(pairs)


def test_a_world_twice_as_large_gives_the_same_image_and_poses_twice_as_far() -> None:
    robots = tuple(
        replace(robot, leds=2 * robot.leds, led_radius=2 * robot.led_radius if robot.led_radius else None)
        for robot in RIG.robots
    )
    assert RIG.range_m is not None
    rig = replace(RIG, robots=robots, range_m=(2 * RIG.range_m[0], 2 * RIG.range_m[1]))
    by = np.kron(np.array([[4.0, 2.0], [2.0, 1.0]]), np.ones((3, 3)))  # rotations stay what they are
    for frame in range(FRAMES):
        image, before = shot(frame)
        found = all_found(image, rig)
        for name, answer in estimates(before).items():
            expected = Pose(2 * answer.position, answer.orientation)
            assert distance(found[name], expected) < EQUAL, (frame, name)
            np.testing.assert_allclose(found[name].covariance, by * answer.covariance, rtol=1e-3, atol=1e-12)
            assert found[name].spots == answer.spots


def test_other_brightness_gives_the_same_robots_within_their_covariance() -> None:
    squares = []
    for frame in range(FRAMES):
        _, before = shot(frame)
        poses, _ = light(frame)
        dimmer = draw(RIG, poses, level=0.7 * 180.0)
        found = all_found(dimmer.expose(np.random.default_rng([frame, 22])), RIG)
        for name, answer in estimates(before).items():
            assert found[name].leds == answer.leds
            squares.append(distance(answer, found[name].pose, answer.covariance + found[name].covariance) ** 2)
    # Chi squared of six degrees of freedom each: 24 robots have a mean of 6 with a sigma of 0.7.
    assert 3.5 < np.mean(squares) < 8.8
    assert max(squares) < 33.0  # one in 100 000


def test_ten_grey_levels_of_stray_light_change_nothing() -> None:
    for frame in range(FRAMES):
        image, before = shot(frame)
        assert image.max() < 245
        found = all_found(image + np.uint8(10), RIG)
        for name, answer in estimates(before).items():
            assert distance(answer, found[name].pose) < EQUAL, (frame, name)
            np.testing.assert_allclose(found[name].covariance, answer.covariance, rtol=1e-3, atol=1e-14)


def test_leds_listed_in_another_order_get_other_numbers_and_the_same_pose(rng: np.random.Generator) -> None:
    orders = {name: rng.permutation(6) for name in NAMES}
    rig = replace(RIG, robots=tuple(replace(robot, leds=robot.leds[orders[robot.id]]) for robot in RIG.robots))
    for frame in range(FRAMES):
        image, before = shot(frame)
        found = all_found(image, rig)
        for name, answer in estimates(before).items():
            assert distance(answer, found[name].pose) < EQUAL
            spot_of = dict(zip(answer.leds, answer.spots, strict=True))
            told = {int(orders[name][led]): spot for led, spot in zip(found[name].leds, found[name].spots, strict=True)}
            assert told == spot_of


def test_names_order_and_robots_elsewhere_do_not_matter(rng: np.random.Generator) -> None:
    others = make_rig(10, seed=3)
    assert [robot.id for robot in others.robots[:6]] == NAMES
    for mine, theirs in zip(RIG.robots, others.robots, strict=False):
        np.testing.assert_array_equal(mine.leds, theirs.leds)
    order = rng.permutation(10)
    renamed = tuple(replace(others.robots[k], id=f"z{97 - k}") for k in order)
    rig = replace(RIG, robots=renamed)
    for frame in range(FRAMES):
        image, before = shot(frame)
        result = alone(image, rig)
        assert list(result.answers) == [robot.id for robot in renamed]
        found = estimates(result)
        assert len(found) == 6
        for k, name in enumerate(NAMES):
            answer, other = before.answers[name], found[f"z{97 - k}"]
            assert isinstance(answer, PoseEstimate)
            assert (other.leds, other.spots) == (answer.leds, answer.spots)
            assert distance(answer, other.pose) < EQUAL
            np.testing.assert_allclose(other.covariance, answer.covariance, rtol=1e-3, atol=1e-14)


def test_twice_the_noise_is_four_times_the_covariance() -> None:
    # Read and shot noise both; the image is drawn so dark that rounding, 1/12, is little beside them.
    ratios = []
    for frame in range(FRAMES):
        poses, _ = light(frame)
        canvas = draw(RIG, poses, level=110.0)
        quiet, loud = (
            all_found(canvas.expose(np.random.default_rng([frame, 23]), read=factor * 1.5, gain=factor**2 * 0.03), RIG)
            for factor in (1.0, 2.0)
        )
        ratios += [np.trace(loud[name].covariance) / np.trace(quiet[name].covariance) for name in NAMES]
    assert 3.2 < np.median(ratios) < 4.8


def test_squared_errors_weighted_by_the_covariance_average_six() -> None:
    # One robot at a time in a small image. Tilted by 15 degrees or more: below, errors of the tilt are no Gaussians.
    rig = make_rig(4, seed=5, camera=make_camera(480, 400))
    squares = []
    for k in range(240):
        rng = np.random.default_rng([k, 24])
        name = rig.robots[k % 4].id
        poses = poses_apart(rig, rng, [name], depth_m=(0.9, 1.6), tilt_deg=(15.0, 50.0))
        answer = alone(draw(rig, poses).expose(rng), rig).answers[name]
        assert isinstance(answer, PoseEstimate), (k, answer)
        squares.append(distance(answer, poses[name]) ** 2)
    # 240 times chi squared of six degrees of freedom: a mean of 6 with a sigma of 0.22. The rest of the band is what
    # estimating each frame's noise from the frame itself may cost.
    assert 5.0 < np.mean(squares) < 7.2


def bits(result: FrameResult) -> list[bytes]:
    """All numbers of a result."""
    blobs = result.blobs
    told = [
        blobs.centres_px,
        blobs.covariances_px2,
        blobs.heights,
        blobs.radii_px,
        blobs.fates,
        blobs.robots,
        blobs.leds,
    ]
    for answer in result.answers.values():
        assert isinstance(answer, PoseEstimate)
        told += [answer.position, answer.orientation, answer.covariance, answer.residuals_px, np.array(answer.spots)]
        if answer.alternative is not None:
            told += [answer.alternative.position, answer.alternative.orientation, np.array(answer.alternative.odds)]
    return [np.asarray(values).tobytes() for values in told]


def test_what_was_located_before_leaves_no_trace(rng: np.random.Generator) -> None:
    texture = rng.integers(0, 256, (1024, 1280)).astype(np.uint8)
    crowded = Canvas.of(1024, 1280)
    for x, y in rng.uniform(10, 1000, (150, 2)):
        crowded.ellipse(x, y, 4.0)
    for frame in range(FRAMES):
        image, before = shot(frame)
        for between in (texture, crowded.expose(rng), np.full((1024, 1280), 255, np.uint8)):
            alone(between, RIG)
        assert bits(alone(image, RIG)) == bits(before)


def test_several_threads_get_the_same_bits() -> None:
    shots = [shot(k % FRAMES) for k in range(24)]
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda shot: alone(shot[0], RIG), shots))
    for (_, expected), result in zip(shots, results, strict=True):
        assert bits(result) == bits(expected)


def test_a_rig_made_again_gives_the_same_bits() -> None:
    image, before = shot(0)
    assert bits(localize(Frame(image, exposed_ns=1, index=0), replace(RIG), Tracks.none())[0]) == bits(before)


def test_the_alternative_is_another_pose() -> None:
    rig = make_rig(4, seed=5, camera=make_camera(480, 400))
    for k in range(60):
        rng = np.random.default_rng([k, 24])
        name = rig.robots[k % 4].id
        poses = poses_apart(rig, rng, [name], depth_m=(0.9, 1.6), tilt_deg=(0.0, 6.0))
        answer = alone(draw(rig, poses).expose(rng), rig).answers[name]
        assert isinstance(answer, PoseEstimate)
        if answer.alternative is not None:
            assert angle_between(answer.pose.rotation, answer.alternative.pose.rotation) > np.radians(0.1)
