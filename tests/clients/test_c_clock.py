"""The age of a pose as a robot without Python knows it: the law of clients/age.py, in C, on the same events."""

import threading

import numpy as np

from asterism.clients.age import SessionAge
from asterism.clients.server_state import FUTURE_S, ServerState
from asterism.protocol import asterism_pb2 as pb
from tests.clients.c_client import CClient

SECOND = 1_000_000_000
SERVER_NS = 1_795_398_896_123_456_789
ROUNDING_NS = 10
UNKNOWN_NS = (1 << 63) - 1
Event = tuple[str, int, int, int, int]


def events(rng: np.random.Generator, count: int) -> list[Event]:
    """Beats, answers, poses and looks at the age of one, as a network with stalls hands them on, clocks 100 ppm apart
    and the server's new at times: kind, session, stamp, when it came (an answer: was asked), exposure (an answer came).
    """
    here_ns, session, ahead_ns, made = int(rng.integers(1, 10**15)), 1, SERVER_NS, []
    exposed_ns = 0
    for _ in range(count):
        here_ns += int(rng.exponential(0.05) * SECOND)
        if rng.random() < 0.002:
            here_ns += int(rng.uniform(60, 86400) * SECOND)
        if rng.random() < 0.01:
            session, ahead_ns, exposed_ns = session + 1, ahead_ns + int(rng.integers(-SECOND, SECOND)) * 1000, 0
        there_ns = ahead_ns + here_ns + here_ns // 10_000
        late_ns = int((rng.exponential(0.001) + 0.3 * (rng.random() < 0.05)) * SECOND)
        kind = str(rng.choice(list("bapp..")))
        if kind == "p":
            exposed_ns = max(exposed_ns + 1, there_ns - late_ns - 4_000_000)
            published_ns = exposed_ns + 4_000_000 + SECOND * int(rng.random() < 0.02)  # at times from the future
            made.append((kind, session, published_ns, here_ns, exposed_ns))
        elif kind == "a":
            made.append((kind, session, there_ns + late_ns // 2, here_ns, here_ns + late_ns))
            here_ns += late_ns
        else:
            made.append((kind, session, there_ns - late_ns, here_ns, exposed_ns))
    return made


def test_ages_are_those_of_pythons_client(c_client: CClient, rng: np.random.Generator) -> None:
    happened = [("a", 1, SERVER_NS, 1, 2), *events(rng, 5000)]
    server, session = ServerState("cam", threading.Event()), 1
    known = future = 0
    for event, (words, age_ns, _) in zip(happened, c_client.events(happened, alone=False), strict=True):
        kind, of, stamp_ns, here_ns, other_ns = event
        if kind == "b":
            server.beats(pb.Beat(session=of, time_ns=stamp_ns, rate=1.0), here_ns)
        elif kind == "a":
            report = pb.RigReport(session=of, time_ns=stamp_ns, rate=1.0)
            server.answers(report, here_ns, other_ns)
        elif kind == "p" and of == session:
            late_s = server.arrived(server.age(of), stamp_ns, here_ns)
            assert (words == "was published later than now") == (late_s < -FUTURE_S)
            future += late_s < -FUTURE_S
        elif kind == "p":
            assert words == "is of a session that the server did not tell of"
        elif of == session:
            told_ns = server.age(of).time_ns(here_ns)
            assert age_ns == UNKNOWN_NS if told_ns is None else abs(age_ns - (told_ns - other_ns)) <= ROUNDING_NS
            known += told_ns is not None
        session = of if kind in "ab" else session
    assert known > 1000
    assert future > 20


def test_alone_ages_rest_on_the_least_delay_as_in_python(c_client: CClient, rng: np.random.Generator) -> None:
    happened = [event for event in events(rng, 5000) if event[1] == 1 and event[0] in "bp."]
    age = SessionAge()
    age.alone = True
    for event, (words, age_ns, _) in zip(happened, c_client.events(happened, alone=True), strict=True):
        kind, _, stamp_ns, here_ns, exposed_ns = event
        if kind in "bp":
            age.heard(here_ns, stamp_ns)
            assert words == "is good"
            continue
        told_ns = age.time_ns(here_ns)
        assert age_ns == UNKNOWN_NS if told_ns is None else abs(age_ns - (told_ns - exposed_ns)) <= ROUNDING_NS


def test_a_pose_is_taken_once_in_the_order_of_exposure_and_of_the_session_that_was_told(c_client: CClient) -> None:
    exposed = SERVER_NS
    told = [
        (("p", 7, exposed + 4, 1000, exposed), "is good"),  # nothing was told: its session is taken
        (("p", 7, exposed + 4, 2000, exposed), "is older than the one before, or the same"),
        (("p", 7, exposed + 4, 3000, exposed - 1), "is older than the one before, or the same"),
        (("p", 8, exposed + 4, 4000, exposed - 1), "is good"),  # a new session: stamps of two do not compare
        (("b", 9, exposed + 5, 5000, 0), "is good"),
        (("p", 8, exposed + 9, 6000, exposed + 2), "is of a session that the server did not tell of"),
        (("p", 9, exposed + 9, 7000, exposed + 2), "is good"),
        (("b", 10, exposed + 10, 8000, 0), "is good"),
        ((".", 9, 0, 9000, exposed + 2), "is good"),
    ]
    answers = c_client.events([event for event, _ in told], alone=True)
    assert [words for words, _, _ in answers] == [words for _, words in told]
    assert answers[-1][1] == UNKNOWN_NS, "of a session that is over there is no age"


def test_a_server_that_sends_nothing_for_four_beats_has_stopped_answering(c_client: CClient) -> None:
    happened = [(".", 1, 0, 5, 0), ("b", 1, SERVER_NS, SECOND, 0)]
    happened += [(".", 1, 0, SECOND + after_ns, 0) for after_ns in (0, 800_000_000, 800_000_001)]
    assert [heard for _, _, heard in c_client.events(happened, alone=False)] == [False, True, True, True, False]


def test_at_the_ends_of_time_nothing_overflows(c_client: CClient, rng: np.random.Generator) -> None:
    """The sanitizer ends the program where a sum does."""
    stamps = rng.choice(np.array([1, 2, 10**9, 10**18, (1 << 62) - 2, (1 << 62) - 1]), 3000).tolist()
    others = rng.choice(np.array([0, 1, 10**9, 10**18, (1 << 61) - 1, 1 << 61]), (3000, 2)).tolist()
    kinds = rng.choice(list("bap."), 3000).tolist()
    sessions = rng.integers(1, 3, 3000).tolist()
    happened = [
        (kind, session, stamp, *two) for kind, session, stamp, two in zip(kinds, sessions, stamps, others, strict=True)
    ]
    assert len(c_client.events(happened, alone=False)) == len(c_client.events(happened, alone=True)) == 3000
