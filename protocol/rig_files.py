"""The files that a rig rests on: those that it names, and those beside them that say how wrong they may be.

Beside `camera.yaml` lies `camera.report.yaml`, what its calibration knows of its own errors; beside `rig4.yaml` lies
`rig4.uncertainty.yaml`, which calibrations write, or `uncertainty.yaml`, a person's, for all rigs of the folder.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from asterism.protocol import heights_file
from asterism.protocol.heights_file import heights_text
from asterism.protocol.stl_file import load_triangles
from asterism.protocol.stl_heights import stl_heights
from asterism.protocol.surface import HEIGHTS, STL
from asterism.protocol.text_file import MOST_BYTES, read_text
from asterism.protocol.yaml_file import Section

UNCERTAINTY = "uncertainty.yaml"
# The text of a file that a section's key names, and what sentences call the file; by section, key, the file's path from
# the rig, and what is expected there.
Named = Callable[[Section, str, str, str], tuple[str, str]]


def report_path(camera_path: Path) -> Path:
    """Where the report of a camera's calibration lies."""
    return camera_path.with_name(f"{camera_path.stem}.report.yaml")


def own_path(rig_path: Path) -> Path:
    """The file of uncertainties of this rig alone."""
    return rig_path.with_name(f"{rig_path.stem}.{UNCERTAINTY}")


def file_of(rig_path: Path) -> Path | None:
    """The file of uncertainties that holds for a rig, if there is one."""
    return next((path for path in (own_path(rig_path), rig_path.parent / UNCERTAINTY) if path.exists()), None)


def beside(rig_path: Path, camera: str) -> dict[str, str]:
    """The texts of the files beside a rig and its ``camera``, as the rig names it: by their paths from the rig.

    Raises InputError for one that cannot be read.
    """
    found = {}
    report = report_path(Path(camera))
    if (path := rig_path.parent / report).exists():
        found[report.as_posix()] = read_text(path, "the report of a camera's calibration")
    if (uncertainty := file_of(rig_path)) is not None:
        found[uncertainty.name] = read_text(uncertainty, "what is not known exactly of a rig")
    return found


def uncertainty_of(files: Mapping[str, str]) -> tuple[str, str] | None:
    """Name and text of the file of uncertainties among those of a rig, None where there is none."""
    for name, text in files.items():
        if name == UNCERTAINTY or name.endswith(f".{UNCERTAINTY}"):
            return name, text
    return None


def on_disk(folder: Path) -> Named:
    """Files as they lie in a rig's folder; of an STL the table of heights that it becomes, which is what is used, sent
    and recorded.
    """

    def text_of(section: Section, key: str, name: str, what: str) -> tuple[str, str]:
        file = folder / name
        if not file.exists():
            raise section.error(key, f"there is no file {file}, expected {what}")
        if key == STL:
            return _table(section, file), str(file)
        return read_text(file, what, heights_file.MOST_BYTES if key == HEIGHTS else MOST_BYTES), str(file)

    return text_of


def _table(section: Section, file: Path) -> str:
    """The table of heights that an STL becomes; `scale` beside its name takes its unit to m."""
    scale = section.number("scale", above=0.0) if "scale" in section else 1.0
    return heights_text(stl_heights(scale * load_triangles(file), str(file)))


def kept(files: Mapping[str, str], where: str) -> Named:
    """Files as a recording or a server keeps them, which is ``where`` they are said to be."""

    def text_of(section: Section, key: str, name: str, what: str) -> tuple[str, str]:
        if name not in files:
            raise section.error(key, f"{name} is not at hand, expected {what}, kept with the rig")
        return files[name], f"{where}: {name}"

    return text_of
