"""Z with a rig that is off: `python -m tests.measure.z [--seeds N] [--survey N] [--sigma PX] [--render]`.

The true rig (f = 1400 px, k1 = -0.11, six LEDs about a circle of 100 mm; --disc: anywhere in it) is given with f off by
0.3 %, the principal point by 3/-2 px, k1 by 5 % and every LED by 0.05 mm. Surveyed poses at 0.8 to 2 m, tilted by 0 to
45 degrees, centres with noise of 0.02 px, go into the physical refit and, by itself, into the super-plane; Z errors are
those of 1500 other poses. "floor": the true rig on the same noisy centres. The same once more with nothing off.

With --render the surveyed film is rendered and goes through `asterism calibrate z`, with --no-refit and without.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.z_correction import ZCorrection
from asterism.server.calibration.survey.refit import refit
from asterism.server.calibration.survey.super_plane import choose_plane, fit_plane
from asterism.server.calibration.survey.surveyed import Pairs
from tests.calibration.survey.surveys import (
    off_rig,
    rim_layout,
    survey_pairs,
    write_frames,
    write_off_rig,
    write_rig,
    write_survey,
    z_errors,
)
from tests.helpers import facing_pose
from tests.servers import asterism

EVALUATED = 1500


def main() -> int:
    """Simulate, fit, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.z")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--survey", type=int, default=60, help="surveyed poses")
    parser.add_argument("--sigma", type=float, default=0.02, help="of every centre, px")
    parser.add_argument("--disc", action="store_true", help="LEDs anywhere in the disc, not about its rim")
    parser.add_argument("--render", action="store_true")
    options = parser.parse_args()
    for off in (True, False):
        print(f"--- {'rig off' if off else 'nothing off'}; Z errors, mm RMS (over the floor's)")
        for seed in range(options.seeds):
            _simulated(seed, off, options.survey, options.sigma, options.disc)
    if options.render:
        _rendered(options.survey, options.sigma)
    return 0


def _simulated(seed: int, off: bool, survey: int, sigma: float, disc: bool) -> None:
    rng = np.random.default_rng([seed, 9])
    with tempfile.TemporaryDirectory() as folder:
        true = write_rig(Path(folder), seed, layout=None if disc else rim_layout(seed))
    given = off_rig(true, rng) if off else true
    pairs = survey_pairs(true, given, [facing_pose(rng) for _ in range(survey)], rng, sigma)
    others = [facing_pose(rng) for _ in range(EVALUATED)]

    def rms(rig: Rig, correction: ZCorrection | None = None) -> float:
        noise = np.random.default_rng([seed, 10])
        return _rms(survey_pairs(true, rig, others, noise, sigma), correction)

    floor, raw = rms(true), rms(given)
    found = refit(given, pairs)
    kept = found.rig if found.better else given
    refitted = rms(kept)
    places, errors, variances = z_errors(pairs)
    chosen = choose_plane(places, errors, variances)
    planes = {kind: rms(given, fit_plane(kind, places, errors, variances)) for kind in ("plane", "quadric")}
    alone = rms(given, chosen.correction)
    resolved = survey_pairs(true, kept, [told.pose for _, told in pairs], np.random.default_rng([seed, 11]), sigma)
    last = choose_plane(*z_errors(resolved)).correction
    both = rms(kept, last)
    print(
        f"seed {seed}: floor {floor:.4f}, as given {raw:.4f} ({raw / floor:.2f}); refit"
        f"{'' if found.better else ' (not kept)'} {refitted:.4f} ({refitted / floor:.3f}); "
        f"super-plane alone: plane {planes['plane']:.4f} ({raw / planes['plane']:.1f} times better), quadric "
        f"{planes['quadric']:.4f} ({raw / planes['quadric']:.1f}), chosen "
        f"{chosen.correction.kind if chosen.correction else 'none'} {alone:.4f} ({raw / alone:.1f}); refit and plane "
        f"({last.kind if last else 'none'}) {both:.4f} ({both / floor:.3f})"
    )


def _rms(pairs: Pairs, correction: ZCorrection | None) -> float:
    places, errors, _ = z_errors(pairs)
    if correction is not None:
        errors = errors - correction.at(places).dz
    return 1e3 * float(np.sqrt((errors**2).mean()))


def _rendered(survey: int, sigma: float) -> None:
    rng = np.random.default_rng(12)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true = write_rig(folder / "true", 4, layout=rim_layout(4))
        given = off_rig(true, rng)
        write_off_rig(folder, true, given)
        poses = [facing_pose(rng) for _ in range(survey)]
        write_frames(folder / "frames", true, poses, rng)
        write_survey(folder / "truth.jsonl", "alpha", poses)
        others = [facing_pose(rng) for _ in range(EVALUATED)]
        for title, more in (("", ()), ("--no-refit", ("--no-refit",)), ("--no-plane", ("--no-plane",))):
            out = folder / f"out{title}.yaml"
            done = asterism(
                *("calibrate", "z", folder / "rig.yaml", folder / "frames", "--truth", folder / "truth.jsonl"),
                *(*more, "-o", out),
            )
            print(f"--- rendered film, asterism calibrate z {title}\n{done.stdout}{done.stderr}")
            results = []
            for rig in (true, given, load_rig(out)):
                pairs = survey_pairs(true, rig, others, np.random.default_rng(13), sigma)
                results.append(_rms(pairs, rig.z_correction))
            print(
                f"1500 other poses: floor {results[0]:.4f}, as given {results[1]:.4f}, new rig {results[2]:.4f} mm RMS"
            )


if __name__ == "__main__":
    sys.exit(main())
