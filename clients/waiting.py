"""A session of the network, for commands that listen: they may be there before the server."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.protocol.network import DEFAULT_ENDPOINT, check_endpoint, client_config

if TYPE_CHECKING:
    import zenoh

RETRY_S = 0.5


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def waited_for(
    connect: str | None, options: Path | None, say: Callable[[str], None] = _say, stop: Callable[[], bool] = bool
) -> "Iterator[tuple[zenoh.Session, str]]":
    """A session with the server, waited for until there is one, and where that is. Raises InputError for a malformed
    endpoint or file, KeyboardInterrupt where ``stop`` says so before there was one.
    """
    import zenoh

    if connect is not None:
        check_endpoint(connect)
    config = client_config(connect, options)
    endpoint = connect or (str(options) if options else DEFAULT_ENDPOINT)
    session, said = None, False
    while session is None:
        try:
            session = zenoh.open(config)
        except zenoh.ZError:
            if not said:
                say(f"waiting for a server at {endpoint} ...")
                said = True
            if stop():
                raise KeyboardInterrupt from None
            time.sleep(RETRY_S)
    try:
        yield session, endpoint
    finally:
        session.close()
