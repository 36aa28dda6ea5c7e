"""Robots in the world under a camera that is followed: `python -m tests.measure.follow [SECONDS]`.

Frames without pixels at 60 Hz (tests/measure/drawn_frames.py, centres with white noise as large as they tell), three
robots that drive, one to three constellations that stand still. The camera stands, creeps 0.05 degrees a minute, shakes
(7 Hz, 0.005 to 0.1 degrees), or is kicked (0.3 degrees, 2 mm, every 5 s). NEES: squared errors of the robots' poses in
the world over their covariances, 6 where they are meant; mm: RMS of their positions; camera's: NEES of T_world_camera
itself. "rig's": `follow` off, the camera where it truly stands at rest.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.server.pose.place import apart
from asterism.server.pose.solve import PoseEstimate
from tests.measure.drawn_frames import Motion, Stage, stage_rig

ROBOTS, RATE, SETTLED_S = 3, 60.0, 2.0
REST = np.zeros(3)


def shake(deg: float) -> Motion:
    """At 7 Hz about two axes."""
    turn = np.radians(deg) * np.array([1.0, 0.6, 0.0])
    return lambda time_s: (turn * np.sin(2.0 * np.pi * 7.0 * time_s), REST)


def creep(time_s: float) -> tuple[Floats, Floats]:
    """Steadily."""
    return np.radians(0.05) * time_s / 60.0 * np.array([1.0, -1.0, 0.0]), REST


def kick(time_s: float) -> tuple[Floats, Floats]:
    """To and fro."""
    on = float(int(time_s / 5.0) % 2)
    return on * np.radians(0.3) * np.array([0.6, 0.8, 0.0]), on * np.array([2e-3, 0.0, 0.0])


MOTIONS: dict[str, Motion] = {
    "stands": lambda _: (REST, REST),
    "creeps": creep,
    "shakes 0.005 deg": shake(0.005),
    "shakes 0.02 deg": shake(0.02),
    "shakes 0.1 deg": shake(0.1),
    "kicked": kick,
}


def measured(motion: Motion, fixed: int, follow: bool, seconds: float) -> tuple[float, float, float]:
    """NEES and RMS, mm, of robots in the world, and NEES of the camera."""
    rig = replace(stage_rig(ROBOTS, fixed, 7), follows_world=follow)
    stage = Stage(rig, 3, always="drive", motion=motion, wrong=False)
    nees, away, camera = [], [], []
    for frame in range(round(seconds * RATE)):
        now = (frame + 1) / RATE
        result = stage.frame(now)
        if now < SETTLED_S:
            continue
        for k, robot in enumerate(rig.robots[fixed:], start=fixed):
            answer = result.answers[robot.id]
            if isinstance(answer, PoseEstimate):
                error = error_of(answer.pose, stage.pose(k, now))
                nees.append(float(error @ np.linalg.solve(answer.covariance, error)))
                away.append(float(error[:3] @ error[:3]))
        if result.place is not None:
            off = apart(stage.T_world_camera(now), result.place.T_world_camera)
            camera.append(float(off @ np.linalg.solve(result.place.covariance, off)))
    # A robot whose tilt was the other one for a moment is no matter of the camera.
    return (
        float(np.mean(np.minimum(nees, 1e3))),
        1e3 * float(np.sqrt(np.mean(away))),
        float(np.mean(camera or [np.nan])),
    )


def error_of(found: Pose, true: Pose) -> Floats:
    """(6,) m and rad about the world's axes."""
    return np.concatenate([found.position - true.position, log_rotation(found.rotation @ true.rotation.T)])


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.follow")
    parser.add_argument("seconds", nargs="?", type=float, default=20.0)
    options = parser.parse_args()
    table = Table(title=f"{options.seconds:g} s of each", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("camera", "fixed", "NEES", "mm", "camera's", "rig's: NEES", "mm"):
        table.add_column(heading, justify="left" if heading == "camera" else "right", no_wrap=True)
    for name in track(MOTIONS, description="following", transient=True):
        plain = measured(MOTIONS[name], 1, False, options.seconds)
        for fixed in (1, 2, 3):
            nees, away, camera = measured(MOTIONS[name], fixed, True, options.seconds)
            row = (f"{nees:.1f}", f"{away:.3f}", f"{camera:.1f}", f"{plain[0]:.1f}", f"{plain[1]:.3f}")
            table.add_row(name if fixed == 1 else "", str(fixed), *row)
    Console(width=120).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
