"""Pieces to a film: its lines under their name, and what they tell."""

from itertools import islice
from pathlib import Path

from asterism.server.service.batch.folder import OUTCOME, Outcome, write
from asterism.server.service.batch.jobs import LINES, MARKS, STATE, TOLD, file_of
from asterism.server.service.batch.outcome import Counting
from asterism.server.service.batch.running import Course


def assemble(course: Course, folder: Path) -> Outcome:
    """The outcome of a film of which nothing more is to be done; its lines stand under their name if it is whole."""
    told = list(course.told.values())
    outcome = Outcome(course.name, course.film.source, pieces=len(course.pieces))
    outcome.seconds = sum(each.seconds for each in told)
    if course.problem:
        outcome.problem = course.problem
        return outcome
    counting = Counting([robot.id for robot in course.film.rig.robots])
    outcome.file = f"{course.name}.jsonl"
    part = course.film.folder / "film.partial"
    with part.open("wb") as out:
        for name, left_out in course.parts():
            with file_of(course.film, name, LINES).open("rb") as lines:
                for line in islice(lines, left_out, None):
                    counting.add(line)
                    out.write(line)
        outcome.bytes = out.tell()
    part.replace(folder / outcome.file)
    outcome.state, outcome.frames, outcome.robots = "done", counting.frames, counting.robots()
    outcome.overlap, outcome.again = course.overlap, course.solved_again
    outcome.unreadable = sum(each.unreadable for name, each in course.told.items() if "+" not in name)
    outcome.notes = [*course.said, *(note for each in told for note in each.notes)]
    write(course.film.folder / OUTCOME, outcome)
    for path in course.film.folder.iterdir():
        if path.suffix in (LINES, MARKS, STATE, TOLD) and path.name != OUTCOME:
            path.unlink()
    return outcome
