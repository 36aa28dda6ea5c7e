"""What came of a batch, and what changed, as tables of 80 columns."""

from rich.console import Console
from rich.table import Table

from asterism.protocol.two_digits import two_digits
from asterism.server.service.batch.comparing import TOLERANCES
from asterism.server.service.batch.folder import Outcome, Result
from asterism.server.service.batch.outcome import Changes

WIDTH = 80
WIDEST = 24  # characters of a film's name, 12 of a robot's


def print_table(result: Result) -> None:
    """Every film with its robots; why one failed."""
    table = _table(
        ("film", "left"), ("frames", "right"), ("/s", "right"), ("robot", "left"), ("found", "right"),
        ("tilt?", "right"), ("lost", "right"), ("rms px", "right"),
    )  # fmt: skip
    for film in result.films:
        if film.state != "done":
            continue
        head = [_short(film.name, WIDEST), str(film.frames), f"{film.rate_hz:.0f}"]
        for robot_id, robot in film.robots.items():
            rms = "" if robot.rms_px is None else f"{robot.rms_px:.3f}"
            counts = [str(robot.states.get(state, 0)) for state in ("TILT_AMBIGUOUS", "LOST")]
            table.add_row(*head, _short(robot_id, 12), f"{robot.found(film.frames):.1%}", *counts, rms)
            head = ["", "", ""]
    console = _console()
    if table.row_count:
        console.print(table)
    for film in result.films:
        _print_rest(console, film)


def _print_rest(console: Console, film: Outcome) -> None:
    if film.state != "done":
        console.print(f"{film.name} failed: {film.problem}", highlight=False, markup=False)
    told = []
    if film.unreadable:
        told.append(f"{film.unreadable} frames could not be read and were skipped")
    if film.again:
        told.append(
            f"cut into {film.pieces} pieces, {film.again} of which were solved again: following did not come to agree "
            "with what was before"
        )
    for text in told:
        console.print(f"{film.name}: {text}", highlight=False, markup=False)


def print_changes(changes: dict[str, Changes], title: str, tolerances: tuple[float, float] = TOLERANCES) -> bool:
    """What changed in every film, robot by robot; whether nothing did, beyond the tolerances."""
    same = all(film.is_none for film in changes.values())
    console = _console()
    if same:
        within = f"within {tolerances[0]:g} m and {tolerances[1]:g} rad"
        films = f"{len(changes)} film{'s' * (len(changes) != 1)}"
        console.print(f"{title}: the same in {films}, {within}", highlight=False, markup=False)
        return True
    table = _table(
        ("film", "left"), ("robot", "left"), ("found", "right"), ("now", "right"), ("other\nstate", "right"),
        ("moved", "right"), ("most\nmm", "right"), ("most\ndeg", "right"),
    )  # fmt: skip
    for name, film in changes.items():
        head = _short(name, WIDEST)
        for robot_id, robot in film.robots.items():
            if robot.is_none:
                continue
            shares = [f"{count / max(robot.frames, 1):.1%}" for count in (robot.found_before, robot.found)]
            most = [two_digits(1e3 * robot.most_m), two_digits(57.29578 * robot.most_rad)]
            table.add_row(head, _short(robot_id, 12), *shares, str(robot.other_state), str(robot.beyond), *most)
            head = ""
    console.print(f"{title}:", highlight=False, markup=False)
    if table.row_count:
        console.print(table)
    for name, film in changes.items():
        if film.only_before or film.only_now:
            console.print(f"{name}: {film.only_before} frames before only, {film.only_now} now only", markup=False)
    return False


def _short(name: str, most: int) -> str:
    return name if len(name) <= most else "…" + name[1 - most :]


def _table(*columns: tuple[str, str]) -> Table:
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name, justify in columns:
        table.add_column(name, justify="left" if justify == "left" else "right", no_wrap=True)
    return table


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)
