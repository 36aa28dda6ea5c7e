"""Pixel formats, against packing pixel by pixel and bit by bit as the naming convention draws it; frames' numbers."""

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.server.sources.genicam.frame_ids import SHORT, missed_between
from asterism.server.sources.genicam.pixel_formats import BY_NAME, BY_NUMBER, FORMATS, unpacked


def packed(values: list[int], name: str) -> NDArray[np.uint8]:
    """As a camera would."""
    if name == "Mono8":
        return np.array(values, np.uint8)
    if name in ("Mono10", "Mono12", "Mono14", "Mono16"):
        return np.frombuffer(b"".join(value.to_bytes(2, "little") for value in values), np.uint8)
    if name.endswith("Packed"):
        low = 2 if name == "Mono10Packed" else 4
        out = []
        for a, b in zip(values[::2], [*values[1::2], 0] if len(values) % 2 else values[1::2], strict=True):
            mask = (1 << low) - 1
            out += [a >> low, (b & mask) << 4 | (a & mask), b >> low]
        return np.array(out, np.uint8)
    bits = 10 if name == "Mono10p" else 12
    stream = "".join(f"{value:0{bits}b}"[::-1] for value in values)
    stream += "0" * (-len(stream) % 8)
    return np.array([int(stream[k : k + 8][::-1], 2) for k in range(0, len(stream), 8)], np.uint8)


@pytest.mark.parametrize("name", [one.name for one in FORMATS])
@pytest.mark.parametrize(("height", "width"), [(6, 8), (5, 7), (1, 1), (3, 10)])
def test_every_value_comes_out_as_it_went_in(rng: np.random.Generator, name: str, height: int, width: int) -> None:
    form = BY_NAME[name]
    image = rng.integers(0, 1 << form.bits, (height, width))
    image[0, 0] = (1 << form.bits) - 1
    data = packed(image.ravel().tolist(), name)
    out = unpacked(np.concatenate([data, rng.integers(0, 256, 9).astype(np.uint8)]), form, width, height)
    assert out.dtype == (np.uint8 if name == "Mono8" else np.uint16)
    np.testing.assert_array_equal(out, image)
    with pytest.raises(ValueError, match=f"are too few for {height * width} pixels of {name}"):
        unpacked(data[:-2], form, width, height)


@pytest.mark.parametrize("name", ["Mono8", "Mono12p", "Mono16"])
def test_bytes_behind_rows_are_left_out(rng: np.random.Generator, name: str) -> None:
    form = BY_NAME[name]
    image = rng.integers(0, 1 << form.bits, (4, 6))
    rows = [np.concatenate([packed(row.tolist(), name), rng.integers(0, 256, 3).astype(np.uint8)]) for row in image]
    np.testing.assert_array_equal(unpacked(np.concatenate(rows), form, 6, 4, 3), image)


def test_what_is_not_packed_is_not_copied() -> None:
    data = np.arange(96, dtype=np.uint8)
    assert np.shares_memory(unpacked(data, BY_NAME["Mono8"], 8, 6), data)
    assert np.shares_memory(unpacked(data, BY_NAME["Mono12"], 8, 6), data)


def test_numbers_tell_the_bits_on_the_wire() -> None:
    assert len(BY_NUMBER) == len(FORMATS)
    for form in FORMATS:
        assert form.number >> 16 & 0xFF == form.wire_bits


@pytest.mark.parametrize("first", [1, SHORT - 30, 70_000, (1 << 40)])
def test_frames_left_out_are_counted_over_the_wrap(rng: np.random.Generator, first: int) -> None:
    """16 bits count 1 to 65535 and again from 1; 64 bits just go on."""
    numbers = [first + k for k in range(100)]
    if first <= SHORT:
        numbers = [(number - 1) % SHORT + 1 for number in numbers]
    kept = sorted({0, 99, *rng.choice(100, 60, replace=False).tolist()})
    seen = [numbers[k] for k in kept]
    missed = [missed_between(before, now) for before, now in zip([None, *seen[:-1]], seen, strict=True)]
    assert sum(missed) == 100 - len(kept)
    assert missed[0] == 0


def test_a_late_frame_and_a_camera_that_begins_anew_miss_nothing() -> None:
    assert missed_between(500, 498) == 0
    assert missed_between(3, SHORT - 2) == 0  # of the last round
    assert missed_between(40_000, 1) == 25_535  # the most that 16 bits can tell
    assert missed_between(20_000, 1) == 0  # begun anew
    assert missed_between(1 << 40, 1) == 0
    assert missed_between(7, 7) == 0
