"""`compiled`: the decorator of every numerical kernel. Machine code is kept on disk for the next start.

numba notices when the file of a kernel changes, but not when a kernel that it calls does. So the code is kept in a
folder named after the contents of all modules with kernels: change one, and everything is compiled anew.
"""

import contextlib
import hashlib
import os
import shutil
from pathlib import Path
from typing import Any

from numba import config, njit

KEPT = 4  # folders of other versions that are left on disk


def cache_folder() -> Path:
    """Where this version's machine code lies: below XDG_CACHE_HOME or ~/.cache."""
    contents = hashlib.sha256()
    for module in sorted(Path(__file__).parent.rglob("*.py")):
        text = module.read_bytes()
        if b"import compiled" in text or module.name == Path(__file__).name:
            contents.update(text)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "asterism" / contents.hexdigest()[:16]


def _use(folder: Path) -> None:
    if not folder.exists():
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True)
            others = sorted(
                (entry for entry in folder.parent.iterdir() if entry != folder),
                key=lambda e: e.stat().st_mtime,
            )
            for old in others[:-KEPT]:
                shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        config.CACHE_DIR = str(folder)


if not os.environ.get("NUMBA_CACHE_DIR"):
    _use(cache_folder())

# The interpreter's lock is released, so that source, recorder and network go on beside the chain. Division by zero
# gives inf or nan as in numpy; the kernels test for what must not be.
compiled: Any = njit(cache=True, nogil=True, error_model="numpy")

# For sums over pixels: lets the compiler reorder additions, which it must in order to use the processor's wide
# registers. nan and inf keep their meaning.
compiled_sums: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "arcp", "nsz"})
