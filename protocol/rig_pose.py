"""A pose in a rig: `position`, m, and `orientation`, a quaternion x y z w."""

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.protocol.rig_hints import refuse_millimetres
from asterism.protocol.yaml_file import Section


def read_pose(section: Section, what: str) -> Pose:
    """From the two keys of a section; ``what`` its position is. Raises InputError with file, key, what was found and
    what is accepted.
    """
    position = section.numbers("position", 3, what)
    refuse_millimetres(section, "position", position)
    quat = section.numbers("orientation", 4, "the quaternion x, y, z, w")
    length = float(np.linalg.norm(quat))
    if abs(length - 1.0) > 1e-3:
        raise section.error("orientation", f"a quaternion of length {length:g}, expected x, y, z, w of length 1")
    return Pose(np.array(position), np.array(quat))
