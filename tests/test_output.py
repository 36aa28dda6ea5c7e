"""What commands write: one rule for files and folders, and nothing half-written under its final name."""

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from asterism.protocol.errors import InputError, WorldError
from asterism.server.output import PARTIAL, Output, check_file, check_folder, check_folder_of_many, new_file, new_folder


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def write(path: Path, text: str, force: bool = False) -> Path | None:
    with new_file(path, force) as output:
        output.path.write_text(text)
    return output.kept


def fill(path: Path, files: dict[str, str], force: bool = False) -> Path | None:
    with new_folder(path, force) as output:
        for name, text in files.items():
            (output.path / name).parent.mkdir(parents=True, exist_ok=True)
            (output.path / name).write_text(text)
    return output.kept


def test_a_file_is_replaced_only_with_force_and_every_old_one_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "poses.jsonl"
    assert write(path, "one") is None
    with pytest.raises(InputError, match=r"poses.jsonl: exists; choose another name, or --force to replace it"):
        write(path, "two")
    assert path.read_text() == "one"
    assert write(path, "two", force=True) == tmp_path / "poses.jsonl.old-1"
    assert write(path, "three", force=True) == tmp_path / "poses.jsonl.old-2"
    assert [(tmp_path / f"poses.jsonl{end}").read_text() for end in ("", ".old-1", ".old-2")] == ["three", "one", "two"]
    assert len(names(tmp_path)) == 3


