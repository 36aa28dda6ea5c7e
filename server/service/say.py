"""What commands tell a person, on the terminal's error channel, so that their output can be piped.

Nobody prints there but the handler that `telling` sets up: what is said here, and what asterism's loggers tell.
"""

import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asterism.protocol.rig import Rig

SAID = "asterism.said"

_LOG = logging.getLogger(SAID)


def say(text: str) -> None:
    """One line; --quiet leaves it out."""
    _LOG.info(text)


def complain(text: str) -> None:
    """One line that --quiet does not leave out: why a command fails."""
    _LOG.error(text)


def say_warnings(rig: "Rig") -> None:
    """What a rig's constellations leave open, and what is odd of its surface."""
    from asterism.protocol.rig import hidden_led_warnings  # numpy would slow --help down
    from asterism.protocol.surface_sight import surface_warnings

    for warning in (*hidden_led_warnings(rig), *surface_warnings(rig)):
        say(f"warning: {warning}")
