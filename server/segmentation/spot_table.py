"""The spot table: a row for every bright spot, and the verdicts on it."""

from asterism.protocol.messages import Fate

# Columns of the spot table: centre, semi-axes and angle of the ellipse (px, rad), height above the local background,
# the background's level at the centre and its slopes (grey levels, per px), its noise, the share of the spot's
# pixels that are saturated, the window (px, exclusive ends), the fate, and, where other light leans on the spot, how
# far, in px, that pulls the foot of its profile away from the upper part (else 0), whether the spot was split from
# others, and, once it is centred, chi squared per degree of freedom of the fit.
(
    X,
    Y,
    SEMI_A,
    SEMI_B,
    ANGLE,
    HEIGHT,
    LEVEL,
    SLOPE_X,
    SLOPE_Y,
    NOISE,
    SATURATED_SHARE,
    WX0,
    WX1,
    WY0,
    WY1,
    FATE,
    SHOULDER,
    TOUCHING,
    MISFIT,
) = range(19)
SPOT_COLUMNS = 19

# The verdicts, as plain integers for the compiled code.
UNEXPLAINED = int(Fate.UNEXPLAINED)
TOO_SMALL = int(Fate.TOO_SMALL)
TOO_LARGE = int(Fate.TOO_LARGE)
ELONGATED = int(Fate.ELONGATED)
AT_EDGE = int(Fate.AT_EDGE)
MASKED = int(Fate.MASKED)
TOO_FAINT = int(Fate.TOO_FAINT)
MISSHAPEN = int(Fate.MISSHAPEN)
