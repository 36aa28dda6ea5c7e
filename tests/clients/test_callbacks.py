"""Who calls back does no harm to others, and may be taken back; poses come to asyncio."""

import asyncio
import itertools
import sys
import threading

import pytest

from asterism.clients import PoseClient
from asterism.clients.callbacks import Callbacks
from tests.clients.serving import Server, until


def test_a_callback_that_raises_is_told_once_and_starves_nobody(
    endpoint: str, server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        called: list[str] = []

        def raises(_: object) -> None:
            called.append("raises")
            raise ZeroDivisionError("meant")

        feed.on_pose(raises)
        take_back = feed.on_pose(lambda _: called.append("other"))
        until(lambda: server.tell() or called.count("other") > 3)
        assert called.count("raises") > 3
        told = [record for record in caplog.records if record.name == Callbacks.__module__]  # a busy link has its own
        assert [record.exc_info is not None for record in told] == [True]
        feed.off_pose(raises)
        take_back()
        take_back()  # twice is no mistake
        feed.on_pose(lambda _: called.append("last"))
        called.clear()
        until(lambda: server.tell() or called.count("last") > 3)
        # What was on its way when they were taken back may still have come.
        assert called.index("last") <= 2
        assert set(called[called.index("last") :]) == {"last"}


def test_callbacks_may_take_themselves_back_and_end_a_thread_of_nobody() -> None:
    callbacks: Callbacks[int] = Callbacks()
    seen: list[int] = []

    def once(value: int) -> None:
        seen.append(value)
        callbacks.remove(once)
        sys.exit(3)

    callbacks.add(once)
    callbacks.add(seen.append)
    callbacks.call(1)
    callbacks.call(2)
    assert seen == [1, 1, 2]
    assert callbacks.raised == 1


def test_a_client_may_be_closed_from_a_callback(endpoint: str, server: Server) -> None:
    robots = PoseClient(endpoint)
    ended = threading.Event()

    def close(_: object) -> None:
        robots.close()
        ended.set()

    robots["alpha"].on_pose(close)
    until(lambda: server.tell() or ended.wait(0.01))
    assert list(robots["alpha"]) == []


def test_poses_come_to_asyncio(endpoint: str, server: Server) -> None:
    async def follow(robots: PoseClient) -> list[int]:
        numbers, seen = itertools.count(100), []
        poses = robots["alpha"].stream()
        server.tell(sequence=next(numbers))
        async for pose in poses:
            seen.append(pose.sequence)
            if len(seen) == 5:
                break
            server.tell(sequence=next(numbers))
        assert [pose async for pose in robots["bravo"].stream(timeout_s=0.01)] == []
        return seen

    async def until_closed(robots: PoseClient) -> int:
        closing = asyncio.get_running_loop().run_in_executor(None, robots.close)
        count = len([pose async for pose in robots["bravo"].stream()])
        await closing
        return count

    with PoseClient(endpoint) as robots:
        until(lambda: server.tell() or robots["alpha"].latest(10.0))
        seen = asyncio.run(asyncio.wait_for(follow(robots), 20.0))
        assert seen == sorted(seen)
        assert asyncio.run(asyncio.wait_for(until_closed(robots), 20.0)) == 0
