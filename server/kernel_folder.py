"""Where the machine code of kernels is kept: a folder of its own for every copy of the program, and for every Python,
numba and processor that runs it.

numba notices when the file of a kernel changes, but not when a kernel that it calls does. So the folder is also named
after the contents of all modules with kernels: change one, and everything is compiled anew.
"""

import contextlib
import functools
import hashlib
import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numba
from llvmlite import binding as llvm

HERE = Path(__file__).resolve().parent
LABEL = "made-for.json"
FORGOTTEN_DAYS = 60.0  # without a start, after which a folder is taken for somebody's who is gone


def made_for(server: Path = HERE) -> dict[str, str]:
    """Everything that the machine code of the copy in that folder depends on, by name."""
    contents = hashlib.sha256()
    for module in sorted(server.rglob("*.py")):
        text = module.read_bytes()
        if b"import compiled" in text or module.parent == server:
            contents.update(text)
    features = llvm.get_host_cpu_features().flatten()
    return {
        "copy": str(server),
        "python": f"{sys.implementation.cache_tag} {sys.version}",
        "numba": f"{numba.__version__} {llvm.llvm_version_info}",
        "machine": f"{llvm.get_process_triple()} {llvm.get_host_cpu_name()} {features}",
        "chosen": f"{numba.config.CPU_NAME} {numba.config.CPU_FEATURES} {numba.config.OPT}",
        "sources": contents.hexdigest(),
    }


def folder_for(made: dict[str, str]) -> Path:
    """The folder's name: below NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    name = hashlib.sha256(json.dumps(made).encode()).hexdigest()[:16]
    return Path(base) / "asterism" / name


@functools.cache
def kernel_folder() -> Path:
    """This copy's folder. It need not exist, and nothing is written."""
    return folder_for(made_for())


def open_folder() -> str | None:
    """Make this copy's folder where it is new, and clean up beside it; returns why nothing can be kept there, if so."""
    made, folder = made_for(), kernel_folder()
    label = folder / LABEL
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not label.exists():
            clean_up(folder.parent, made)
            _write(label, json.dumps({**made, "host": platform.node()}, indent=1))
        label.touch()
    except OSError as error:
        return f"{folder}: {error.strerror}"
    return None


def clean_up(base: Path, made: dict[str, str]) -> None:
    """Remove folders of copies that are gone, of this copy's former sources, and what was not used for long."""
    for folder in base.iterdir():
        if folder.is_dir() and _is_left_over(folder, made):
            shutil.rmtree(folder, ignore_errors=True)


def _is_left_over(folder: Path, made: dict[str, str]) -> bool:
    label = folder / LABEL
    try:
        theirs = json.loads(label.read_text(encoding="utf-8"))
        # Another host, or a container, sees other paths.
        gone = theirs["host"] == platform.node() and not Path(theirs["copy"]).exists()
        former = [name for name in made if theirs[name] != made[name]] == ["sources"]
        return gone or former or _is_forgotten(label)
    except (OSError, ValueError, KeyError, TypeError):
        return _is_forgotten(folder)  # of a version without labels


def _is_forgotten(path: Path) -> bool:
    with contextlib.suppress(OSError):
        return time.time() - path.stat().st_mtime > FORGOTTEN_DAYS * 86400.0
    return False


def _write(file: Path, text: str) -> None:
    # Two starts may write it at once.
    part = file.with_suffix(f".{os.getpid()}")
    part.write_text(text, encoding="utf-8")
    part.replace(file)


@contextlib.contextmanager
def alone(wait: Callable[[], None]) -> Iterator[None]:
    """One start at a time compiles, and another one, which calls ``wait`` first, waits for what it leaves.

    Where there are no locks both compile: each file is written at once, so that neither harms the other.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            file = stack.enter_context((kernel_folder() / "lock").open("w"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                wait()
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
