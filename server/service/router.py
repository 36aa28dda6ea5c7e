"""What a person is told of a router: where it listens, who comes and goes, which cameras are to be heard."""

import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import NamedTuple

import zenoh

from asterism.protocol import keys

LOOK_EVERY_S = 0.1
MOST_WAITING = 1024  # events between two looks
LINKED_WITHIN_S = 3.0  # after that it is said that another router does not answer
LOOPBACK = ("127.", "localhost:", "[::1]:")
MOST_NAMES = 1000


def remark(listen: Sequence[str], is_ruled: bool) -> str:
    """A sentence about endpoints that others may reach, where no rules say who may speak; else nothing."""
    wide = [endpoint for endpoint in listen if not _is_of_this_machine(endpoint)]
    if not wide or is_ruled:
        return ""
    return (
        f"warning: whoever reaches {', '.join(wide)} may publish in any camera's name; who may is said by "
        "access_control, for users or certificates (--zenoh FILE)"
    )


def _is_of_this_machine(endpoint: str) -> bool:
    protocol, _, address = endpoint.partition("/")
    return protocol == "unixsock-stream" or address.startswith(LOOPBACK)


class _Guest(NamedTuple):
    name: str
    is_router: bool
    since_s: float


class Visitors:
    """Who is connected to a router, and which cameras' servers it hears. `step` again and again, then `close`.

    ``linked`` are endpoints of the routers that it links to; ``say`` tells a person; ``monotonic`` is in s.
    """

    def __init__(
        self,
        session: zenoh.Session,
        linked: Sequence[str],
        say: Callable[[str], None],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._info = session.info
        self._linked = tuple(linked)
        self._say = say
        self._monotonic = monotonic
        self._began_s = monotonic()
        self._waits = bool(linked)
        self._guests: dict[str, _Guest] = {}
        self._came = self._most = 0
        self._cameras: set[str] = set()
        self._heard: dict[str, None] = {}  # every camera that ever was, in their order
        # No callbacks: the threads that zenoh runs them on may outlive the session, and Python.
        channel = zenoh.handlers.RingChannel
        self._links = self._info.declare_link_events_listener(channel(MOST_WAITING), history=True)
        self._tokens = session.liveliness().declare_subscriber(keys.alive("*"), channel(MOST_WAITING), history=True)

    def step(self) -> None:
        """Tell what has happened, and wait a little."""
        while (event := self._links.handler.try_recv()) is not None:
            (self._come if event.kind == zenoh.SampleKind.PUT else self._go)(event.link)
        while (token := self._tokens.handler.try_recv()) is not None:
            self._tell_camera(str(token.key_expr).split("/")[-2], token.kind == zenoh.SampleKind.PUT)
        self._tell_if_not_linked()
        time.sleep(LOOK_EVERY_S)

    def close(self) -> None:
        """Look no more."""
        self._links.undeclare()
        self._tokens.undeclare()

    def summary(self) -> list[str]:
        """What there was, in lines."""
        told = [
            f"{self._came} connections came, at most {self._most} at once; {len(self._guests)} are there at the end"
        ]
        if self._heard:
            told.append(f"cameras heard: {', '.join(_printable(name) for name in self._heard)}")
        return told

    def _come(self, link: zenoh.Link) -> None:
        kinds = {str(one.zid): str(one.whatami) for one in self._info.transports()}
        kind = kinds.get(str(link.zid), "program")
        # A certificate's name, where it has one; users' names zenoh does not tell.
        certificate = f", certificate {_printable(link.auth_identifier)}" if link.auth_identifier else ""
        guest = _Guest(f"{_short(link.dst)} ({kind}{certificate})", kind == "router", self._monotonic())
        self._guests[_place(link)] = guest
        self._came += 1
        self._most = max(self._most, len(self._guests))
        self._say(f"connected: {guest.name}")

    def _go(self, link: zenoh.Link) -> None:
        guest = self._guests.pop(_place(link), None)
        if guest is not None:
            self._say(f"gone: {guest.name}, after {_duration(self._monotonic() - guest.since_s)}")

    def _tell_camera(self, name: str, there: bool) -> None:
        if there == (name in self._cameras) or len(self._heard) > MOST_NAMES:
            return
        (self._cameras.add if there else self._cameras.discard)(name)
        self._heard[name] = None
        self._say(f"camera '{_printable(name)}': its server is {'there' if there else 'gone'}")

    def _tell_if_not_linked(self) -> None:
        if not self._waits or self._monotonic() - self._began_s < LINKED_WITHIN_S:
            return
        self._waits = False
        if sum(guest.is_router for guest in self._guests.values()) < len(self._linked):
            self._say(f"not linked yet to every router of {', '.join(self._linked)}; it is tried on and on ...")


def _place(link: zenoh.Link) -> str:
    return f"{link.zid} {link.src} {link.dst}"


def _short(locator: str) -> str:
    return _printable(locator.partition("#")[0].partition("?")[0])


def _printable(text: str) -> str:
    return "".join(char if char.isprintable() else "?" for char in text)[:200]


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
