"""One seeded generator a test; the seed is the test's name, so every failure can be repeated."""

import zlib

import numpy as np
import pytest


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random generator that is the same in every run of the same test."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))
