"""Servers for clients."""

from collections.abc import Iterator

import pytest

from tests.clients.serving import Server
from tests.servers import free_endpoint


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def server(endpoint: str) -> Iterator[Server]:
    made = Server(endpoint)
    yield made
    made.close()
