"""Ports of this machine's loopback address."""

import socket

HOST = "127.0.0.1"


def free_port() -> int:
    """One that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
        return port


def why_taken(port: int) -> str:
    """Why a port cannot be listened on, or nothing if it can."""
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that was in use a moment ago is free
            probe.bind((HOST, port))
            probe.listen()
    except OverflowError:
        return "there is none"
    except OSError as error:
        return error.strerror or "it fails"
    return ""
