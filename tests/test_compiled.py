"""Kernels: parts are compiled once and never as wholes; results are numba's own; what is kept is kept apart by all that
it depends on, and only what is gone is cleaned up.
"""

import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import binding as llvm
from numba.core import event

from asterism.server import kernel, kernel_folder
from asterism.server.kernel import Kernel
from asterism.server.kernel_folder import FORGOTTEN_DAYS, LABEL, clean_up, folder_for, made_for
from tests.measure.first_start import Compiled


@pytest.fixture
def compiled() -> Iterator[Compiled]:
    listener = Compiled()
    event.register("numba:compile", listener)
    yield listener
    event.unregister("numba:compile", listener)


def add_up(values: Any, count: Any) -> Any:
    total = 0.0
    for i in range(count):
        total += values[i]
    return total


def kernels(folder: Path) -> tuple[Kernel, Kernel]:
    inner = Kernel(add_up, folder, error_model="numpy")

    def both(values: Any, doubled: Any) -> Any:
        doubled[:] = values
        return inner(values, 2) + inner(doubled, values.shape[0])

    return inner, Kernel(both, folder, error_model="numpy")


def test_a_part_is_compiled_once_and_only_the_whole_is_kept(tmp_path: Path, compiled: Compiled) -> None:
    inner, outer = kernels(tmp_path)
    values = np.arange(4.0)
    assert outer(values, np.empty(4)) == 1.0 + 6.0
    # Once, though it is called with a constant and with a variable; nothing else either: not one of numba's own.
    assert compiled.names[:2] == ["both", "add_up"]
    assert compiled.names.count("add_up") == 1
    assert not [name for name in compiled.names if "str" in name or "join" in name]
    assert inner.overloads == {}
    assert sorted(file.suffix for file in tmp_path.rglob("*both*")) == [".nbc", ".nbi"]
    assert not list(tmp_path.rglob("*add_up*"))


def test_a_large_part_is_left_out_until_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "LARGE", 3)
    inner = Kernel(add_up, tmp_path)

    def twice(values: Any, count: Any) -> Any:
        return inner(values, count) + inner(values, 1)

    middle = Kernel(twice, tmp_path)

    def whole(values: Any, count: Any) -> Any:
        return middle(values, count) + inner(values, 3)

    values = np.arange(4.0)
    assert Kernel(whole, tmp_path)(values, 4) == 6.0 + 0.0 + 3.0
    (part,), (caller,) = inner._parts.values(), middle._parts.values()
    assert list(caller.library.left_out) == [part.library]
    assert not [name for name in (one.name for one in caller.library.get_defined_functions()) if "add_up" in name]
    assert Kernel(whole, tmp_path)(values, 4) == 9.0  # from the disk


def test_python_can_call_a_part_too(tmp_path: Path) -> None:
    inner, outer = kernels(tmp_path)
    values = np.arange(4.0)
    outer(values, np.empty(4))
    assert inner(values, 3) == 3.0
    assert len(list(tmp_path.rglob("*add_up*"))) == 2
    assert outer(values, np.empty(4)) == 7.0


def test_the_next_start_compiles_nothing(tmp_path: Path, compiled: Compiled) -> None:
    values = np.arange(4.0)
    first, again = Kernel(add_up, tmp_path), Kernel(add_up, tmp_path)
    types = tuple(map(numba.typeof, (values, 3)))
    assert not first.is_kept(types)
    assert first(values, 3) == 3.0
    assert again.is_kept(types)
    compiled.names.clear()
    assert again(values, 3) == 3.0
    assert compiled.names == []


def test_kernels_compute_what_numba_computes(tmp_path: Path, rng: np.random.Generator) -> None:
    values = rng.normal(size=100)
    assert Kernel(add_up, tmp_path)(values, 100) == numba.njit(add_up)(values, 100) == add_up(values, 100)


def test_shapes_that_differ_are_refused_in_kernels(tmp_path: Path) -> None:
    _, outer = kernels(tmp_path)
    with pytest.raises(ValueError, match="shapes of the two sides of an assignment differ"):
        outer(np.arange(4.0), np.empty(3))


