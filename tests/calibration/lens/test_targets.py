"""What is refused as a calibration target, and in which words."""

from pathlib import Path

import pytest

from asterism.protocol.errors import InputError
from asterism.server.calibration.lens.targets import parse_target


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chess:9x6:0.025", "expected KIND:COLSxROWS:PITCH"),
        ("chessboard:9:0.025", "expected KIND:COLSxROWS:PITCH"),
        ("chessboard:9x6:25", "if you meant mm, say 0.025"),
        ("acircles:4x10:0.02", "10 rows, expected an odd number"),
        ("chessboard:2x6:0.025", "expected 3 x 3"),
        ("leds:nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_a_target_that_is_none_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_target(text)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("[0, 0, 0], [1, 0, 0]", "2 of them, expected 6"),
        ("[0,0,0],[1,0,0],[2,0,0],[3,0,0],[4,0,0],[5,0,0]", "on one line"),
        ("[0,0,0],[1,0,0],[2,1,0],[3,0,1],[4,2,0],[5,0,0]", "not in one plane"),
    ],
)
def test_an_led_board_that_is_none_is_refused(tmp_path: Path, rows: str, words: str) -> None:
    (tmp_path / "board.yaml").write_text(f"leds: [{rows}]\n")
    with pytest.raises(InputError, match=words):
        parse_target(f"leds:{tmp_path / 'board.yaml'}")
