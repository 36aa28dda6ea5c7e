"""What is said where the install does not fit names what is there to be installed."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from asterism.server.__main__ import main
from asterism.server.command import parser
from asterism.server.command.installed import MODULES, missing_module, older_install
from tests.helpers import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def distributions(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=\[ ;]", each)[0] for each in requirements}


def test_every_module_is_in_the_extra_that_is_named() -> None:
    extras = {"": PROJECT["dependencies"], **PROJECT["optional-dependencies"]}
    for module, (distribution, extra) in MODULES.items():
        assert distribution in distributions(extras[extra]), module
    named = {distribution for distribution, _ in MODULES.values()}
    imported = ("server", "review", "metrics", "ros", "dds", "foxglove", "parquet", "cluster")
    wanted = distributions([*PROJECT["dependencies"], *(each for extra in imported for each in extras[extra])])
    assert wanted == named


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("numba", "pip install 'asterism-localization[server]'"),
        ("rerun", "pip install 'asterism-localization[review]'"),
        ("prometheus_client", "pip install 'asterism-localization[metrics]'"),
        ("ruamel.yaml", "ruamel.yaml, which is not installed; install it with: pip install asterism-localization"),
    ],
)
def test_a_missing_module_is_told_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], module: str, words: str
) -> None:
    def missing(_: str) -> None:
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)

    monkeypatch.setattr(parser, "module_of", missing)
    assert main(["locate", "rig.yaml", "frames", "-o", "-"]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"asterism: asterism locate needs the module {module}")
    assert told.endswith(f"{words}\n")


def test_a_module_of_nobody_s_is_an_error_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_module("asterism.server.command.nonsense", ["x"]) == ""

    def missing(_: str) -> None:
        raise ModuleNotFoundError("No module named 'asterism.nonsense'", name="asterism.nonsense")

    monkeypatch.setattr(parser, "module_of", missing)
    with pytest.raises(ModuleNotFoundError):
        main(["check", "rig.yaml"])


def installed(site: Path, name: str, record: str, entry_points: str) -> str:
    """A folder of packages with a distribution's metadata, as pip leaves them."""
    metadata = site / f"{name}-0.1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    (metadata / "RECORD").write_text(record)
    (metadata / "entry_points.txt").write_text(entry_points)
    return str(site)


OURS = "[console_scripts]\nasterism = asterism.server.__main__:main\n"


def test_an_older_install_under_another_name_is_told(tmp_path: Path) -> None:
    wheel = installed(tmp_path / "wheel", "asterism", "asterism/server/__init__.py,sha256=x,1\n", "")
    editable = installed(tmp_path / "editable", "asterism", "__editable__.asterism-0.1.0.pth,,\n", OURS)
    for site in (wheel, editable):
        told = older_install(["", str(tmp_path / "none"), site])
        assert "version 0.1.0" in told
        assert "pip uninstall asterism asterism-localization, then: pip install" in told
        assert "\n" not in told


def test_what_is_not_ours_or_is_this_one_is_left_alone(tmp_path: Path) -> None:
    other = installed(tmp_path / "other", "asterism", "asterism/__init__.py,sha256=x,1\n", "")
    new = installed(tmp_path / "new", "asterism_localization", "asterism/server/__init__.py,sha256=x,1\n", OURS)
    assert older_install([other, new]) == ""
    assert older_install([]) == ""


def test_it_is_said_once_per_start_and_not_with_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    site = installed(tmp_path, "asterism", "asterism/server/__init__.py,sha256=x,1\n", OURS)
    monkeypatch.setattr(sys, "path", [*sys.path, site])
    main(["check", "nowhere.yaml"])
    assert capsys.readouterr().err.count("under its older name") == 1
    main(["check", "nowhere.yaml", "--quiet"])
    assert capsys.readouterr().err == "asterism: nowhere.yaml: no such file\n"
