"""Texts of calibrations that other programs wrote, to what they tell.

ROS' camera_info YAML (camera_calibration_parsers), what `ros2 topic echo --once /camera_info` prints, OpenCV's
FileStorage in YAML and XML, and what scripts dump of cv2.calibrateCamera's results are all told apart by their keys;
kalibr's camchain (https://github.com/ethz-asl/kalibr/wiki/yaml-formats) by its cameras.
"""

import re
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.yaml_file import Section, describe, parse_yaml, shortened
from asterism.server.sources.foreign.ros_messages import CameraInfoTold

_MATRIX = ("cameramatrix", "k", "intrinsicmatrix", "mtx", "intrinsics")
_DISTORTION = ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "d", "dist")
_WIDTH, _HEIGHT, _SIZE = ("imagewidth", "width"), ("imageheight", "height"), ("imagesize", "resolution")
_MOST = 100  # numbers of a matrix
_NAMES_OF_MODELS = ("plumb_bob", "radtan", "rational_polynomial", "equidistant", "fisheye")


def read_calibration(text: str, file: str, which: str | None) -> tuple[str, CameraInfoTold]:
    """What kind of text it is, in words, and what it tells; ``which`` of several cameras. Raises InputError."""
    if "<opencv_storage" in text[:1000]:
        _refuse_which(which, file)
        return "OpenCV's FileStorage", _by_keys(_storage_xml(text, file), file)
    if "!!opencv-matrix" in text or text.startswith("%YAML"):
        _refuse_which(which, file)
        return "OpenCV's FileStorage", _by_keys(_storage_yaml(text, file), file)
    # A dump of several messages: the first.
    first = re.split(r"^(?:---|\.\.\.)\s*$", text.removeprefix("---\n"), maxsplit=1, flags=re.MULTILINE)[0]
    section = parse_yaml(first, file)
    cameras = [key for key in section.values if re.fullmatch(r"cam\d+", key)]
    if cameras:
        return "kalibr's camchain", _kalibr(section, cameras, which)
    _refuse_which(which, file)
    values = dict(section.values)
    if (name := _name(first)) is not None:
        values["camera_name"] = name
    kind = "a dump of CameraInfo" if {"k", "K"} & values.keys() else "camera_info YAML"
    return kind, _by_keys(values, file)


def _refuse_which(which: str | None, file: str) -> None:
    if which is not None:
        raise InputError(f"{file}#{which}: holds one camera, expected the file's name alone")


def _name(text: str) -> str | None:
    """A serial number is a name as it stands there, with its zeros in front."""
    found = re.search(r"^camera_name:[ \t]*([0-9]+)[ \t]*(?:#.*)?$", text, re.MULTILINE)
    return found[1] if found else None


def _by_keys(values: Mapping[str, Any], file: str) -> CameraInfoTold:
    known = {re.sub(r"[_ ]", "", key.lower()): value for key, value in values.items()}

    def get(names: tuple[str, ...], what: str) -> Any:
        found = next((known[name] for name in names if name in known), None)
        if found is None:
            raise InputError(f"{file}: {what} is missing; it has {shortened(', '.join(values), 200)}")
        return found

    matrix = _numbers(get(_MATRIX, "camera_matrix"), f"{file}: camera_matrix")
    if len(matrix) != 9:
        raise InputError(f"{file}: camera_matrix: {len(matrix)} numbers, expected 3 x 3")
    distortion = _numbers(get(_DISTORTION, "distortion_coefficients"), f"{file}: distortion_coefficients")
    width, height = _size(known, get, file)
    model = known.get("distortionmodel", "")
    if not model and known.get("cameramodel") in _NAMES_OF_MODELS:
        raise InputError(
            f"{file}: camera_model: {known['cameramodel']}: did you mean distortion_model? (camera_model is kalibr's "
            "for pinhole, omni, ...)"
        )
    if not model and _is_set(known.get("fisheyemodel")):
        model = "equidistant"
    if not isinstance(model, str):
        raise InputError(f"{file}: distortion_model: {describe(model)}, expected text")
    region = _region(known.get("roi"), file)
    binning = tuple(_whole(known.get(name, 0), f"{file}: {name}") for name in ("binningx", "binningy"))
    name = known.get("cameraname", "")
    if not isinstance(name, str):
        raise InputError(f"{file}: camera_name: {describe(name)}, expected text; put it in quotes")
    matrix_3x3 = matrix.reshape(3, 3)
    return CameraInfoTold(name, width, height, model, distortion, matrix_3x3, (binning[0], binning[1]), region)


