"""Connections to where cameras' servers are: what they publish goes into a queue, with when it arrived."""

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import zenoh

from asterism.protocol import keys
from asterism.protocol.codec import decode_rig
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.network import check_endpoint, client_config
from asterism.server.service.fusing.answer import Answer, Texts, read_answer
from asterism.server.service.say import say
from asterism.server.service.threads import Ticker

RETRY_S = 1.0  # of endpoints at which nothing answered at the start
ANSWER_S = 2.0  # a server that does not tell its rig within that time is asked again
MOST_BYTES = 1 << 20  # of a message: a frame report of thousands of spots, a rig of hundreds of robots
TOO_MUCH = b"\xff"  # in place of a longer one: no message
MOST_ANSWERS = 8  # of servers under one name


class Heard(NamedTuple):
    """A sample: of which connection, the camera's name, the key's last word, and when it arrived, by the monotonic
    clock. ``payload`` is None where the camera's liveliness token came (``there``) or went.
    """

    ear: int
    camera: str
    word: str
    payload: bytes | None
    arrived_ns: int
    there: bool = True


class Answers(NamedTuple):
    """What came of asking for a camera's rig: every answer, none where nobody gave one."""

    camera: str
    answers: tuple[Answer, ...]


class Ears:
    """Hands on what is heard of ``cameras`` (none: of all) to ``take``, on zenoh's threads. A context manager.

    Raises InputError for malformed endpoints and files, WorldError where no endpoint answers.
    """

    def __init__(
        self,
        endpoints: Sequence[str],
        options: Path | None,
        cameras: Sequence[str],
        take: Callable[[Heard | Answers], None],
    ) -> None:
        for endpoint in endpoints:
            check_endpoint(endpoint)
        self._take = take
        self._names = tuple(cameras) or ("*",)
        self._closed = threading.Event()
        self._asking: list[threading.Thread] = []
        self._held: list[object] = []
        self._sessions: list[zenoh.Session] = []
        self._own: list[zenoh.Session] = []
        self._missing = {endpoint: _config(endpoint, options) for endpoint in endpoints}
        self._open_missing()
        if endpoints and not self._sessions:
            raise WorldError(f"{', '.join(endpoints)}: no server answers there; start one first, or name another place")
        for endpoint in self._missing:
            say(f"{endpoint}: no server answers there yet; it is tried again")
        self._retrying = Ticker(self._open_missing, RETRY_S)

    def hear(self, session: zenoh.Session) -> None:
        """Hear through this session too, which stays its owner's."""
        ear = len(self._sessions)
        self._sessions.append(session)

        def take(sample: zenoh.Sample) -> None:
            arrived_ns = time.monotonic_ns()
            _, camera, word = str(sample.key_expr).split("/")
            payload = sample.payload.to_bytes() if len(sample.payload) <= MOST_BYTES else TOO_MUCH
            self._take(Heard(ear, camera, word, payload, arrived_ns))

        def show(sample: zenoh.Sample) -> None:
            _, camera, word = str(sample.key_expr).split("/")
            there = sample.kind == zenoh.SampleKind.PUT
            self._take(Heard(ear, camera, word, None, time.monotonic_ns(), there))

        for name in self._names:
            for key in (keys.frame(name), keys.event(name)):
                self._held.append(session.declare_subscriber(key, take))
            self._held.append(session.liveliness().declare_subscriber(keys.alive(name), show, history=True))

    def ask(self, ear: int, camera: str, known: Texts) -> None:
        """Ask for a camera's rig, beside; the answers are handed on as all else. ``known`` is what need not be read."""
        self._asking = [one for one in self._asking if one.is_alive()]
        name = f"rig of {camera}"
        if any(one.name == name for one in self._asking):  # what was answered is still being read
            return
        thread = threading.Thread(target=self._ask, args=(ear, camera, known), name=name, daemon=True)
        self._asking.append(thread)
        thread.start()

    def close(self) -> None:
        """Hear nothing any more."""
        self._closed.set()
        self._retrying.close()
        for subscriber in self._held:
            subscriber.undeclare()  # type: ignore[attr-defined]
        until_s = time.monotonic() + ANSWER_S + 1.0
        for thread in self._asking:
            thread.join(max(until_s - time.monotonic(), 0.0))
        for session in self._own:
            session.close()

    def __enter__(self) -> "Ears":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open_missing(self) -> None:
        for endpoint, config in list(self._missing.items()):
            with contextlib.suppress(zenoh.ZError):
                session = zenoh.open(config)
                del self._missing[endpoint]
                self._own.append(session)
                self.hear(session)

    def _ask(self, ear: int, camera: str, known: Texts) -> None:
        answers: list[Answer] = []
        with contextlib.suppress(zenoh.ZError):
            replies = self._sessions[ear].get(
                keys.rig(camera), timeout=ANSWER_S, consolidation=zenoh.ConsolidationMode.NONE
            )
            for reply in replies:
                if len(answers) >= MOST_ANSWERS:
                    break
                if reply.ok is not None and len(reply.ok.payload) <= MOST_BYTES:
                    with contextlib.suppress(InputError):
                        answers.append(read_answer(decode_rig(reply.ok.payload.to_bytes()), camera, known))
        if not self._closed.is_set():
            self._take(Answers(camera, tuple(answers)))


def _config(endpoint: str, options: Path | None) -> zenoh.Config:
    """Of a client, whatever the file has for the server that speaks."""
    config = client_config(endpoint, options)
    config.insert_json5("mode", '"client"')
    config.insert_json5("listen/endpoints", "[]")
    return config
