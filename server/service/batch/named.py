"""From what a person names to the films it is, each with a name of its own that is readable as a file's."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath

from asterism.protocol.errors import InputError
from asterism.server.sources.images import EXTENSIONS
from asterism.server.sources.open_source import refuse_endless

LONGEST_NAME = 80  # characters
PLAIN = ("frames", "images")  # names of folders that say nothing of a film
MOST_SINGLE = 20  # images named one by one


def films_of(texts: Sequence[str]) -> dict[str, str]:
    """Names, as they stand in DIR, and the source of each, in the order in which they were given.

    A glob whose matches are all images is one film; otherwise each match is one. Raises InputError where a glob finds
    nothing, where one file is in two of them, and for single images by the dozen, which a shell makes of a glob.
    """
    sources = [source for text in texts for source in _spread(text)]
    for source in sources:
        if not Path(source).exists() and not _matches(source):
            refuse_endless(source, "batch")
            raise InputError(
                f"{source}: there is no such source; expected a folder or glob of images, a video, a recording, an "
                "MCAP file or a ROS bag"
            )
    _refuse_singles(sources)
    _refuse_twice(sources)
    return dict(zip(_names(sources), sources, strict=True))


def files_of(source: str) -> list[Path]:
    """The files that a source is made of, in order; with their folders' times."""
    path = Path(source)
    if path.is_dir():
        return sorted(entry for entry in path.iterdir() if entry.is_file())
    if path.exists():
        return [path]
    found = _matches(source)
    return sorted({*found, *(times for one in found if (times := one.parent / "times.csv").exists())})


def _matches(text: str) -> list[Path]:
    if not any(char in text for char in "*?["):
        return []
    path = Path(text)
    base = Path(path.anchor) if path.is_absolute() else Path()
    return sorted(base.glob(str(path.relative_to(base))))


def _spread(text: str) -> Iterator[str]:
    found = [] if Path(text).exists() else _matches(text)
    if found and not all(_is_image(path) for path in found):
        yield from (str(path) for path in found if path.is_dir() or not _is_image(path))
    else:
        yield text


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in EXTENSIONS


def _refuse_singles(sources: Sequence[str]) -> None:
    single = [source for source in sources if _is_image(Path(source)) and Path(source).is_file()]
    if len(single) > MOST_SINGLE:
        raise InputError(
            f"{single[0]} and {len(single) - 1} more are single images, each of which would be a film; name their "
            "folder, or put the glob into quotes"
        )


def _refuse_twice(sources: Sequence[str]) -> None:
    """A file that is in two films: also where one of them goes by another name of it."""
    known: dict[Path, str] = {}
    for number, source in enumerate(sources):
        for file in files_of(source):
            if file.name == "times.csv":
                continue
            first = known.setdefault(file.resolve(), f"{number} {source}")
            if first != f"{number} {source}":
                other = first.partition(" ")[2]
                same = "is named twice" if other == source else f"and {other} are the same, or share it"
                raise InputError(f"{source} {same} ({file}); expected every film once")


def _names(sources: Sequence[str]) -> list[str]:
    """The last part of each that is a name, and as much of the folders before it as keeps them apart."""
    parts = [_parts(source) for source in sources]
    lengths = [1] * len(sources)
    while True:
        names = ["-".join(own[-length:]) for own, length in zip(parts, lengths, strict=True)]
        alike = [k for k, name in enumerate(names) if _folded(names).count(name.casefold()) > 1]
        longer = [k for k in alike if lengths[k] < len(parts[k])]
        if not longer:
            break
        for k in longer:
            lengths[k] += 1
    return _numbered([name[-LONGEST_NAME:].lstrip("-.") or "film" for name in names])


def _folded(names: Sequence[str]) -> list[str]:
    """Some disks do not tell capitals apart."""
    return [name.casefold() for name in names]


def _numbered(names: Sequence[str]) -> list[str]:
    taken: set[str] = set()
    out = []
    for name in names:
        number, own = 2, name
        while own.casefold() in taken:
            own, number = f"{name}-{number}", number + 1
        taken.add(own.casefold())
        out.append(own)
    return out


def _parts(source: str) -> list[str]:
    path = PurePath(source)
    if not any(char in source for char in "*?["):
        path = PurePath(Path(source).resolve())
    parts = [word for part in path.parts if (word := re.sub(r"[^\w.+-]+", "-", part).strip("-."))]
    if parts and Path(source).is_file():
        parts[-1] = PurePath(parts[-1]).stem
    elif len(parts) > 1 and "*" in path.name:
        parts = parts[:-1] if parts[-1].casefold() in {extension[1:] for extension in EXTENSIONS} else parts
    if len(parts) > 1 and parts[-1].casefold() in PLAIN:
        parts = parts[:-1]
    return parts or ["film"]
