"""Where what is drawn of one camera stands among rerun's entities: alone, or as one of several in one world."""

from dataclasses import dataclass

import rerun as rr


def part(name: str) -> str:
    """A name as one part of an entity's path, whatever characters it holds."""
    escaped: str = rr.escape_entity_path_part(name)
    return escaped


@dataclass(frozen=True, slots=True)
class Entities:
    """``camera`` is the camera's own place, empty where there is none; ``space`` stands before `robots`,
    `alternatives` and `paths`, ``told`` before `robots`, `plots` and `states`, or is None where robots are drawn over
    the image only; ``events`` is where events go.

    ``by`` is told with every robot's name in space, ``storey`` above its plate; ``several``: frames are numbered
    camera by camera, so that time alone is common to all, and images stand near their cameras.
    """

    camera: str = "world/camera"
    space: str = "world"
    told: str | None = ""
    events: str = "events"
    by: str = ""
    storey: int = 0
    several: bool = False

    @property
    def image(self) -> str:
        """The camera's image."""
        return f"{self.camera}/image"

    def robot(self, what: str, robot: str) -> str:
        """What is drawn of a robot in space: `robots`, `alternatives` or `paths`."""
        return f"{self.space}/{what}/{part(robot)}"


ALONE = Entities()
JOINED = Entities(camera="", events="events/joined", several=True)  # robots that several cameras see, by all of them


def camera_path(name: str) -> str:
    """Of one of several cameras."""
    return f"world/cameras/{part(name)}"


def beside_joined(name: str) -> Entities:
    """A camera beside a recording of what all of them see: it shows its image."""
    return Entities(camera_path(name), told=None, events=f"events/{part(name)}", several=True)


def by_itself(name: str, storey: int) -> Entities:
    """A camera among several that nobody joined: each tells where it sees the robots."""
    own = part(name)
    return Entities(camera_path(name), f"world/by/{own}", f"{own}/", f"events/{own}", name, storey, True)
