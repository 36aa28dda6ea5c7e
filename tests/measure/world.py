"""Cameras placed by a board and by robots, each with a lens calibrated anew: `python -m tests.measure.world [TRIALS]`.

Every trial calibrates the lens from 14 views of a chessboard (fit_camera, noise 0.1 px), then places that camera by one
view of a board on the floor (8x5 corners, 30 mm, 1.2 m off, noise 0.1 px) and by a robot at 12 surveyed places (0.9 to
1.4 m, noise 0.02 px). "weighted": the squared error weighted by the covariance that is told, 6 on average where it is
meant, with its standard error; "lens left out": by the covariance of the residuals alone; "sigmas only": with the lens'
standard deviations as if they were independent.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.server.calibration.lens.board_points import Seen
from asterism.server.calibration.lens.bundle import View
from asterism.server.calibration.lens.fit import CameraFit, fit_camera
from asterism.server.calibration.lens.targets import parse_target
from asterism.server.calibration.survey.world import fit_world
from asterism.server.calibration.survey.world_board import fit_board
from asterism.server.calibration.survey.world_lens import with_systematic_errors
from tests.calibration.lens.boards import Lens, poses
from tests.calibration.survey.surveys import survey_pairs
from tests.helpers import facing_pose, random_pose
from tests.rigs import make_camera, make_rig

TRUE = make_camera()
NOISE_PX = 0.1


def main() -> int:
    """Calibrate, place, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.world")
    parser.add_argument("trials", nargs="?", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng([options.seed, 9])
    placed: dict[str, list[tuple[Floats, Floats, Floats, Floats]]] = {"board": [], "robots": []}
    for _ in range(options.trials):
        lens = calibrated(rng)
        placed["board"].append(by_board(lens, rng))
        placed["robots"].append(by_robots(lens, rng))
    for name, rows in placed.items():
        errors = np.array([row[0] for row in rows])
        sigmas = np.sqrt(np.array([np.diag(row[1]) for row in rows]))
        print(
            f"{name}: {len(rows)} trials; error RMS x y z {_row(1e3 * np.sqrt((errors[:, :3] ** 2).mean(axis=0)))} mm, "
            f"told {_row(1e3 * np.sqrt((sigmas[:, :3] ** 2).mean(axis=0)))} mm"
        )
        for what, k in (("weighted", 1), ("lens left out", 2), ("sigmas only", 3)):
            nees = np.array([row[0] @ np.linalg.solve(row[k], row[0]) for row in rows])
            print(f"  {what}: {nees.mean():.2f} +- {nees.std() / np.sqrt(len(nees)):.2f}")
    return 0


def calibrated(rng: np.random.Generator) -> CameraFit:
    """The true camera as fourteen views of a board find it."""
    target = parse_target("chessboard:9x6:0.05")
    lens = Lens((TRUE.width, TRUE.height), (TRUE.matrix[0, 0], TRUE.matrix[1, 1]))
    views = []
    for k, pose in enumerate(poses(rng, 14, target.points.mean(axis=0), lens, 0.5, 0.7, 1.3, 0.6)):
        noise = NOISE_PX * rng.standard_normal((len(target.points), 2))
        views.append(View(f"{k}", Seen(target.points, TRUE.project(pose.map(target.points)) + noise)))
    fit = fit_camera(views, TRUE.width, TRUE.height, "plumb_bob")
    assert fit is not None
    return fit


def by_board(lens: CameraFit, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Error (6,), and the covariances: whole, without the lens, with the lens' standard deviations only."""
    points = parse_target("chessboard:8x5:0.03").points
    tilt = exp_rotation(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-3.0, 3.0)]))
    T = Pose.from_matrix(tilt, np.array([rng.uniform(-0.3, 0.1), rng.uniform(-0.2, 0.1), 1.2]))
    pixels = TRUE.project(T.map(points))
    view = View("0", Seen(points, pixels + NOISE_PX * rng.standard_normal(pixels.shape)))
    fit = fit_board([view], lens.camera, lens.covariance)
    alone = fit_board([view], lens.camera, np.diag(np.diag(lens.covariance)))
    true = fit_board([View("0", Seen(points, pixels))], TRUE, 0.0 * lens.covariance).T_world_camera
    own = fit.covariance - fit.of_lens
    return _error(fit.T_world_camera, true), fit.covariance, own, alone.covariance


def by_robots(lens: CameraFit, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """The same of a robot at surveyed places."""
    rig, T = make_rig(1, seed=4), random_pose(rng)
    given = replace(rig, camera=lens.camera)
    there = [facing_pose(rng, (0.9, 1.4), (15.0, 50.0)) for _ in range(12)]
    fit = fit_world(survey_pairs(replace(rig, T_world_camera=T), given, there, rng), "survey")
    whole, alone = (
        with_systematic_errors(fit, given, c, {})[0].covariance
        for c in (lens.covariance, np.diag(np.diag(lens.covariance)))
    )
    return _error(fit.T_world_camera, T), whole, fit.covariance, alone


def _error(found: Pose, true: Pose) -> Floats:
    return np.concatenate([true.position - found.position, log_rotation(true.rotation @ found.rotation.T)])


def _row(values: Floats) -> str:
    return " ".join(f"{value:.3f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
