"""How far a batch is: a line, redrawn on a terminal; elsewhere one for every film that is done."""

import time

from asterism.server.service.batch.folder import Outcome
from asterism.server.service.batch.running import Course
from asterism.server.service.batch.solving import frames_done
from asterism.server.service.say import say
from asterism.server.service.telling import shows_progress

WIDEST_NAME = 32
EVERY_S = 30.0  # elsewhere than on a terminal


class Progress:
    """A context manager; `look` is to be called some times a second. ``done`` fills with the films that are."""

    def __init__(self, courses: list[Course], done: dict[str, Outcome]) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self._courses, self._done = courses, done
        self._told = set(done)
        self._whole = sum(end or 0 for course in courses for _, end in course.pieces[-1:])
        self._bar = None
        self._began = self._said = time.monotonic()
        self._first = self._frames()
        if shows_progress():
            columns = (TextColumn("{task.description}"), BarColumn(20), TaskProgressColumn(), TimeRemainingColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True, auto_refresh=False)
            self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> "Progress":
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def look(self) -> None:
        """Tell how far it is, and of films that are done by now."""
        for course in self._courses:
            if course.name in self._done and course.name not in self._told:
                self._told.add(course.name)
                self._tell(self._done[course.name])
        now = time.monotonic()
        if self._bar is not None:
            whole = len(self._courses)
            done = sum(course.name in self._done for course in self._courses)
            self._bar.update(self._task, description=f"{done} of {whole} films, {self._rate():.0f} frames/s")
            self._bar.update(self._task, completed=self._share(), total=1.0)
            self._bar.refresh()
        elif now > self._said + EVERY_S:
            self._said = now
            say(f"{self._share():.0%}, {self._rate():.0f} frames/s")

    def _tell(self, outcome: Outcome) -> None:
        if outcome.state == "done":
            say(f"{outcome.name[-WIDEST_NAME:]}: {outcome.frames} frames")

    def _frames(self) -> int:
        open_ = sum(frames_done(course.film.folder) for course in self._courses if course.name not in self._done)
        return open_ + sum(self._done[course.name].frames for course in self._courses if course.name in self._done)

    def _rate(self) -> float:
        return (self._frames() - self._first) / max(time.monotonic() - self._began, 1e-3)

    def _share(self) -> float:
        return min(self._frames() / max(sum(course.length or 0 for course in self._courses), 1), 1.0)
