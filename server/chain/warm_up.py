"""Compile kernels before they are needed: the first time on a machine that takes a while, and is said."""

import contextlib
import importlib
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence

from numba import config
from numba.np import linalg

from asterism.protocol.rig import ESTIMATORS, Rig
from asterism.server.chain.compile_beside import compile_beside, cores, divide
from asterism.server.chain.kernel_list import BLOBS, COVERAGE, LOCALIZE, SIMULATE, Entry, kernel_list
from asterism.server.kernel_folder import alone, open_folder

_SAID = logging.getLogger("asterism.said")  # what the command line tells a person

FINDING = BLOBS, ESTIMATORS[0]  # what finding the spots of a calibration target needs


def localizing(rig: Rig, source: str = "") -> tuple[str, ...]:
    """What `localize` needs for a rig, the named source of frames, if it is `sim`, and who tells where tools were."""
    works = rig.surface is not None and any(robot.stands is not None for robot in rig.robots)
    return BLOBS, rig.centre, LOCALIZE, *((SIMULATE,) if source == "sim" else ()), *((COVERAGE,) if works else ())


def warm_up(*needs: str) -> None:
    """Make every kernel ready that is needed for any of ``needs``; what is compiled is kept on disk."""
    if config.DISABLE_JIT:
        return
    _leave_scipy_out()
    entries = [entry for entry in kernel_list() if not entry.needs.isdisjoint(needs)]
    problem = open_folder()
    if not all(entry.is_kept() for entry in entries):
        if problem is None:
            with alone(lambda: _SAID.info("another start is compiling; waiting for it ...")):
                _compile([entry for entry in entries if not entry.is_kept()])
        else:
            _SAID.info(f"nothing can be kept for the next start ({problem})")
            _compile(entries, kept=False)
    for entry in entries:
        entry.make_ready()


def _leave_scipy_out() -> None:
    """With its first kernel numba imports SciPy's linear algebra, a twelfth of a start, to see whether it is there.

    It is: the server needs SciPy. A kernel that calls it imports it when it is compiled, or runs.
    """
    look, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = look


def _compile(missing: Sequence[Entry], kept: bool = True) -> None:
    """On all cores, where it can be kept on disk; what the processes beside this one leave undone, here."""
    left = list(missing)
    with _told(missing, kept) as tell:
        shares = divide(missing, cores())
        if kept and len(shares) > 1:
            with contextlib.closing(compile_beside(shares)) as done:
                for entry in done:
                    left.remove(entry)
                    tell(entry)
        for entry in left:
            entry.make_ready()
            tell(entry)


@contextlib.contextmanager
def _told(missing: Sequence[Entry], kept: bool) -> Iterator[Callable[[Entry], None]]:
    """Say how far it is: a bar that counts kernels on a terminal, else a line before and one after."""
    if not missing:
        yield lambda _: None
        return
    began = time.monotonic()
    kernels = "1 kernel" if len(missing) == 1 else f"{len(missing)} kernels"
    if _shows():
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (
            TextColumn(f"compiling for this machine{', once' * kept}"),
            BarColumn(),
            TextColumn("{task.fields[count]}"),
        )
        with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
            count = 0
            task = bar.add_task("", total=sum(entry.seconds for entry in missing), count=f"0 of {kernels}")

            def tell(entry: Entry) -> None:
                nonlocal count
                count += 1
                bar.update(task, advance=entry.seconds, count=f"{count} of {kernels}")

            yield tell
    else:
        _SAID.info(f"compiling {kernels} for this machine{', only the first time' * kept} (up to a minute or two) ...")
        yield lambda _: None
    _SAID.info(f"compiled {kernels} in {time.monotonic() - began:.0f} s{'; the next start has them' * kept}")


def _shows() -> bool:
    """Whether there is a terminal, and somebody who is told: nobody is with --quiet, nor in other programs."""
    listeners = logging.getLogger("asterism").handlers
    return sys.stderr.isatty() and any(listener.level <= logging.INFO for listener in listeners)
