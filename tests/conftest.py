"""For all tests: the chain is compiled first; one seeded generator a test, named after it, so that failures repeat."""

import zlib

import numpy as np
import pytest

from asterism.server.warm_up import warm_up


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    """No test's clock or output is disturbed by what happens only at the first start on a machine."""
    warm_up()


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random generator that is the same in every run of the same test."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))
