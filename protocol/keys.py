"""The zenoh keys: one function a key, so that no other module spells them."""

PREFIX = "asterism"
REPLAY = "replay/"  # before every key of a replay
FUSED = "fused"  # stands where a camera's name does, for what `asterism fuse` publishes: no camera has it
LONGEST_NAME = 128  # bytes, of a camera, robot or point

# What a client of one robot, of any camera, subscribes to is `odometry("*", robot)`.


def odometry(camera: str, robot: str) -> str:
    """Pose of a robot, one message a frame in which it is located."""
    return f"{PREFIX}/{camera}/robot/{robot}/odometry"


def frame(camera: str) -> str:
    """Report of every frame."""
    return f"{PREFIX}/{camera}/frame"


def rig(camera: str) -> str:
    """Queryable: rig and calibration in force."""
    return f"{PREFIX}/{camera}/rig"


def status(camera: str) -> str:
    """Health, once a second."""
    return f"{PREFIX}/{camera}/status"


def event(camera: str) -> str:
    """What happened, when it happens: a robot was lost or found, frames stopped, another rig is in force."""
    return f"{PREFIX}/{camera}/event"


def coverage(camera: str) -> str:
    """Where tools have been, once a second, where the rig has a surface and robots that stand on it."""
    return f"{PREFIX}/{camera}/coverage"


def beat(camera: str) -> str:
    """The server's beat, five times a second, whatever its camera does."""
    return f"{PREFIX}/{camera}/beat"


def alive(camera: str) -> str:
    """Liveliness token of the server."""
    return f"{PREFIX}/{camera}/alive"


def visible(camera: str, robot: str) -> str:
    """Liveliness token of a robot that is being located."""
    return f"{PREFIX}/{camera}/robot/{robot}/visible"


# Only in recordings:


def image(camera: str) -> str:
    """The frames themselves."""
    return f"{PREFIX}/{camera}/image"


def annotations(camera: str) -> str:
    """Spots and names, for drawing over the image."""
    return f"{PREFIX}/{camera}/annotations"


def calibration(camera: str) -> str:
    """The camera's calibration."""
    return f"{PREFIX}/{camera}/calibration"


TRANSFORMS = "/tf"


def key_problem(name: str) -> str | None:
    """Why ``name`` cannot be one part of a zenoh key, or None if it can."""
    if not name:
        return "is empty, expected at least one character"
    if name.startswith("@"):
        return "begins with '@', which zenoh keeps for itself"
    if len(name.encode(errors="replace")) > LONGEST_NAME:
        return f"is longer than {LONGEST_NAME} bytes; files and folders are named after it"
    bad = sorted({char for char in name if char in "/*$?#" or not char.isprintable()})
    if bad:
        return f"holds {' '.join(repr(char) for char in bad)}, expected none of / * $ ? # and no control characters"
    return None


def robot_of(key: str) -> str | None:
    """The robot's id in an odometry or visible key, behind any prefix, or None for other keys."""
    parts = key.split("/")
    if len(parts) >= 5 and parts[-5] == PREFIX and parts[-3] == "robot" and parts[-1] in {"odometry", "visible"}:
        return parts[-2]
    return None
