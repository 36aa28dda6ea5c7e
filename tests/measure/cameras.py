"""Cameras placed together by robots that they share: `python -m tests.measure.cameras [SEEDS] [--drawn N]`.

Three cameras (f = 1400 px) 1.3 m from the middle of a floor, 60 degrees apart; two robots drive there, 300 frames at
15 Hz, rendered and localized by the chain. The rigs that are believed: "exact" but for where the cameras are, which is
20 cm and 10 degrees wrong, or not told; "0.05 mm", "0.4 mm" of LEDs within their plates; "clock": exact, but the
cameras expose 7 ms after each other and the second one's clock is 10 ms ahead and gains 20 ppm. Printed: errors of
position and angle, RMS and worst of a camera, what is told, how many of the six coordinates lie within two sigmas, the
squared error weighted by the covariance (6 where it is meant, with its standard error), the clock's error and sigma,
and seconds for the fit; and the squared errors, weighted, of poses that `fuse` then makes of another drive's drawn
spots (noise 0.02 px) with the places found and their covariances, 6 where these are meant.

"drawn": the same with N drives of drawn spots (noise 0.02 px) in place of pictures.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.calibration.cameras.calibration import CamerasFit, calibrate_cameras
from asterism.server.calibration.cameras.views import Seen, views_of
from asterism.server.chain.frame import Frame
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.memory import Joint
from asterism.server.pose.place import apart
from tests.calibration.cameras.drawn import ROBOTS, error_of, seen_by, three, times, with_leds_off
from tests.fusing.drawn import Seen as Drawn
from tests.fusing.drawn import sighting
from tests.several import Drive, frames_of, reports_of

FRAMES = 300
OFFSET_S, DRIFT = 0.01, 2e-5
LEDS_M = {"exact": 0.0, "0.05 mm": 5e-5, "0.4 mm": 4e-4, "clock": 0.0}


def main() -> int:
    """Drive, calibrate, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.cameras")
    parser.add_argument("seeds", nargs="?", type=int, default=4)
    parser.add_argument("--drawn", type=int, default=0, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for kind in LEDS_M:
        for what, count in (("rendered", options.seeds), ("drawn", options.drawn)):
            rows = [trial(kind, what, seed) for seed in range(options.seed, options.seed + count)]
            if rows:
                tell(f"{kind}, {what}", rows)
    return 0


FUSED = 20  # exposures of another drive

Row = tuple[list[tuple[Floats, Floats]], tuple[float, float], float, float]


def trial(kind: str, what: str, seed: int) -> Row:
    """Errors and covariances of both cameras, the second's clock's error and sigma, seconds, and what is fused."""
    rng = np.random.default_rng([seed, 14])
    true = three(seed)
    stamps = [times(FRAMES) for _ in true]
    if kind == "clock":
        stamps = [times(FRAMES), times(FRAMES, 0.007, OFFSET_S, DRIFT), times(FRAMES, 0.014)]
    believed = with_leds_off(true, LEDS_M[kind], rng) if LEDS_M[kind] else true
    believed = [misplaced(rig, camera, rng) for camera, rig in enumerate(believed)]
    drive = Drive(ROBOTS, seed)
    seen = rendered(true, believed, stamps, drive, seed) if what == "rendered" else (
        seen_by(true, believed, stamps, rng, drive)
    )  # fmt: skip
    began = time.perf_counter()
    lenses = [np.zeros((9, 9))] * len(true)
    fit = calibrate_cameras(seen, believed[0].robots, lenses)
    taken = time.perf_counter() - began
    placed = [(error_of(fit.cameras[c].T_first_camera, true, c), fit.cameras[c].covariance) for c in (1, 2)]
    return placed, clock_error(fit, stamps[1]), taken, fused(fit, true, believed, rng)


def fused(fit: CamerasFit, true: Sequence[Rig], believed: Sequence[Rig], rng: np.random.Generator) -> float:
    """The mean squared error, weighted, of poses fused with the places found, in the first camera's true world."""
    place = true[0].T_world_camera
    assert place is not None
    turn = np.kron(np.eye(2), place.rotation)
    views = [
        View(replace(rig, T_world_camera=place @ one.T_first_camera), turn @ one.covariance @ turn.T)
        for rig, one in zip(believed, fit.cameras, strict=True)
    ]
    fleet, drive = Fleet.of(views), Drive(ROBOTS, 77)
    off = {robot.id: robot.leds - fleet.robots[robot.id].leds for robot in true[0].robots}
    told = []
    for k in range(FUSED):
        poses = drive(2.0 * k)
        # What a camera's frames have told by then of the robots' LEDs.
        sightings = [
            sighting(
                view, poses, 10**9,
                rng, Drawn(truth.T_world_camera, off, misfit_m=float(np.median(list(fit.misfits_m.values())))),
            )
            for view, truth in zip(views, true, strict=True)
        ]  # fmt: skip
        answers = fuse(sightings, fleet, Joint.none())[0].answers
        for robot, answer in answers.items():
            if isinstance(answer, FusedPose):
                error = apart(poses[robot], answer.pose)
                told.append(float(error @ np.linalg.solve(answer.covariance, error)))
    return float(np.mean(told))


def clock_error(fit: CamerasFit, stamps: Mapping[float, float]) -> tuple[float, float]:
    """Of the second camera's clock in the middle of the drive: its error and what is told, s."""
    clock = fit.cameras[1].clock
    middle = sorted(stamps)[len(stamps) // 2]
    return clock.offset_s - (stamps[middle] - middle), clock.offset_sigma_s


def misplaced(rig: Rig, camera: int, rng: np.random.Generator) -> Rig:
    """A rig whose world is wrong, of the last camera absent."""
    if camera == 2:
        return replace(rig, T_world_camera=None)
    assert rig.T_world_camera is not None
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn, shift = np.radians(10.0) * turn / np.linalg.norm(turn), 0.2 * shift / np.linalg.norm(shift)
    place = Pose.from_matrix(exp_rotation(turn) @ rig.T_world_camera.rotation, rig.T_world_camera.position + shift)
    return replace(rig, T_world_camera=place)


def rendered(
    true: Sequence[Rig], believed: Sequence[Rig], stamps: Sequence[Mapping[float, float]], drive: Drive, seed: int
) -> list[Seen]:
    """What the chain makes of pictures."""
    out = []
    for camera, (truth, rig, each) in enumerate(zip(true, believed, stamps, strict=True)):
        taken = frames_of(truth, drive, [round(at * 1e9) for at in each], seed=10 * seed + camera)
        shown = (
            Frame(frame.image, exposed_ns=round(stamp * 1e9), index=frame.index)
            for frame, stamp in zip(taken, each.values(), strict=True)
        )
        reports = ((report, rig) for report in reports_of(shown, rig))
        out.append(views_of(reports, rig, ROBOTS, 0, rig.camera.name))
    return out


def tell(name: str, rows: Sequence[Row]) -> None:
    """A line."""
    errors = np.array([error for placed, _, _, _ in rows for error, _ in placed])
    covariances = np.array([covariance for placed, _, _, _ in rows for _, covariance in placed])
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    away, turned = np.linalg.norm(errors[:, :3], axis=1), np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
    told = np.sqrt((sigmas**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0)) * [1e3, np.degrees(1.0)]
    nees = np.array([error @ np.linalg.solve(spread, error) for error, spread in zip(errors, covariances, strict=True)])
    clocks = 1e3 * np.array([clock for _, clock, _, _ in rows])
    print(
        f"{name}: {len(rows)} drives; position {1e3 * np.sqrt((away**2).mean()):.4f} mm RMS, worst "
        f"{1e3 * away.max():.4f}, told {told[0]:.4f}; angle {np.sqrt((turned**2).mean()):.5f} degrees, worst "
        f"{turned.max():.5f}, told {told[1]:.5f}; within 2 sigma {(np.abs(errors) < 2 * sigmas).mean():.1%}; weighted "
        f"{nees.mean():.2f} +- {nees.std() / np.sqrt(len(nees)):.2f}; clock {np.sqrt((clocks[:, 0] ** 2).mean()):.4f} "
        f"ms, told {clocks[:, 1].mean():.4f}; {np.mean([taken for _, _, taken, _ in rows]):.1f} s; fused, weighted "
        f"{np.mean([told for *_, told in rows]):.2f}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
