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
        ("--web frames/", "argument --web: 'frames/', expected a port, 1 to 65535; RIG and SOURCE go before it"),
        ("--foxglove 70000", "argument --foxglove: '70000', expected a port, 1 to 65535; RIG and SOURCE go before it"),
        ("--dds --ros-domain 233", "expected a domain of ROS 2, 0 to 232"),
        ("--dds --ros-namespace lab//north", "is no namespace for ROS, expected parts parted by single slashes"),
        ("--web 9380 --foxglove 9381", "--foxglove 9381: port 9381 is that of --web, which takes PORT + 1 too"),
        (
            "--foxglove 9100 --metrics 9100",
            "--metrics 9100: port 9100 is that of --foxglove; expected a port of its own",
        ),
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


def test_of_a_domain_in_the_environment_it_is_said_that_it_is_not_read(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["serve", str(DEMO_RIG), "sim", "--mavlink", "nobody=127.0.0.1:1"]  # refused, right after
    remark = "ROS_DOMAIN_ID is '7' here and not read: this is domain 0, another is --ros-domain N"
    for set_to, more, said in (
        ("7", ["--ros2"], True),
        ("7", ["--ros2", "--ros-domain", "7"], False),
        ("0", ["--ros2"], False),
        ("7", [], False),
    ):
        monkeypatch.setenv("ROS_DOMAIN_ID", set_to)
        assert main([*words, *more]) == 2
        assert (remark in capsys.readouterr().err) == said, more


def test_a_robot_whose_id_is_no_name_for_ros_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("camera.yaml", "rig.yaml"):
        text = (DEMO_RIG.parent / name).read_text()
        (tmp_path / name).write_text(text.replace("  alpha:", "  7-of-nine:"))
    assert main(["serve", str(tmp_path / "rig.yaml"), "sim", "--dds"]) == 2
    assert "--dds: the robot's id '7-of-nine'" in capsys.readouterr().err
