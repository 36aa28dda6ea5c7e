"""The robots in C fit the client that they use, and what they use of zenoh; the client goes where C99 goes."""

import subprocess
from pathlib import Path

import pytest

from tests.clients.c_client import SOURCES, STRICT, compiler

HEADERS = Path(__file__).with_name("c_headers")
WITH_THREADS = ("-DZ_FEATURE_MULTI_THREAD=1", "-DZ_FEATURE_QUERY=1")
WAYS = {
    "robot_zenoh_c": ("-std=c11",),
    "robot_zenoh_pico": ("-std=c11", *WITH_THREADS),
    "robot_zenoh_pico without threads": ("-std=c99", "-DASTERISM_FLOAT", "-DASTERISM_NO_MAIN"),
    "asterism_wire on bare metal": ("-ffreestanding", "-DASTERISM_FLOAT", "-Wdouble-promotion"),
    "asterism_odometry on bare metal": ("-ffreestanding", "-DASTERISM_FLOAT", "-Wdouble-promotion"),
    "asterism_clock on bare metal": ("-ffreestanding", "-DASTERISM_FLOAT", "-Wdouble-promotion"),
}


@pytest.mark.skipif(compiler() is None, reason="needs a C compiler: `cc`, or what CC names")
@pytest.mark.parametrize("what", WAYS)
def test_it_compiles_without_a_warning(what: str) -> None:
    name, *_ = what.split()
    command = [compiler() or "", *STRICT, *WAYS[what], "-fsyntax-only", f"-I{HEADERS}", str(SOURCES / f"{name}.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
