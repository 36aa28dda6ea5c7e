"""Processes beside the server: Ctrl-C in its terminal does not reach them, and they end with it, however it ends."""

import os
import subprocess
import sys
from collections.abc import Sequence

# Linux ends it with who started it (prctl 1 is PR_SET_PDEATHSIG, which survives the exec), also after kill -9.
_UNTIL_THE_PARENT_ENDS = """
import ctypes, os, sys
parent, *command = sys.argv[1:]
ctypes.CDLL(None).prctl(1, 9, 0, 0, 0)
if os.getppid() == int(parent):
    os.execv(command[0], command)
"""


def start(command: Sequence[str], *, stays: bool = False, pipes: bool = False) -> subprocess.Popen[bytes]:
    """Start it, in a session of its own. What it prints is for nobody, unless ``pipes``: then it is read, and fed.

    ``stays``: it outlives this process. It ends with the thread that calls this.
    """
    if sys.platform == "linux" and not stays:
        command = [sys.executable, "-I", "-S", "-c", _UNTIL_THE_PARENT_ENDS, str(os.getpid()), *command]
    end = subprocess.PIPE if pipes else subprocess.DEVNULL
    # Unbuffered: closing must not wait for a write that hangs.
    return subprocess.Popen(
        command, bufsize=0, stdin=end, stdout=end, stderr=subprocess.DEVNULL, start_new_session=True
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End it, and with it what is bound to it; it has nothing to save."""
    if process.poll() is None:
        process.kill()
        process.wait()
