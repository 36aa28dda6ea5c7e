"""Results are written where nothing is lost by it; a simulation's truth is never written over."""

import os
import threading
from pathlib import Path

import pytest

from asterism.protocol.errors import InputError
from asterism.server.calibration.result_file import check_result_file, holds_truth, write_result_file
from asterism.server.simulation.measured_rig import TRUTH_MARK

TRUTH = f"# mine\n{TRUTH_MARK}\ncamera: true-camera.yaml\n"


@pytest.mark.parametrize("force", [False, True])
def test_truth_is_not_written_over(tmp_path: Path, force: bool) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(TRUTH)
    for attempt in (lambda: check_result_file(path, force), lambda: write_result_file(path, "new\n", force)):
        with pytest.raises(InputError, match=r"rig\.yaml: holds the truth of a simulation.*choose another name"):
            attempt()
    assert path.read_text() == TRUTH
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_made_from_truth_is_no_truth(tmp_path: Path) -> None:
    path = tmp_path / "rig2.yaml"
    assert write_result_file(path, TRUTH, force=False) is None
    assert path.read_text() == "# mine\ncamera: true-camera.yaml\n"
    assert not holds_truth(path)
    # So it can be replaced, and the old one stays.
    kept = write_result_file(path, "new\n", force=True)
    assert kept is not None
    assert kept.read_text() == "# mine\ncamera: true-camera.yaml\n"


def test_only_the_mark_itself_makes_truth(tmp_path: Path) -> None:
    for name, data in (("a", b"\xff\xfe\x00"), ("b", b"camera: x  " + TRUTH_MARK.encode()), ("c", b"")):
        (tmp_path / name).write_bytes(data)
        assert not holds_truth(tmp_path / name)
    assert not holds_truth(tmp_path)
    assert not holds_truth(tmp_path / "none")


def test_what_is_no_file_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = os.open(tmp_path / "pipe", os.O_RDWR)  # so that reading it would take what is here
    os.write(writer, TRUTH.encode())
    looking = threading.Thread(target=lambda: told.append(holds_truth(tmp_path / "pipe")), daemon=True)
    told: list[bool] = []
    looking.start()
    looking.join(10.0)  # a pipe ends when its last writer does
    assert told == [False]
    assert os.read(writer, 1000) == TRUTH.encode(), "nobody took it"
    os.close(writer)
