"""A camera's clock on the host's: drift, late frames, clocks that are set, and what only the camera itself can tell."""

from collections.abc import Iterator

import numpy as np
import pytest

from asterism.server.sources.camera_clock import CameraClock

MS = 1_000_000
RATE_HZ = 60.0
CAMERA_0 = 7_000_000_000_000


class Camera:
    """Frames of a camera: when they were taken by the host's clock, their stamps, and when they were here."""

    def __init__(self, rng: np.random.Generator, ppm: float = 0.0, always_ms: float = 0.0, jitter_ms: float = 2.0):
        self.rng, self.ppm, self.always_ms, self.jitter_ms = rng, ppm, always_ms, jitter_ms
        self.set_by_ns = 0

    def stamp(self, host_ns: int) -> int:
        return CAMERA_0 + round(host_ns * (1 + 1e-6 * self.ppm)) + self.set_by_ns

    def frames(self, begin_s: float, seconds: float) -> Iterator[tuple[int, int, int]]:
        for k in range(round(seconds * RATE_HZ)):
            host_ns = round((begin_s + k / RATE_HZ) * 1e9)
            late_ns = round((self.always_ms + self.rng.exponential(self.jitter_ms)) * MS)
            yield host_ns, self.stamp(host_ns), host_ns + late_ns


def errors_ms(clock: CameraClock, camera: Camera, begin_s: float, seconds: float) -> np.ndarray:
    """Of every stamp."""
    return np.array([(clock.host_ns(s, a) - h) / MS for h, s, a in camera.frames(begin_s, seconds)])


@pytest.mark.parametrize("ppm", [0.0, 100.0, -100.0, 30.0])
@pytest.mark.parametrize("jitter_ms", [0.1, 2.0, 8.0])
def test_after_fifteen_seconds_times_are_true_to_a_millisecond(
    rng: np.random.Generator, ppm: float, jitter_ms: float
) -> None:
    error = errors_ms(CameraClock(), Camera(rng, ppm, jitter_ms=jitter_ms), 0.0, 120.0)
    assert np.abs(error[round(15 * RATE_HZ) :]).max() < 1.0
    # An hour's drift is a third of a second: it is followed.
    assert np.abs(error[round(60 * RATE_HZ) :]).mean() < 0.3


def test_the_drift_that_is_found_is_the_one_there_is(rng: np.random.Generator) -> None:
    """Two stamps a second apart by the camera are as far apart as they were."""
    clock, camera = CameraClock(), Camera(rng, 100.0, jitter_ms=1.0)
    error = errors_ms(clock, camera, 0.0, 300.0)
    assert np.ptp(error[-round(60 * RATE_HZ) :]) < 0.3  # 6 ms if nothing were done


def test_late_frames_change_nothing(rng: np.random.Generator) -> None:
    clock, camera = CameraClock(), Camera(rng, jitter_ms=0.2)
    errors_ms(clock, camera, 0.0, 20.0)
    for k, (host_ns, stamp_ns, here_ns) in enumerate(camera.frames(20.0, 10.0)):
        late_ns = 300 * MS if k % 7 == 3 else 0
        assert abs(clock.host_ns(stamp_ns, here_ns + late_ns) - host_ns) < MS
    assert clock.begun == 1


@pytest.mark.parametrize("set_by_s", [3.0, -3.0, 0.06, -0.06, -(CAMERA_0 * 1e-9) - 20.0])
def test_a_camera_whose_clock_is_set_is_followed_within_a_second(rng: np.random.Generator, set_by_s: float) -> None:
    """Switched off and on, set by PTP: times are the host's again."""
    clock, camera = CameraClock(), Camera(rng, 40.0, jitter_ms=0.5)
    errors_ms(clock, camera, 0.0, 20.0)
    camera.set_by_ns = round(set_by_s * 1e9)
    errors_ms(clock, camera, 20.0, 2.1)
    assert clock.begun >= 2
    assert np.abs(errors_ms(clock, camera, 22.1, 5.0)).max() < 1.0


def test_what_every_frame_is_late_by_shows_only_where_the_camera_can_be_asked(rng: np.random.Generator) -> None:
    camera = Camera(rng, 100.0, always_ms=9.0, jitter_ms=0.5)
    blind = errors_ms(CameraClock(), camera, 0.0, 20.0)[round(15 * RATE_HZ) :]
    assert np.abs(blind - 9.0).max() < 1.0
    asked = CameraClock((camera.stamp(-50 * MS), -50 * MS))
    assert np.abs(errors_ms(asked, camera, 0.0, 60.0)[round(5 * RATE_HZ) :]).max() < 1.0


def test_a_camera_that_counts_with_another_epoch_is_no_matter(rng: np.random.Generator) -> None:
    """Stamps of PTP are as large as those of a clock that began now are small."""
    host = list(Camera(rng).frames(0.0, 3.0))
    small, large = CameraClock(), CameraClock()
    for host_ns, stamp_ns, here_ns in host:
        early = small.host_ns(stamp_ns - CAMERA_0 + 1, here_ns)
        assert early == large.host_ns(stamp_ns + (1 << 60), here_ns)
        assert early <= here_ns
        assert early >= host_ns - MS
