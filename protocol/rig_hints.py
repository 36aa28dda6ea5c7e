"""What people write into a rig.yaml instead of what it asks: other words for its keys, millimetres for metres."""

from collections.abc import Sequence

from asterism.protocol.yaml_file import Section

FARTHEST_M = 100.0  # of a working distance, and of the camera from the world's origin
FARTHEST_POINT = 100.0  # of the LEDs' extent: a named point farther away would shake by more than a pose is worth

# Other words -> the key meant, by the mapping they stand in.
RIG_WORDS = {
    "intrinsics": "camera",
    "calibration": "camera",
    "camera_info": "camera",
    "pose": "world",
    "extrinsics": "world",
    "camera_pose": "world",
    "t_world_camera": "world",
    "distance": "range",
    "distances": "range",
    "depth": "range",
    "roi": "masks",
    "ignore": "masks",
    "estimator": "centre",
    "mould": "surface",
    "mold": "surface",
    "workpiece": "surface",
    "part": "surface",
    "table": "surface",
    "floor": "surface",
    "ground": "surface",
    "plane": "surface",
    "stl": "surface",
    "mesh": "surface",
    "heights": "surface",
    "objects": "robots",
    "bodies": "robots",
    "targets": "robots",
    "rate": "capture.rate",
    "fps": "capture.rate",
    "exposure": "capture.exposure_us",
    "exposure_us": "capture.exposure_us",
    "gain": "capture.gain",
    "bits": "capture.bits",
    "line_time_us": "capture.line_time_us",
    "delay_us": "capture.delay_us",
    "pixel_format": "capture.pixel_format",
    "trigger": "capture.trigger",
    "size": "capture.size",
    "resolution": "capture.size",
}
CAPTURE_WORDS = {
    "fps": "rate",
    "frame_rate": "rate",
    "framerate": "rate",
    "hz": "rate",
    "exposure": "exposure_us",
    "exposure_time": "exposure_us",
    "shutter": "exposure_us",
    "resolution": "size",
    "width": "size",
    "height": "size",
    "depth": "bits",
    "line_time": "line_time_us",
    "row_time": "line_time_us",
    "row_time_us": "line_time_us",
    "line_time_ns": "line_time_us",
    "rolling_shutter": "line_time_us",
    "format": "pixel_format",
    "pixelformat": "pixel_format",
    "fourcc": "pixel_format",
    "binning_x": "binning",
    "bin": "binning",
    "roi": "offset",
    "region": "offset",
    "offset_x": "offset",
    "offset_y": "offset",
    "trigger_source": "trigger",
    "timestamp": "stamp",
    "delay": "delay_us",
    "latency_us": "delay_us",
}
WORLD_WORDS = {
    "translation": "position",
    "location": "position",
    "xyz": "position",
    "t": "position",
    "rotation": "orientation",
    "quaternion": "orientation",
    "quat": "orientation",
    "rpy": "orientation",
    "euler": "orientation",
}
ROBOT_WORDS = {
    "positions": "leds",
    "led_positions": "leds",
    "constellation": "leds",
    "markers": "leds",
    "marker_positions": "leds",
    "coordinates": "leds",
    "radius": "led.radius",
    "led_radius": "led.radius",
    "axis": "led.axis",
    "led_axis": "led.axis",
    "offset": "led.offset",
    "led_offset": "led.offset",
    "tool": "points",
    "tools": "points",
    "tcp": "points",
    "prior": "normal",
    "stand": "stands",
    "standing": "stands",
    "on": "stands",
    "on_surface": "stands",
    "surface": "stands",
    "contact": "stands",
    "touches": "stands",
}
SURFACE_WORDS = {
    "file": "stl",
    "mesh": "stl",
    "cad": "stl",
    "drawing": "stl",
    "grid": "heights",
    "csv": "heights",
    "height_map": "heights",
    "heightmap": "heights",
    "table": "heights",
    "equation": "quadric",
    "sphere": "quadric",
    "unit": "scale",
    "units": "scale",
    "pose": "frame",
    "t_world_surface": "frame",
    "position": "frame.position",
    "orientation": "frame.orientation",
    "outline": "edge",
    "boundary": "edge",
    "border": "edge",
    "polygon": "edge",
    "tilt_sigma": "tilt_sigma_deg",
}
STANDS_WORDS = {
    "tool": "point",
    "tilt_sigma": "tilt_sigma_deg",
    "normal": "axis",
    "direction": "axis",
    "tolerance": "sigma",
}
LED_WORDS = {"diameter": "radius", "size": "radius", "direction": "axis", "normal": "axis"}
NORMAL_WORDS = {"direction": "world", "axis": "world", "angle": "within_deg", "within": "within_deg"}


def refuse_millimetres(section: Section, key: str, values: Sequence[float]) -> None:
    """Refuse a key whose ``values`` would be farther off, in m, than anything a rig holds.

    Raises InputError with the limit, and with the values in m if they are mm.
    """
    if max(abs(value) for value in values) > FARTHEST_M:
        raise section.error(key, f"{shown(values)}, expected at most {FARTHEST_M:g} m each; {in_metres(values)}")


def in_metres(values: Sequence[float]) -> str:
    """Asks whether ``values`` are mm, and shows them in m."""
    return f"is that mm? Expected m, for example {shown([value / 1e3 for value in values])}"


def shown(values: Sequence[float]) -> str:
    """A list of numbers as a file would hold it."""
    return f"[{', '.join(f'{value:g}' for value in values)}]"
