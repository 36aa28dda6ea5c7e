"""Recordings of several cameras without pictures: spots where LEDs truly are, with drawn noise, and poses near by."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import set_report_pose, to_bytes
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.calibration.cameras.views import Seen, views_of
from asterism.server.calibration.lens.camera_file import camera_text
from tests.helpers import conic_centres
from tests.several import Drive, facing_pair, looking_at, rigs_at

SIGMA_PX = 0.02
RATE_HZ = 15.0
ROBOTS = ("r00", "r01")
FAR_AWAY_S = 1_700_000_000


def three(seed: int = 0) -> list[Rig]:
    """Rigs of three cameras, 1.3 m about the middle of a floor, as they truly stand."""
    return rigs_at([*facing_pair(), looking_at(np.array([0.1, 0.9, 0.95]), np.zeros(3), 1.0)], 2, seed)


def with_leds_off(rigs: Sequence[Rig], sigma_m: float, rng: np.random.Generator) -> list[Rig]:
    """The same with LEDs that are not where they say, within their plates, in all alike."""
    robots = tuple(
        replace(robot, leds=robot.leds + np.column_stack([sigma_m * rng.normal(size=(6, 2)), np.zeros(6)]))
        for robot in rigs[0].robots
    )
    return [replace(rig, robots=robots) for rig in rigs]


def reports(
    rig: Rig,
    poses_at: Callable[[float], Mapping[str, Pose]],
    stamps_s: Mapping[float, float],
    rng: np.random.Generator,
    sigma_px: float = SIGMA_PX,
    T_world_camera: Pose | None = None,
) -> "Iterator[pb.FrameReport]":
    """Frame reports of a camera that stands where ``rig`` says; ``stamps_s`` by the true times. ``T_world_camera`` is
    where it is believed to be; None: poses are told in its frame.
    """
    assert rig.T_world_camera is not None
    T_camera_world = rig.T_world_camera.inverse()
    for sequence, (time_s, stamp_s) in enumerate(stamps_s.items()):
        report = pb.FrameReport(sequence=sequence, exposed_ns=round((FAR_AWAY_S + stamp_s) * 1e9))
        for robot, T_world_robot in poses_at(time_s).items():
            _add(report, rig, robot, T_camera_world @ T_world_robot, T_world_camera or Pose.identity(), (rng, sigma_px))
        yield report


def _add(
    report: "pb.FrameReport", rig: Rig, robot_id: str, T: Pose, T_told: Pose, noise: tuple[np.random.Generator, float]
) -> None:
    """One robot's spots and poses, where it is whole in the image."""
    (rng, sigma_px), robot = noise, rig.robot(robot_id)
    k, T_camera_plane = len(report.robots), T @ robot.T_robot_plane
    told = report.robots.add(id=robot_id, state=pb.State.Value("LOST"))
    ideal = conic_centres(T_camera_plane, robot.leds_plane * [1, 1, 0], robot.led_radius or 0.0)
    pixels = rig.camera.project(np.column_stack([ideal, np.ones(6)])) + sigma_px * rng.normal(size=(6, 2))
    if not ((pixels > 5) & (pixels < [rig.camera.width - 5, rig.camera.height - 5])).all():
        return
    spots = report.spots
    for led, (x, y) in enumerate(pixels):
        for column, value in zip(
            (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy, spots.fate, spots.robot,
             spots.led, spots.radius, spots.brightness),
            (x, y, sigma_px**2, 0.0, sigma_px**2, pb.Fate.Value("LED"), k, led, 2.0, 200.0), strict=True,
        ):  # fmt: skip
            column.append(value)
    sight = T.position / np.linalg.norm(T.position)
    away = 1e-3 * rng.normal() * sight + 2e-5 * rng.normal(size=3)
    pose = Pose.from_matrix(exp_rotation(3e-3 * rng.normal(size=3)) @ T.rotation, T.position + away)
    mirrored = (np.eye(3) - 2.0 * np.outer(sight, sight)) @ pose.rotation @ np.diag([1.0, 1.0, -1.0])
    tilts = [pose, Pose.from_matrix(mirrored, pose.position)]
    if rng.uniform() < 0.2:
        tilts.reverse()
    told.state = pb.State.Value("TILT_AMBIGUOUS")
    set_report_pose(told.pose, T_told @ tilts[0])
    set_report_pose(told.alternative.pose, T_told @ tilts[1])
    turn = T_told.rotation
    spread = turn @ (2e-5**2 * np.eye(3) + 1e-3**2 * np.outer(sight, sight)) @ turn.T
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = spread, 3e-3**2 * np.eye(3)
    told.covariance.extend(covariance.ravel().tolist())
    told.leds, told.alternative.odds = 6, 3.0


def times(frames: int, first_s: float = 0.0, offset_s: float = 0.0, drift: float = 0.0) -> dict[float, float]:
    """Stamps by true times; the clock shows ``offset_s`` more than it should, and gains."""
    true = first_s + np.arange(frames) / RATE_HZ
    return dict(zip(true.tolist(), (true + offset_s + drift * true).tolist(), strict=True))


def seen_by(
    true: Sequence[Rig],
    believed: Sequence[Rig],
    stamps: Sequence[Mapping[float, float]],
    rng: np.random.Generator,
    poses_at: Callable[[float], Mapping[str, Pose]] | None = None,
) -> list[Seen]:
    """What all cameras saw of a drive."""
    poses_at = poses_at or Drive(ROBOTS)
    return [
        views_of(
            ((report, rig) for report in reports(truth, poses_at, each, rng, T_world_camera=rig.T_world_camera)),
            rig, ROBOTS, FAR_AWAY_S * 10**9, rig.camera.name,
        )
        for truth, rig, each in zip(true, believed, stamps, strict=True)
    ]  # fmt: skip


def write_rig(folder: Path, rig: Rig, world: Pose | None, more: str = "") -> Path:
    """`<camera>.yaml` and the camera's file."""
    name = rig.camera.name
    folder.mkdir(exist_ok=True)
    (folder / f"{name}-camera.yaml").write_text(camera_text(rig.camera))
    lines = [f"camera: {name}-camera.yaml", "range: [0.8, 2.0]   # by the eye"]
    if world is not None:
        place = {"position": world.position.tolist(), "orientation": world.orientation.tolist()}
        lines.append(f"world: {json.dumps(place)}")
    robots = [f"  {robot.id}: {{leds: {robot.leds.tolist()}, led: {{radius: 0.0025}}}}" for robot in rig.robots]
    (folder / f"{name}.yaml").write_text("\n".join([*lines, "robots:", *robots]) + "\n" + more)
    return folder / f"{name}.yaml"


def record(folder: Path, rig: Rig, told: "Iterator[pb.FrameReport]") -> Path:
    """A recording of frame reports; ``rig`` is read from files."""
    recorder = Recorder(folder, rig, "drawn", FramesKept(0), wait=True)
    for report in told:
        at = report.exposed_ns
        message = Message(keys.frame(rig.camera.name), FRAME_REPORT, to_bytes(report), at, at, report.sequence)
        recorder.write([message], None, at, report.sequence)
    recorder.close({})
    return recorder.folder


def error_of(T_first_camera: Pose, rigs: Sequence[Rig], camera: int) -> Floats:
    """How far a camera was placed from where it truly is against the first: m, and rad about the first's axes (6,)."""
    from asterism.server.pose.place import apart

    first, other = rigs[0].T_world_camera, rigs[camera].T_world_camera
    assert first is not None
    assert other is not None
    return apart(first.inverse() @ other, T_first_camera)
