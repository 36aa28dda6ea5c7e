"""Recordings that earlier servers of a camera left cut off are recovered once it runs, and never in its way."""

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from asterism.recordings.held import cut_off

LOWEST = 19  # priority, of `nice`


class Recovery:
    """Recovers what is cut off in ``parent`` in processes of the lowest priority. A context manager.

    `begin` is to be called when the camera runs, as often as it likes; ``say`` is told what came of it.
    """

    def __init__(self, parent: Path, camera: str, say: Callable[[str], None]) -> None:
        self._parent = parent
        self._camera = camera
        self._say = say
        self._begun = threading.Event()
        self._closed = False
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, name="recovery", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """There is a frame."""
        if not self._begun.is_set():
            self._begun.set()

    def __enter__(self) -> "Recovery":
        return self

    def __exit__(self, *_: object) -> None:
        """What is not finished by now stays for the next start."""
        self._closed = True
        self._begun.set()
        if (process := self._process) is not None:
            process.terminate()
        self._thread.join()

    def _run(self) -> None:
        self._begun.wait()
        for folder in [] if self._closed else cut_off(self._parent, self._camera):
            self._say(f"{folder}: was cut off; recovering it ...")
            began = time.monotonic()
            told, failed = self._recover(folder)
            if self._closed:
                return
            if failed:
                self._say(f"{folder}: could not be recovered ({told})")
            else:
                self._say(f"{folder}: recovered in {time.monotonic() - began:.1f} s ({told})")

    def _recover(self, folder: Path) -> tuple[str, bool]:
        """What `asterism recover` says of it, in one line, and whether it failed."""
        # What it has to say is not for systemd.
        environment = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
        process = self._process = subprocess.Popen(
            [sys.executable, "-m", "asterism.server", "recover", str(folder.absolute())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="backslashreplace",
            env=environment,
            start_new_session=True,  # Ctrl-C is for the server, which ends it
        )
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process.pid, LOWEST)
        if self._closed:
            process.terminate()
        out, err = process.communicate()
        lines = (err if process.returncode else out).splitlines()
        return "; ".join(lines), process.returncode != 0
