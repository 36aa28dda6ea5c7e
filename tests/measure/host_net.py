"""Hosts in network namespaces for `tests.measure.hosts`: a wired network, and one behind a wireless link."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.helpers import REPOSITORY
from tests.measure.slow_link import End, Quality, SlowLink, run

PREFIX = f"a{os.getpid() % 10_000}"  # of all that is made here: other programs may do the same
BRIDGE = "wired"
HUB = "10.77.0.1"  # on the wired network: the host with the router
HUB_IN_THE_AIR = "10.77.1.1"


def why_not() -> str:
    """Why there can be no namespaces here, or nothing."""
    if os.geteuid() != 0:
        return "this needs root: it makes network namespaces"
    for program in ("ip", "tc", "unshare"):
        if shutil.which(program) is None:
            return f"this needs {program} (Debian: iproute2, util-linux)"
    tried = subprocess.run(["unshare", "-n", "true"], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
        return f"network namespaces cannot be made here: {tried.stderr.strip()}"
    if not Path("/dev/net/tun").exists():
        return "this needs /dev/net/tun"
    return ""


class Host:
    """A machine: a namespace of its own."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.space = f"{PREFIX}-{name}"

    def start(self, *words: "str | Path", env: dict[str, str] | None = None) -> "subprocess.Popen[str]":
        """Start a Python program there: what it says on both channels is to be read."""
        command = ["ip", "netns", "exec", self.space, sys.executable, "-u", *map(str, words)]
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY, env=env
        )

    def received_bytes(self, device: str) -> int:
        """What a device there has received since it was made, with all headers."""
        path = f"/sys/class/net/{device}/statistics/rx_bytes"
        told = subprocess.run(
            ["ip", "netns", "exec", self.space, "cat", path], check=True, capture_output=True, text=True
        )
        return int(told.stdout)


class Network:
    """Hosts on a bridge, and one behind a wireless link to the first of them, the hub."""

    def __init__(self, wired: Sequence[str], quality: Quality) -> None:
        self.hosts = {name: Host(name) for name in (*wired, "robots")}
        self._switch = Host("switch")
        self._wired = tuple(wired)
        ends = (
            End(self.hosts[wired[0]].space, f"{PREFIX}air0", f"{HUB_IN_THE_AIR}/24"),
            End(self.hosts["robots"].space, f"{PREFIX}air1", "10.77.1.2/24"),
        )
        self.air = SlowLink(ends, quality)
        self.air_device = ends[1].device

    def cut(self, name: str, is_cut: bool) -> None:
        """Pull a wired host's plug out of the switch, or put it in again; the host keeps its carrier."""
        where = ["master", BRIDGE] if not is_cut else ["nomaster"]
        run("ip", "netns", "exec", self._switch.space, "ip", "link", "set", self._port(name), *where)

    def _port(self, name: str) -> str:
        return f"p{self._wired.index(name)}"

    def build(self, stack: ExitStack) -> None:
        """Make all of it; ``stack`` takes it away."""
        for host in (self._switch, *self.hosts.values()):
            run("ip", "netns", "add", host.space)
            stack.callback(run, "ip", "netns", "del", host.space)
            run("ip", "netns", "exec", host.space, "ip", "link", "set", "lo", "up")
        inside = ("ip", "netns", "exec", self._switch.space, "ip", "link")
        run(*inside, "add", BRIDGE, "type", "bridge")
        run(*inside, "set", BRIDGE, "up")
        for number, name in enumerate(self._wired):
            end = End(self.hosts[name].space, "eth0", f"10.77.0.{number + 1}/24")
            peer = ("peer", "name", "eth0", "netns", end.space)
            run(*inside, "add", self._port(name), "type", "veth", *peer)
            run(*inside, "set", self._port(name), "master", BRIDGE, "up")
            end.bring_up()
        stack.enter_context(self.air)


@contextmanager
def network(wired: Sequence[str], quality: Quality) -> Iterator[Network]:
    """A network as `Network` has it, until the context ends."""
    with ExitStack() as stack:
        made = Network(wired, quality)
        made.build(stack)
        yield made
