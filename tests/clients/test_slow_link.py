"""Over links that stand still or carry too little, no pose is taken for fresher than it is, and the client says why."""

import itertools
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from asterism.clients import LinkState, PoseClient, ReceivedPose
from tests.clients.proxy import Proxy
from tests.clients.serving import Server, until

EVERY_S = 0.005


@contextmanager
def telling(server: Server, robots: tuple[str, ...]) -> Iterator[None]:
    """A server that tells of robots all the time."""
    stop = threading.Event()

    def tell() -> None:
        for sequence in itertools.count():
            for robot in robots:
                server.tell(robot=robot, sequence=sequence)
            if stop.wait(EVERY_S):
                return

    thread = threading.Thread(target=tell)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


class Watching:
    """Asks again and again for what is fresh, and compares with when that was exposed."""

    def __init__(self, server: Server, robots: PoseClient) -> None:
        self._server = server
        self._feed = robots["alpha"]
        self.given = 0
        self.oldest_s = 0.0

    def look(self) -> bool:
        # The time before: so no pause of this thread makes a pose look older than it was given for.
        now_ns = self._server.clock.now_ns()
        pose = self._feed.latest(max_age_s=0.1)
        if pose is not None:
            self.given += 1
            self.oldest_s = max(self.oldest_s, (now_ns - pose.exposed_ns) * 1e-9)
        return pose is not None


def test_what_waited_while_the_link_stood_still_is_not_fresh(endpoint: str, server: Server) -> None:
    with Proxy(endpoint) as proxy, PoseClient(proxy.endpoint) as robots, telling(server, ("alpha",)):
        watching = Watching(server, robots)
        until(watching.look)
        proxy.flows.clear()
        until(lambda: not watching.look() and robots.link.state is LinkState.SILENT)
        assert "the server has stopped answering, for" in robots.link.sentence
        assert robots["alpha"].link.state is LinkState.SILENT
        assert not robots.alive
        proxy.flows.set()
        until(lambda: watching.look() or robots["alpha"].late)
        until(watching.look)
        until(lambda: robots.alive)
    assert watching.oldest_s < 0.11
    assert robots["alpha"].late > 10, "what arrived after the stall came late"


def test_a_link_too_slow_gives_nothing_stale_and_is_told(
    endpoint: str, server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    names = ("alpha", "bravo", "charlie")
    with Proxy(endpoint, rate=60_000) as proxy, PoseClient(proxy.endpoint) as robots, telling(server, names):
        robots.all()
        watching = Watching(server, robots)
        until(lambda: watching.look() or robots["alpha"].late)
        until(lambda: (watching.look(), robots["alpha"].late > 50)[1])
        assert robots.link.state is LinkState.SLOW
        until(lambda: caplog.messages)
    assert watching.oldest_s < 0.11
    assert "the link is too slow, what the server sends arrives" in caplog.messages[0]


def test_a_callback_that_takes_long_is_not_the_links_fault(endpoint: str, server: Server) -> None:
    ages: list[float] = []

    def dawdle(pose: ReceivedPose) -> None:
        ages.append(pose.age_s)
        time.sleep(0.1)

    with PoseClient(endpoint) as robots, telling(server, ("alpha",)):
        robots["alpha"].on_pose(dawdle)
        until(lambda: ages and ages[-1] > 0.5)
        assert robots["alpha"].late == 0
        assert robots.link.state is LinkState.LIVE


def test_a_server_on_another_clock_and_one_that_comes_back(endpoint: str) -> None:
    from asterism.server.sources.session_clock import SessionClock

    with PoseClient(endpoint) as robots:
        for years in (-7, 0, 12):
            off_ns = years * 365 * 86_400 * 10**9
            clock = SessionClock(wall=lambda off_ns=off_ns: 1_800_000_000 * 10**9 + off_ns)  # type: ignore[misc]
            server = Server(endpoint, clock=clock)
            watching = Watching(server, robots)
            until(lambda s=server, w=watching: s.tell() or w.look())
            # What took long before it went out is old on arrival.
            until(lambda s=server: s.tell(age_s=2.0) or robots["alpha"].latest(1.9) is None)
            assert robots["alpha"].latest(60.0) is not None
            server.close()
            until(lambda: not robots.alive)
            assert watching.oldest_s < 0.11


def test_each_play_of_a_replay_has_its_own_ages_at_its_own_speed(endpoint: str) -> None:
    from asterism.server.service.play_clock import PlayClock

    clock = PlayClock(rate=4.0)
    server = Server(endpoint, "replay/", clock)
    with PoseClient(endpoint, prefix="replay/") as robots:
        for play in range(3):
            clock.begin(1_700_000_000 * 10**9)  # the same time again
            watching = Watching(server, robots)
            until(
                lambda n=play, w=watching, c=clock: (
                    server.tell(sequence=n) or (w.look() and _session(robots) == c.session)
                )
            )
            assert watching.oldest_s < 0.1 + 4 * 0.01
    server.close()


def _session(robots: PoseClient) -> int:
    pose = robots["alpha"].latest(60.0)
    return 0 if pose is None else pose.session


def test_a_connection_that_hangs_is_given_up_for_a_new_one(endpoint: str, server: Server) -> None:
    with Proxy(endpoint) as proxy, PoseClient(proxy.endpoint) as robots, telling(server, ("alpha",)):
        watching = Watching(server, robots)
        until(watching.look)
        hangs, proxy.flows = proxy.flows, threading.Event()
        proxy.flows.set()
        hangs.clear()
        until(lambda: not watching.look() and robots.link.state is LinkState.SILENT)
        until(lambda: watching.look() and robots.link.state is LinkState.LIVE)
        hangs.set()
    assert watching.oldest_s < 0.11
