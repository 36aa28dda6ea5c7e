"""Frames from MCAP files and bags of other programs: one topic with images."""

from collections.abc import Iterator
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from statistics import median

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.depth import Depth
from asterism.server.sources.foreign.image_messages import IMAGE_NAMES, IMAGE_TYPES, BadEncoding, picture
from asterism.server.sources.foreign.mcap_files import McapFiles
from asterism.server.sources.foreign.ros_bags import RosFiles, is_bag, open_folder
from asterism.server.sources.foreign.ros_messages import BadMessage
from asterism.server.sources.foreign.topics import Topics, chosen, shown
from asterism.server.sources.images import to_grey8
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, Say

SUFFIXES = (".mcap", ".db3", ".bag")
RATE_MESSAGES = 20  # whose spacing tells the rate


def holds_topics(path: Path) -> bool:
    """Whether a file or folder is of a kind that holds topics."""
    return path.suffix.lower() in SUFFIXES if path.is_file() else is_bag(path)


def open_topics(path: Path) -> Topics:
    """The topics of an MCAP file, a rosbag2 folder or one of its files, or a ROS 1 bag. Raises InputError."""
    if path.is_dir():
        return open_folder(path)
    return McapFiles(str(path), [path]) if path.suffix.lower() == ".mcap" else RosFiles(str(path), [path])


class ForeignFrames:
    """The images of a topic, with the time in each message's header as its exposure, else when it was written.

    A message that holds no whole image is said, counted and skipped.
    """

    live = False

    def __init__(self, name: str, files: Topics, topic: str | None, rig: Rig | None, say: Say) -> None:
        """Raises InputError where the topic is not to be found, is none of images, or holds no messages."""
        self.name = name
        self.unreadable = 0
        self._files, self._say = files, say
        self._expected = Expected(rig)
        self._topic = chosen(files, topic, IMAGE_TYPES, "images", IMAGE_NAMES)
        self._depth = Depth(self._expected.capture.bits, say)
        self.length: int | None = self._topic.held
        times = [time_ns for time_ns, _ in islice(files.messages(self._topic), RATE_MESSAGES)]
        if not times:
            raise InputError(f"{name}: topic {shown(self._topic.name)} holds no messages")
        steps = [after - before for before, after in pairwise(times) if after > before]
        self.rate_hz = 1e9 / median(steps) if steps else DEFAULT_RATE_HZ

    def frames(self) -> Iterator[Frame]:
        """In the order of the file, also where the clock was set. Raises InputError for images of another size than
        calibrated, for pixels of a kind that is not read, where nothing could be read.
        """
        before_ns, read = 0, 0
        decode = IMAGE_TYPES[self._topic.type, self._topic.encoding]
        for index, (written_ns, payload) in enumerate(self._files.messages(self._topic)):
            where = f"{self.name}, {shown(self._topic.name)}, message {index}"
            try:
                found = picture(decode(bytes(payload)), partial(self._expected.check_size, where=where))
            except BadEncoding as problem:
                raise InputError(f"{where}: {problem}") from None
            except BadMessage as problem:
                self.unreadable += 1
                self._say(f"{where}: {problem}; skipped")
                continue
            grey = to_grey8(found.image, self._depth.bits_of(found.image, where), where)
            read += 1
            exposed_ns = found.stamp_ns if found.stamp_ns > 0 else written_ns
            if exposed_ns < before_ns:
                self._say(f"{where}: the clock was set back by {(before_ns - exposed_ns) * 1e-9:.3f} s")
            before_ns = exposed_ns
            yield Frame(grey, exposed_ns, index, f"{index:06d}", exposed_ns)
        if not read:
            raise InputError(
                f"{self.name}: none of the {self.unreadable} images on {shown(self._topic.name)} can be read"
            )
