"""How near a rolling shutter's poses come to a global one's. `python -m tests.measure.rolling [SEQUENCES]`.

Robots that move at up to 0.5 m/s and 3 rad/s, each LED rendered at its own row's time, 60 frames/s, followed. Straight:
velocity and turn stay the same. Driving: the velocity turns with the robot. Swinging: to and fro, 1 to 3 Hz. A row:
RMSE of the position across (an axis) and along the line of sight (mm) and of the rotation (degrees), NEES of the poses
that are no flips (6 where covariances are meant) and its median (5.35), poses flagged TILT_AMBIGUOUS, flips (those not
flagged), lost. Rows marked `untold`: the rig does not say that the shutter rolls.
"""

import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.capture import Capture
from asterism.server import PoseEstimate
from tests.chain.moving import KINDS, Told, followed, motions
from tests.measure.honesty import is_flipped
from tests.rigs import make_rig

FRAMES = 10
ROBOTS = 4
LINE_TIMES_US = (0.0, 10.0, 30.0)
HEADINGS = ("motion", "us/row", "frame", "across", "along", "deg", "NEES", "median", "flagged", "flips", "lost")


def cells(among: list[Told]) -> list[str]:
    """The figures of some poses."""
    found = [(told, told.answer) for told in among if isinstance(told.answer, PoseEstimate)]
    flips = [answer for told, answer in found if is_flipped(answer, told.true)]
    good = [told for told, answer in found if not is_flipped(answer, told.true)]
    errors = np.array([told.error for told in good])
    sights = np.array([told.true.position / np.linalg.norm(told.true.position) for told in good])
    along = np.einsum("ij,ij->i", errors[:, :3], sights)
    across = np.linalg.norm(errors[:, :3] - along[:, None] * sights, axis=1) / np.sqrt(2)
    turn = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
    nees = np.array([told.nees for told in good])
    silent = sum(answer.alternative is None for answer in flips)
    rms = [f"{np.sqrt(np.mean(x**2)):.3f}" for x in (1e3 * across, 1e3 * along, turn)]
    flagged = sum(answer.alternative is not None for _, answer in found)
    last = [f"{flagged}/{len(found)}", f"{len(flips)} ({silent})", str(len(among) - len(found))]
    return [*rms, f"{nees.mean():.2f}", f"{np.median(nees):.2f}", *last]


def sequences(kind: str, line_us: float, count: int, told: bool) -> list[Told]:
    """What was found in so many."""
    found = []
    for seed in track(range(count), description=f"{kind} {line_us:g}", transient=True):
        rig = replace(make_rig(ROBOTS, seed), capture=Capture(line_time_us=line_us))
        speed, spin = np.random.default_rng([seed, 8]).uniform(0, 1, 2) * [0.5, 3.0]
        moving = motions(rig, kind, np.random.default_rng([seed, 7]), speed, spin)
        found += followed(rig, moving, FRAMES, seed, told)
    return found


def main(count: int) -> None:
    """Measure and print."""
    table = Table(title="rolling shutter, followed")
    for name in HEADINGS:
        table.add_column(name, justify="right")
    for kind in KINDS:
        for line in LINE_TIMES_US:
            for told in (True, False)[: 1 + (line > 0.0)]:
                found = sequences(kind, line, count, told)
                for name, among in (("1", (0,)), ("2", (1,)), ("3", (2,)), ("4-", range(3, FRAMES))):
                    label = f"{line:g}" if told else f"{line:g} untold"
                    table.add_row(kind, label, name, *cells([each for each in found if each.index in among]))
    Console(width=130).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30)
