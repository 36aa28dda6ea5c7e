"""What is installed: the very modules of the tree, from a clone with or without symbolic links, and from an sdist."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

import asterism
from tests.helpers import REPOSITORY

FOLDERS = ("clients", "protocol", "recordings", "server")
PYPROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())


def tracked() -> list[Path]:
    """The files that git knows, as far as they are there."""
    if not (REPOSITORY / ".git").exists():
        pytest.skip("only a git checkout tells which files belong to the project")
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    return [Path(line) for line in listed.stdout.splitlines() if (REPOSITORY / line).exists()]


def clone(to: Path, links: bool) -> Path:
    """The files of this tree in a new folder; without ``links`` a link is a small file, as git makes it on Windows."""
    for path in tracked():
        target, source = to / path, REPOSITORY / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_symlink() and links:
            target.symlink_to(source.readlink())
        elif source.is_symlink():
            target.write_text(str(source.readlink()))
        else:
            shutil.copy(source, target)
    return to


def build(folder: Path, *how: str) -> dict[str, bytes]:
    """The files of the wheel that is built there."""
    command = [sys.executable, "-m", "build", "--no-isolation", *how, "--outdir", str(folder / "out"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = (folder / "out").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def expected() -> set[str]:
    """What a wheel must hold of the tree."""
    # The client in C is compiled from the repository: Python's package has no use for it.
    ours = {path for path in tracked() if path.parts[0] in FOLDERS and path.parts[:2] != ("clients", "c")}
    source = {
        f"asterism/{path}"
        for path in ours
        if path.suffix in (".py", ".pyi", ".proto", ".yaml", ".bin", ".json", ".md", ".csv")
    }
    return source | {"asterism/__init__.py", "asterism/__main__.py", "asterism/py.typed"}


def test_a_wheel_holds_the_modules_of_the_tree_with_and_without_links_and_by_way_of_an_sdist(tmp_path: Path) -> None:
    wheel = build(clone(tmp_path / "links", True), "--wheel")
    assert {name for name in wheel if name.startswith("asterism/")} == expected()
    assert build(clone(tmp_path / "plain", False), "--wheel") == wheel
    assert build(clone(tmp_path / "sdist", False)) == wheel


def test_every_folder_with_modules_is_a_package_of_the_table() -> None:
    listed = set(PYPROJECT["tool"]["setuptools"]["packages"])
    there = {
        "asterism." + ".".join(path.parent.parts)
        for path in tracked()
        if path.parts[0] in FOLDERS and path.suffix == ".py"
    }
    assert listed == there | {"asterism"}


def test_the_installed_version_is_the_one_in_the_code() -> None:
    assert version("asterism-localization") == asterism.__version__


def test_python_m_asterism_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "asterism", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"asterism {asterism.__version__}\n"