def test_others_keep_numbas_own_message() -> None:
    @numba.njit
    def assign(target: Any, source: Any) -> None:
        target[:] = source

    with pytest.raises(ValueError, match="cannot assign slice of shape"):
        assign(np.empty(3), np.empty(4))


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_file_that_was_cut_off_is_made_anew(tmp_path: Path, suffix: str) -> None:
    values, types = np.arange(4.0), (numba.float64[::1], numba.int64)
    assert Kernel(add_up, tmp_path)(values, 3) == 3.0
    (file,) = tmp_path.rglob(f"*{suffix}")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert Kernel(add_up, tmp_path)(values, 3) == 3.0
    again = Kernel(add_up, tmp_path)
    assert again.is_kept(types)
    assert again(values, 3) == 3.0
    assert len(file.read_bytes()) > len(whole) // 2


def test_where_nothing_can_be_written_kernels_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert Kernel(add_up, tmp_path / "file" / "no folder")(np.arange(4.0), 3) == 3.0


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the program, with one kernel."""
    room = tmp_path / "copy" / "server" / "room"
    room.mkdir(parents=True)
    (room / "kernel.py").write_text("from asterism.server.compiled import compiled\n")
    (room / "other.py").write_text("print()\n")
    return room.parent


def test_the_folder_is_named_after_everything_the_code_depends_on(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folders = [folder_for(made_for(copy))]
    assert folders[0] == folder_for(made_for(copy))
    assert folders[0].parent == tmp_path / "cache" / "asterism"
    shutil.copytree(copy, tmp_path / "another" / "server")
    folders.append(folder_for(made_for(tmp_path / "another" / "server")))
    (copy / "room" / "kernel.py").write_text("from asterism.server.compiled import compiled\n# changed\n")
    folders.append(folder_for(made_for(copy)))
    for owner, name, value in (
        (sys, "version", "3.99.0"),
        (numba, "__version__", "9.9.9"),
        (llvm, "get_host_cpu_name", lambda: "z80"),
        (llvm, "get_process_triple", lambda: "z80-unknown-cpm"),
    ):
        monkeypatch.setattr(owner, name, value)
        folders.append(folder_for(made_for(copy)))
    assert len(set(folders)) == 7
    (copy / "room" / "other.py").write_text("print(1)\n")
    assert folder_for(made_for(copy)) == folders[-1]  # a module without kernels


def test_numbas_own_variable_is_respected(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert folder_for(made_for(copy)).is_relative_to(tmp_path / "mine")


def labelled(base: Path, name: str, label: dict[str, str], days: float = 0.0) -> Path:
    folder = base / name
    folder.mkdir(parents=True)
    file = folder / LABEL
    file.write_text(json.dumps({"host": platform.node(), **label}))
    then = time.time() - days * 86400.0
    os.utime(file, (then, then))
    return folder


def test_only_what_is_gone_is_cleaned_up(copy: Path, tmp_path: Path) -> None:
    base, made = tmp_path / "cache", made_for(copy)
    other = tmp_path / "other copy"
    other.mkdir()
    gone = [
        labelled(base, "former sources", {**made, "sources": "0"}),
        labelled(base, "copy that is gone", {**made, "copy": str(tmp_path / "nowhere")}),
        labelled(base, "unused for long", {**made, "numba": "0.1"}, FORGOTTEN_DAYS + 1.0),
    ]
    kept = [
        labelled(base, "this", made),
        labelled(base, "another copy", {**made, "copy": str(other), "sources": "0"}),
        labelled(base, "another Python", {**made, "python": "3.99", "sources": "0"}),
        labelled(base, "another numba", {**made, "numba": "9", "sources": "0"}, FORGOTTEN_DAYS - 1.0),
        labelled(base, "another processor", {**made, "machine": "z80"}),
        labelled(base, "another host's", {**made, "copy": str(tmp_path / "nowhere"), "host": "elsewhere"}),
    ]
    (base / "somebody else's").mkdir()
    (base / "a file").write_text("")
    clean_up(base, made)
    assert not [folder.name for folder in gone if folder.exists()]
    assert [folder.name for folder in kept if not folder.exists()] == []
    assert (base / "somebody else's").exists()
    assert (base / "a file").exists()


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(kernel_folder, "kernel_folder", lambda: tmp_path / "file" / "asterism" / "0")
    assert kernel_folder.open_folder() == f"{tmp_path / 'file' / 'asterism' / '0'}: Not a directory"