def test_a_folder_is_replaced_as_a_whole_and_an_empty_one_is_welcome(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()
    assert fill(path, {"a": "one", "frames/0": "one", "frames/1": "one"}) is None
    with pytest.raises(InputError, match="out: exists already, expected a new or empty folder, or --force"):
        fill(path, {"a": "two"})
    assert fill(path, {"a": "two", "frames/0": "two"}, force=True) == tmp_path / "out.old-1"
    assert names(path) == ["a", "frames", "frames/0"]
    assert names(tmp_path / "out.old-1") == ["a", "frames", "frames/0", "frames/1"]
    assert (tmp_path / "out.old-1" / "a").read_text() == "one"
    assert fill(tmp_path / "other", {"b": ""}) is None
    assert names(tmp_path / "other") == ["b"]


def test_what_is_already_partial_stands_in_no_rerun_s_way(tmp_path: Path) -> None:
    """As a run that was killed leaves it."""
    (tmp_path / f"poses.jsonl{PARTIAL}").write_text("half")
    write(tmp_path / "poses.jsonl", "whole")
    (tmp_path / "out" / PARTIAL).mkdir(parents=True)
    (tmp_path / "out" / PARTIAL / "half").write_text("half")
    fill(tmp_path / "out", {"a": "whole"})
    assert names(tmp_path) == ["out", "out/a", "poses.jsonl"]


@pytest.mark.parametrize("kind", [KeyboardInterrupt, InputError])
def test_what_is_cut_short_leaves_what_was_there_and_says_so(tmp_path: Path, kind: type[BaseException]) -> None:
    def cut(begin: Callable[[], object]) -> list[str]:
        with pytest.raises(kind) as ended:
            begin()
        return getattr(ended.value, "__notes__", [])[-1:]

    def file(keep: bool) -> None:
        with new_file(tmp_path / "a", True, keep) as output:
            output.path.write_text("half")
            raise kind("cut short")

    def folder(path: Path) -> None:
        with new_folder(path, True) as output:
            (output.path / "half").write_text("half")
            raise kind("cut short")

    nothing = ["nothing was written"] if kind is KeyboardInterrupt else []
    assert cut(lambda: file(keep=False)) == nothing
    assert cut(lambda: folder(tmp_path / "out")) == nothing
    assert names(tmp_path) == []
    write(tmp_path / "a", "whole")
    fill(tmp_path / "out", {"b": "whole"})
    assert cut(lambda: folder(tmp_path / "out")) == nothing
    assert cut(lambda: file(keep=True)) == [f"what was done so far is in {tmp_path / 'a'}{PARTIAL}"]
    assert names(tmp_path) == ["a", f"a{PARTIAL}", "out", "out/b"]
    assert (tmp_path / "a").read_text() == "whole"


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("")
    for check, name, words in (
        (check_file, "none/x", "there is no folder .*none"),
        (check_folder, "none/x", "there is no folder .*none"),
        (check_file, "file/x", "file is a file, expected a folder"),
        (check_folder, "file/x", "file is a file, expected a folder"),
        (check_file, "full", "is a folder, expected the name of a file"),
        (check_folder, "file", "is a file, expected a new or empty folder"),
        (check_file, "x" * 300, "cannot be written .File name too long"),
        (check_file, "x" * 250, "cannot be written .File name too long"),
        (check_folder, "x" * 300, "cannot be written .File name too long"),
        (check_file, "\udcff/x", "there is no folder"),
    ):
        for force in (False, True):
            with pytest.raises(InputError, match=words):
                check(tmp_path / name, force)
    with pytest.raises(InputError, match="-: is the terminal, expected the name of a file"):
        check_file(Path("-"), False)
    with pytest.raises(InputError, match="is a file, expected a new or empty folder"):
        check_folder_of_many(tmp_path / "file")
    with pytest.raises(InputError, match="there is no folder"):
        check_folder_of_many(tmp_path / "none" / "x")
    check_folder_of_many(tmp_path / "full")
    check_folder_of_many(tmp_path / "new")
    monkeypatch.chdir(tmp_path / "full")
    for path in (Path(), tmp_path / "full", tmp_path):
        with pytest.raises(InputError, match="is the folder you are in, or holds it"):
            check_folder(path, True)
    assert names(tmp_path) == ["file", "full", "full/note"]


@pytest.mark.parametrize(
    ("number", "kind"), [(errno.EACCES, InputError), (errno.EROFS, InputError), (errno.ENOSPC, WorldError)]
)
def test_a_disk_that_does_not_take_it_is_told_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, kind: type[Exception]
) -> None:
    """A full disk is the world's fault, a read-only one was named by the user."""

    def refuse(**_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    for check in (check_file, check_folder):
        with pytest.raises(kind, match=rf"new: cannot be written \({os.strerror(number)}\)"):
            check(tmp_path / "new", False)
    with pytest.raises(kind, match="cannot be written"):
        check_folder_of_many(tmp_path)


def test_a_disk_that_fills_up_meanwhile_is_the_world_s_failure(tmp_path: Path) -> None:
    def full(output: Output) -> None:
        if output.path.name != PARTIAL:
            output.path.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with (
        pytest.raises(WorldError, match=r"x: cannot be written \(No space left") as failed,
        new_file(tmp_path / "x", False, keep=True) as output,
    ):
        full(output)
    assert failed.value.__notes__ == [f"what was done so far is in {tmp_path / 'x'}{PARTIAL}"]
    with pytest.raises(WorldError, match="y: cannot be written"), new_folder(tmp_path / "y", False) as output:
        full(output)
    assert not (tmp_path / "y").exists()


def test_errors_of_other_files_are_not_blamed_on_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), new_file(tmp_path / "x", False):
        (tmp_path / "frame.png").read_bytes()


def test_devices_and_pipes_are_written_to_as_they_are(tmp_path: Path) -> None:
    check_file(Path("/dev/null"), False)
    assert write(Path("/dev/null"), "x") is None
    assert not Path("/dev/null").is_file()


def test_a_link_is_followed_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "data" / "real")
    assert write(tmp_path / "link", "one") is None
    assert write(tmp_path / "link", "two", force=True) == tmp_path / "data" / "real.old-1"
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "data" / "real").read_text() == "two"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_that_takes_nothing_is_named() -> None:
    with pytest.raises(WorldError, match=r"^/dev/full: cannot be written \(No space left on device\)$"):
        write(Path("/dev/full"), "a")
