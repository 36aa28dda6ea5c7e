"""All checks, in the order in which a person would look."""

from pathlib import Path

from asterism.server.doctor.calibration import check_calibration
from asterism.server.doctor.constellations import check_positions
from asterism.server.doctor.exposure import check_bright_areas, check_dim, check_exposure
from asterism.server.doctor.finding import Finding
from asterism.server.doctor.focus import blurs, check_focus, check_sizes, check_streaks
from asterism.server.doctor.foreign import check_clutter, check_hot_pixels
from asterism.server.doctor.gather import Gathered
from asterism.server.doctor.place import check_place, judge_place
from asterism.server.doctor.robots import check_robots
from asterism.server.doctor.shutter import check_shutter
from asterism.server.doctor.surface import check_surface
from asterism.server.doctor.timing import check_jitter, check_lost, check_rate, stamps_of


def examine(gathered: Gathered, rig_name: str, camera_file: Path, now_s: float) -> list[Finding]:
    """What the frames tell. ``camera_file`` is the calibration's, whose age is told; ``now_s`` since the epoch."""
    found = blurs(gathered.cuts, gathered.rig)
    stamps, place = stamps_of(gathered.times), judge_place(gathered.rig, gathered.sightings)
    return [
        check_robots(gathered),
        check_focus(found, gathered.rig),
        check_exposure(gathered),
        check_bright_areas(gathered),
        check_streaks(gathered, found),
        check_shutter(gathered),
        check_hot_pixels(gathered),
        check_clutter(gathered),
        check_sizes(found, gathered),
        check_dim(gathered),
        check_positions(gathered, rig_name),
        check_calibration(gathered, camera_file, now_s, place),
        check_place(gathered, place),
        *check_surface(gathered),
        check_rate(gathered, stamps),
        check_lost(gathered, stamps),
        check_jitter(gathered, stamps),
    ]
