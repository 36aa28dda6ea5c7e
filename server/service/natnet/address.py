"""Where `serve --natnet` listens: HOST or HOST:PORT of the command line."""

import ipaddress

from asterism.protocol.errors import InputError

LOOPBACK = "127.0.0.1"
PORT = 1510  # for calls; clients take it for granted


def address(text: str) -> tuple[str, int]:
    """An IPv4 address of this machine, and a UDP port. Raises InputError for what is none."""
    host, colon, port = text.partition(":")
    try:
        if ipaddress.IPv4Address(host).is_multicast:
            raise ValueError
        if colon and not (port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65_536):
            raise ValueError
    except ValueError:
        raise InputError(
            f"--natnet {text}: expected an IPv4 address of this machine, such as {LOOPBACK} or {LOOPBACK}:{PORT}; "
            "RIG and SOURCE go before it"
        ) from None
    return host, int(port or PORT)
