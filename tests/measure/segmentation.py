"""A picture per photograph of what segmentation keeps and rejects, and why:
`python -m tests.measure.segmentation OUT [PHOTOGRAPH ...]` (default: ../shared/real/hdk_ir)."""

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.messages import Fate
from asterism.server.centres.blobs import Blobs, find_blobs
from asterism.server.identity.plan import LARGEST_SPOT
from asterism.server.segmentation.segment import Scratch
from asterism.server.sources.images import read_pages, to_grey8
from tests.helpers import SHARED

ZOOM = 2
KEPT, REJECTED = (60, 255, 90), (60, 110, 255)  # BGR


def drawn(image: NDArray[np.uint8], blobs: Blobs) -> NDArray[np.uint8]:
    """The photograph, enlarged, with a circle and a verdict at every spot."""
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    canvas = cv2.resize(canvas, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_NEAREST)
    for place, radius, height, fate in zip(blobs.centres_px, blobs.radii_px, blobs.heights, blobs.fates, strict=True):
        kept = fate == Fate.UNEXPLAINED
        colour = KEPT if kept else REJECTED
        x, y = (ZOOM * (place + 0.5)).astype(int)
        reach = int(ZOOM * radius + 7)
        cv2.circle(canvas, (x, y), reach, colour, 1, cv2.LINE_AA)
        text = f"{height:.0f}" if kept else f"{Fate.Name(int(fate)).lower().replace('_', ' ')} {height:.0f}"
        cv2.putText(canvas, text, (x + reach + 3, y + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return np.asarray(canvas, np.uint8)


def main(out: Path, photographs: list[Path]) -> None:
    """Write the pictures and say what they show."""
    out.mkdir(parents=True, exist_ok=True)
    for path in photographs:
        ((name, pixels),) = read_pages(path, lambda *_: None)
        image = to_grey8(pixels, None, name)
        height, width = image.shape
        largest = LARGEST_SPOT * float(np.hypot(width, height))
        blobs = find_blobs(image, largest, np.empty((0, 4), np.int64), "edge-model", Scratch.of(height, width))
        cv2.imwrite(str(out / f"{path.stem}.png"), drawn(image, blobs))
        names, counts = np.unique([Fate.Name(int(fate)) for fate in blobs.fates], return_counts=True)
        said = ", ".join(f"{count} {name.lower().replace('_', ' ')}" for name, count in zip(names, counts, strict=True))
        print(f"{path.name}: {said.replace('unexplained', 'kept')}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    given = [Path(argument) for argument in sys.argv[2:]] or sorted((SHARED / "real" / "hdk_ir").glob("*.png"))
    main(Path(sys.argv[1]), given)
