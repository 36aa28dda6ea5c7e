"""A router's rules as docs/security.md has them: a camera speaks under its own name only, a robot hears itself only."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh

from asterism.clients import PoseClient
from asterism.protocol import keys
from asterism.protocol.errors import InputError
from asterism.protocol.network import client_config, open_router, router_config
from asterism.server.service.on_air import OnAir, Place
from tests.clients.serving import until
from tests.service.page_files import Files, make_certificates
from tests.service.test_router import served, tell

NAMES = ("router", "left", "right", "fuse", "desk")
USERS = 'transport: {auth: {usrpwd: {user: "router", password: "r", dictionary_file: "users.txt"}}},'
HEARD_S = 0.5  # in which what is let through has long been heard

Of = Callable[[str], Path]  # the file of options of whoever has that name


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("router")
    make_certificates(folder, NAMES)
    return folder


@contextmanager
def by_certificate(folder: Path) -> Iterator[Of]:
    """A router with the page's rules, and everybody's file."""
    files = Files(folder)
    # The page's router has a certificate with the server's address, which `server.pem` is.
    own = {"router.pem": "server.pem", "router.key": "server.key"}
    with open_router(router_config(options=files.file("router.json5", **own))):
        yield lambda name: files.file("alpha-tls.json5", alpha=name)


@contextmanager
def by_password(folder: Path) -> Iterator[Of]:
    """The same with users, as the page says it is done."""
    files = Files(folder)
    (folder / "users.txt").write_text("".join(f"{name}:{name}'s secret\n" for name in ("alpha", *NAMES)))
    options = files.file("router.json5", cert_common_names="usernames", tls="tcp")
    text = options.read_text()
    begin, end = text.index("transport:"), text.index("access_control:")
    options.write_text(text[:begin] + USERS.replace("users.txt", str(folder / "users.txt")) + text[end:])
    with open_router(router_config(options=options)):
        yield lambda name: files.file("alpha-users.json5", alpha=name)


def arrives(air: OnAir, client: PoseClient, robot: str, camera: str) -> bool:
    tell(air, robot, camera)
    return client[robot].latest(1.0) is not None


@pytest.mark.parametrize("by", [by_certificate, by_password])
def test_everybody_says_and_hears_what_is_his(by: "Callable[[Path], object]", certificates: Path) -> None:
    with ExitStack() as stack:
        enter = stack.enter_context
        of: Of = enter(by(certificates))  # type: ignore[arg-type]
        # Under another's name nobody is heard, and is told so.
        with (
            pytest.raises(
                InputError, match=r"what is published there reaches nobody .* this program publish asterism/left/"
            ),
            served(Place(options=of("right")), "left"),
        ):
            pass
        left = enter(served(Place(options=of("left")), "left"))
        fused = enter(served(Place(options=of("fuse")), "fused"))
        desk, alpha = (enter(PoseClient(options=of(name))) for name in ("desk", "alpha"))
        for air, camera in ((left, "left"), (fused, "fused")):
            for robot in ("alpha", "bravo"):
                until(lambda a=air, r=robot, c=camera: tell(a, r, c) or desk.all().latest(1.0).get(r))
        until(lambda: arrives(fused, alpha, "alpha", "fused"))
        assert set(alpha.links) == {"left", "fused"}
        tell(left, "alpha", "left")
        heard: list[str] = []
        with zenoh.open(client_config(options=of("alpha"))) as robot:
            subscriber = robot.declare_subscriber("asterism/**", lambda sample: heard.append(str(sample.key_expr)))
            until(lambda: tell(fused, "alpha", "fused") or keys.odometry("fused", "alpha") in heard)
            for air, camera in ((left, "left"), (fused, "fused")):
                for name in ("alpha", "bravo"):
                    tell(air, name, camera)
            tell(fused, "alpha", "fused")
            count = heard.count(keys.odometry("fused", "alpha"))
            until(lambda: heard.count(keys.odometry("fused", "alpha")) >= count)
            subscriber.undeclare()
        beats = {keys.beat("left"), keys.beat("fused")}
        assert keys.odometry("fused", "alpha") in set(heard) <= {keys.odometry("fused", "alpha"), *beats}


def test_nobody_forges_what_is_not_his(certificates: Path) -> None:
    forgers = {"alpha": ("left", "fused"), "desk": ("left", "fused"), "fuse": ("left",)}
    with ExitStack() as stack:
        enter = stack.enter_context
        of = enter(by_certificate(certificates))
        left = enter(served(Place(options=of("left")), "left"))
        listener = enter(zenoh.open(client_config(options=of("desk"))))
        sessions = {name: enter(zenoh.open(client_config(options=of(name)))) for name in forgers}
        forged, genuine = threading.Event(), threading.Event()

        def hear(sample: zenoh.Sample) -> None:
            (forged if sample.payload.to_bytes() == b"forged" else genuine).set()

        def forge() -> None:
            for name, cameras in forgers.items():
                for camera in cameras:
                    sessions[name].put(keys.odometry(camera, "alpha"), b"forged")

        listener.declare_subscriber("asterism/**", hear)
        for name, cameras in forgers.items():
            for camera in cameras:
                sessions[name].liveliness().declare_token(keys.alive(f"{camera}-of-{name}"))
                sessions[name].declare_queryable(keys.rig(camera), lambda query: query.reply(query.key_expr, b"forged"))
        until(lambda: forge() or tell(left, "alpha", "left") or genuine.is_set())
        forge()
        assert not forged.wait(HEARD_S)
        there = [str(reply.ok.key_expr) for reply in listener.liveliness().get("asterism/*/alive") if reply.ok]
        assert there == [keys.alive("left")]
        (reply,) = [reply.ok for reply in listener.get("asterism/*/rig") if reply.ok]
        assert reply.payload.to_bytes() != b"forged"
