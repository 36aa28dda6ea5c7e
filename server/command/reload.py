"""asterism reload: a server on this machine reads its rig again, and tells how that went."""

import argparse
import contextlib
import os
import platform
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError, WorldError
from asterism.server.command.shared_arguments import add_client

if TYPE_CHECKING:
    import zenoh

    from asterism.protocol import asterism_pb2 as pb

EXAMPLES = "asterism reload\nasterism reload CAMERA\n"

ANSWER_S = 5.0  # a server that does not answer for so long, on however busy a machine, is dead
DONE_S = 300.0  # another estimator's kernels may have to be compiled


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("camera", metavar="CAMERA", nargs="?", help="whose server, where there are several")
    add_client(part)


def run(options: argparse.Namespace) -> int:
    """Send SIGHUP to the camera's server, and wait for what comes of it."""
    from asterism.protocol.keys import key_problem
    from asterism.protocol.network import DEFAULT_ENDPOINT

    if options.camera is not None and (problem := key_problem(options.camera)):
        raise InputError(f"camera {options.camera!r}: {problem}")
    where = str(options.connect or options.zenoh or DEFAULT_ENDPOINT)
    with _session(options.connect, options.zenoh, where) as session:
        before = _the_one(_answers(session, options.camera or "*"), options.camera, where)
        refuse_what_cannot_reload(before, platform.node())
        name = f"camera '{before.camera}' (process {before.pid})"
        began = time.monotonic()
        _send(before.pid, name)
        after = _settled(session, before, name)
    if after.reloads.problem:
        raise InputError(f"{name}: {after.reloads.problem}")
    robots = f"{len(after.robots)} robot{'s' * (len(after.robots) > 1)}"
    print(f"{name}: the rig was read again and is in force after {time.monotonic() - began:.2f} s, {robots}")
    return 0


@contextlib.contextmanager
def _session(connect: str | None, options: Path | None, where: str) -> "Iterator[zenoh.Session]":
    import zenoh

    from asterism.protocol.network import check_endpoint, client_config

    if connect is not None:
        check_endpoint(connect)
    config = client_config(connect, options)
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        raise WorldError(f"{where}: no server answers there") from None
    try:
        yield session
    finally:
        session.close()


def _answers(session: "zenoh.Session", camera: str) -> "list[pb.RigReport]":
    """What the servers of a camera, or of all, tell of their rigs."""
    from asterism.protocol import keys
    from asterism.protocol.codec import decode_rig

    answers = []
    for reply in session.get(keys.rig(camera), timeout=ANSWER_S):
        if reply.ok is not None:
            with contextlib.suppress(InputError):
                answers.append(decode_rig(reply.ok.payload.to_bytes()))
    return answers


def _the_one(answers: "list[pb.RigReport]", camera: str | None, where: str) -> "pb.RigReport":
    if not answers:
        who = "no server" if camera is None else f"no server of a camera '{camera}'"
        raise WorldError(f"{where}: {who} answers there")
    if len(answers) > 1:
        names = ", ".join(sorted(answer.camera for answer in answers))
        raise InputError(f"{where}: several cameras are served there, expected the name of one: {names}")
    return answers[0]


def refuse_what_cannot_reload(told: "pb.RigReport", here: str, processes: Path = Path("/proc")) -> None:
    """Raises InputError for a server that SIGHUP of a process on this machine, ``here``, does not reach, or would end.

    ``processes`` is where a system shows them; where it does not, the server's word is taken.
    """
    name = f"camera '{told.camera}'"
    if not told.HasField("reloads"):
        raise InputError(
            f"{name}: its program does not read its rig again, or is still starting; expected asterism serve"
        )
    if told.host != here:
        raise InputError(
            f"{name}: is served by process {told.pid} on {told.host}, and this is {here}; expected this command there"
        )
    if not hasattr(signal, "SIGHUP"):
        raise InputError(f"{name}: this system has no signal SIGHUP; stop the server and start it anew")
    # In a container of the same host name its numbers are those of other processes.
    if processes.is_dir() and b"serve" not in _command_line(processes / str(told.pid)).split(b"\0"):
        raise InputError(
            f"{name}: process {told.pid} of this machine is not its server (is it in a container?); expected this "
            "command where the server runs"
        )


def _command_line(process: Path) -> bytes:
    try:
        return (process / "cmdline").read_bytes()
    except OSError:
        return b""


def _send(pid: int, name: str) -> None:
    try:
        os.kill(pid, signal.SIGHUP)
    except PermissionError:
        raise InputError(f"{name}: belongs to another user; expected this command as that user, or as root") from None
    except ProcessLookupError:
        raise WorldError(f"{name}: has ended") from None


def _settled(session: "zenoh.Session", before: "pb.RigReport", name: str) -> "pb.RigReport":
    """The answer of the same server once it has read its rig again: looked for at every beat."""
    from asterism.protocol import keys

    beaten = threading.Event()
    end = time.monotonic() + DONE_S
    with session.declare_subscriber(keys.beat(before.camera), lambda _: beaten.set()):
        while time.monotonic() < end:
            for told in _answers(session, before.camera):
                if told.pid == before.pid and told.reloads.count > before.reloads.count:
                    return told
            beaten.clear()
            if not beaten.wait(ANSWER_S):
                raise WorldError(f"{name}: has stopped answering")
    raise WorldError(f"{name}: has not read its rig again within {DONE_S:.0f} s")
