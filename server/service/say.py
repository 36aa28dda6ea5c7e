"""What commands tell a person, on the terminal's error channel, so that their output can be piped."""

import sys

from asterism.protocol.rig import Rig, hidden_led_warnings


def say(text: str) -> None:
    """One line."""
    print(f"asterism: {text}", file=sys.stderr, flush=True)


def say_warnings(rig: Rig) -> None:
    """What a rig's constellations leave open."""
    for warning in hidden_led_warnings(rig):
        say(f"warning: {warning}")
