"""A tool's tip by pivoting, against the truth: `python -m tests.measure.point [CASES] [--rendered N]`.

The demonstration's robot alpha rests with its tool at one place, 1.25 m from the camera (f = 1400 px), tilted by up to
30 degrees to all sides and turned by up to 40 about its plate's normal ("only tilted": not), in 100 frames. Spots are
drawn with the noise of their light, rigs with what is not known of them: "exact" nothing, "calibrated" as `calibrate
leds` and `calibrate camera` leave it, "assumed" as where no uncertainty is given, "ruler" LEDs that are 0.4 mm off but
told as 0.05 mm. Printed: RMSE along the robot's axes, and what is told; the Cramer-Rao bound of the spots' noise, and
the RMSE over it; how many of the coordinates lie within two sigmas; squared errors weighted by the covariance, 3 on
average where it is meant, with their standard error.

"touching": six touches of one mark, ten frames each, eight between; frames rightly and wrongly used are counted.
"rendered": the simulator's frames, localized.
"""

import argparse
import sys
from collections.abc import Iterator

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.budget.budget import Poses, image_by_pose
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.point.calibration import PointCalibration
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.chain.frame import Frame
from asterism.server.simulation.hand_film import PIVOT_SPIN
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.calibration.point.drawn import ASSUMED, EXACT, POINT, Drawn, calibrated, demo, drawn, pivots, touches

FRAMES = 100
CALIBRATED = Uncertainty(
    led_position_m=5e-6, offset_m=1e-5, focal_relative=2e-4, principal_point_px=0.3, distortion_relative=5e-3
)
RULER = Uncertainty(led_position_m=4e-4)
# What a rig is off by, what is told of it, and by how much the robot is turned about its plate's normal, rad.
KINDS = {
    "exact": (EXACT, EXACT, PIVOT_SPIN),
    "only tilted": (EXACT, EXACT, 0.0),
    "calibrated": (CALIBRATED, CALIBRATED, PIVOT_SPIN),
    "assumed": (ASSUMED, ASSUMED, PIVOT_SPIN),
    "ruler": (RULER, ASSUMED, PIVOT_SPIN),
}


def main() -> int:
    """Draw, calibrate, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.point")
    parser.add_argument("cases", nargs="?", type=int, default=100)
    parser.add_argument("--rendered", type=int, default=3, help="films (default: 3)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rig = demo()
    seeds = range(options.seed, options.seed + options.cases)
    for kind, (true, told, spin) in KINDS.items():
        films = {seed: pivots(rig, FRAMES, seed, spin) for seed in seeds}
        least = np.sqrt(np.mean([np.diag(bound(rig, poses)) for poses in films.values()], axis=0))
        found = []
        for seed, poses in films.items():
            film = drawn(rig, true, poses, np.random.default_rng([seed, 14]))
            found.append(calibrated(film, told))
        tell(kind, rig, found, least)
    touching(rig, seeds)
    tell("rendered", rig, [calibrated(rendered(rig, seed), EXACT) for seed in range(options.rendered)])
    return 0


def tell(kind: str, rig: Rig, found: list[PointCalibration], least: Floats | None = None) -> None:
    """A line of errors."""
    if not found:
        return
    errors = np.array([one.point for one in found]) - rig.robots[0].points[POINT]
    sigmas = np.array([one.sigmas for one in found])
    weighted = np.array([e @ np.linalg.solve(one.covariance, e) for e, one in zip(errors, found, strict=True)])
    rmse = np.sqrt((errors**2).mean(axis=0))
    used, inflated = (np.mean(part) for part in ([one.used.mean() for one in found], [one.wanders for one in found]))
    within = (np.abs(errors) < 2.0 * sigmas).mean(axis=0)
    over = "" if least is None else f"; bound {_um(least)}, over it {' '.join(f'{a:.2f}' for a in rmse / least)}"
    print(
        f"{kind}: {len(found)} films; RMSE {_um(rmse)} um, told {_um(np.sqrt((sigmas**2).mean(axis=0)))}{over}; within "
        f"2 sigma {' '.join(f'{a:.0%}' for a in within)}, "
        f"all {within.mean():.1%}; weighted {weighted.mean():.2f} +- {weighted.std() / len(found) ** 0.5:.2f}; frames "
        f"used {used:.2%}; sigmas inflated in {inflated:.0%}",
        flush=True,
    )


def touching(rig: Rig, seeds: range) -> None:
    """Which frames are taken for touches, and what comes of it."""
    resting = np.tile([True] * 10 + [False] * 8, 6)
    found, missed, wrong = [], 0, 0
    for seed in seeds:
        rng = np.random.default_rng([seed, 15])
        film = drawn(rig, CALIBRATED, touches(rig, 6, 10, 8, rng), rng)
        found.append(calibrated(film, CALIBRATED))
        truly = resting[[one.index for one in film.sightings]]
        missed += int((truly & ~found[-1].used).sum())
        wrong += int((~truly & found[-1].used).sum())
    tell("touching", rig, found)
    print(f"  of {60 * len(found)} frames that rest {missed} are left out, of {48 * len(found)} others {wrong} used")


def rendered(rig: Rig, seed: int) -> Drawn:
    """A film of the simulator, as it is localized."""
    scene, poses = Scene(rig, seed), pivots(rig, FRAMES, seed)

    def frames() -> Iterator[Frame]:
        for k, pose in enumerate(poses):
            image = scene.render(k, [Truth(rig.robots[0].id, pose, (True,) * 6)])
            yield Frame(image, k, k, f"{k:05d}.png", k)

    return Drawn(rig, rig, [one for _, seen in observe(frames(), rig) for one in seen])


def bound(rig: Rig, poses: list[Pose]) -> Floats:
    """Covariance (3, 3) m of the point at best: only spots have noise, every frame has its own rotation."""
    robot = rig.robots[0]
    stack = Poses(np.array([pose.rotation for pose in poses]), np.array([pose.position for pose in poses]))
    by_point, _ = image_by_pose(rig, robot, stack)
    arms = np.einsum("nij,lj->nli", stack.rotations, robot.leds - robot.points[POINT])
    turns = np.cross(np.eye(3)[None, None], arms[:, :, None]).swapaxes(2, 3)
    own, rounding = centre_covariances(
        np.einsum("nij,lj->nli", stack.rotations, robot.leds) + stack.ts[:, None],
        np.broadcast_to((stack.rotations @ robot.T_robot_plane.rotation[:, 2])[:, None], arms.shape),
        robot.led_radius or 0.0, rig.camera.focal_px, Look(),
    )  # fmt: skip
    whiten = np.linalg.inv(np.linalg.cholesky(own + rounding))
    n = len(poses)
    by_turn = (whiten @ by_point @ turns).reshape(n, 12, 3)
    shared = np.concatenate([-by_point @ stack.rotations[:, None], by_point], axis=-1)
    by_shared = (whiten @ shared).reshape(n, 12, 6)
    basis, _ = np.linalg.qr(by_turn)
    left = by_shared - basis @ (np.swapaxes(basis, 1, 2) @ by_shared)
    covariance: Floats = np.linalg.inv(np.einsum("nij,nik->jk", left, left))[:3, :3]
    return covariance


def _um(values: Floats) -> str:
    return " ".join(f"{1e6 * value:.1f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
