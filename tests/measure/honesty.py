"""Are covariances meant, and tilts never wrong in silence? `python -m tests.measure.honesty [POSES PER ROW]`.

One robot at a time, rendered, located alone, compared with the truth; all six LEDs lit or one hidden, bright or dim.
A row: NEES, the squared error of the pose weighted by its covariance (6 where covariances are meant), of the poses that
are no flips, with its standard error and its median (5.35); the same of the spots' centres (2), before the pose stage;
the share of poses whose residuals surprised the pose stage; poses flagged TILT_AMBIGUOUS; wrong minimum, that is nearer
the other tilt and more than 5 degrees off: of the flagged ones, of the others (silent). The last line sums up.
"""

import sys
from dataclasses import dataclass, field, replace

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Pose, log_rotation
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.chain.judging import TILTED_RAD
from tests.helpers import conic_centres, facing_pose
from tests.rigs import make_camera, make_rig

BRIGHT = Look(psf_px=0.85, brightness=180.0, gain=0.03, read_noise=1.2)
DIM = replace(BRIGHT, brightness=40.0, read_noise=2.0)
LOOKS = {"bright": BRIGHT, "dim": DIM}
DISTANCES = ((0.6, 0.9), (0.9, 1.4), (1.4, 2.0))
TILTS = ((0, 15), (15, 30), (30, 45), (45, 60))
RIGS = 8


@dataclass
class Row:
    """What one kind of frames gave."""

    tried: int = 0
    nees: list[float] = field(default_factory=list)
    spots: list[float] = field(default_factory=list)  # squared error of centres weighted by their covariance
    flagged: int = 0
    flips: int = 0
    silent: int = 0

    def add(self, other: "Row") -> None:
        """Count another row's poses in."""
        self.tried += other.tried
        self.nees += other.nees
        self.spots += other.spots
        self.flagged += other.flagged
        self.flips += other.flips
        self.silent += other.silent

    def cells(self) -> list[str]:
        """The figures as the table shows them."""
        nees = np.array(self.nees)
        found = len(nees) + self.flips + self.silent
        return [
            f"{found}/{self.tried}",
            f"{nees.mean():.2f} ±{nees.std() / np.sqrt(len(nees)):.2f}",
            f"{np.median(nees):.2f}",
            f"{np.mean(self.spots):.2f}",
            f"{np.median(self.spots):.2f}",
            str(self.flagged),
            str(self.flips),
            str(self.silent),
        ]


def is_flipped(answer: PoseEstimate, truth: Pose) -> bool:
    """Whether the pose is the other minimum: its normal is nearer the true one's mirror image in the line of sight."""
    sight = truth.position / np.linalg.norm(truth.position)
    normal = truth.rotation[:, 2]
    mirrored = 2.0 * (normal @ sight) * sight - normal
    found = answer.pose.rotation[:, 2]
    return bool(found @ mirrored > found @ normal and np.arccos(min(found @ normal, 1.0)) > TILTED_RAD)


def measure(
    look: Look, hidden: int, distance: tuple[float, float], tilt: tuple[float, float], count: int, scenes: list[Scene]
) -> Row:
    """Render and locate ``count`` poses."""
    row = Row()
    for trial in range(count):
        rng = np.random.default_rng([round(look.brightness), hidden, round(10 * distance[0]), round(tilt[0]), trial])
        scene = scenes[trial % len(scenes)]
        robot = scene.rig.robots[0]
        sideways = facing_pose(rng, distance, tilt)
        pose = Pose(sideways.position * np.array([0.35, 0.35, 1.0]), sideways.orientation)
        # The tilt is against the line of sight, which the move to the middle turned.
        lit = np.ones(6, np.bool_)
        lit[rng.permutation(6)[:hidden]] = False
        image = scene.render(trial, [Truth(robot.id, pose, tuple(lit.tolist()))])
        result, _ = localize(Frame(image, 1, 0), scene.rig, Tracks.none())
        answer = result.answers[robot.id]
        row.tried += 1
        if not isinstance(answer, PoseEstimate):
            continue
        row.flagged += answer.alternative is not None
        if is_flipped(answer, pose):
            row.flips += answer.alternative is not None
            row.silent += answer.alternative is None
            continue
        error = np.concatenate([answer.position - pose.position, log_rotation(answer.pose.rotation @ pose.rotation.T)])
        row.nees.append(float(error @ np.linalg.solve(answer.covariance, error)))
        radius = robot.led_radius or 0.0
        rays = conic_centres(pose, robot.leds, radius)[list(answer.leds)]
        pixels = scene.rig.camera.project(np.column_stack([rays, np.ones(len(rays))]))
        spots = list(answer.spots)
        for off, (xx, xy, yy) in zip(
            result.blobs.centres_px[spots] - pixels, result.blobs.covariances_px2[spots], strict=True
        ):
            row.spots.append(float(off @ np.linalg.solve([[xx, xy], [xy, yy]], off)))
    return row


def scenes_of(look: Look) -> list[Scene]:
    """Several robots, each alone before the camera."""
    camera = make_camera(640, 512, 1400.0)
    rigs: list[Rig] = [make_rig(1, seed=seed, camera=camera, range_m=(0.5, 2.5)) for seed in range(RIGS)]
    return [Scene(rig, seed, replace(look)) for seed, rig in enumerate(rigs)]


def main(count: int) -> None:
    """Measure and print."""
    table = Table(title="each frame alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("look", "hidden", "m", "deg", "located", "NEES", "median", "of spots", "median"):
        table.add_column(heading, justify="right")
    for heading in ("flagged", "flips said", "silent"):
        table.add_column(heading, justify="right")
    kinds = [(name, hidden, d, t) for name in LOOKS for hidden in (0, 1) for d in DISTANCES for t in TILTS]
    scenes = {name: scenes_of(look) for name, look in LOOKS.items()}
    everything = Row()
    sums: dict[tuple[str, int], Row] = {}
    for name, hidden, distance, tilt in track(kinds, description="locating", transient=True):
        row = measure(LOOKS[name], hidden, distance, tilt, count, scenes[name])
        table.add_row(name, str(hidden), f"{distance[0]}-{distance[1]}", f"{tilt[0]}-{tilt[1]}", *row.cells())
        everything.add(row)
        sums.setdefault((name, hidden), Row()).add(row)
    table.add_section()
    for (name, hidden), row in sums.items():
        table.add_row(name, str(hidden), "", "", *row.cells())
    table.add_row("all", "", "", "", *everything.cells())
    Console(width=120).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
