"""Who writes a recording is known while its process lives, and no longer."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from asterism.protocol.errors import InputError
from asterism.recordings import held
from asterism.recordings.held import WRITER, cut_off, held_for_recovery, hold

HOLDER = """
import sys
from pathlib import Path
from asterism.recordings.held import hold
held = hold(Path(sys.argv[1]), "cam")
print("held", flush=True)
sys.stdin.read()
"""


def test_what_a_living_process_writes_is_nobody_elses(tmp_path: Path) -> None:
    folder = tmp_path / "cam-1"
    folder.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        assert cut_off(tmp_path, "cam") == []
        with pytest.raises(InputError, match=rf"cam-1: is being written by process {holder.pid}, which records or"):
            hold(folder)
        with pytest.raises(InputError), held_for_recovery(folder):
            pass
        holder.kill()
    assert cut_off(tmp_path, "cam") == [folder]
    assert cut_off(tmp_path, "other") == []
    with held_for_recovery(folder):
        assert cut_off(tmp_path, "cam") == []
    assert cut_off(tmp_path, "cam") == []
    assert not (folder / WRITER).exists()


def test_a_recovery_that_fails_leaves_the_mark_and_makes_none(tmp_path: Path) -> None:
    folder = tmp_path / "cam-1"
    folder.mkdir()
    (tmp_path / "cam-link").symlink_to(folder)
    hold(folder, "cam").release(whole=False)
    with pytest.raises(OSError, match="full"), held_for_recovery(folder):
        raise OSError("full")
    assert cut_off(tmp_path, "cam") == [folder]
    (folder / WRITER).unlink()
    with pytest.raises(OSError, match="full"), held_for_recovery(folder):
        raise OSError("full")
    assert list(folder.iterdir()) == []


def test_what_may_only_be_read_is_refused_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    living = hold(tmp_path, "cam")

    def only_read(*_: object) -> None:
        raise PermissionError

    with monkeypatch.context() as patch:
        patch.setattr(held, "hold", only_read)
        with pytest.raises(InputError, match=f"is being written by process {os.getpid()}"), held_for_recovery(tmp_path):
            pass
        living.release(whole=False)
        with held_for_recovery(tmp_path):
            pass


@pytest.mark.parametrize("what", ["fifo", "link", "folder", "nonsense", "list", "deep", "empty"])
def test_marks_that_are_none_of_ours_are_left_alone(tmp_path: Path, what: str) -> None:
    folder = tmp_path / "cam-1"
    folder.mkdir()
    path = folder / WRITER
    if what == "fifo":
        os.mkfifo(path)
    elif what == "link":
        path.symlink_to(tmp_path / "elsewhere")
    elif what == "folder":
        path.mkdir()
    else:
        path.write_text({"nonsense": "\x00", "list": "[1]", "deep": "[" * 4000, "empty": ""}[what])
    assert cut_off(tmp_path, "cam") == []
    assert not (tmp_path / "elsewhere").exists()
