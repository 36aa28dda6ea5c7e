"""The documentation's pictures of a recording, without a screen.

`python -m tests.viewer_picture RECORDING DIR [FRAME]` writes DIR/review.png, all that `asterism review` shows, and
DIR/robots.png, image and space alone. docs/ has those of frame 130 of `asterism demo --seconds 3`.
`python -m tests.viewer_picture several RECORDING ... DIR` writes DIR/several.png, several cameras in one world.
Needs a software Vulkan driver (Debian: mesa-vulkan-drivers).
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import rerun.blueprint as rrb

from asterism.protocol.rig import Rig
from asterism.recordings.layout import camera_view, review_blueprint, space_view
from asterism.recordings.reader import Recording
from asterism.recordings.tape import tapes_of
from asterism.server.command.review import write_rrd, write_several

LAVAPIPE = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json"
MENU_PX = 37


def main(recording: Recording, folder: Path, frame: int | None) -> None:
    """Draw the recording twice, and take a picture of each."""
    with tempfile.TemporaryDirectory() as made:
        for name, views, size in (("review", review_blueprint, "1600x1000"), ("robots", robots_alone, "1600x680")):
            file = Path(made) / f"{name}.rrd"
            write_rrd(recording, file, views)
            (folder / f"{name}.png").write_bytes(picture(file, size, frame))


def several(recordings: list[Path], folder: Path) -> None:
    """Draw recordings of several cameras, and take a picture of their end."""
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / "several.rrd"
        write_several(tapes_of(recordings), file)
        (folder / "several.png").write_bytes(picture(file, "1600x1000", None))


def robots_alone(rig: Rig) -> rrb.Blueprint:
    """Image and space side by side, nothing else."""
    return rrb.Blueprint(
        rrb.Horizontal(camera_view(), space_view(rig), column_shares=[4, 5]),
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def picture(recording: Path, size: str, frame: int | None) -> bytes:
    """A PNG of what a headless viewer of ``size`` shows of a rerun file at a frame."""
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    rerun = shutil.which("rerun", path=f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}")
    assert rerun is not None, "the rerun viewer is not installed"
    viewer = subprocess.Popen(
        [rerun, "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", size],
        env={
            **os.environ,
            "VK_ICD_FILENAMES": os.environ.get("VK_ICD_FILENAMES", LAVAPIPE),
            "XDG_RUNTIME_DIR": "/tmp",
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        client = None
        for _ in range(100):
            try:
                client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.get_state()
                break
            except (RuntimeError, ConnectionError, ValueError):
                time.sleep(0.2)
        assert client is not None, "the headless viewer did not start"
        client.open(str(recording))
        if frame is not None:
            client.set_time("frame", sequence=frame, play_state="paused")
        time.sleep(12.0)  # notices of the software renderer fade
        return without_menu(client.take_screenshot(max_size=1600))
    finally:
        # The program on the path only starts the viewer proper.
        os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


def without_menu(png: bytes) -> bytes:
    """The picture below the viewer's menu."""
    shown = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return cv2.imencode(".png", shown[MENU_PX:], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


if __name__ == "__main__" and sys.argv[1] == "several":
    several([Path(each) for each in sys.argv[2:-1]], Path(sys.argv[-1]))
elif __name__ == "__main__":
    main(Recording(Path(sys.argv[1])), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else None)
