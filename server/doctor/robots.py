"""Which robots are seen, and what keeps the others from being found."""

from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered
from asterism.server.service.adviser import Adviser

OFTEN = 0.9  # share of the frames


def check_robots(gathered: Gathered) -> Finding:
    """How many of the rig's robots are found; what to do where that is none."""
    name, rig, n = "robots seen", gathered.rig, len(gathered.pictures.spots)
    shares = {
        robot.id: float((gathered.sightings.robots == number).sum()) / max(n, 1)
        for number, robot in enumerate(rig.robots)
    }
    missing = [robot for robot, share in shares.items() if share == 0.0]
    told = f"{len(shares) - len(missing)} of {len(shares)}"
    why = Adviser(rig, gathered.tally, lambda _: None).last() if missing else []
    if len(missing) == len(shares):
        return Finding(name, Verdict.WRONG, told, _sentence(why) or "Are its LEDs on and in view?")
    if missing:
        few = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        advice = _sentence(why) or "If they should be in view: are they turned to the camera, is it their rig?"
        return Finding(name, Verdict.LOOK, f"{told}; not {few}", advice)
    least = min(shares, key=lambda robot: shares[robot])
    if shares[least] < OFTEN:
        advice = "What hides it, or is it at the edge of the view?"
        return Finding(name, Verdict.LOOK, f"{told}; {least} in {shares[least]:.0%} of the frames", advice)
    return Finding(name, Verdict.GOOD, told)


def _sentence(why: list[str]) -> str:
    """The first of what an adviser says, as a sentence of its own."""
    if not why:
        return ""
    text = why[0].removeprefix("no robot was found: ")
    return text[0].upper() + text[1:] + ("" if text[-1] in ".?" else ".")
