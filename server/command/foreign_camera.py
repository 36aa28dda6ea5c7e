"""asterism calibrate camera --from FILE: the calibration that another program made, as a camera.yaml."""

import argparse

from asterism.protocol.camera import parse_camera
from asterism.protocol.errors import InputError
from asterism.protocol.keys import key_problem
from asterism.protocol.rig_files import report_path
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.calibration.lens.foreign_camera import read_foreign_camera
from asterism.server.calibration.result_file import check_result_file, set_aside, write_result_file

FOREIGN = (
    "instead of SOURCE and --target: a calibration of another program's: ROS' camera_info (a file, a dump, a bag), "
    "OpenCV's FileStorage, kalibr's camchain (FILE#cam1 for one of several)"
)


def take_foreign(options: argparse.Namespace) -> int:
    """Read, say what was read, write the camera.yaml."""
    for given, word in ((options.source, "SOURCE"), (options.target, "--target")):
        if given is not None:
            raise InputError(f"--from takes a calibration as it is; expected no {word} ({given})")
    check_result_file(options.out, options.force)
    name = options.out.stem
    if problem := key_problem(name):
        raise InputError(f"{options.out}: the camera is named after the file, and {name!r} {problem}")
    model = None if options.model == "auto" else options.model
    found = read_foreign_camera(options.foreign, options.topic, model, name)
    text = camera_text(found.camera)
    camera = parse_camera(text, str(options.out))
    kept = write_result_file(options.out, text, options.force)
    for line in found.told:
        print(line)
    fx, fy, cx, cy = (camera.matrix[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    print(f"camera '{camera.name}': fx {fx:.6g}, fy {fy:.6g}, cx {cx:.6g}, cy {cy:.6g} px")
    print("how sure it is nobody told: calibrations and asterism report assume it")
    print(f"written: {options.out}" + (f"; the old one is kept as {kept}" if kept else ""))
    # What was known of an older calibration is not known of this one.
    if old := set_aside(report_path(options.out)):
        print(f"{report_path(options.out)} was of an older {options.out.name}: kept as {old}")
    return 0
