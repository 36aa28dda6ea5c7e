"""What processes listen on, as the kernel tells it, and which processes there are."""

import socket
import time
from pathlib import Path

LISTENS = "0A"  # in /proc/net/tcp
LOOPBACK = {"0100007F", "00000000000000000000000001000000"}  # 127.0.0.1 and ::1, as the kernel writes them


def family(pid: int) -> set[int]:
    """A process and all that it has started, whatever session they are in."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has ended
                continue
            if fields[0] != "Z":
                parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, new = {pid}, [pid]
    while new:
        new = [child for parent in new for child in parents.get(parent, ())]
        found.update(new)
    return found


def listening(pids: set[int]) -> set[tuple[str, int]]:
    """Address, in the kernel's letters, and port of every TCP socket that one of them listens on."""
    inodes = {inode for pid in pids for inode in _sockets(pid)}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTENS and fields[9] in inodes:
                address, port = fields[1].split(":")
                found.add((address, int(port, 16)))
    return found


def free_ports(count: int) -> int:
    """The first of so many ports of loopback in a row that nobody listens on."""
    for first in range(20_000, 30_000, count):
        sockets = [socket.socket() for _ in range(count)]
        try:
            for port, probe in enumerate(sockets, first):
                probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        else:
            return first
        finally:
            for probe in sockets:
                probe.close()
    raise AssertionError("no ports are free")


def wait_until_gone(pids: set[int], timeout_s: float = 30.0) -> None:
    """Until none of them lives, zombies not counted."""
    until = time.monotonic() + timeout_s
    while living := {pid for pid in pids if _lives(pid)}:
        assert time.monotonic() < until, f"{living} live on"
        time.sleep(0.02)


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _sockets(pid: int) -> list[str]:
    found = []
    try:
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            name = str(entry.readlink())
            if name.startswith("socket:["):
                found.append(name[8:-1])
    except OSError:
        pass
    return found
