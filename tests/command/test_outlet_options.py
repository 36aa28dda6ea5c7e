"""What of serve's outlets cannot be is refused in one sentence, before anything is begun."""

import sys
from pathlib import Path

import pytest

from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--mavlink alpha", "--mavlink alpha: expected ROBOT=HOST:PORT such as alpha=127.0.0.1:14550"),
        ("--mavlink alpha=drone:99999", "--mavlink alpha=drone:99999: port '99999', expected 1 to 65535"),
        ("--mavlink nobody=127.0.0.1:1", "the rig has no robot 'nobody', expected one of alpha, bravo, charlie"),
        ("--mavlink alpha=drone:1 --mavlink alpha=drone:1", "--mavlink alpha=drone:1: is there twice, expected once"),
        ("--web 0", "'0', expected a port, 1 to 65535"),
        ("--foxglove 70000", "'70000', expected a port, 1 to 65535"),
        ("--natnet 224.0.0.1", "--natnet 224.0.0.1: expected an IPv4 address of this machine, such as 127.0.0.1"),
        ("--natnet somewhere", "--natnet somewhere: expected an IPv4 address of this machine, such as 127.0.0.1"),
        ("--dds --ros-domain 233", "expected a domain of ROS 2, 0 to 232"),
        ("--dds --ros-namespace lab//north", "is no namespace for ROS, expected parts parted by single slashes"),
    ],
)
def test_it_is_said_what_is_wrong(words: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(["serve", str(DEMO_RIG), "sim", *words.split()])
    except SystemExit as end:
        code = int(str(end.code))
    said = capsys.readouterr().err
    assert code == 2
    assert sentence in said
    assert said.count("\n") == 1


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    assert main(["serve", str(DEMO_RIG), "sim", "--dds"]) == 2
    assert "install it with: pip install 'asterism-localization[dds]'" in capsys.readouterr().err


def test_a_robot_whose_id_is_no_name_for_ros_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("camera.yaml", "rig.yaml"):
        text = (DEMO_RIG.parent / name).read_text()
        (tmp_path / name).write_text(text.replace("  alpha:", "  7-of-nine:"))
    assert main(["serve", str(tmp_path / "rig.yaml"), "sim", "--dds"]) == 2
    assert "--dds: the robot's id '7-of-nine'" in capsys.readouterr().err
