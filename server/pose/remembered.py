"""How far off the surface light saw a robot in the last frames: what one frame cannot tell, several may.

Of the distances only the part of the error averages that is new in every frame. As many of the last frames count as
agree with the newest; and no more than `REMEMBERED` ever, so that what was before is forgotten for good.
"""

from asterism.server.compiled import compiled

REMEMBERED = 32  # frames
DISTANCE, NOISE, DENIAL = range(3)  # columns: m; the part of its variance that is new in every frame, m^2; sigmas
CHANGED = 3.0  # sigmas between frames that no longer tell of the same
DENIED = 5.0  # sigmas of the distance from which on light denies the surface
BELIEVED_AGAIN = 3.0  # and down to which it stays denied


@compiled
def look_back(history, distance, noise):
    """The mean distance, m, of this frame, of ``distance`` and ``noise`` m^2, and those before that agree with it; and
    what is new in every frame of its variance, m^2.

    Blocks of 1, 1, 2, 4, ... frames before are taken in, until one differs.
    """
    weight = 1.0 / max(noise, 1e-18)
    total, size, at = weight * distance, 1, 0
    while at < REMEMBERED:
        block = block_weight = 0.0
        last = min(at + size, REMEMBERED)
        for k in range(at, last):
            if history[k, NOISE] > 0.0:
                block_weight += 1.0 / history[k, NOISE]
                block += history[k, DISTANCE] / history[k, NOISE]
        if block_weight == 0.0:
            break
        off = block / block_weight - total / weight
        if off * off > CHANGED * CHANGED * (1.0 / block_weight + 1.0 / weight):
            break
        total += block
        weight += block_weight
        if at > 0:
            size *= 2
        at = last
    return total / weight, 1.0 / weight


@compiled
def remember(history, distance, noise, denial):
    """Write a frame; and whether light denies the surface: it did beyond `DENIED` sigmas, and since then has not
    believed it again.
    """
    for k in range(REMEMBERED - 1, 0, -1):
        for column in range(3):
            history[k, column] = history[k - 1, column]
    history[0, DISTANCE], history[0, NOISE], history[0, DENIAL] = distance, max(noise, 1e-18), denial
    for k in range(REMEMBERED):
        if history[k, NOISE] == 0.0 or history[k, DENIAL] <= BELIEVED_AGAIN:
            return False
        if history[k, DENIAL] > DENIED:
            return True
    return False
