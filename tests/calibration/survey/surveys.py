"""Robots at known poses, as calibrations from surveyed poses get them: centres with noise, or whole films."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, load_rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.survey.survey import SurveyedPose
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.calibration.leds.films import off_by
from tests.chain.frames import disc_image, draw
from tests.rigs import random_layouts

Apparent = Callable[[Floats, Floats], Floats]  # LED and axis in the camera's frame -> where it is seen


def survey_pairs(
    true: Rig, given: Rig, poses: Sequence[Pose], rng: np.random.Generator, sigma_px: float = 0.02,
    apparent: Apparent | None = None, hidden: float = 0.0,
) -> Pairs:  # fmt: skip
    """Sightings of the first robot at T_camera_robot ``poses``, drawn by ``true``, located by ``given``; with truth,
    T_world_robot where the true rig has a world. ``hidden``: the probability that one of the LEDs is.
    """
    T_parent_camera = true.T_world_camera or Pose.identity()
    sightings = []
    robot = true.robots[0]
    for index, pose in enumerate(poses):
        centres = spots(true.camera, robot.leds, pose, robot.led_radius or 0.0, apparent, robot.axis)
        noisy = centres + sigma_px * rng.standard_normal((6, 2))
        spreads = np.tile(sigma_px**2 * np.eye(2), (6, 1, 1))
        if rng.random() < hidden:
            led = rng.integers(6)
            noisy[led], spreads[led] = np.nan, np.nan
        known = LedCentres(noisy, spreads)
        sightings.append(Sighting(f"{index:05d}.png", index, robot.id, known, pose, np.eye(6), None))
    located = []
    for sighting, answer in zip(sightings, solve_sightings(given, sightings), strict=True):
        assert answer is not None
        found, covariance = answer
        located.append(Sighting(sighting.frame, sighting.index, robot.id, sighting.centres, found, covariance, None))
    return [
        (sighting, SurveyedPose(robot.id, told.position, told.orientation))
        for sighting, told in zip(located, (T_parent_camera @ pose for pose in poses), strict=True)
    ]


def spots(
    camera: Camera, leds: Floats, pose: Pose, radius: float, apparent: Apparent | None = None,
    axis: Floats | None = None,
) -> Floats:  # fmt: skip
    """Centres (6, 2) px of the spots of discs that lie in the robot's x-y plane."""
    turned = pose.rotation @ (np.array([0.0, 0.0, 1.0]) if axis is None else axis)
    places = pose.map(leds)
    if apparent is not None:
        places = np.array([apparent(led, turned) for led in places])
    if radius == 0.0:
        return camera.project(places)
    return np.array([disc_image(camera, place, pose.rotation[:, 2], radius)[0] for place in places])


def write_survey(path: Path, robot: str, poses: Sequence[Pose]) -> None:
    """The truth of a film's frames 00000.png, 00001.png, ..."""
    lines = [
        json.dumps(
            {
                "frame": f"{index:05d}.png",
                "robots": [{"id": robot, "position": pose.position.tolist(), "orientation": pose.orientation.tolist()}],
            }
        )
        for index, pose in enumerate(poses)
    ]
    path.write_text("\n".join(lines) + "\n")


def write_frames(
    folder: Path, rig: Rig, poses: Sequence[Pose], rng: np.random.Generator, apparent: Apparent | None = None
) -> None:
    """Frames of the rig's first robot at T_camera_robot poses, drawn by tests/centres/rendering.py."""
    folder.mkdir(parents=True)
    for index, pose in enumerate(poses):
        image = draw(rig, {rig.robots[0].id: pose}, apparent=apparent).expose(rng)
        assert cv2.imwrite(str(folder / f"{index:05d}.png"), image)


def rim_layout(seed: int) -> Floats:
    """Six LEDs (6, 2) m about a circle of 100 mm, where they make Z best known, and not alike when turned."""
    angles = np.radians([0.0, 63.0, 115.0, 180.0, 248.0, 297.0])
    jitter = 4e-3 * np.random.default_rng([seed, 80]).standard_normal((6, 2))
    layout: Floats = 0.05 * np.column_stack([np.cos(angles), np.sin(angles)]) + jitter
    return layout


def write_rig(folder: Path, seed: int, led: str = "{radius: 2.5e-3}", layout: Floats | None = None) -> Rig:
    """camera.yaml and rig.yaml of one robot, alpha, with comments that are to survive; returns the rig. ``layout``
    (6, 2) m; without it LEDs lie anywhere in a disc of 100 mm.
    """
    layout = random_layouts(1, seed)[0] if layout is None else layout
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "camera.yaml").write_text("# the 12 mm lens\n" + (DEMO_RIG.parent / "camera.yaml").read_text())
    rows = "".join(f"      - [{x:.6f}, {y:.6f}, 0.012]\n" for x, y in layout.tolist())
    (folder / "rig.yaml").write_text(
        "camera: camera.yaml   # beside this\nrange: [0.70, 1.8]\nrobots:\n  alpha:   # the first one\n"
        f"    leds:\n{rows}    led: {led}\n"
    )
    return load_rig(folder / "rig.yaml")


def off_rig(true: Rig, rng: np.random.Generator) -> Rig:
    """The rig with f off by 0.3 %, the principal point by 3/-2 px, k1 by 5 %, every LED by 0.05 mm."""
    camera = true.camera
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[0, 0] *= 0.997
    matrix[1, 1] *= 0.997
    matrix[:2, 2] += 3.0, -2.0
    distortion[0] *= 1.05
    robots = tuple(replace(robot, leds=robot.leds + off_by(rng, 0.05e-3)) for robot in true.robots)
    return replace(true, camera=replace(camera, matrix=matrix, distortion=distortion), robots=robots)


def z_errors(pairs: Pairs) -> tuple[Floats, Floats, Floats]:
    """Places (n, 3) m, z_true - z_found (n,) m and its variances (n,) m^2 of sightings in a rig without a world."""
    places = np.array([sighting.pose.position for sighting, _ in pairs])
    truth = np.array([told.position for _, told in pairs])
    return places, truth[:, 2] - places[:, 2], np.array([sighting.covariance[2, 2] for sighting, _ in pairs])


def write_off_rig(folder: Path, true: Rig, given: Rig) -> None:
    """camera.yaml and rig.yaml of ``given``, which is off, with all else as in the files of ``true``."""
    numbers = ", ".join(f"{value:.7f}" for value in given.camera.matrix.ravel())
    text = true.camera_text.replace("[1400.0, 0.0, 642.0, 0.0, 1400.0, 509.0, 0.0, 0.0, 1.0]", f"[{numbers}]")
    coefficients = ", ".join(f"{value:.9f}" for value in given.camera.distortion)
    (folder / "camera.yaml").write_text(text.replace("[-0.11, 0.03, 0.0004, -0.0003, 0.0]", f"[{coefficients}]"))
    lines = true.rig_text.splitlines()
    first = next(k for k, line in enumerate(lines) if line.lstrip().startswith("- ["))
    for k, (x, y, z) in enumerate(given.robots[0].leds.tolist()):
        lines[first + k] = f"      - [{x:.7f}, {y:.7f}, {z:.7f}]"
    (folder / "rig.yaml").write_text("\n".join(lines) + "\n")
