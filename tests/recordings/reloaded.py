"""A recording during which the rig was read again: alpha is gone since, zulu and echo have joined."""

from collections.abc import Callable
from pathlib import Path

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.simulation.demo_rig import DEMO_RIG

SINCE = 3  # the first frame with the second rig, of four


def two_rigs() -> tuple[Rig, Rig]:
    """Before and after."""
    whole, camera = DEMO_RIG.read_text(), load_rig(DEMO_RIG).camera_text
    texts = whole[: whole.index("  echo:")], whole.replace("  alpha:", "  zulu:")
    return parse_rig(texts[0], camera, "demo"), parse_rig(texts[1], camera, "demo")


def record_reloaded(folder: Path, report_of: Callable[[Rig, int], "pb.FrameReport"]) -> Recording:
    """Four frames, of which ``report_of`` tells by rig and number."""
    first, second = two_rigs()
    recorder = Recorder(folder, first, "test", FramesKept(every=0), wait=True)
    for sequence in range(1, 5):
        if sequence == SINCE:
            recorder.take_rig(second)
        report = report_of(first if sequence < SINCE else second, sequence)
        message = Message(keys.frame("demo"), FRAME_REPORT, to_bytes(report), report.exposed_ns, 10**18, sequence)
        recorder.write([message], None, report.exposed_ns, sequence)
    recorder.close({})
    return Recording(recorder.folder)
