"""The surface that robots drive on, from their touches: of what kind, where, how sure, and where nobody was.

Everything is one linear model: numbers of the surface, what each robot's LEDs and its point may be off, and noise; the
standard deviations are those of the surface with all else open.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.checks import check_common, check_places, check_touches
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.fitting import noise_of
from asterism.server.calibration.surface.found import Settled, found
from asterism.server.calibration.surface.frame import frame_of
from asterism.server.calibration.surface.kinds import best_of, smooth, try_kinds
from asterism.server.calibration.surface.surface_fit import SurfaceFit
from asterism.server.calibration.surface.touches import Touches


def calibrate_surface(contacts: Contacts, axes: list[Floats], source: str) -> SurfaceFit:
    """The surface. ``axes``: of every robot (3,), in its own frame, what is to be along the normal.

    Raises InputError for a drive that does not tell one; ``source`` is what sentences call it.
    """
    check_touches(source, contacts)
    check_places(source, contacts.points)
    frame, contacts = frame_of(contacts), likelier(contacts)
    touches = Touches.of(contacts, frame)
    free, stiff = smooth(touches)
    told = free.variances / free.noise.factors[touches.robots]
    check_common(source, stiff.residuals.ravel(), told, int(free.used.sum()), len(touches))
    kept = touches[free.used]
    every = np.ones(len(kept), np.bool_)
    noise = noise_of(kept, free.residuals[free.used], told[free.used], every, stiff.numbers)
    tried = try_kinds(kept, noise, stiff, free.numbers)
    return found(contacts, Settled(frame, touches, free.used, noise), tried, best_of(tried), axes)


def likelier(contacts: Contacts) -> Contacts:
    """Every pose by that of its two tilts whose touch is nearer to a surface that those without doubt agree on."""
    doubtful = contacts.doubtful
    if not doubtful.any():
        return contacts
    sure = contacts[~doubtful] if 2 * doubtful.sum() < len(contacts) else contacts
    frame = frame_of(sure)
    by, _ = smooth(Touches.of(sure, frame))
    away = []
    for each in (contacts, contacts.by_other_tilt(doubtful)):
        touches = Touches.of(each, frame)
        away.append(np.abs(touches.z - by.heights(touches.xy)[0]))
    return contacts.by_other_tilt(doubtful & (away[1] < away[0]))
