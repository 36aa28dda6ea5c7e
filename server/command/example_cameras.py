"""What `asterism example --cameras` writes: several cameras about one floor, whose robots stand in one file."""

from pathlib import Path
from string import Template

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.command.example_texts import robot_lines, world_lines
from asterism.server.simulation.measured_places import LEVEL_RAD, TAPE_M, draw_places, floor_robots
from asterism.server.simulation.measured_rig import TRUTH_MARK

README = Path(__file__).parent.parent / "simulation" / "example" / "cameras.md"
FEWEST, MOST = 2, 6


def files_of_several(cameras: int, seed: int) -> dict[str, str]:
    """The folder's files by name. Raises InputError for another number of cameras than can stand there."""
    if not FEWEST <= cameras <= MOST:
        raise InputError(f"--cameras {cameras}: expected {FEWEST} to {MOST}, or no --cameras for one")
    places = draw_places(seed, cameras)
    names = [place.camera.name for place in places]
    files = {"README.md": _readme(names, seed), "robots.yaml": _robots(), "uncertainty.yaml": _uncertainty()}
    for place in places:
        name = place.camera.name
        files[f"{name}-camera.yaml"] = camera_text(place.camera)
        files[f"true-{name}.yaml"] = f"{TRUTH_MARK}\n{_rig(name, place.true, 6)}"
        files[f"{name}.yaml"] = (
            f"# The camera's place was measured with a tape and a level.\n{_rig(name, place.measured, 3)}"
        )
    return files


def _readme(names: list[str], seed: int) -> str:
    def lines(form: str) -> str:
        return "\n".join(form.replace("CAM", name) for name in names)

    return Template(README.read_text(encoding="utf-8")).substitute(
        seed=seed,
        count=len(names),
        true=" ".join(f"true-{name}.yaml" for name in names),
        rigs=" ".join(f"{name}.yaml" for name in names),
        locate_film=lines("asterism locate CAM.yaml film/CAM/frames --record film-poses"),
        locate_check=lines("asterism locate placed/CAM.yaml check/CAM/frames --record check-poses"),
    )


def _rig(name: str, place: Pose, digits: int) -> str:
    lines = [f"camera: {name}-camera.yaml", "range: [0.8, 1.9]                   # working distances, m"]
    return "\n".join([*lines, *world_lines(place, digits), "robots: robots.yaml"]) + "\n"


def _robots() -> str:
    lines = ["# The robots of all cameras. `base` lies on the floor and does not move: it says where the world is."]
    for robot in floor_robots():
        lines += robot_lines(robot, 4, "m")
    return "\n".join(lines) + "\n"


def _uncertainty() -> str:
    place = f"world: {{position_m: {TAPE_M:g}, orientation_rad: {LEVEL_RAD:g}, by: a tape and a level}}"
    return f"# How well the places in cam*.yaml are known, one standard deviation per axis.\n{place}\n"
