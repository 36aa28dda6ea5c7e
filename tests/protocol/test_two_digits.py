"""Errors as people read them."""

import pytest

from asterism.protocol.two_digits import two_digits


@pytest.mark.parametrize(
    ("value", "text"), [(183.4, "180"), (710.0, "710"), (99.7, "100"), (8.64, "8.6"), (0.01234, "0.012"), (0.0, "0")]
)
def test_large_numbers_are_written_out(value: float, text: str) -> None:
    assert two_digits(value) == text
