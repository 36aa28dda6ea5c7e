"""Image in, poses out: the chain (pure) and its rim (sources, sinks, threads, command line).

    Frame -> Blobs -> Matches -> PoseEstimate | Lost -> FrameResult -> messages -> zenoh, MCAP, rerun

    from asterism.server import Frame, Tracks, load_rig, localize
    rig, tracks = load_rig("rig.yaml"), Tracks.none()
    result, tracks = localize(Frame(image, exposed_ns=0, index=0), rig, tracks)

Frames, axes and units: see `asterism.protocol`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from asterism.protocol.rig import Rig, load_rig
    from asterism.server.chain.frame import Frame, FrameResult
    from asterism.server.chain.pipeline import localize
    from asterism.server.pose.solve import Lost, PoseEstimate
    from asterism.server.pose.track import Tracks

# The command line must start at once, so what is heavy (numba, OpenCV) is imported when it is first asked for.
_HOMES = {
    "Rig": "asterism.protocol.rig",
    "load_rig": "asterism.protocol.rig",
    "Frame": "asterism.server.chain.frame",
    "FrameResult": "asterism.server.chain.frame",
    "localize": "asterism.server.chain.pipeline",
    "Lost": "asterism.server.pose.solve",
    "PoseEstimate": "asterism.server.pose.solve",
    "Tracks": "asterism.server.pose.track",
}

__all__ = ["Frame", "FrameResult", "Lost", "PoseEstimate", "Rig", "Tracks", "load_rig", "localize"]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
