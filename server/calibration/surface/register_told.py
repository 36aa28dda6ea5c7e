"""What a registration leaves open, in words: a flat plate slides, a ball spins, a mould looks the same turned."""

import math

import numpy as np

from asterism.protocol.geometry import Floats, log_rotation
from asterism.server.calibration.surface.register import FRAME_SIGMA_M, FRAME_SIGMA_RAD, Registration
from asterism.server.calibration.surface.register_left import between, extent_of
from asterism.server.calibration.surface.register_others import Other

OPEN_M = 1e-3  # one sigma that the drawing's middle, or its rim by a turn, may be off
MOST = 2  # other places that are told
NEARLY = 100.0  # times less likely, up to which it is said of another place that it fits as well


def sigmas_of(found: Registration) -> Floats:
    """Of the drawing's middle and its turn about that (6,), m and rad, along and about the drawing's own axes."""
    turn = np.kron(np.eye(2), found.T_world_drawing.rotation.T)
    sigmas: Floats = np.sqrt(np.diag(turn @ found.about_centre @ turn.T))
    return sigmas


def open_text(found: Registration, name: str) -> str:
    """Which directions the drive does not tell, and what to do; empty where it tells all."""
    sigmas = sigmas_of(found)
    low, high = extent_of(found.drawing)
    arm = 0.5 * float(np.linalg.norm(high - low))
    slides = [f"{axis} (+- {1e3 * s:.3g} mm)" for axis, s in zip("xyz", sigmas[:3], strict=True) if s > OPEN_M]
    turns = [
        f"{axis} (+- {math.degrees(s):.3g} degrees)"
        for axis, s in zip("xyz", sigmas[3:], strict=True)
        if s * arm > OPEN_M
    ]
    if not slides and not turns:
        return ""
    how = [f"slides along its {_joined(slides)}"] * bool(slides) + [f"turns about its {_joined(turns)}"] * bool(turns)
    kept = (
        f"the rig's `frame` keeps it there, taken as right within {1e3 * FRAME_SIGMA_M:g} mm and "
        f"{math.degrees(FRAME_SIGMA_RAD):g} degrees"
        if found.prior.told
        else "a rig whose `surface` has this `stl` and a rough `frame` keeps it near that"
    )
    return f"warning: the drive does not tell where {name} lies all round: it {' and '.join(how)}; {kept}"


def others_text(found: Registration) -> list[str]:
    """Where else it fits as well, or nearly."""
    out = []
    for other in found.others[:MOST]:
        if other.odds < NEARLY:
            odds = f"{other.odds:.2g} times less likely" if other.odds > 1.0 else "no less likely"
            out.append(
                f"warning: it fits {_moved_text(found, other)} as well ({odds}); if that is right, give the rig a "
                "`surface` with this `stl` and a rough `frame`"
            )
    return out


def _moved_text(found: Registration, other: Other) -> str:
    by = between(found.drawing, found.T_world_drawing, other.T_world_drawing)
    turn = log_rotation(found.T_world_drawing.rotation.T @ other.T_world_drawing.rotation)
    axis = "xyz"[int(np.abs(turn).argmax())]
    return (
        f"turned by {math.degrees(float(np.linalg.norm(turn))):.0f} degrees, mostly about its {axis}, and moved by "
        f"{1e3 * float(np.linalg.norm(by[:3])):.0f} mm"
    )


def _joined(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
