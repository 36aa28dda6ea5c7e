"""All films' pieces, in work and done: what can be begun next, and what came of it."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from itertools import pairwise

from asterism.protocol.errors import WorldError
from asterism.server.service.batch.cutting import WHOLE, Piece
from asterism.server.service.batch.jobs import Film, Job, Told, told_of
from asterism.server.service.batch.solving import solve

LOOK_S = 0.25
ALL = "whole"  # the name of a film that is not cut


@dataclass(eq=False)
class Course:
    """A film on its way. ``told``: what came of its pieces and of what joins them, by name; ``going``: in work."""

    name: str
    film: Film
    pieces: list[Piece]
    length: int | None = None
    told: dict[str, Told] = field(default_factory=dict)
    going: set[str] = field(default_factory=set)
    problem: str = ""
    said: list[str] = field(default_factory=list)

    def recall(self) -> None:
        """Take over what an earlier start finished."""
        pieces = range(len(self.pieces))
        joins = [join_name(k, again) for k in pieces for again in (False, True)]
        for name in [*map(self.piece, pieces), *joins]:
            if (told := told_of(self.film, name)) is not None:
                self.told[name] = told
        self._check_order()
        if self.pieces == WHOLE and (told := told_of(self.film, ALL)) is not None:
            self.told[ALL] = told

    def piece(self, k: int) -> str:
        """The name of a piece."""
        return f"{k:04d}" if len(self.pieces) > 1 else ALL

    def again(self, k: int) -> bool:
        """Whether the memory after piece k is only known from solving it again: before it memories did not meet."""
        if k <= 0:
            return False
        join = self.told.get(join_name(k, self.again(k - 1)))
        return join is not None and not join.agreed

    def jobs(self) -> Iterator[Job]:
        """What can be begun, and is not."""
        if self.problem:
            return
        last = len(self.pieces) - 1
        cut = last > 0 and not self.film.independent
        for k, (first, end) in enumerate(self.pieces):
            name = self.piece(k)
            if name not in self.told and name not in self.going:
                yield Job(self.film, name, first, end, marked=cut and k > 0)
        for k in range(1, last + 1) if cut else ():
            before, now = self.piece(k - 1), self.piece(k)
            name = join_name(k, self.again(k - 1))
            if before in self.told and now in self.told and name not in self.told and name not in self.going:
                memory = join_name(k - 1, self.again(k - 2)) if self.again(k - 1) else before
                first, end = self.pieces[k]
                yield Job(self.film, name, first, end, before=memory, until=now)

    def add(self, name: str, told: Told) -> None:
        """A piece is done."""
        self.going.discard(name)
        self.said += [text for text in told.said if text not in self.said]
        if told.problem:
            self.problem = self.problem or told.problem
        self.told[name] = told
        self._check_order()

    def _check_order(self) -> None:
        if len(self.pieces) > 1 and not self.film.independent and not self._in_order():
            self.pieces, self.told = WHOLE, {}
            self.said.append("its clock was set back: not cut")

    def _in_order(self) -> bool:
        """Whether time runs forwards, as far as is known; memories could not be compared otherwise."""
        pieces = [told for k in range(len(self.pieces)) if (told := self.told.get(self.piece(k))) and told.frames]
        edges = pairwise(pieces)
        return all(told.in_order for told in pieces) and all(a.last_ns <= b.first_ns for a, b in edges)

    @property
    def solved_again(self) -> int:
        """How many pieces were, from their begin to their end."""
        return sum(self.again(k) for k in range(1, len(self.pieces)))

    @property
    def overlap(self) -> int:
        """How many frames were solved twice, so that memories met."""
        return sum(told.frames for name, told in self.told.items() if "+" in name)

    def parts(self) -> list[tuple[str, int]]:
        """The files of lines that make the film, in order, each with how many of its first lines are left out."""
        parts: list[tuple[str, int]] = []
        for k in range(len(self.pieces)):
            left_out = 0
            if k and not self.film.independent:
                join = join_name(k, self.again(k - 1))
                parts.append((join, 0))
                left_out = self.told[join].frames
            parts.append((self.piece(k), left_out))
        return parts


def join_name(k: int, again: bool) -> str:
    """Of piece k's begin with the memory of the piece before it; ``again``: which was itself solved again."""
    return f"{k:04d}+{'again' if again else ''}"


def run(
    courses: list[Course], executor: Executor, looks: Sequence[Callable[[], None]], finish: Callable[[Course], None]
) -> None:
    """Do all of it, the longest films first. ``looks`` are called now and then and may raise; ``finish`` gets every
    film of which nothing more is to be done. Raises WorldError where workers die.
    """
    going: dict[Future[Told], tuple[Course, Job]] = {}
    left = list(courses)
    for course in sorted(left, key=lambda course: -(course.length or 0)):
        _begin(course, executor, going)
    while left:
        for course in [course for course in left if not course.going]:
            left.remove(course)
            finish(course)
        done, _ = wait(going, LOOK_S, FIRST_COMPLETED) if going else (set[Future[Told]](), None)
        for look in looks:
            look()
        for future in done:
            course, job = going.pop(future)
            course.add(job.name, _result(future, course))
            _begin(course, executor, going)


def _begin(course: Course, executor: Executor, going: dict[Future[Told], tuple[Course, Job]]) -> None:
    for job in list(course.jobs()):
        course.going.add(job.name)
        going[executor.submit(solve, job)] = course, job


def _result(future: Future[Told], course: Course) -> Told:
    from concurrent.futures.process import BrokenProcessPool

    try:
        return future.result()
    except BrokenProcessPool:
        raise WorldError(f"{course.film.source}: a process that solved it died; was there too little memory?") from None
    except Exception as error:  # one film's; the others go on
        return Told(problem=f"{type(error).__name__}: {error}")
