"""Names as ROS 2 has them: topics of a robot, and what may be a part of one.

The rules are those of ROS's own check (rmw_validate_full_topic_name, rmw_validate_namespace): parts of letters, digits
and underscores, parted by single slashes, none beginning with a digit.
"""

import re
from typing import NamedTuple

TF = "/tf"
TF_STATIC = "/tf_static"
DIAGNOSTICS = "/diagnostics"

LARGEST_DOMAIN = 232  # of DDS, whose ports are counted by it; ROS 2 takes it for all
LONGEST_TOPIC = 247  # characters
_LONGEST = 245  # of a namespace
_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_RULE = "expected letters A-Z a-z, digits and underscores, not beginning with a digit"


class RosPlace(NamedTuple):
    """Where in ROS's world: a domain, and a namespace as `clean_namespace` gives it."""

    domain: int
    namespace: str


def pose_topic(namespace: str, robot: str) -> str:
    """geometry_msgs/PoseWithCovarianceStamped. ``namespace`` is as `clean_namespace` gives it."""
    return f"{namespace}/{robot}/pose"


def odom_topic(namespace: str, robot: str) -> str:
    """nav_msgs/Odometry."""
    return f"{namespace}/{robot}/odom"


def part_problem(name: str) -> str | None:
    """Why ROS would not take ``name`` for one part of a topic, or None if it would."""
    return None if _PART.fullmatch(name) else f"is no name for ROS, {_RULE}"


def namespace_problem(namespace: str) -> str | None:
    """Why ``namespace`` is none, or None if it is one; empty and ``/`` are the root."""
    if namespace in ("", "/"):
        return None
    if len(namespace) > _LONGEST:
        return f"has {len(namespace)} characters, expected at most {_LONGEST}"
    parts = namespace.removeprefix("/").split("/")
    if not all(map(_PART.fullmatch, parts)):
        return f"is no namespace for ROS, expected parts parted by single slashes such as lab/north; of each: {_RULE}"
    return None


def topic_problem(topic: str) -> str | None:
    """Why ``topic`` is none, or None if it is one."""
    if not topic.strip("/") or (problem := namespace_problem(topic)):
        return f"is no topic for ROS, expected a name such as /camera/image_raw; of each part: {_RULE}"
    return problem


def clean_namespace(namespace: str) -> str:
    """With one slash before every part, and none for the root: what topics are put behind."""
    return f"/{namespace.strip('/')}" if namespace.strip("/") else ""


def node_name(camera: str) -> str:
    """What the server of a camera is called among nodes: names of cameras may hold what those of nodes may not."""
    return "asterism_" + re.sub(r"[^A-Za-z0-9_]", "_", camera)
