"""The plates of `asterism design`, judged by trying everything: `python -m tests.measure.design [ROBOTS]`.

The command runs twice: with an empty folder for compiled code (the first start on a machine), and again. Its rig is
then judged without anything of the product's search (tests/identity/separations.py): every order of every five and six
LEDs against every choice of the other's, both directions, every robot with itself, maps that mirror included.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from asterism.protocol.yaml_file import read_yaml
from tests.identity.separations import brute_force
from tests.servers import asterism

DISC, SPACING = 0.1, 0.02


def main(robots: int) -> int:
    """Run, judge, print; 1 where the command fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        asked = ("--robots", robots, "--disc", DISC, "--spacing", SPACING, "--distance", 1.5, "--sigma", 0.05)
        os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
        for start in ("first start", "compiled"):
            began = time.perf_counter()
            done = asterism("design", *asked, "-o", folder / start)
            print(f"{start}: {time.perf_counter() - began:.1f} s, whole process", flush=True)
            if done.returncode:
                print(done.stderr)
                return 1
        rigs = [read_yaml(folder / start / "rig.yaml").section("robots") for start in ("first start", "compiled")]
        assert rigs[0].values == rigs[1].values, "the same request gave two rigs"
        layouts = [np.array(part.rows("leds", 3, ""))[:, :2] for part in rigs[0].sections().values()]
    apart = np.linalg.norm(np.array(layouts)[:, :, None] - np.array(layouts)[:, None], axis=-1) + np.eye(6)
    farthest = max(float(np.linalg.norm(layout, axis=1).max()) for layout in layouts)
    print(
        f"{len(layouts)} plates: LEDs {1e3 * apart.min():.3f} mm apart, {1e3 * farthest:.2f} mm from the centre at most"
    )
    itself = np.eye(len(layouts), dtype=bool)
    for mirrors in (False, True):
        for hidden in (0, 1):
            found = brute_force(layouts, hidden, mirrors)
            pairs = f"{1e3 * found[~itself].min():.3f} mm between robots, " if len(layouts) > 1 else ""
            print(
                f"{'one LED hidden' if hidden else 'all LEDs visible'}{', mirror images too' if mirrors else ''}: "
                f"{pairs}{1e3 * found[itself].min():.3f} mm from itself"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
