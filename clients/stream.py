"""Poses for asyncio: what the feed's thread hands over wakes the loop that waits for it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TypeVar

from asterism.clients.callbacks import Callbacks

T = TypeVar("T")


async def stream(
    wakers: Callbacks[None], after: Callable[[int], tuple[int, T | None, bool]], seen: int, timeout_s: float | None
) -> AsyncIterator[T]:
    """What follows number ``seen``, one after another, until the feed is closed or nothing came for ``timeout_s``.

    ``wakers`` are called when there is something new; ``after`` gives the next with its number, and whether the feed
    is closed.
    """
    loop, fresh = asyncio.get_running_loop(), asyncio.Event()

    def wake(_: None) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(fresh.set)

    take_back = wakers.add(wake)
    try:
        while True:
            fresh.clear()
            seen, pose, closed = after(seen)
            if closed:
                return
            if pose is not None:
                yield pose
                continue
            try:
                await asyncio.wait_for(fresh.wait(), timeout_s)
            except TimeoutError:
                return
    finally:
        take_back()
