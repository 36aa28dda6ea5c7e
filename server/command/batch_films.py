"""From what a person names to films that can be solved: opened once, to see whether and where they can be cut."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.installed import missing_module
from asterism.server.service.batch.basis import Basis, basis_of
from asterism.server.service.batch.cutting import WHOLE, cuts
from asterism.server.service.batch.folder import HIDDEN, PLAN, Planned, pieces_folder, read_plan, write
from asterism.server.service.batch.jobs import Film
from asterism.server.service.batch.named import files_of
from asterism.server.service.batch.running import Course
from asterism.server.sources.source import Cuttable, Source


@dataclass(frozen=True, slots=True)
class How:
    """How films are solved: as `locate`'s options say."""

    independent: bool
    smooth: str | None
    topic: str | None


@dataclass(slots=True)
class _Opened:
    """A film before it is cut; ``problem`` says why it cannot be solved."""

    name: str
    source: str
    rig: Rig
    basis: Basis | None = None
    length: int | None = None
    places: int | None = None
    rate_hz: float = 1.0
    problem: str = ""


def courses(
    named: dict[str, str], rig: Rig, how: How, out: Path, cores: int, say: Callable[[str], None]
) -> list[Course]:
    """The films by name, cut as an earlier start cut them where nothing changed since; says what did."""
    opened = [_open(name, source, rig, how, say) for name, source in named.items()]
    fresh = cuts([one.length for one in opened], [one.places for one in opened], [one.rate_hz for one in opened], cores)
    before, plan, films = read_plan(out), {}, []
    for one, cut in zip(opened, fresh, strict=True):
        if one.basis is None:
            films.append(Course(one.name, _film(one, how, "", out), WHOLE, problem=one.problem))
            continue
        old = before.get(one.name)
        changed = one.basis.changed(old.basis) if old is not None else ""
        if changed:
            say(f"{one.name}: {changed} changed since; it is solved anew")
        pieces = cut if old is None or changed else [(first, end) for first, end in old.pieces]
        plan[one.name] = Planned(one.basis, pieces)
        course = Course(one.name, _film(one, how, one.basis.key(pieces), out), pieces, one.length)
        course.recall()
        films.append(course)
    write(out / HIDDEN / PLAN, {name: told for name, told in before.items() if name not in plan} | plan)
    return films


def _open(name: str, source: str, rig: Rig, how: How, say: Callable[[str], None]) -> _Opened:
    one = _Opened(name, source, rig)

    def tell(text: str) -> None:
        say(f"{name}: {text}")

    try:
        one.rig, frames = open_fitting(source, rig, tell, how.topic)
        one.length, one.rate_hz = frames.length, frames.rate_hz
        one.places = _places(frames, one.rig, how)
        one.basis = basis_of(files_of(source), one.rig, [how.independent, how.smooth, how.topic])
    except (InputError, WorldError) as error:
        one.problem = str(error)
    except ModuleNotFoundError as error:
        if not (text := missing_module(error.name or "", ["batch"])):
            raise
        one.problem = text
    except OSError as error:
        one.problem = f"{source}: {error.strerror or error}"
    return one


def _places(frames: Source, rig: Rig, how: How) -> int | None:
    """How many places there are to cut it at. Smoothing, and a camera that is followed, do not forget in so short a
    time what came before.
    """
    remembers = how.smooth is not None or rig.follows_world
    return frames.places if isinstance(frames, Cuttable) and not remembers else None


def _film(one: _Opened, how: How, key: str, out: Path) -> Film:
    folder = pieces_folder(out, one.name, key) if key else out
    # Workers may be elsewhere in the tree of folders; a pattern stays one.
    source = str(Path(one.source).resolve()) if Path(one.source).exists() else str(Path.cwd() / one.source)
    return Film(source, how.topic, one.rig, key, how.independent, how.smooth, folder.resolve())
