"""docs/security.md as it stands there: with the right key poses arrive, with a wrong one or none they do not."""

import re
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from asterism.clients import PoseClient
from asterism.server.service.on_air import OnAir, Place, on_air
from asterism.server.sources.session_clock import SessionClock
from tests.clients.serving import tell
from tests.protocol.make_golden import RIG
from tests.servers import free_endpoint
from tests.service.page_files import Files, make_certificates

TIMEOUT_S = 15.0
KEPT_OUT_S = 5.0
REFUSED_S = 1.0  # in which a client with the right key has long had its pose


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's commands, run; and the files of another authority in stranger/."""
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "stranger").mkdir()
    for place in (folder, folder / "stranger"):
        make_certificates(place)
    return folder


@contextmanager
def server(options: Path) -> Iterator[OnAir]:
    with on_air(Place(options=options), RIG, SessionClock(), lambda: None) as air:
        yield air


def arrives(air: OnAir, options: Path, timeout_s: float, robot: str = "alpha") -> bool:
    """Whether that robot's poses arrive at a client within that time."""
    with PoseClient(options=options) as robots:
        feed, end = robots[robot], time.monotonic() + timeout_s
        while time.monotonic() < end:
            tell(air, robot)
            if feed.wait(0.02) is not None:
                return True
    return False


def test_certificates_on_both_sides(certificates: Path) -> None:
    files = Files(certificates)
    with server(files.file("server-tls.json5")) as air:
        assert arrives(air, files.file("alpha-tls.json5"), TIMEOUT_S)
        stranger = {"alpha.pem": "stranger/alpha.pem", "alpha.key": "stranger/alpha.key"}
        assert not arrives(air, files.file("alpha-tls.json5", **stranger), REFUSED_S)
        # Who trusts another authority does not believe this server either.
        assert not arrives(air, files.file("alpha-tls.json5", **{"ca.pem": "stranger/ca.pem"}), REFUSED_S)
        without = files.file("alpha-tls.json5")
        without.write_text(re.sub(r"connect_(certificate|private_key).*\n", "", without.read_text()))
        assert not arrives(air, without, REFUSED_S)


def test_users_and_passwords(tmp_path: Path) -> None:
    files = Files(tmp_path)
    (tmp_path / "users.txt").write_text("alpha:alpha's secret\n")
    with server(files.file("server-users.json5")) as air:
        assert arrives(air, files.file("alpha-users.json5"), TIMEOUT_S)
        assert not arrives(air, files.file("alpha-users.json5", **{"alpha's secret": "a guess"}), REFUSED_S)
        assert not arrives(air, files.file("alpha-users.json5", **{'"alpha"': '"bravo"'}), REFUSED_S)
        without = files.file("alpha-users.json5")
        without.write_text(re.sub(r"transport:.*\n", "", without.read_text()))
        assert not arrives(air, without, REFUSED_S)


def test_a_robot_reads_its_own_poses_only(tmp_path: Path) -> None:
    files = Files(tmp_path)
    (tmp_path / "users.txt").write_text("alpha:alpha's secret\ndesk:desk's secret\n")
    alpha = files.file("alpha-users.json5")
    desk = files.file("alpha-users.json5", **{"alpha": "desk"})
    with server(files.file("server-rights.json5")) as air:
        assert arrives(air, alpha, TIMEOUT_S)
        assert not arrives(air, alpha, REFUSED_S, "bravo")
        assert arrives(air, desk, TIMEOUT_S)
        assert arrives(air, desk, TIMEOUT_S, "bravo")


def test_connections_that_say_nothing_keep_nobody_out() -> None:
    endpoint = free_endpoint()
    host, port = endpoint.removeprefix("tcp/").split(":")
    with on_air(Place(listen=endpoint), RIG, SessionClock(), lambda: None) as air, ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection((host, int(port))))
        with PoseClient(endpoint) as robots:
            feed, end = robots["alpha"], time.monotonic() + KEPT_OUT_S
            while feed.wait(0.02) is None:
                tell(air)
                assert time.monotonic() < end, "by zenoh's own settings they wait for 10 s"
