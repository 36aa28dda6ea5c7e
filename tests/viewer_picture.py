"""Render a rerun recording to a PNG without a screen: `python -m tests.viewer_picture FILE.rrd OUT.png [FRAME]`.

Needs a software Vulkan driver (Debian: mesa-vulkan-drivers). Used for the README's picture and to look at recordings
on machines without a display.
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

SIZE = "1600x1000"
LAVAPIPE = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json"


def picture(recording: Path, out: Path, frame: int | None) -> None:
    """Open the recording in a headless viewer, go to a frame, save what it shows."""
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    rerun = shutil.which("rerun", path=f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}")
    assert rerun is not None, "the rerun viewer is not installed"
    viewer = subprocess.Popen(
        [rerun, "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", SIZE],
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
        out.write_bytes(client.take_screenshot(max_size=1600))
    finally:
        # The program on the path only starts the viewer proper.
        os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


if __name__ == "__main__":
    picture(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else None)
