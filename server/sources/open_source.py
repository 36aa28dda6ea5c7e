"""From what a person names to the source it is."""

import logging
import re
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.sources.files import ImageFiles, image_files
from asterism.server.sources.foreign.network import SCHEME, NetworkImages
from asterism.server.sources.foreign.ros_images import ROS_SCHEME, RosImages, is_ros
from asterism.server.sources.foreign.topic_frames import ForeignFrames, holds_topics, open_topics
from asterism.server.sources.genicam.camera import genicam_camera
from asterism.server.sources.genicam.listing import PREFIX
from asterism.server.sources.images import EXTENSIONS
from asterism.server.sources.recorded import RecordedFrames
from asterism.server.sources.simulated import Simulated
from asterism.server.sources.source import Say, Source
from asterism.server.sources.v4l2.camera import v4l2_camera
from asterism.server.sources.v4l2.place import is_v4l2
from asterism.server.sources.video import VideoFile

_LOG = logging.getLogger(__name__)


def open_source(
    text: str, rig: Rig | None, say: Say, seed: int = 0, topic: str | None = None, ros_domain: int = 0
) -> Source:
    """The source that a person names: `0`, `/dev/video0`, `genicam:...`, a folder or glob of images, a video, a
    recording, `sim`, an MCAP file or a bag with images on a ``topic`` (None: the only one), or images of the network,
    `zenoh:KEY` or `ros2:TOPIC` in ``ros_domain``, which `ArrivingImages.join` must be told the session of.

    Without a rig images may be of any size, all of the same, and there is nothing to simulate.

    Raises InputError when it is none of these, WorldError when a camera does not open.
    """
    path = Path(text)
    if holds_topics(path) and (topic is not None or not _is_recorded(path)):
        source: Source = ForeignFrames(text, open_topics(path), topic, rig, say)
    elif topic is not None:
        raise InputError(f"--topic {topic}: {text} has no topics; they are in MCAP files and bags of ROS")
    else:
        source = (
            RosImages(text.removeprefix(ROS_SCHEME), ros_domain, rig, say)
            if is_ros(text)
            else _open(text, rig, say, seed)
        )
    many = "frames without end" if source.length is None else f"{source.length} frames"
    _LOG.debug("%s is a %s: %s at %g Hz", text, type(source).__name__, many, source.rate_hz)
    return source


def _open(text: str, rig: Rig | None, say: Say, seed: int) -> Source:
    if text == "sim" and rig is not None:
        return Simulated(rig, seed)
    if text.startswith(SCHEME):
        return NetworkImages(text.removeprefix(SCHEME), rig, say)
    if is_v4l2(text):
        return v4l2_camera(text, rig, say)
    if text.startswith(PREFIX):
        return genicam_camera(text, rig, say)
    path = Path(text)
    if path.is_dir():
        if any(map(_is_recorded, path.glob("*.mcap"))):
            return RecordedFrames(path, rig, say)
        if any(path.glob("*.mcap")):
            raise InputError(
                f"{text}: holds MCAP files, but is neither a recording (poses-0001.mcap) nor a bag (metadata.yaml); "
                "name one of the files"
            )
        return image_files(text, [entry for entry in path.iterdir() if entry.is_file()], rig, say)
    if path.is_file():
        if path.suffix.lower() in EXTENSIONS:
            return ImageFiles(text, [path], rig, say)
        if path.suffix.lower() == ".mcap":
            raise InputError(f"{text}: is one file of a recording, expected the recording's folder {path.parent}")
        return VideoFile(path, rig, say)
    if any(char in text for char in "*?["):
        base = Path(path.anchor) if path.is_absolute() else Path()
        return image_files(text, list(base.glob(str(path.relative_to(base)))), rig, say)
    raise InputError(
        f"{text}: there is no such source; expected a camera (0, /dev/video0 or a link, genicam:SERIAL, zenoh:KEY, "
        "ros2:TOPIC), a folder or glob of images, a video, a recording, an MCAP file or a ROS bag, or sim"
    )


def _is_recorded(path: Path) -> bool:
    """Whether a file is named as those of a recording are, or a folder holds such files."""
    if path.is_dir():
        return any(map(_is_recorded, path.glob("*.mcap")))
    return re.fullmatch(r"(poses|frames)-\d+\.mcap", path.name) is not None


def is_endless(text: str) -> bool:
    """Whether a source never ends: a camera, the network, the simulator."""
    return text == "sim" or text.startswith((SCHEME, ROS_SCHEME, PREFIX)) or is_v4l2(text)


def refuse_endless(text: str, command: str) -> None:
    """Raise InputError for a source that never ends; ``command`` is what cannot use it."""
    if is_endless(text):
        raise InputError(
            f"{text}: has no end; {command} takes a folder or glob of images, a video, a recording, an MCAP file or "
            f"a ROS bag ({typed('simulate')} makes images)"
        )
