"""Whose fault it is decides the exit code: the user's input (2) or the world (1)."""


def one_line(text: str) -> str:
    """The text with whatever would steer a terminal or break the line written out: names of files and keys hold it."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text)


class InputError(Exception):
    """The user's input (file, key, message, argument) is wrong.

    The text is one sentence: what, where, and what would be accepted. The command line prints it and exits 2.
    """

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


class WorldError(Exception):
    """The world failed (camera gone, disk full, network down); what was recorded is kept.

    The text says what was tried. The command line prints it and exits 1.
    """

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))
