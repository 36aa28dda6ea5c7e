"""Two drawings as SVG: rooms with their arrows, and steps in a row. Text and rectangles, no fonts from elsewhere."""

import textwrap
from collections.abc import Sequence
from html import escape

from docs.programs.tree import Room
from docs.programs.way import Door

WIDTH = 480
BOX = 350
LEFT = 10
PAD = 10
LINE = 16
GAP = 14
LANE = 16
CHARACTERS = 47  # of a sentence in a line of a box
HUES = (210, 32, 130, 275, 0, 180, 55, 320, 95, 240, 15, 155, 295, 75, 195, 340)


def colour(index: int, lightness: int) -> str:
    """A room's colour: of its number, so that both drawings agree."""
    return f"hsl({HUES[index % len(HUES)]}, 55%, {lightness}%)"


def draw_rooms(rooms: Sequence[Room]) -> str:
    """Rooms from top to bottom; an arrow for every use that does not follow from others."""
    parts, tops, bottoms, y = [], {}, {}, GAP
    for index, room in enumerate(rooms):
        box, height = _box(y, index, room.name, room.sentence)
        parts.append(box)
        tops[room.name], bottoms[room.name] = y, y + height
        y += height + GAP
    names = [room.name for room in rooms]
    lanes: list[list[tuple[int, int]]] = []
    for room in rooms:
        for other in sorted(needed(room, rooms), key=names.index):
            if names.index(other) == names.index(room.name) + 1:
                parts.append(_straight(bottoms[room.name], tops[other]))
            else:
                start, end = (tops[room.name] + bottoms[room.name]) // 2, tops[other] + 12
                parts.append(_round(start, end, _lane(lanes, start, end), names.index(room.name)))
    return _page("".join(parts), y)


def draw_steps(doors: Sequence[Door], rooms: Sequence[Room]) -> str:
    """Steps from top to bottom, each in its room's colour."""
    names = [room.name for room in rooms]
    parts, y = [], GAP
    for number, door in enumerate(doors):
        if number:
            parts.append(_straight(y - GAP, y))
        box, height = _box(y, names.index(door.room), f"{door.room} · {door.name}", door.sentence, WIDTH - 2 * LEFT)
        parts.append(box)
        y += height + GAP
    return _page("".join(parts), y)


def needed(room: Room, rooms: Sequence[Room]) -> set[str]:
    """The rooms that a room uses and that no other room it uses leads to."""
    below = {one.name: set(one.uses) for one in rooms}
    for one in reversed(rooms):  # used before users: what is below them is complete
        below[one.name].update(*(below[other] for other in one.uses))
    return {other for other in room.uses if not any(other in below[third] for third in room.uses)}


def _box(y: int, index: int, title: str, sentence: str, width: int = BOX) -> tuple[str, int]:
    lines = textwrap.wrap(sentence, CHARACTERS * width // BOX)
    height = PAD + LINE * (1 + len(lines)) + PAD
    texts = [f'<text x="{LEFT + PAD}" y="{y + PAD + 13}" class="t">{escape(title)}</text>']
    for row, line in enumerate(lines, 1):
        texts.append(f'<text x="{LEFT + PAD}" y="{y + PAD + 13 + LINE * row}">{escape(line)}</text>')
    frame = f'<rect x="{LEFT}" y="{y}" width="{width}" height="{height}" rx="6" fill="{colour(index, 94)}" '
    return f'{frame}stroke="{colour(index, 45)}"/>\n' + "\n".join(texts) + "\n", height


def _straight(start: int, end: int) -> str:
    return f'<path d="M{LEFT + 40},{start} V{end - 2}" class="a" stroke="#555" marker-end="url(#h)"/>\n'


def _round(start: int, end: int, lane: int, index: int) -> str:
    x, out = LEFT + BOX, LEFT + BOX + 14 + LANE * lane
    path = f"M{x},{start} H{out - 8} Q{out},{start} {out},{start + 8} V{end - 8} Q{out},{end} {out - 8},{end} H{x + 2}"
    return f'<path d="{path}" class="a" stroke="{colour(index, 40)}" marker-end="url(#h)"/>\n'


def _lane(lanes: list[list[tuple[int, int]]], start: int, end: int) -> int:
    """The first lane that is free between two heights; takes it."""
    for number, taken in enumerate(lanes):
        if all(end < other_start or start > other_end for other_start, other_end in taken):
            taken.append((start, end))
            return number
    lanes.append([(start, end)])
    return len(lanes) - 1


def _page(body: str, height: int) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}">\n'
        "<style>text{font:13px sans-serif;fill:#333}.t{font-weight:bold;fill:#111}"
        ".a{fill:none;stroke-width:1.4}</style>\n"
        '<defs><marker id="h" markerWidth="8" markerHeight="8" refX="6" refY="4" orient="auto">'
        '<path d="M0,0.5 L7,4 L0,7.5 z" fill="#444"/></marker></defs>\n'
        f'<rect width="{WIDTH}" height="{height}" rx="8" fill="#fff"/>\n{body}</svg>\n'
    )
