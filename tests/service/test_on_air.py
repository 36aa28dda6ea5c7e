"""Who may speak: forged messages, names that are taken, places where nobody hears, two servers at once."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_rig, encode_odometry, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.messages import ODOMETRY, Message
from asterism.protocol.network import client_config
from asterism.server.service.names import HEARD_S, refuse_to_go_unheard
from asterism.server.service.on_air import OnAir, Place, on_air
from asterism.server.sources.session_clock import SessionClock
from tests.protocol.make_golden import RIG, ROBOT_POSE
from tests.servers import free_endpoint, open_router

TIMEOUT_S = 10.0
ODOMETRY_KEY = keys.odometry("cam", "alpha")


def nothing() -> None:
    """What happens when a rival was first, in tests that have none."""


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def air(endpoint: str) -> Iterator[OnAir]:
    with on_air(Place(listen=endpoint), RIG, SessionClock(), nothing) as made:
        yield made


def tell(air: OnAir) -> None:
    air.publisher.publish([Message(ODOMETRY_KEY, ODOMETRY, encode_odometry(ROBOT_POSE), ROBOT_POSE.exposed_ns, 0, 42)])


class Heard:
    """What a client at an endpoint hears, and an event for the first of it."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.payloads: list[bytes] = []
        self.any = threading.Event()
        self._subscriber = session.declare_subscriber(key, self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        self.payloads.append(sample.payload.to_bytes())
        self.any.set()

    def until(self, call: Callable[[], object]) -> None:
        again_until(self.any, call)


def again_until(reached: threading.Event, call: Callable[[], object]) -> None:
    """Call again and again: what is told before a subscription has got round is told to nobody."""
    end = time.monotonic() + TIMEOUT_S
    while not reached.is_set():
        call()
        assert time.monotonic() < end, "nothing came of it"
        reached.wait(0.02)


def test_through_a_servers_listener_nobody_else_is_heard(endpoint: str, air: OnAir) -> None:
    with zenoh.open(client_config(endpoint)) as forger, zenoh.open(client_config(endpoint)) as client:
        for prefix in ("", keys.REPLAY):
            heard = Heard(client, prefix + "asterism/**")
            forger.put(prefix + ODOMETRY_KEY, b"forged")
            forger.delete(prefix + ODOMETRY_KEY)
            heard.any.clear()
        seen = Heard(client, ODOMETRY_KEY)
        forger.put(ODOMETRY_KEY, b"forged")
        seen.until(lambda: (forger.put(ODOMETRY_KEY, b"forged"), tell(air)))
        assert b"forged" not in seen.payloads
        # Presence and rig replies neither; what is not Asterism's passes.
        token = forger.liveliness().declare_token(keys.alive("other"))
        queryable = forger.declare_queryable(keys.rig("cam"), lambda query: query.reply(query.key_expr, b"forged"))
        other = Heard(client, "elsewhere")
        other.until(lambda: forger.put("elsewhere", b"x"))
        alive = [str(r.ok.key_expr) for r in client.liveliness().get("asterism/*/alive") if r.ok is not None]
        assert alive == [keys.alive("cam")]
        replies = [r.ok.payload.to_bytes() for r in client.get(keys.rig("cam")) if r.ok is not None]
        assert [decode_rig(payload).camera for payload in replies] == ["cam"]
        token.undeclare()
        queryable.undeclare()


def test_a_reply_tells_who_answers(endpoint: str, air: OnAir) -> None:
    with zenoh.open(client_config(endpoint)) as client:
        told = [decode_rig(r.ok.payload.to_bytes()) for r in client.get("asterism/*/rig") if r.ok is not None]
        beat = Heard(client, keys.beat("cam"))
        beat.until(nothing)
    lived = pb.Beat()
    lived.ParseFromString(beat.payloads[0])
    assert [(t.camera, t.session, t.protocol, t.rate) for t in told] == [("cam", lived.session, 2, 1.0)]
    assert told[0].pid > 0
    assert told[0].time_ns < lived.time_ns < told[0].time_ns + 60e9


def test_a_living_name_is_not_taken_twice() -> None:
    with (
        open_router() as (router, _),
        on_air(Place(connect=router), RIG, SessionClock(), nothing),
        pytest.raises(InputError, match=r"camera 'cam' is being served already, by process \d+ on .* since 20"),
        on_air(Place(connect=router), RIG, SessionClock(), nothing),
    ):
        pass


def test_a_dead_servers_name_is_taken_over() -> None:
    with open_router() as (router, session):
        # It holds its token and its queryable, and does not answer: frozen.
        token = session.liveliness().declare_token(keys.alive("cam"))
        unanswered: list[zenoh.Query] = []
        queryable = session.declare_queryable(keys.rig("cam"), unanswered.append)
        began = time.monotonic()
        with on_air(Place(connect=router), RIG, SessionClock(), nothing) as air:
            assert unanswered
            assert time.monotonic() - began < TIMEOUT_S
            heard = Heard(session, ODOMETRY_KEY)
            heard.until(lambda: tell(air))
        token.undeclare()
        queryable.undeclare()


def test_who_joins_a_servers_own_listener_is_told_that_nobody_hears(endpoint: str, air: OnAir) -> None:
    other = replace(RIG, camera=replace(RIG.camera, name="other"))
    with (
        pytest.raises(InputError, match=r"what is published there reaches nobody .* expected a zenoh router"),
        on_air(Place(connect=endpoint), other, SessionClock(), nothing),
    ):
        pass


def test_of_two_that_started_together_the_later_ends() -> None:
    with open_router() as (router, session):
        ended = threading.Event()
        with on_air(Place(connect=router), RIG, SessionClock(), ended.set) as air:
            began_ns, number = air.publisher.age_key
            later = pb.Beat(session=number, started_ns=began_ns + 1)
            earlier = pb.Beat(session=number, started_ns=began_ns - 1)
            heard = Heard(session, "asterism/**")
            for nonsense in (b"\xff no beat", b"", to_bytes(pb.FrameReport()), to_bytes(pb.Beat(session=1))):
                session.put(keys.beat("cam"), nonsense)
            session.put(keys.beat("cam"), to_bytes(later))
            heard.until(nothing)
            assert not air.rivals.sentence
            again_until(ended, lambda: session.put(keys.beat("cam"), to_bytes(earlier)))
            assert "was there first, so this one ends" in air.rivals.sentence


def test_who_is_heard_late_is_not_taken_for_unheard() -> None:
    with open_router() as (router, session), on_air(Place(connect=router), RIG, SessionClock(), nothing) as air:

        class Busy:
            """A session of a machine so busy that it gets round to nothing for longer than a beat is waited for."""

            def declare_subscriber(self, key: str, heard: Callable[[zenoh.Sample], None]) -> zenoh.Subscriber[None]:
                self.subscribe = lambda: session.declare_subscriber(key, heard)
                return session.declare_subscriber("nothing", heard)

            def get(self, key: str, timeout: float) -> list[zenoh.Reply]:
                time.sleep(HEARD_S + 0.5)
                self.held = self.subscribe()
                return list(session.get(key, timeout=timeout))

        refuse_to_go_unheard(air.publisher, Busy(), router)  # type: ignore[arg-type]
