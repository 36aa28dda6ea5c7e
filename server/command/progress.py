"""What shows that long work goes on, on terminals only: a bar where its length is known, else the time it has taken."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import TypeVar

from asterism.server.service.telling import shows_progress

T = TypeVar("T")

_LOG = logging.getLogger(__name__)


def progress(items: Iterable[T], length: int | None, what: str) -> Iterator[T]:
    """The items, with a bar that shows how far it is; ``length`` is how many there are, if that is known."""
    _LOG.debug("%s, %s", what, "no end known" if length is None else f"{length} in all")
    if not shows_progress():
        yield from items
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=length)
        for item in items:
            yield item
            bar.advance(task)


def interruptible(work: Callable[[], T]) -> T:
    """What ``work`` returns; Ctrl-C ends it also while it is in compiled code, which would not hear it."""
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name="work", daemon=True).start()
    return done.result()


@contextlib.contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show that something is worked on, and for how long; call what it gives with what is done now."""
    _LOG.debug(what)
    if not shows_progress():
        yield _LOG.debug
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def now(step: str) -> None:
            _LOG.debug(step)
            bar.update(task, description=f"{what}: {step}")

        yield now
