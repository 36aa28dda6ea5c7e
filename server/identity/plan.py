"""What a rig's frames need again and again, computed once: tables, layouts, limits, work arrays."""

import copy
import math
from collections import deque
from functools import lru_cache

import numpy as np

from asterism.protocol.constellation import confusions
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Ints
from asterism.server.identity.quads import QuadTable
from asterism.server.pose.choose import Mounts
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import Constellations
from asterism.server.pose.on_surface import Underfoot
from asterism.server.pose.rolling import Shutter
from asterism.server.pose.spot_shift import optics_of
from asterism.server.segmentation.segment import Scratch

MOST_TILT = math.cos(math.radians(75.0))  # beyond that a plate shows no LED worth measuring
LARGEST_SPOT = 0.02  # of the image's diagonal, where the rig does not say how large the LEDs are
NEARER = 0.8  # than `near`, times: robots are looked for from there on
WIDEST = 0.75  # extent over distance
LED_MARGIN = 1.6  # an LED's spot may be this much larger than its disc, and two pixels
MISTOLD = 4.0  # LEDs may be larger than the rig says by this, as far as LARGEST_SPOT allows


class Plan:
    """Everything derived from a rig; never changes after construction, but for the pool of work arrays."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        camera = rig.camera
        self.lens: Floats = lens_of(camera)
        self.focal = math.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
        self.layouts: Floats = np.ascontiguousarray([robot.leds_plane for robot in rig.robots])
        self.constellations = Constellations(self.layouts, np.array([optics_of(robot) for robot in rig.robots]))
        self.mounts = Mounts.of(rig)
        self.underfoot = Underfoot.of(rig)
        self.extents = np.array([robot.extent for robot in rig.robots])
        self.smallest, self.largest = float(self.extents.min()), float(self.extents.max())
        self.separations = np.full(len(rig.robots), np.inf)
        for confusion in confusions([robot.leds_plane[:, :2] for robot in rig.robots]):
            for robot in (confusion.seen, confusion.taken):
                self.separations[robot] = min(self.separations[robot], confusion.separation)
        self.near, self.far = rig.range_m or self._range()
        nearest = np.maximum(NEARER * self.near, self.extents / WIDEST)
        self.quads = QuadTable.of(self.layouts, math.sqrt(1.0 - MOST_TILT**2) / nearest)
        self.reach = float((self.extents / nearest).max())  # chord of the directions of one robot's LEDs
        self.masks: Ints = np.array(rig.masks, np.int64).reshape(-1, 4)
        # nan where the rig does not say how large the LEDs are
        offsets = [robot.led_offset for robot in rig.robots]
        self.has_scatter = np.array([led is not None and not math.isnan(led.scatter_px) for led in offsets])
        self.some_scatter = bool(self.has_scatter.any())
        self.is_weighted = self.has_scatter & np.array([led is not None and led.weighted for led in offsets])
        self.led_radii = np.array([robot.led_radius or math.nan for robot in rig.robots])
        self.largest_radius_px = LARGEST_SPOT * math.hypot(camera.width, camera.height)
        largest = LED_MARGIN * float(self.led_radii.max()) * self.focal / self.near
        if math.isfinite(largest) and rig.range_m is not None:
            self.largest_radius_px = max(largest + 2.0, min(MISTOLD * largest + 2.0, self.largest_radius_px))
        line_s = 1e-6 * rig.capture.line_time_us
        self.shutter = Shutter(line_s, 0.5 * (camera.height - 1)) if line_s > 0.0 else None
        self._scratch: deque[Scratch] = deque()

    def _range(self) -> tuple[float, float]:
        """Distances at which the rig's robots can be seen at all: from filling the image to LEDs that merge."""
        camera = self.rig.camera
        near = self.focal * float(self.extents.min()) / (0.95 * min(camera.width, camera.height))
        spacing = 0.0
        for layout in self.layouts:
            apart = np.linalg.norm(layout[:, None] - layout[None], axis=-1) + np.eye(len(layout)) * 1e9
            spacing = max(spacing, float(apart.min()))
        return near, self.focal * spacing / 4.0

    def at(self, T_world_camera: Pose) -> "Plan":
        """The same with the camera at another place."""
        other = copy.copy(self)
        place = T_world_camera.rotation, T_world_camera.position.copy()
        other.mounts = self.mounts._replace(camera_rotation=place[0], camera_origin=place[1])
        if self.underfoot is not None:
            other.underfoot = self.underfoot.at(self.rig, T_world_camera)
        return other

    def borrow_scratch(self) -> Scratch:
        """Work arrays nobody else is using; hand them back with `return_scratch`."""
        try:
            return self._scratch.pop()
        except IndexError:
            return Scratch.of(self.rig.camera.height, self.rig.camera.width)

    def return_scratch(self, scratch: Scratch) -> None:
        """Keep work arrays for the next frame."""
        self._scratch.append(scratch)


@lru_cache(maxsize=4)
def plan_for(rig: Rig) -> Plan:
    """The plan of a rig, made once."""
    return Plan(rig)
