"""A terminal, pipe, disk or log that is gone does not end the work."""

import contextlib
import io
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest

from asterism.server.service.lasting import Lasting
from asterism.server.service.say import say
from asterism.server.service.telling import telling

FULL = Path("/dev/full")


@contextlib.contextmanager
def error_channel(number: int) -> Iterator[None]:
    """What is written to the error channel goes to that file descriptor, which is closed in the end."""
    before = sys.stderr
    stream = os.fdopen(number, "w")
    sys.stderr = stream
    try:
        yield
    finally:
        sys.stderr = before
        stream.close()


def test_the_reader_of_a_pipe_may_end() -> None:
    reader, writer = os.pipe()
    with error_channel(writer), telling():
        say("one")
        assert os.read(reader, 100) == b"asterism: one\n"
        os.close(reader)
        for _ in range(5000):
            say("two, to nobody, again and again")
        os.write(writer, b"neither do libraries fail there")


def test_a_terminal_may_be_closed() -> None:
    master, terminal = os.openpty()
    with error_channel(terminal), telling():
        say("one")
        os.close(master)
        for _ in range(100):
            say("two, to nobody")
        assert not os.isatty(terminal)


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
def test_a_full_disk_loses_lines_only(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left"), FULL.open("w") as full:
        full.write("into a full disk")
    with error_channel(os.open(FULL, os.O_WRONLY)), telling() as told:
        told.choose(quiet=False, verbose=False, log=FULL)
        for _ in range(5000):
            say("into a full disk, again and again")


def test_what_finds_room_again_is_written() -> None:
    class Disk(io.StringIO):
        full = True

        def write(self, text: str) -> int:
            if self.full:
                raise OSError(28, "No space left on device")
            return super().write(text)

    disk = Disk()
    stream: TextIO = Lasting(disk)  # type: ignore[assignment]
    print("lost", file=stream, flush=True)
    disk.full = False
    print("written", file=stream, flush=True)
    assert disk.getvalue() == "written\n"


def test_a_channel_that_was_closed_before_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with telling():
        say("to nobody")
    assert sys.stderr is None


def test_a_log_that_is_moved_or_whose_folder_goes_is_begun_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "logs" / "serve.log"
    log.parent.mkdir()
    with telling() as told:
        told.choose(quiet=False, verbose=False, log=log)
        say("first")
        log.rename(log.with_suffix(".1"))
        say("second")
        shutil.rmtree(log.parent)
        say("lost")
        log.parent.mkdir()
        say("third")
    assert log.read_text().endswith("asterism.said: third\n")
    assert len(log.read_text().splitlines()) == 1
    assert [line.removeprefix("asterism: ") for line in capsys.readouterr().err.splitlines()] == [
        "first",
        "second",
        "lost",
        "third",
    ]
