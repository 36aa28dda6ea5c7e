"""Streams of frames for `tests.measure.doctor`: rigs and light of several kinds, and faults staged in them."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import Camera
from asterism.protocol.capture import Capture
from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig, Robot, load_rig
from asterism.server import Frame
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.hand_film import hand_pose
from asterism.server.simulation.measured_rig import draw_rig
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.rigs import make_camera, make_rig, random_layouts

Image = NDArray[np.uint8]
RATE_HZ = 60.0
START_NS = 1_700_000_000_000_000_000
STAMP_SIGMA_S = 30e-6  # of a healthy camera's stamps
CALIBRATED_M = 3e-6  # of LEDs after `calibrate leds`
CALIBRATED_F = 2e-4  # of the focal length after `calibrate camera`
LONGER = 5  # times
COMPRESSED, QUALITY = 7, 90  # every so many streams come as JPEG
FLOOR_M = 1.3  # of fixed constellations below the camera


@dataclass(frozen=True)
class Stream:
    """``true`` is what is rendered, ``told`` what the doctor is given; the rest is what befalls frames and stamps."""

    true: Rig
    told: Rig
    look: Look
    seed: int
    brush: Callable[[Image, int], Image]
    dimmed: dict[tuple[int, int], float] = field(default_factory=dict)
    stamp_sigma_s: float = STAMP_SIGMA_S
    dropped: float = 0.0
    by_hand: bool = False  # the first robot alone, from all sides, for LONGER
    age_days: float = 30.0

    def frames(self, count: int) -> Iterator[Frame]:
        """So many, by a camera's clock."""
        count *= LONGER if self.by_hand else 1
        scene, rng = Scene(self.true, self.seed, self.look), np.random.default_rng([self.seed, 11])
        for (robot, led), share in self.dimmed.items():
            scene.led_brightness[robot, led] = share
        gone = rng.choice(np.arange(1, count - 1), math.ceil(self.dropped * count), replace=False)
        for index in range(count):
            if index in gone:
                continue
            time_s = index / RATE_HZ
            truth = shown(scene, index, count) if self.by_hand else placed(scene, index, time_s)
            image = self.brush(scene.render(index, truth), index)
            stamp_ns = START_NS + round(1e9 * (time_s + self.stamp_sigma_s * rng.normal()))
            yield Frame(image, stamp_ns, index, f"{index:06d}", stamp_ns, Clock.CAMERA, 1)


def placed(scene: Scene, index: int, time_s: float) -> list[Truth]:
    """Where the robots are, those that do not move where the rig has them."""
    rig = scene.rig
    T_camera_world = (rig.T_world_camera or Pose.identity()).inverse()
    return [
        replace(told, T_camera_robot=T_camera_world @ robot.T_world_fixed, after=None) if robot.T_world_fixed else told
        for told, robot in zip(scene.truth(index, time_s), rig.robots, strict=True)
    ]


def shown(scene: Scene, index: int, count: int) -> list[Truth]:
    """The first robot, held before the camera."""
    robot = scene.rig.robots[0]
    return [Truth(robot.id, hand_pose(scene.rig, robot, index, count, scene.seed), (True,) * 6)]


def rig_of(seed: int) -> Rig:
    """One of five kinds: the demo's, many robots near and far, one robot, a long lens, one with what stands still."""
    kind = seed % 5
    if kind == 0:
        rig = load_rig(DEMO_RIG)
    elif kind == 1:
        rig = make_rig(6, seed, range_m=(1.4, 2.2))
    elif kind == 2:
        rig = draw_rig(seed).true
    elif kind == 3:
        rig = make_rig(3, seed, make_camera(focal_px=2200.0), range_m=(1.2, 2.0))
    else:
        rig = standing(seed)
    return replace(rig, capture=Capture(rate_hz=RATE_HZ))