def _size(known: Mapping[str, Any], get: Any, file: str) -> tuple[int, int]:
    if any(name in known for name in _SIZE) and not any(name in known for name in _WIDTH):
        size = _numbers(get(_SIZE, "image_size"), f"{file}: image_size")
        if len(size) != 2 or (size % 1).any():
            raise InputError(f"{file}: image_size: {len(size)} numbers, expected width and height, px")
        return int(size[0]), int(size[1])
    width, height = (get(names, what) for names, what in ((_WIDTH, "image_width"), (_HEIGHT, "image_height")))
    return _whole(width, f"{file}: image_width"), _whole(height, f"{file}: image_height")


def _region(told: Any, file: str) -> tuple[int, int, int, int]:
    if told is None:
        return 0, 0, 0, 0
    if not isinstance(told, dict):
        raise InputError(f"{file}: roi: {describe(told)}, expected x_offset, y_offset, width, height")
    x, y, width, height = (
        _whole(told.get(key, 0), f"{file}: roi.{key}") for key in ("x_offset", "y_offset", "width", "height")
    )
    return x, y, width, height


def _whole(value: object, where: str) -> int:
    number = float(value) if isinstance(value, int | float) and abs(value) < 2**31 else -1.0
    if isinstance(value, bool) or not number.is_integer() or number < 0:
        raise InputError(f"{where}: {describe(value)}, expected a whole number")
    return int(number)


def _is_set(value: object) -> bool:
    return value not in (None, 0, 0.0, False, "", "0", "false")


def _numbers(value: object, where: str) -> Floats:
    """Numbers in a list, a list of lists, or a mapping with `data`, in one row."""
    if isinstance(value, dict):
        value = value.get("data")
    try:
        found = np.asarray(value, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        found = np.full(1, np.nan)
    if value is None or len(found) > _MOST or not np.isfinite(found).all():
        raise InputError(f"{where}: {describe(value)}, expected numbers")
    return found


def _kalibr(section: Section, cameras: list[str], which: str | None) -> CameraInfoTold:
    several = ", ".join(f"{section.file}#{camera}" for camera in cameras)
    if which is None and len(cameras) > 1:
        raise InputError(f"{section.file}: holds {len(cameras)} cameras; say which: {several}")
    if which is not None and which not in cameras:
        raise InputError(f"{section.file}#{which}: there is no such camera, expected {several}")
    camera = section.section(which or cameras[0])
    model = camera.text("camera_model")
    if model != "pinhole":
        raise camera.error(
            "camera_model",
            f"{describe(model)}, expected pinhole (with distortion_model radtan or equidistant): calibrate with "
            "kalibr's pinhole-radtan or pinhole-equi",
        )
    fx, fy, cx, cy = camera.numbers("intrinsics", 4, "fu, fv, pu, pv")
    count = len(camera.values.get("distortion_coeffs") or ())
    coefficients = camera.numbers("distortion_coeffs", count, "the coefficients") if count else []
    width, height = camera.numbers("resolution", 2, "width, height, px")
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size = _whole(width, f"{section.file}: resolution"), _whole(height, f"{section.file}: resolution")
    return CameraInfoTold("", *size, camera.text("distortion_model"), np.array(coefficients), matrix)


def _storage_yaml(text: str, file: str) -> dict[str, Any]:
    """The values at the top of a FileStorage in YAML, whose first line and tags other readers do not know."""
    plain = re.sub(r"!!opencv-(?:nd-)?matrix", "", re.sub(r"^%YAML.*$", "", text, count=1, flags=re.MULTILINE))
    return parse_yaml(plain, file).values


def _storage_xml(text: str, file: str) -> dict[str, Any]:
    """Of one in XML."""
    if "<!" in text.replace("<!--", ""):
        raise InputError(f"{file}: declares a document type, expected XML as OpenCV writes it")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{file}: is no XML ({shortened(str(error))})") from None
    return {part.tag: _value(part) for part in root}


def _value(part: ElementTree.Element) -> Any:
    """Numbers, a number or a text."""
    data = part.find("data")
    words = ((part if data is None else data).text or "").split()
    try:
        numbers = [float(word) for word in words[: _MOST + 1]]
    except ValueError:
        return (part.text or "").strip().strip('"')
    return numbers if data is not None or len(numbers) != 1 else numbers[0]
