"""Two batches beside each other: what changed in every film that both have."""

from pathlib import Path

from asterism.server.service.batch.folder import Result, read_result
from asterism.server.service.batch.outcome import Changes, changes

TOLERANCES = 1e-6, 1e-6  # m and rad, as `asterism compare` has them


def compared(
    before: Path, now: Result, folder: Path, tolerances: tuple[float, float] = TOLERANCES
) -> tuple[dict[str, Changes], list[str]]:
    """What changed from the batch in ``before`` to that in ``folder``, by film; and sentences about films that only one
    of them has. Raises InputError for files that are no batch's.
    """
    old = {film.name: film for film in read_result(before).films}
    told, apart = {}, []
    for film in now.films:
        there = old.pop(film.name, None)
        if there is None:
            apart.append(f"{film.name}: is not in {before}")
        elif there.state == film.state == "done":
            told[film.name] = changes(before / there.file, folder / film.file, *tolerances)
        elif there.state != film.state:
            apart.append(f"{film.name}: {there.state} in {before}, {film.state} in {folder}")
    apart += [f"{name}: is in {before} only" for name in old]
    return told, apart
