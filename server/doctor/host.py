"""The computer that will serve: is the port free, is there room for recordings."""

import shutil
import socket
from pathlib import Path

from asterism.protocol.network import DEFAULT_ENDPOINT
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.service.disk import duration
from asterism.server.sources.source import DEFAULT_RATE_HZ

SHORT_S = 600.0  # of whole frames, uncompressed


def check_port() -> Finding:
    """Whether a server could listen where clients look for it."""
    host, _, port = DEFAULT_ENDPOINT.removeprefix("tcp/").partition(":")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, int(port)))
        except OSError as error:
            advice = f"A server or a router is there already: see {typed('serve', '--help')}, --listen and --connect."
            return Finding(
                "network", Verdict.LOOK, f"{DEFAULT_ENDPOINT}: {(error.strerror or 'taken').lower()}", advice
            )
    return Finding("network", Verdict.GOOD, f"{DEFAULT_ENDPOINT} is free")


def check_disk(rig: Rig, folder: Path) -> Finding:
    """How long whole frames could be recorded into a folder."""
    free = shutil.disk_usage(folder).free
    rate = rig.camera.width * rig.camera.height * (rig.capture.rate_hz or DEFAULT_RATE_HZ)
    told = f"{free / 1e9:.0f} GB free here: {duration(free / rate)} of whole frames"
    if free / rate >= SHORT_S:
        return Finding("disk", Verdict.GOOD, told)
    return Finding("disk", Verdict.LOOK, told, "Record elsewhere, or only spots: serve --record-frames spots.")
