"""For all tests: the chain is compiled first; one seeded generator a test, named after it, so that failures repeat."""

import signal
import threading
import zlib
from collections.abc import Iterator

import numpy as np
import pytest

from asterism.protocol.rig import ESTIMATORS
from asterism.server.chain.kernel_list import BLOBS, CHECK, COVERAGE, DESIGN, FUSE, LOCALIZE, SIMULATE
from asterism.server.chain.warm_up import warm_up
from asterism.server.service.telling import telling


def _compile(config: pytest.Config) -> None:
    with config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled(), telling():
        warm_up(BLOBS, *ESTIMATORS, LOCALIZE, SIMULATE, CHECK, DESIGN, FUSE, COVERAGE)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Where several processes share the tests, it is compiled once, before they are started."""
    if session.config.getoption("numprocesses", None):
        _compile(session.config)


@pytest.fixture(scope="session", autouse=True)
def _compiled(pytestconfig: pytest.Config) -> None:
    """No test's clock or output is disturbed by what happens only at the first start on a machine, which is shown."""
    _compile(pytestconfig)


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """A shell starts what runs in its background deaf to Ctrl-C, and the processes of tests would inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _signals_as_they_were() -> Iterator[None]:
    """A test that leaves signals ignored makes the processes of all later ones deaf to them."""
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = [signal.getsignal(number) for number in numbers]
    yield
    assert [signal.getsignal(number) for number in numbers] == before


@pytest.fixture(scope="session", autouse=True)
def _closed() -> Iterator[None]:
    """Every zenoh session is closed: a callback's thread that is left aborts the process as Python ends."""
    yield
    assert not [thread.name for thread in threading.enumerate() if "pyo3" in thread.name]


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random generator that is the same in every run of the same test, in whatever room it lies."""
    return np.random.default_rng(zlib.crc32(f"tests/{request.node.nodeid.rpartition('/')[2]}".encode()))
