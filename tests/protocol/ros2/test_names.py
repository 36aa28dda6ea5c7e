"""Names as ROS 2 takes them."""

import pytest

from asterism.protocol.ros2 import names


@pytest.mark.parametrize("good", ["alpha", "_a", "A1_b", "a" * 100])
def test_parts(good: str) -> None:
    assert names.part_problem(good) is None


@pytest.mark.parametrize("bad", ["", "8", "a-b", "a b", "a/b", "ä", "a٣", "~", "a\n"])
def test_what_is_no_part(bad: str) -> None:
    assert names.part_problem(bad) is not None


@pytest.mark.parametrize(
    ("told", "clean"), [("", ""), ("/", ""), ("lab", "/lab"), ("/lab", "/lab"), ("lab/north", "/lab/north")]
)
def test_namespaces(told: str, clean: str) -> None:
    assert names.namespace_problem(told) is None
    assert names.clean_namespace(told) == clean
    assert names.odom_topic(clean, "alpha") == f"{clean}/alpha/odom"
    assert names.pose_topic(clean, "alpha") == f"{clean}/alpha/pose"


@pytest.mark.parametrize("bad", ["//", "lab//north", "lab/", "//lab", "1st", "lab/1st", "la-b", "a" * 246, "lab\n"])
def test_what_is_no_namespace(bad: str) -> None:
    assert names.namespace_problem(bad) is not None


def test_topics() -> None:
    assert names.topic_problem("/camera/image_raw") is None
    assert names.topic_problem("camera/image_raw") is None
    for bad in ("", "/", "camera//image", "camera/", "/1/image"):
        assert names.topic_problem(bad) is not None


@pytest.mark.parametrize("camera", ["cam", "front-left", "küche 2", "_"])
def test_every_camera_has_a_node(camera: str) -> None:
    assert names.part_problem(names.node_name(camera)) is None
