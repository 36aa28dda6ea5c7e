"""A map's folder: page, pictures, tables, arrays, and a file for rerun."""

from pathlib import Path

from asterism.server.coverage.in_rerun import write_rrd
from asterism.server.coverage.page import page
from asterism.server.coverage.pictures import pictures_of
from asterism.server.coverage.summary import Summary
from asterism.server.coverage.tables import grid_npz, patches_csv, regions_csv

PAGE, RRD = "coverage.html", "coverage.rrd"
_FILES = (
    ("patches.csv", "a row for every patch of the surface: place in the world, area, and dwell, passes, mean speed, "
     "direction (from x to y of the surface's frame) and last visit (ns since 1970), of all robots and of each"),
    ("gaps.csv", "the list of gaps"),
    ("overworked.csv", "the list of overworked patches"),
    ("coverage.npz", "the same as arrays on the grid, for numpy: numpy.load('coverage.npz')['dwell_s']"),
)  # fmt: skip
_RRD_WORDS = "the surface in rerun, coloured: rerun coverage.rrd"


def write_folder(told: Summary, folder: Path) -> str:
    """Fill an empty folder; returns a sentence about what could not be written, else nothing.

    Raises OSError where the disk does.
    """
    files, missing = list(_FILES), ""
    try:
        write_rrd(told, folder / RRD)
        files.append((RRD, _RRD_WORDS))
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rerun":
            raise
        missing = f"{RRD} was not written: rerun is not installed; pip install 'asterism-localization[review]'"
    pictures = pictures_of(told)
    for picture in pictures:
        (folder / picture.name).write_bytes(picture.png)
    with (folder / "patches.csv").open("w", encoding="utf-8") as table:
        table.writelines(patches_csv(told))
    (folder / "gaps.csv").write_text(regions_csv(told.gaps), encoding="utf-8")
    (folder / "overworked.csv").write_text(regions_csv(told.overworked), encoding="utf-8")
    (folder / "coverage.npz").write_bytes(grid_npz(told))
    (folder / PAGE).write_text(page(told, pictures, files), encoding="utf-8")
    return missing
