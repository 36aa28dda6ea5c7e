"""Servers for clients."""

from collections.abc import Iterator

import pytest

from tests.clients.c_client import CClient, build, compiler
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


@pytest.fixture(scope="session")
def c_client(tmp_path_factory: pytest.TempPathFactory) -> CClient:
    """The client in C, compiled."""
    if compiler() is None:
        pytest.skip("needs a C compiler: `cc`, or what CC names")
    return build(tmp_path_factory.mktemp("c"))
