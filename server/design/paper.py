"""Paper in its usual sizes, and a bar to check what a printer made of a drawing."""

from asterism.server.design.page import Line, Mark, Words

PAPER = (("A4", 210.0, 297.0), ("A3", 297.0, 420.0), ("A2", 420.0, 594.0), ("A1", 594.0, 841.0), ("A0", 841.0, 1189.0))
BAR = 100.0  # mm


def scale_bar(x: float, y: float, words: str, tall: float = 4.0, size: float = 3.2) -> list[Mark]:
    """A bar of BAR mm from (x, y) to the right with ticks up to ``tall`` mm, and beside it ``words`` of ``size`` mm."""
    marks: list[Mark] = [Line(x, y, x + BAR, y, 0.2)]
    for tick in range(int(BAR) // 10 + 1):
        long = tall if tick % 10 == 0 else tall / 2
        marks.append(Line(x + 10 * tick, y, x + 10 * tick, y + long, 0.2))
    return [*marks, Words(x + BAR + 3, y, words, size)]
