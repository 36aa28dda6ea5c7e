"""LEDs under domes and with chips in cups: `python -m tests.measure.offset [--survey N] [--poses N] [--cups]`.

A surveyed film is rendered (tests/centres/rendering.py; every LED is seen where traced_leds.py says, 0.7 to 1.2
m, 0 to 55 degrees, 1280x1024, f = 1400 px, noise of camera and light) and given to `asterism calibrate offset`; then
other poses at 0.8 m and 45 degrees are rendered and located: LEDs without any offset, domes with the plain rig, domes
with the rig that names led.yaml.

``--cups``: LEDs with chip and reflector cup instead (cup_leds.py), of several builds; N surveyed poses and N others,
0.8 to 1.5 m, 0 to 57 degrees, every LED rendered and centred; errors of the others by the offset learned, and NEES.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.protocol.geometry import Floats, Pose, angle_between
from asterism.protocol.rig import Rig, load_rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.offset import calibrate_offset, with_offset
from asterism.server.calibration.survey.surveyed_fit import errors_of, weighted_errors
from tests.calibration.survey.cup_films import cup_pairs
from tests.calibration.survey.cup_leds import CupLed
from tests.calibration.survey.surveys import Apparent, write_frames, write_rig, write_survey
from tests.calibration.survey.traced_leds import DOME, WINDOW, seen_at
from tests.chain.frames import alone, draw, estimates
from tests.helpers import facing_pose
from tests.rigs import make_camera, make_rig
from tests.servers import asterism

CUPS = {
    "clear, chip 1.45 mm deep": CupLed(),
    "clear, chip 2.55 mm deep": CupLed(rim=2.0e-3, deep=0.7e-3),
    "clear, chip 0.85 mm deep": CupLed(rim=0.4e-3),
    "clear, wide cup": CupLed(rim=1.2e-3, deep=0.5e-3, wide=1.2e-3, narrow=0.6e-3),
    "dull cup": CupLed(rim=1.2e-3, dull=0.25, mirror=0.5),
    "3 mm": CupLed(1.5e-3, 0.8e-3, 0.35e-3, 0.5e-3, 0.25e-3, 0.11e-3, 0.1e-3, 2e-3),
}


def main() -> int:
    """Render, calibrate, locate, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.offset")
    parser.add_argument("--survey", type=int, default=120, help="surveyed frames")
    parser.add_argument("--poses", type=int, default=200, help="other frames, at 0.8 m and 45 degrees")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cups", action="store_true", help="LEDs with chip and cup instead")
    options = parser.parse_args()
    if options.cups:
        return _cups(options.survey, options.poses, options.seed)
    covers = (
        ("dome", DOME),
        ("window", WINDOW),
    )
    for name, cover in covers:
        rng = np.random.default_rng([options.seed, 5])

        def apparent(led: Floats, axis: Floats, cover=cover) -> Floats:  # type: ignore[no-untyped-def]
            return seen_at(cover, led, axis)

        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            rig = write_rig(folder, options.seed)
            surveyed = [facing_pose(rng, (0.7, 1.2), (0.0, 55.0)) for _ in range(options.survey)]
            write_frames(folder / "frames", rig, surveyed, rng, apparent)
            write_survey(folder / "truth.jsonl", "alpha", surveyed)
            done = asterism(
                *("calibrate", "offset", folder / "rig.yaml", folder / "frames", "--truth", folder / "truth.jsonl"),
                *("-o", folder / "led.yaml"),
            )
            print(f"--- {name}\n{done.stdout}{done.stderr}")
            if done.returncode:
                return 1
            text = (folder / "rig.yaml").read_text().replace("radius: 2.5e-3", "radius: 2.5e-3, offset: led.yaml")
            (folder / "with.yaml").write_text(text)
            compensated = load_rig(folder / "with.yaml")
        poses = [facing_pose(rng, (0.8, 0.8), (45.0, 45.0)) for _ in range(options.poses)]
        floor = _errors("no offset at all", rig, rig, poses, None, options.seed)
        _errors("domes, not compensated", rig, rig, poses, apparent, options.seed)
        left = _errors("domes, compensated", rig, compensated, poses, apparent, options.seed)
        print(f"compensated over no offset: x {left[0] / floor[0]:.3f}, y {left[1] / floor[1]:.3f}\n")
    return 0


def _cups(survey: int, count: int, seed: int) -> int:
    rig = make_rig(1, seed=3, camera=replace(make_camera(), distortion=np.zeros(5)))
    for name, led in CUPS.items():
        rng = np.random.default_rng([seed, 7])
        films = [[facing_pose(rng, (0.8, 1.5), (0.0, 57.0)) for _ in range(n)] for n in (survey, count)]
        learned, others = (cup_pairs(rig, poses, led, rng) for poses in films)
        found = calibrate_offset(rig, learned, name)
        given = with_offset(rig, found.offset)
        solved = solve_sightings(given, [sighting for sighting, _ in others])
        away, squared = errors_of(others, given, solved)[0], weighted_errors(others, given, solved)
        before = errors_of(others, rig, solve_sightings(rig, [sighting for sighting, _ in others]))[0]
        told = [", ".join(f"{x:.3f}" for x in 1e3 * np.sqrt(np.nanmean(e**2, axis=0))) for e in (before, away)]
        print(
            f"{name}: {len(learned)} surveyed, {len(others)} others; RMS x, y, z {told[0]} mm before, {told[1]} mm "
            f"after; NEES {np.nanmean(squared):.1f} mean, {np.nanmedian(squared):.1f} median"
        )
    return 0


def _errors(name: str, rig: Rig, given: Rig, poses: list[Pose], apparent: Apparent | None, seed: int) -> Floats:
    """RMS errors (3,) m of poses located by ``given``, each frame alone; printed."""
    rng = np.random.default_rng([seed, 6])
    away, turned = [], []
    for pose in poses:
        image = draw(rig, {"alpha": pose}, apparent=apparent).expose(rng)
        found = estimates(alone(image, given)).get("alpha")
        if found is not None:
            away.append(found.position - pose.position)
            turned.append(angle_between(found.pose.rotation, pose.rotation))
    rms: Floats = np.sqrt((np.array(away) ** 2).mean(axis=0))
    x, y, z = 1e3 * rms
    print(
        f"{name}: {len(away)} of {len(poses)} located; x {x:.4f}, y {y:.4f}, z {z:.4f} mm RMS; angle "
        f"{np.degrees(np.median(turned)):.4f} degrees median"
    )
    return rms


if __name__ == "__main__":
    sys.exit(main())
