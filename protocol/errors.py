"""Whose fault it is decides the exit code: the user's input (2) or the world (1)."""


class InputError(Exception):
    """The user's input (file, key, message, argument) is wrong.

    The text is one sentence: what, where, and what would be accepted. The command line prints it and exits 2.
    """


class WorldError(Exception):
    """The world failed (camera gone, disk full, network down); what was recorded is kept.

    The text says what was tried. The command line prints it and exits 1.
    """
