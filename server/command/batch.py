"""asterism batch: poses of many films and recordings, on all cores or on a cluster."""

import argparse
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.compile_beside import cores
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.batch_films import How, courses
from asterism.server.command.batch_progress import Progress
from asterism.server.command.batch_tables import print_changes, print_table
from asterism.server.command.shared_arguments import add_out, add_smoothing_ways, add_topic, named
from asterism.server.service.batch.assembling import assemble
from asterism.server.service.batch.cluster import cluster
from asterism.server.service.batch.comparing import compared
from asterism.server.service.batch.folder import (
    RESULT,
    Outcome,
    Result,
    held,
    outcome_of,
    prepare,
    read_result,
    write,
)
from asterism.server.service.batch.named import films_of
from asterism.server.service.batch.running import Course
from asterism.server.service.batch.running import run as run_all
from asterism.server.service.batch.workers import workers
from asterism.server.service.say import complain, say, say_warnings
from asterism.server.service.stop import Stop, stop_on_signals

EXAMPLES = (
    "asterism batch rig.yaml monday/ tuesday.mp4 recordings/* -o poses\n"
    "asterism batch rig.yaml recordings/* -o poses2 --against poses\n"
    "asterism batch rig.yaml recordings/* -o poses --dask tcp://HOST:8786\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument(
        "sources",
        metavar="SOURCE",
        nargs="+",
        help="folders or globs of images, videos, recordings, MCAP files, ROS bags; a glob in quotes of other than "
        "images is one for each match",
    )
    add_topic(part)
    add_out(part, "DIR", "where the lines go, a file for every SOURCE: new, empty, or of a batch to go on with")
    part.add_argument("--independent", action="store_true", help="each frame alone, without what came before")
    add_smoothing_ways(part)
    part.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler's, in place of this machine's cores")
    part.add_argument("--against", metavar="DIR", type=named, help="an earlier batch: tell what changed")


def run(options: argparse.Namespace) -> int:
    """Solve what is not solved yet, and tell what came of it; exit code 1 if a film failed."""
    if options.independent and options.smooth:
        raise InputError("--independent and --smooth exclude each other: each frame alone, or joined to those before")
    if options.against:
        read_result(options.against)
    if options.against and options.out.exists() and options.against.resolve() == options.out.resolve():
        raise InputError(f"--against {options.against}: is -o DIR itself, expected an earlier batch's folder")
    rig = load_rig(options.rig)
    films = films_of(options.sources)
    say_warnings(rig)
    if told := prepare(options.out, options.force):
        say(told)
    with held(options.out):
        result = _solve(options, rig, films)
        if options.against:
            result.against = str(options.against)
            result.changes, apart = compared(options.against, result, options.out)
            for text in apart:
                say(text)
        write(options.out / RESULT, result)
    print_table(result)
    if options.against:
        print_changes(result.changes, f"from {options.against} to {options.out}")
    failed = sum(film.state != "done" for film in result.films)
    say(f"{options.out / RESULT}: {len(result.films) - failed} of {len(result.films)} films done")
    return 1 if failed else 0


def _solve(options: argparse.Namespace, rig: Rig, films: dict[str, str]) -> Result:
    how, stop = How(options.independent, options.smooth, options.topic), Stop()
    out, done = options.out, dict[str, Outcome]()
    with stop_on_signals(stop), _stopping(out, stop) as look, _executor(options, rig, films) as (executor, count):
        ways = courses(films, rig, how, out, count, say)
        left = []
        for course in ways:
            if course.film.key and (outcome := outcome_of(out, course.film.folder)):
                done[course.name] = outcome
            else:
                left.append(course)
        if done:
            say(f"{len(done)} of {len(ways)} films were done before")

        def finish(course: Course) -> None:
            outcome = done[course.name] = assemble(course, out)
            for text in outcome.notes:
                say(f"{course.name}: {text}")
            if outcome.problem:
                complain(f"{course.name} failed: {outcome.problem}")

        if any(not course.problem for course in left):
            with Progress(left, done) as progress:
                run_all(left, executor, (look, progress.look), finish)
        else:
            for course in left:
                finish(course)
    return Result(_version(), str(options.rig), how.independent, how.smooth, how.topic, [done[name] for name in films])


def _version() -> str:
    from asterism import __version__

    return __version__


@contextmanager
def _stopping(out: Path, stop: Stop) -> Iterator[Callable[[], None]]:
    """What raises once it is to stop; what was done is kept, and it is said how to go on."""

    def look() -> None:
        if stop():
            raise KeyboardInterrupt

    try:
        yield look
    except KeyboardInterrupt as error:
        error.add_note(f"what was done is kept in {out}; the same command goes on with it")
        raise


@contextmanager
def _executor(options: argparse.Namespace, rig: Rig, films: dict[str, str]) -> Iterator[tuple[Executor, int]]:
    if options.dask is not None:
        with cluster(options.dask, options.out, list(films.values()), rig) as sent:
            yield sent
    else:
        warm_up(*localizing(rig))
        with workers(cores()) as executor:
            yield executor, cores()
