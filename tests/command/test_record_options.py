"""What `serve` takes to say what is recorded, and how much at most."""

import argparse

import pytest

from asterism.recordings.recorder import FramesKept
from asterism.server.command.number_arguments import size
from asterism.server.command.serve import add_arguments


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("50GB", 50_000_000_000),
        ("500 MB", 500_000_000),
        ("1.5TB", 1_500_000_000_000),
        ("64MiB", 64 << 20),
        ("2gb", 2_000_000_000),
    ],
)
def test_sizes(text: str, expected: int) -> None:
    assert size(text) == expected


@pytest.mark.parametrize(
    "text", ["", "50", "50G", "GB", "-5GB", "5e3GB", "50 gigabytes", "1GB2", "٥GB", "9" * 400 + "GB"]
)
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"expected a size such as 50GB, 500MB or 1\.5TiB"):
        size(text)


def test_a_size_too_small_for_anything_is_refused() -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="expected at least 10MB"):
        size("9MB")


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("all", FramesKept()),
        ("none", FramesKept(0)),
        ("10", FramesKept(10)),
        ("spots", FramesKept(1, spots=True)),
    ],
)
def test_which_frames(text: str, kept: FramesKept) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert parser.parse_args(["rig.yaml", "frames", "--record-frames", text]).record_frames == kept
