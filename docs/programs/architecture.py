"""The parts of docs/architecture.md that the source tree dictates: `python -m docs.programs.architecture`.

Writes docs/rooms.svg, docs/way.svg and the table of rooms in docs/architecture.md. A test compares all three with
the tree, so that the page cannot say what is not so.
"""

import re

from docs.programs.drawing import draw_rooms, draw_steps
from docs.programs.tree import REPOSITORY, Room, rooms
from docs.programs.way import way

DOCS = REPOSITORY / "docs"
START = ("asterism.server.service.serve", "serve")  # a function or method: where a frame's way begins
BETWEEN = re.compile(r"(?<=<!-- rooms -->\n).*?(?=<!-- end of rooms -->)", re.DOTALL)


def table(found: list[Room]) -> str:
    """The rooms as a table in Markdown."""
    order = [room.name for room in found]
    rows = [
        f"| `{room.name}` | {room.sentence} | {', '.join(sorted(room.uses, key=order.index)) or '-'} |"
        for room in found
    ]
    return "\n".join(["| room | what it is | uses |", "|---|---|---|", *rows]) + "\n"


def made() -> dict[str, str]:
    """Every file that the tree dictates, by its name in docs/, with its text."""
    found = rooms()
    page = (DOCS / "architecture.md").read_text()
    steps = way(*START)
    if not steps:
        raise SystemExit(f"{START[0]} has no function {START[1]}: say in {__name__} where a frame's way begins now")
    return {
        "rooms.svg": draw_rooms(found),
        "way.svg": draw_steps(steps, found),
        "architecture.md": BETWEEN.sub(lambda _: table(found), page),
    }


if __name__ == "__main__":
    for name, text in made().items():
        (DOCS / name).write_text(text)
        print(DOCS / name)