def standing(seed: int) -> Rig:
    """Two robots that drive, and two constellations on the floor that do not, under a camera in a world."""
    T_world_camera = Pose(np.array([0.0, 0.0, FLOOR_M]), np.array([1.0, 0.0, 0.0, 0.0]))
    rig = make_rig(2, seed, make_camera(), range_m=(1.0, 1.6), T_world_camera=T_world_camera)
    fixed = []
    for k, layout in enumerate(random_layouts(12, seed + 100)[10:]):
        place = Pose(np.array([(-0.42, 0.42)[k], (0.3, -0.3)[k], 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
        leds = np.column_stack([layout, np.zeros(6)])
        fixed.append(Robot(f"base{k}", leds, led_radius=0.0025, T_world_fixed=place))
    return replace(rig, robots=(*rig.robots, *fixed))


def look_of(seed: int) -> Look:
    """Light of several kinds, all of them healthy."""
    rng = np.random.default_rng([seed, 12])
    return Look(
        psf_px=float(rng.uniform(0.55, 1.0)),
        brightness=float(rng.uniform(110.0, 215.0)),
        background=float(rng.uniform(3.0, 25.0)),
        read_noise=float(rng.uniform(0.7, 2.0)),
        gain=float(rng.uniform(0.015, 0.05)),
        hidden=float(rng.choice([0.0, 0.0, 0.02])),
        glints=int(rng.choice([0, 0, 3])),
    )


def healthy(seed: int) -> Stream:
    """A rig as well calibrated as ours are, in good light."""
    true, rng = rig_of(seed), np.random.default_rng([seed, 13])
    told = replace(
        true,
        camera=with_focal(true.camera, 1.0 + CALIBRATED_F * rng.normal()),
        robots=tuple(replace(robot, leds=robot.leds + CALIBRATED_M * rng.normal(size=(6, 3))) for robot in true.robots),
    )
    return Stream(true, told, look_of(seed), seed, _compressed if seed % COMPRESSED == 3 else _as_it_is)


def _as_it_is(image: Image, _: int) -> Image:
    return image


def _compressed(image: Image, _: int) -> Image:
    """As cameras on a slow link send it."""
    packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)


def with_focal(camera: Camera, share: float) -> Camera:
    """The same camera with another focal length."""
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= share
    return Camera(camera.name, camera.width, camera.height, matrix, camera.model, camera.distortion)


def _defocused(stream: Stream, blur_px: float) -> Stream:
    return replace(stream, look=replace(stream.look, psf_px=blur_px))


def _exposed(stream: Stream, brightness: float) -> Stream:
    return replace(stream, look=replace(stream.look, brightness=brightness))


def _half_saturated(stream: Stream, share: float) -> Stream:
    def brush(image: Image, _: int) -> Image:
        image[:, : round(share * image.shape[1])] = 255
        return image

    return replace(stream, brush=brush)


def _hot(stream: Stream, count: float) -> Stream:
    rng = np.random.default_rng([stream.seed, 14])
    camera = stream.true.camera
    x, y = rng.integers(0, camera.width, int(count)), rng.integers(0, camera.height, int(count))
    levels = rng.uniform(50.0, 250.0, int(count))

    def brush(image: Image, index: int) -> Image:
        noisy = levels + 3.0 * np.random.default_rng([stream.seed, 15, index]).normal(size=len(levels))
        image[y, x] = np.clip(noisy, image[y, x], 255).astype(np.uint8)
        return image

    return replace(stream, brush=brush)


def _cluttered(stream: Stream, glints: float) -> Stream:
    return replace(stream, look=replace(stream.look, glints=int(glints)))


def _wrong_rig(stream: Stream, _: float) -> Stream:
    other = make_rig(len(stream.told.robots), stream.seed + 500, stream.told.camera, stream.told.range_m)
    return replace(stream, told=replace(other, capture=stream.told.capture))


def _moved(stream: Stream, tilt_deg: float) -> Stream:
    """Only what stands still can tell."""
    still = standing(stream.seed)
    rng = np.random.default_rng([stream.seed, 16])
    axis = rng.normal(size=3) * [1.0, 1.0, 0.3]
    turn = exp_rotation(np.radians(tilt_deg) * axis / np.linalg.norm(axis))
    before = still.T_world_camera
    assert before is not None
    now = Pose.from_matrix(before.rotation @ turn, before.position + 1e-3 * rng.normal(size=3) * tilt_deg)
    told = replace(still, capture=stream.told.capture)
    return replace(stream, told=told, true=replace(told, T_world_camera=now))


def _bent(stream: Stream, off_m: float) -> Stream:
    rng = np.random.default_rng([stream.seed, 17])
    number, led, angle = rng.integers(len(stream.told.robots)), rng.integers(6), rng.uniform(0, 2 * np.pi)
    robot = stream.told.robots[number]
    leds = robot.leds.copy()
    leds[led] += off_m * robot.T_robot_plane.rotation[:, :2] @ [np.cos(angle), np.sin(angle)]
    robots = list(stream.told.robots)
    robots[number] = replace(robot, leds=leds)
    return replace(stream, told=replace(stream.told, robots=tuple(robots)))


def _dim(stream: Stream, share: float) -> Stream:
    rng = np.random.default_rng([stream.seed, 18])
    return replace(stream, dimmed={(int(rng.integers(len(stream.true.robots))), int(rng.integers(6))): share})


def _dropped(stream: Stream, share: float) -> Stream:
    return replace(stream, dropped=share)


def _jittering(stream: Stream, sigma_s: float) -> Stream:
    return replace(stream, stamp_sigma_s=sigma_s)


def _stale(stream: Stream, focal: float) -> Stream:
    """The file is as new as it was: only frames can tell."""
    return replace(stream, told=replace(stream.told, camera=with_focal(stream.told.camera, 1.0 + focal)))


def _stale_standing(stream: Stream, focal: float) -> Stream:
    still = replace(standing(stream.seed), capture=stream.told.capture)
    return _stale(replace(stream, true=still, told=still), focal)


def _rolling(stream: Stream, line_us: float) -> Stream:
    return replace(stream, true=replace(stream.true, capture=replace(stream.true.capture, line_time_us=line_us)))


def by_hand(stream: Stream, focal: float = 0.0) -> Stream:
    """One robot's rig, that robot shown from all sides."""
    true, told = (replace(rig, robots=rig.robots[:1]) for rig in (stream.true, stream.told))
    return _stale(replace(stream, true=true, told=told, by_hand=True), focal)


def _aged(stream: Stream, days: float) -> Stream:
    return replace(stream, age_days=days)


class Fault:
    """``stage`` makes a healthy stream ill, so much; ``rows`` of the doctor's table that are to name it."""

    def __init__(self, stage: Callable[[Stream, float], Stream], sizes: tuple[float, ...], *rows: str) -> None:
        self.stage, self.sizes, self.rows = stage, sizes, rows


FAULTS = {
    "defocus, px of blur": Fault(_defocused, (2.0, 3.0, 4.0), "focus"),
    "over-exposed, grey levels": Fault(_exposed, (400.0, 700.0, 1500.0), "exposure"),
    "under-exposed, grey levels": Fault(_exposed, (45.0, 30.0, 20.0), "exposure"),
    "saturated part of the image": Fault(_half_saturated, (0.1, 0.25, 0.5), "bright areas"),
    "hot pixels": Fault(_hot, (15.0, 60.0, 300.0), "hot pixels"),
    "clutter, spots a frame": Fault(_cluttered, (60.0, 120.0, 250.0), "clutter"),
    "wrong rig": Fault(_wrong_rig, (1.0,), "robots seen"),
    "moved camera, degrees": Fault(_moved, (0.02, 0.05, 0.2, 1.0), "camera's place"),
    "bent LED, m": Fault(_bent, (0.1e-3, 0.3e-3, 1e-3), "LED positions"),
    "dim LED, share of its light": Fault(_dim, (0.45, 0.2, 0.0), "LEDs lit"),
    "dropped frames, share": Fault(_dropped, (0.03, 0.1, 0.3), "lost frames"),
    "jittering stamps, s": Fault(_jittering, (0.5e-3, 1e-3, 3e-3), "time stamps"),
    "stale: focal length, by residuals": Fault(_stale, (0.003, 0.01, 0.03), "calibration"),
    "stale: focal length, fixed in view": Fault(_stale_standing, (0.001, 0.003, 0.01), "calibration", "camera's place"),
    "stale: focal length, by hand": Fault(by_hand, (0.003, 0.006, 0.01), "calibration"),
    "rolling shutter, us a row": Fault(_rolling, (5.0, 15.0, 40.0), "rolling shutter"),
    "stale: age, days": Fault(_aged, (500.0,), "calibration"),
}


def film_of(folder: str, told: Rig, images: list[str]) -> Iterator[Frame]:
    """Frames of a folder of images, as a camera would have stamped them."""
    for index, name in enumerate(images):
        image = cv2.imread(f"{folder}/{name}", cv2.IMREAD_GRAYSCALE)
        assert image is not None, name
        stamp_ns = START_NS + round(1e9 * index / RATE_HZ)
        yield Frame(np.asarray(image, np.uint8), stamp_ns, index, name, stamp_ns, Clock.FILE, 0)
