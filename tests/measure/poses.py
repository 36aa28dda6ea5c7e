"""Poses against the Cramer-Rao bound, and the honesty of covariances and tilts: `python -m tests.measure.poses`.

One robot at a time, anywhere in the image, at given distances and tilts: rendered, located alone, compared with the
truth. The bound takes every LED's centre at its own Cramer-Rao bound (tests/centres/bounds.py). Printed per cell: the
median minor radius of the spots, RMSE over bound of each component (without flips) for the refined pose and of z and
the rotation about x for the linear stages (`linear_pose`: by depths, by the homography) from the same spots, NEES (6
where covariances are honest), and flips (more than 5 degrees off, nearer to the other minimum), of which silent:
`alternative` does not hold the truth. Takes minutes: the bounds are differences of rendered images.
"""

import sys

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.linear_pose import pose_by_depths, pose_by_homography
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.centres.bounds import centre_bound, pose_bound
from tests.helpers import facing_pose
from tests.rigs import make_camera, make_rig

CELLS = [(distance, tilt) for distance in (0.8, 1.2, 2.0) for tilt in (0, 15, 30, 45, 60)]
LOOK = Look(psf_px=0.85, brightness=180.0, gain=0.03, read_noise=1.2)
BLUR_PX = LOOK.psf_px


def spots_of(rig: Rig, pose: Pose) -> list[tuple[float, float, float, float]]:
    """Semi-axes (px), angle and level of every LED's image, to first order."""
    robot, f = rig.robots[0], rig.camera.matrix[0, 0]
    normal = pose.rotation[:, 2]
    told = []
    for led in pose.map(robot.leds):
        sight = led / np.linalg.norm(led)
        facing = abs(float(normal @ sight))
        # The short axis lies along the normal's image.
        u = (normal - led * normal[2] / led[2])[:2]
        a = robot.led_radius * f / led[2]
        told.append((a, a * facing, float(np.arctan2(u[0], -u[1])), LOOK.brightness * facing))
    return told


def bound_of(rig: Rig, pose: Pose, cache: dict[tuple[int, ...], Floats]) -> Floats:
    """Covariance (6, 6) of the best possible pose: translation m, rotation about the camera's axes rad."""
    covariances = []
    for a, b, angle, level in spots_of(rig, pose):
        key = (round(a * 10), round(b * 10), round(np.degrees(angle) / 15) % 12, round(level / 10))
        if key not in cache:
            cache[key] = centre_bound(
                key[0] / 10, min(key[1] / 10, key[0] / 10 - 0.02), np.radians(key[2] * 15), key[3] * 10.0, BLUR_PX
            )
        covariances.append(cache[key])

    def project(step: Floats) -> Floats:
        moved = Pose.from_matrix(exp_rotation(step[3:]) @ pose.rotation, pose.position + step[:3])
        projected: Floats = rig.camera.project(moved.map(rig.robots[0].leds))
        return projected

    return pose_bound(project, np.zeros(6), np.array(covariances))


def error_of(found: Pose, true: Pose) -> Floats:
    """(6,) m and rad about the camera's axes."""
    return np.concatenate([found.position - true.position, log_rotation(found.rotation @ true.rotation.T)])


def linear_errors(rig: Rig, result: FrameResult, answer: PoseEstimate, truth: Pose) -> list[Floats]:
    """Errors of the two linear stages on the spots that the answer rests on; far off where they give none."""
    robot, spots = rig.robots[0], list(answer.spots)
    rays, ray_covariances = np.empty((len(spots), 2)), np.empty((len(spots), 3))
    covariances = result.blobs.covariances_px2[spots]
    undistort(lens_of(rig.camera), result.blobs.centres_px[spots], covariances, rays, ray_covariances)
    errors = []
    for method in (pose_by_depths, pose_by_homography):
        T_camera_plane = method(robot.leds_plane[list(answer.leds)], rays)
        assert T_camera_plane is not None
        errors.append(error_of(T_camera_plane @ robot.T_robot_plane.inverse(), truth))
    return errors


def cell(distance: float, tilt: float, count: int, cache: dict[tuple[int, ...], Floats]) -> list[str]:
    """The figures of one distance and tilt."""
    camera = make_camera(640, 512, 1400.0)
    errors, linear, bounds, nees, radii = [], [], [], [], []
    flips = silent = located = 0
    for trial in range(count):
        rng = np.random.default_rng([round(10 * distance), round(tilt), trial])
        rig = make_rig(1, seed=trial % 12, camera=camera, range_m=(0.7 * distance, 1.4 * distance))
        sideways = facing_pose(rng, (distance, distance), (tilt, tilt))
        pose = Pose(sideways.position * np.array([0.35, 0.35, 1.0]), sideways.orientation)
        scene = Scene(rig, trial, LOOK)
        result, _ = localize(Frame(scene.render(trial, [Truth("r00", pose, (True,) * 6)]), 1, 0), rig, Tracks.none())
        answer = result.answers["r00"]
        if not isinstance(answer, PoseEstimate):
            continue
        located += 1
        error = error_of(answer.pose, pose)
        radii.append(min(spot[1] for spot in spots_of(rig, pose)))
        if np.linalg.norm(error[3:]) > np.radians(5):
            other = answer.alternative
            if other is not None and angle_between(other.pose.rotation, pose.rotation) < np.linalg.norm(error[3:]):
                flips += 1
                continue
            sigma = np.sqrt(np.linalg.eigvalsh(answer.covariance[3:, 3:])[-1])
            silent += np.linalg.norm(error[3:]) > 3 * sigma
        errors.append(error)
        linear.append(linear_errors(rig, result, answer, pose))
        bounds.append(np.diag(bound_of(rig, pose, cache)))
        nees.append(float(error @ np.linalg.solve(answer.covariance, error)))
    # Each error over its own bound: poses of one cell differ in how well they are determined.
    ratios = np.sqrt(np.mean(np.square(errors) / bounds, axis=0))
    # Both methods' z and rotation about x.
    stages = np.sqrt(np.mean(np.square(linear) / np.array(bounds)[:, None], axis=0))[:, [2, 3]].ravel()
    return [
        f"{distance:.1f}",
        f"{tilt:.0f}",
        f"{np.median(radii):.1f}",
        f"{located}/{count}",
        *(f"{ratio:.2f}" for ratio in ratios),
        *(f"{ratio:.1f}" for ratio in stages),
        f"{np.mean(nees):.1f}",
        str(flips),
        str(silent),
    ]


def main(count: int) -> None:
    """Measure and print."""
    table = Table(title="RMSE over bound, each frame alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in (
        "m",
        "deg",
        "radius px",
        "located",
        "x",
        "y",
        "z",
        "rx",
        "ry",
        "rz",
        "depths z",
        "rx",
        "homogr. z",
        "rx",
        "NEES",
        "flips said",
        "silent",
    ):
        table.add_column(heading, justify="right")
    cache: dict[tuple[int, ...], Floats] = {}
    for distance, tilt in track(CELLS, description="locating", transient=True):
        table.add_row(*cell(distance, tilt, count, cache))
    Console(width=140).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 120)
