"""What ROS 2 has no name for is refused before anything is begun, in a sentence that says what it would take."""

import argparse
from pathlib import Path

import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.command.joined import joined
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.simulated import Simulated

RULE = "expected letters A-Z a-z, digits and underscores, not beginning with a digit"


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """What a command that refuses says."""
    try:
        code = main([str(word) for word in words])
    except SystemExit as left:
        code = left.code
    assert code == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told
    return told


@pytest.mark.parametrize("domain", ["233", "-1", "1.5", "x", "", "1" * 20])
def test_domains(capsys: pytest.CaptureFixture[str], domain: str) -> None:
    told = refusal(capsys, "serve", DEMO_RIG, "sim", "--ros2", f"--ros-domain={domain}")
    assert "expected a domain of ROS 2, 0 to 232" in told or "expected a number of at most 15 digits" in told


@pytest.mark.parametrize("namespace", ["lab//north", "lab/", "1st", "la-b", "lab north"])
def test_namespaces(capsys: pytest.CaptureFixture[str], namespace: str) -> None:
    told = refusal(capsys, "serve", DEMO_RIG, "sim", "--ros2", f"--ros-namespace={namespace}")
    assert "is no namespace for ROS, expected parts parted by single slashes such as lab/north" in told
    assert RULE in told


def test_robots(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    (tmp_path / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    rig.write_text(DEMO_RIG.read_text().replace("  bravo:", "  bravo-2:"))
    told = refusal(capsys, "serve", rig, "sim", "--ros2")
    assert f"--ros2: the robot's id 'bravo-2' is no name for ROS, {RULE}; it becomes part of its topics" in told


@pytest.mark.parametrize("name", ["world", "demo"])
def test_frames_of_one_name(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    (tmp_path / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    (tmp_path / "rig.yaml").write_text(DEMO_RIG.read_text().replace("  bravo:", f"  {name}:"))
    told = refusal(capsys, "serve", tmp_path / "rig.yaml", "sim", "--ros2")
    assert f"--ros2: the robot '{name}' has the name of a frame that is there, expected another" in told


def test_topics_that_are_too_long(capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "serve", DEMO_RIG, "sim", "--ros2", "--ros-namespace", "n" * 240)
    assert "/alpha/odom has 252 characters, expected at most 247" in told


def test_options_of_ros_without_ros(capsys: pytest.CaptureFixture[str]) -> None:
    assert "add --ros2" in refusal(capsys, "serve", DEMO_RIG, "sim", "--ros-namespace", "lab")
    assert "add --ros2, or take images from it: ros2:TOPIC" in refusal(
        capsys, "serve", DEMO_RIG, "sim", "--ros-domain", "3"
    )
    source = Simulated(load_rig(DEMO_RIG))
    options = argparse.Namespace(listen=None, connect=None, zenoh=None, ros_domain=3)
    with pytest.raises(InputError, match="--ros-domain: is for images of ROS 2, ros2:TOPIC"), joined(source, options):
        pass


def test_what_is_no_topic(capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "serve", DEMO_RIG, "ros2:/a b")
    assert "is no topic for ROS, expected a name such as /camera/image_raw" in told
