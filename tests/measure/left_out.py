"""What `asterism calibrate offset` is worth on poses that it did not see:
`python -m tests.measure.left_out FOLDER [SPLITS]`.

FOLDER holds `rig.yaml`, `frames/` and surveyed `truth.jsonl`. Its sightings are dealt into thirds, SPLITS times
(default 3, seeded); each third is located, every frame alone, with the offset that the other two taught. Printed:
located, RMS errors (mm) and NEES without an offset, of every third, and of all thirds together.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from asterism.protocol.led_offset import LedOffset, parse_offset
from asterism.protocol.rig import load_rig
from asterism.server.calibration.survey.offset import with_offset
from tests.chain.judging import Judged, judge, truth_of
from tests.servers import asterism


def learned(folder: Path, kept: set[str], place: Path) -> LedOffset:
    """What the sightings in ``kept`` teach."""
    lines = []
    for entry in truth_of(folder):
        robots = [robot for robot in entry["robots"] if f"{entry['frame']} {robot['id']}" in kept]
        lines.append(json.dumps({**entry, "robots": robots}))
    survey, out = place / "kept.jsonl", place / "led.yaml"
    survey.write_text("\n".join(lines) + "\n")
    files = (folder / "rig.yaml", folder / "frames", "--truth", survey)
    done = asterism("calibrate", "offset", *files, "-o", out, "--force")
    if done.returncode:
        sys.exit(done.stderr)
    return parse_offset(out.read_text(), out.name)


def told(name: str, robots: list[Judged]) -> None:
    """A line of figures."""
    right = [robot for robot in robots if robot.answer is not None and not robot.wrong]
    x, y, z = 1e3 * np.sqrt(np.mean([robot.error[:3] ** 2 for robot in right], axis=0))
    nees = np.mean([robot.nees for robot in right if not robot.tilted])
    wrong = sum(robot.wrong for robot in robots)
    figures = f"RMS {x:.3f} / {y:.3f} / {z:.3f} mm, NEES {nees:.1f}"
    print(f"{name}: {len(right)} of {len(robots)} located, {wrong} wrong; {figures}", flush=True)


def main(folder: Path, splits: int = 3) -> None:
    """Deal, learn, locate, print."""
    rig = load_rig(folder / "rig.yaml")
    named = {robot.where.partition("/")[2]: robot for robot in judge(folder) if robot.true is not None}
    told("no offset", list(named.values()))
    names, everything = sorted(named), []
    for split in range(splits):
        order = np.random.default_rng([split, 17]).permutation(len(names))
        for part in np.array_split(order, 3):
            left = {names[k] for k in part}
            with tempfile.TemporaryDirectory() as place:
                given = with_offset(rig, learned(folder, set(names) - left, Path(place)))
            judged = [robot for robot in judge(folder, given) if robot.where.partition("/")[2] in left]
            told(f"split {split}", judged)
            everything += judged
    told("all left out", everything)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(word) for word in sys.argv[2:]))
