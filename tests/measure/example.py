"""From a bare camera to calibrated poses: `python -m tests.measure.example [--seeds N] [options]`.

Of every seed the folder that `asterism example` writes, with all commands of its README.md run in it. The poses of the
check film, which nothing was fitted to, beside its truth: RMS errors along the camera's axes, before (rig3) and after
`calibrate z` (rig4), and the squared error over the covariances (NEES; 6 is honest): the chain's own and the budget's,
as `asterism report --truth` prints them. The README's films have the same noise in every folder; --films gives every
seed its own. With --keep DIR the folders and what was printed (README.log) stay; --first is the seed to begin with.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from asterism.protocol.rig import load_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.budget import Light
from asterism.server.budget.truth import Compared, compare, light_of
from asterism.server.budget.uncertainty import read_uncertainty
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.survey.survey import match_frames, read_survey
from asterism.server.sources.open_source import open_source
from tests.command.pasting import commands_of, paste

CHECK = "check"


def main() -> int:
    """Every seed's line, then the means."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.example")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed to begin with")
    parser.add_argument("--films", action="store_true", help="every seed its own films")
    parser.add_argument("--keep", type=Path, metavar="DIR")
    options = parser.parse_args()
    print("      before calibrate z           after it                     lost   NEES before         after")
    print("seed    x mm   y mm   z mm    deg    x mm   y mm   z mm    deg       chain's budget's chain's budget's    s")
    rows = []
    for seed in range(options.first, options.first + options.seeds):
        if options.keep:
            row = _one(seed, options.films, options.keep / f"seed{seed}")
        else:
            with tempfile.TemporaryDirectory() as name:
                row = _one(seed, options.films, Path(name) / "try")
        print(f"{seed:4d}  " + _line(row), flush=True)
        rows.append(row)
    print("mean  " + _line(np.mean(rows, axis=0)))
    after = np.array(rows)[:, 11]
    print(f"NEES of the chain's covariances after it: mean {after.mean():.2f}, {after.min():.2f} to {after.max():.2f}")
    return 0


def _one(seed: int, films: bool, folder: Path) -> np.ndarray:
    began = time.monotonic()
    folder.parent.mkdir(parents=True, exist_ok=True)
    told = paste(["example", str(folder.resolve()), "--seed", str(seed)], folder.parent)
    for words in commands_of(folder):
        if words[0] == "simulate" and films:
            words += ["--seed", str(100 * (seed + 1) + int(words[-1] if "--seed" in words else 0))]
        if words[0] not in ("example", "report", "locate"):
            told += f"\n$ asterism {' '.join(words)}\n" + paste(words, folder)
    (folder / "README.log").write_text(told)
    before, after = (_judged(folder / name) for name in ("rig3.yaml", "rig4.yaml"))
    seconds = time.monotonic() - began
    missed = after.lost + after.flips
    return np.array([*_rms(before), *_rms(after), missed, *before.nees[::-1], *after.nees[::-1], seconds])


def _judged(rig_path: Path) -> Compared:
    """What `asterism report` compares."""
    rig, folder = load_rig(rig_path), rig_path.parent
    camera = folder / parse_yaml(rig.rig_text, str(rig_path)).text("camera")
    uncertainty = read_uncertainty(rig_path, rig.centre, camera)
    source = open_source(str(folder / CHECK / "frames"), rig, print)
    seen = [(frame.name, sightings) for frame, sightings in observe(source.frames(), rig)]
    survey = read_survey(folder / CHECK / "truth.jsonl", [robot.id for robot in rig.robots])
    matched = match_frames(survey, [name for name, _ in seen], source.name)
    light = light_of(rig, Light.assumed(rig.centre), [sighting for _, sightings in seen for sighting in sightings])
    return compare(rig, seen, matched.frames, uncertainty, light)


def _rms(compared: Compared) -> list[float]:
    square = np.square(compared.errors)
    return [*(1e3 * np.sqrt(square[:, :3].mean(axis=0))), float(np.degrees(np.sqrt(square[:, 3:].sum(axis=1).mean())))]


def _line(row: np.ndarray) -> str:
    before, after = (" ".join(f"{value:6.3f}" for value in row[k : k + 4]) for k in (0, 4))
    return f"{before}  {after} {row[8]:4.1f} {row[9]:8.0f} {row[10]:8.2f} {row[11]:7.2f} {row[12]:8.2f} {row[13]:4.0f}"


if __name__ == "__main__":
    sys.exit(main())
