"""LED positions from films, through `asterism calibrate leds`: `python -m tests.measure.leds [FILMS] [--frames N]`.

Every film is rendered anew (another constellation, another motion, another start, every LED 1 mm off), at 0.8 to 1.5 m,
1280x1024, f = 1400 px. "weighted": the squared errors weighted by the covariance that belongs to the published standard
deviations, 11 on average where these are honest.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from asterism.protocol.rig import load_rig
from asterism.server.calibration.leds.calibration import calibrate_leds
from asterism.server.calibration.leds.gauge import Gauge, rigid_fit
from asterism.server.simulation.simulate import Look
from asterism.server.sources.open_source import open_source
from tests.calibration.leds.films import write_film
from tests.servers import asterism


def main() -> int:
    """Render, run, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.leds")
    parser.add_argument("films", nargs="?", type=int, default=3)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--hide", type=float, default=0.0)
    parser.add_argument("--glints", type=int, default=0)
    parser.add_argument("--off", type=float, default=1e-3, help="of every LED at the start, m")
    options = parser.parse_args()
    for seed in range(100, 100 + options.films):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "film"
            look = Look(hidden=options.hide, glints=options.glints)
            true = write_film(folder, options.frames, seed, look=look, off_m=options.off).robots[0].leds
            metres = float(np.linalg.norm(true[0] - true[3]))
            out = folder / "out.yaml"
            done = asterism(
                *("calibrate", "leds", folder / "rig.yaml", folder / "frames", "--robot", "alpha"),
                *("--distance", f"0,3={metres:.7f}", "-o", out),
            )
            if done.returncode:
                print(f"film {seed}: {done.stderr.strip()}")
                continue
            found, given = load_rig(out).robots[0].leds, load_rig(folder / "rig.yaml").robots[0].leds
            rig = load_rig(folder / "rig.yaml")
            frames = list(open_source(str(folder / "frames"), rig, print).frames())
            adjusted = calibrate_leds(rig, "alpha", lambda f=frames: f, "film", Gauge(given, (0, 3, metres))).adjusted
        off = _off(adjusted.leds, given, true).ravel()
        weighted = off @ np.linalg.pinv(adjusted.covariance, rcond=1e-8, hermitian=True) @ off
        start, end = (np.linalg.norm(_off(leds, true, true), axis=1) for leds in (given, found))
        print(
            f"film {seed}: {options.frames} frames, start {1e3 * _rms(start):.3f} mm RMS, result {1e3 * _rms(end):.4f} "
            f"mm RMS, {1e3 * end.max():.4f} at most; weighted {weighted:.1f}; {done.stdout.splitlines()[0]}"
        )
    return 0


def _off(leds: np.ndarray, frame: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Errors (6, 3), m, after the best rigid fit of both to ``frame``."""
    placed = [points @ turn.T + shift for points in (leds, true) for turn, shift in [rigid_fit(points, frame)]]
    off: np.ndarray = placed[0] - placed[1]
    return off


def _rms(lengths: np.ndarray) -> float:
    return float(np.sqrt((lengths**2).mean()))


if __name__ == "__main__":
    sys.exit(main())
