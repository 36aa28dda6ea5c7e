"""How often is the wrong minimum published in silence? `python -m tests.measure.flips [POSES PER ROW]`.

Poses of one robot each, cold, no prior, with noise on the spots that the solver knows, and in the last rows LEDs that
lie 0.05 mm off what the rig says, which it does not. Wrong: nearer the other tilt and more than 5 degrees off. Printed:
how many are flagged TILT_AMBIGUOUS, how many of those are wrong, how many others are and lie beyond their covariance
(silent), and that per thousand of the poses that are not flagged. `tests.measure.honesty` counts the same in rendered
frames.
"""

import sys

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, log_rotation
from asterism.server.chain.answers import SURE
from asterism.server.pose.lens import lens_of
from asterism.server.pose.linear_pose import pose_by_homography
from asterism.server.pose.matched import Constellations, Matched, Measured
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import OPTICS
from tests.chain.judging import TILTED_RAD
from tests.helpers import facing_pose
from tests.measure.silent import FAR
from tests.rigs import make_camera, random_layout

LAYOUTS = 200
TILTS = ((0.0, 5.0), (5.0, 15.0), (15.0, 45.0))
KINDS = [
    (distance, tilt, sigma_px, hidden, 0.0)
    for distance in (1.2, 2.0)
    for tilt in TILTS
    for sigma_px in (0.01, 0.02, 0.05, 0.1)
    for hidden in (0, 1)
] + [(distance, tilt, 0.01, 0, 5e-5) for distance in (1.2, 2.0) for tilt in TILTS]


def count_flips(
    distance: float, tilt: tuple[float, float], sigma_px: float, hidden: int, led_error_m: float, count: int
) -> Floats:
    """Poses, flagged ones, wrong ones among those, wrong ones among the others."""
    rng = np.random.default_rng([round(10 * distance), round(tilt[1]), round(1e3 * sigma_px), hidden])
    camera, sigma = make_camera(), sigma_px / 1400
    flat = [random_layout(rng) for _ in range(LAYOUTS)]
    layouts, poses, starts, rays = np.zeros((count, 6, 3)), [], [], np.empty((6 * count, 2))
    for k in range(count):
        layouts[k, :, :2] = flat[k % LAYOUTS] - flat[k % LAYOUTS].mean(axis=0)
        pose = facing_pose(rng, (distance, distance), tilt)
        mapped = pose.map(layouts[k] + led_error_m * rng.standard_normal((6, 3)) * [1, 1, 0])
        rays[6 * k : 6 * k + 6] = mapped[:, :2] / mapped[:, 2:] + sigma * rng.standard_normal((6, 2))
        poses.append(pose)
        # What a frame gives, and nothing of the truth: the linear pose, of either tilt.
        start = pose_by_homography(layouts[k, hidden:], rays[6 * k + hidden : 6 * k + 6])
        assert start is not None, "six LEDs of a random plate are not on a line"
        starts.append(start)
    assignment = np.arange(6 * count).reshape(count, 6)
    assignment[:, :hidden] = -1
    ray_covariances = np.tile([sigma**2, 0.0, sigma**2], (6 * count, 1))
    pixels = camera.project(np.column_stack([rays, np.ones(len(rays))]))
    rotations, ts = np.array([start.rotation for start in starts]), np.array([start.position for start in starts])
    matched, solutions = Matched(np.arange(count), assignment, rotations, ts), Solutions.room(count)
    constellations, measured = (
        Constellations(layouts, np.zeros((count, OPTICS))),
        Measured(rays, ray_covariances, pixels),
    )
    solve_robots(lens_of(camera), constellations, matched, measured, solutions)
    told = np.zeros(4)
    for k, pose in enumerate(poses):
        first, second = solutions.costs[k]
        best = 0 if first <= second else 1
        rotation = solutions.rotations[k, best]
        found = rotation[:, 2]
        flagged = abs(first - second) < 2.0 * np.log(SURE)
        sight, normal = pose.position / np.linalg.norm(pose.position), pose.rotation[:, 2]
        mirrored = 2.0 * (normal @ sight) * sight - normal
        wrong = found @ mirrored > found @ normal and np.arccos(min(found @ normal, 1.0)) > TILTED_RAD
        error = np.append(solutions.ts[k, best] - pose.position, log_rotation(rotation @ pose.rotation.T))
        beyond = error @ np.linalg.solve(solutions.covariances[k, best], error) > FAR
        told += [1, flagged, wrong and flagged, wrong and not flagged and beyond]
    return told


def cells(told: Floats) -> list[str]:
    """The figures as the table shows them."""
    poses, flagged, _, silent = told
    return [f"{value:.0f}" for value in told] + [f"{1e3 * silent / max(poses - flagged, 1):.2f}"]


def main(count: int) -> None:
    """Measure and print."""
    table = Table(title="the wrong minimum, each pose alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("m", "deg", "noise px", "hidden", "LEDs off mm", "poses", "flagged", "wrong", "silent", "per 1000"):
        table.add_column(heading, justify="right")
    known, unknown = np.zeros(4), np.zeros(4)
    for kind in track(KINDS, description="solving", transient=True):
        distance, tilt, sigma_px, hidden, led_error_m = kind
        told = count_flips(*kind, count)
        known, unknown = (known + told, unknown) if led_error_m == 0.0 else (known, unknown + told)
        where = [f"{distance:.1f}", f"{tilt[0]:.0f}-{tilt[1]:.0f}", f"{sigma_px:g}", str(hidden)]
        table.add_row(*where, f"{1e3 * led_error_m:g}", *cells(told))
    table.add_section()
    table.add_row("all", "", "", "", "0", *cells(known))
    table.add_row("all", "", "", "", "0.05", *cells(unknown))
    Console(width=110).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
