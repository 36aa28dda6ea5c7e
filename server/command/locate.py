"""asterism locate: poses of images, a video or a recording, as JSON lines."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import load_rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.pipeline import localize
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.progress import progress
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.say import say, say_warnings
from asterism.server.sources.open_source import open_source, refuse_endless


def run(options: argparse.Namespace) -> int:
    """Localize every frame; nothing is waited for, nothing is dropped."""
    if options.independent and options.smooth:
        raise InputError("--independent and --smooth exclude each other: each frame alone, or joined to those before")
    rig = load_rig(options.rig)
    say_warnings(rig)
    refuse_endless(options.source, "locate")
    source = open_source(options.source, rig, say)
    warm_up(*localizing(rig, options.source))
    encoder = msgspec.json.Encoder()
    tracks, motions = Tracks.none(), Motions.none()
    with _output(options.out) as out:
        for frame in progress(source.frames(), source.length, "localizing"):
            result, after = localize(frame, rig, tracks)
            if not options.independent:
                tracks = after
            if options.smooth:
                result, motions = smooth(result, motions)
            try:
                out.write(encoder.encode(line(frame, result)) + b"\n")
            except OSError as error:
                raise WorldError(f"{options.out}: cannot be written ({error.strerror})") from None
    if source.unreadable:
        say(f"{source.unreadable} images could not be read and were skipped")
    return 0


def line(frame: Frame, result: FrameResult) -> dict[str, Any]:
    """One line of output: the frame, every located robot, every lost one with its reason."""
    robots, lost = [], {}
    for robot, answer in result.answers.items():
        if not isinstance(answer, PoseEstimate):
            lost[robot] = answer.reason
            continue
        alternative = None
        if answer.alternative is not None:
            alternative = {**_pose(answer.alternative.pose), "odds": answer.alternative.odds}
        told = {
            "id": robot,
            "state": answer.state,
            **_pose(answer.pose),
            "covariance": answer.covariance.ravel().tolist(),
            "leds": len(answer.leds),
            "rms_px": answer.rms_px,
            "alternative": alternative,
        }
        if answer.smoothed_by:
            told |= {"smoothed": True, "filter": answer.smoothed_by}
        if answer.extrapolated:
            told["extrapolated"] = True
        robots.append(told)
    return {"frame": frame.name, "exposed_ns": frame.exposed_ns, "robots": robots, "lost": lost}


def _pose(pose: Pose) -> dict[str, list[float]]:
    return {"position": pose.position.tolist(), "orientation": pose.orientation.tolist()}


def _output(path: Path) -> BinaryIO:
    if str(path) == "-":
        return os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    try:
        return path.open("wb")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
