"""Ten robots with a lamp's glare over the frame: found, and the frame's time: `python -m tests.measure.glare`.

Frames of 1280x1024, each kind of glare in twelve of them, with its shot noise; processor time of this thread, medians,
and times the clean frame's. The glare is 100 to 400 px broad, at drawn places, the same for all frames of a kind.
"""

import time

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.simulation.simulate import Scene, Truth
from tests.rigs import make_rig

FRAMES, RATE = 12, 60
GAIN = 0.03  # grey levels of variance per grey level of light
FAR_M = 0.02
KINDS = [("none", 0.0), ("soft", 120.0), ("sharp", 60.0), ("core", 120.0), ("brushed", 60.0), ("brushed", 120.0)]


def glare(kind: str, top: float, shape: tuple[int, ...], draws: np.random.Generator) -> Floats:
    """The light, grey levels, that is added to frames of that shape."""
    height, width = shape
    y, x = np.mgrid[0:height, 0:width].astype(float)
    x, y = x - draws.uniform(0.25, 0.75) * width, y - draws.uniform(0.3, 0.7) * height
    broad_x, broad_y = draws.uniform(50, 200, 2)
    if kind == "soft":
        light = top * np.exp(-1.6 * ((x / broad_x) ** 2 + (y / broad_y) ** 2))
    else:
        inside = np.minimum(broad_x - np.abs(x), broad_y - np.abs(y))
        light = top / (1 + np.exp(np.clip(-inside / 5, -50, 50)))
    if kind == "core":
        light += 400 / (1 + np.exp(np.clip((np.hypot(x - 0.3 * broad_x, y) - 25) / 2, -50, 50)))
    if kind == "brushed":
        texture = gaussian_filter(draws.standard_normal(light.shape), (1, 12))
        light *= 1 + 0.08 * texture / texture.std()
    return np.asarray(light)


def shone_on(image: NDArray[np.uint8], light: Floats, draws: np.random.Generator) -> NDArray[np.uint8]:
    """The image with light added, and its noise."""
    noise = draws.standard_normal(light.shape) * np.sqrt(GAIN * np.maximum(light, 0.0))
    return np.clip(np.rint(image + light + noise), 0, 255).astype(np.uint8)


def measured(rig: Rig, images: list[NDArray[np.uint8]], truths: list[list[Truth]]) -> tuple[str, float, float]:
    """What is found, said, and the median times of following and of each frame alone, ms."""
    following, alone = [], []
    found = wrong = 0
    localize(Frame(images[0], 1, 0), rig, Tracks.none())
    tracks = Tracks.none()
    for k, image in enumerate(images):
        frame = Frame(image, 1 + k * 10**9 // RATE, k)
        start = time.thread_time()
        result, _ = localize(frame, rig, Tracks.none())
        alone.append(time.thread_time() - start)
        start = time.thread_time()
        _, tracks = localize(frame, rig, tracks)
        following.append(time.thread_time() - start)
        for entry in truths[k]:
            answer = result.answers[entry.robot]
            if isinstance(answer, PoseEstimate):
                found += 1
                wrong += bool(np.linalg.norm(answer.pose.position - entry.T_camera_robot.position) > FAR_M)
    said = f"found {found} of {sum(map(len, truths))}, {wrong} wrong; {len(result.blobs.kept)} spots kept at the end"
    return said, 1e3 * float(np.median(following)), 1e3 * float(np.median(alone))


def main() -> None:
    """Measure and print."""
    rig = make_rig(10)
    scene = Scene(rig, seed=0)
    truths = [scene.truth(k, k / RATE) for k in range(FRAMES)]
    clean = [scene.render(k, truth) for k, truth in enumerate(truths)]
    base = (1.0, 1.0)
    for kind, top in KINDS:
        draws = np.random.default_rng([int(top), len(kind)])
        light = glare(kind, top, clean[0].shape, draws)
        said, following, alone = measured(rig, [shone_on(image, light, draws) for image in clean], truths)
        if kind == "none":
            base = following, alone
        times = (
            f"{following:.2f} ms following (x {following / base[0]:.1f}), {alone:.2f} alone (x {alone / base[1]:.1f})"
        )
        print(f"{kind:8s}{top:4.0f} grey: {said}; {times}")


if __name__ == "__main__":
    main()
