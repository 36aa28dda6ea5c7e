"""Whatever stands in a file or message is read, or refused with a sentence: a slice of `tests.measure.mutated`."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_text
from tests.helpers import shared
from tests.protocol.mutated_targets import TARGETS, check


@pytest.mark.parametrize("name", TARGETS)
def test_mutated_input_is_read_or_refused(name: str, rng: np.random.Generator) -> None:
    target = TARGETS[name]
    assert all(check(target, good) for good in target.good), "what is not mutated is read"
    read = sum(check(target, target.mutated(rng)) for _ in range(target.in_tests))
    assert read < target.in_tests, "nothing was refused"


def test_what_readers_have_stumbled_over(tmp_path: Path) -> None:
    folder = Path(__file__).parent.parent / "data" / "mutated"
    found = sorted(folder.iterdir())
    assert len(found) >= 20
    for file in found:
        target = TARGETS[file.name.split("-")[0]]
        check(target, file.read_bytes() if target.is_bytes else file.read_text(encoding="utf-8", errors="replace"))


def test_the_complaints_folder_too() -> None:
    folder = shared("cases") / "19-mutated-inputs"
    known = [file for file in sorted(folder.iterdir()) if file.name.split("-")[0] in TARGETS]
    assert known
    for file in known:
        target = TARGETS[file.name.split("-")[0]]
        check(target, file.read_bytes() if target.is_bytes else file.read_text(encoding="utf-8", errors="replace"))


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "long").write_bytes(b"x" * 101)
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    for name, words in (
        (tmp_path / "pipe", "is no regular file (a pipe, a device?), expected a rig"),
        (Path("/dev/zero"), "is no regular file"),
        (tmp_path, "is a folder, expected a rig"),
        (tmp_path / "none", "no such file"),
        (tmp_path / "long", "is longer than 100 bytes, expected a rig"),
        (tmp_path / "bytes", "is no text in UTF-8, expected a rig"),
        (tmp_path / ("x" * 300), "cannot be read (File name too long)"),
        (Path("a\x00b"), "is no name of a file, expected a rig"),
    ):
        with pytest.raises(InputError) as refused:
            read_text(name, "a rig", 100)
        assert words in str(refused.value)
