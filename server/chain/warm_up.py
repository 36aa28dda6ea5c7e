"""Compile the chain before it is needed: the first time on a machine that takes a while, and is said."""

import contextlib
import sys

from asterism.protocol.rig import load_rig
from asterism.server.kernel_folder import kernel_folder as cache_folder


def warm_up() -> None:
    """Run every compiled function once; what is compiled is kept on disk for the next start."""
    done = cache_folder() / "complete"
    if not done.exists():
        print(
            "compiling the chain for this machine (only the first time; about a minute) ...",
            file=sys.stderr,
            flush=True,
        )
    _run()
    # Where nothing can be kept, the next start says so again.
    with contextlib.suppress(OSError):
        done.touch()


def _run() -> None:
    from dataclasses import replace

    from asterism.server.chain.frame import Frame
    from asterism.server.chain.pipeline import localize
    from asterism.server.pose.track import Tracks
    from asterism.server.simulation.demo_rig import DEMO_RIG
    from asterism.server.simulation.simulate import Look, Scene

    rig = load_rig(DEMO_RIG)
    # Hidden LEDs and glints make sure that the rarer paths (rivals, touching spots) are compiled as well.
    scene = Scene(rig, seed=1, look=Look(hidden=0.05, glints=20))
    tracks = Tracks.none()
    for index in range(2):
        image = scene.render(index, scene.truth(index, index / 60.0))
        for estimator in ("edge-model",):
            frame = Frame(image, index * 16_666_667 + 1, index)
            _, after = localize(frame, replace(rig, centre=estimator), tracks)
        tracks = after
    four = [replace(entry, lit=(True,) * 4 + (False,) * 2) for entry in scene.truth(2, 0.0)]
    localize(Frame(scene.render(2, four), 1, 2), rig, Tracks.none())
