"""What `asterism export --from` writes: a spreadsheet's survey as the JSON lines that calibrations take."""

from pathlib import Path
from typing import Any

import msgspec

from asterism.recordings.export.written import counts
from asterism.server.calibration.survey.survey_csv import Row, read_survey_csv
from asterism.server.output import new_file
from asterism.server.service.say import say


def write_truth(survey: Path, out: Path, force: bool) -> int:
    """Write a line a frame, in the order in which the spreadsheet names them; returns the exit code.

    Raises InputError as `read_survey_csv` does, and as `new_file` does, WorldError when it cannot be written.
    """
    read = read_survey_csv(survey)
    for remark in read.remarks:
        say(remark)
    frames: dict[str, dict[str, Any]] = {}
    for row in read.rows:
        line: dict[str, Any] = {"frame": row.frame, "exposed_ns": row.exposed_ns, "robots": []}
        frames.setdefault(row.frame, line)["robots"].append(_robot(row))
    encoder = msgspec.json.Encoder()
    with new_file(out, force) as output, output.path.open("wb") as stream:
        for line in frames.values():
            told = {key: value for key, value in line.items() if value is not None}
            stream.write(encoder.encode(told) + b"\n")
    robots = len({row.robot for row in read.rows})
    print(f"{out}: {counts(len(read.rows), robots, len(frames))}{output.note}")
    return 0


def _robot(row: Row) -> dict[str, Any]:
    told: dict[str, Any] = {"id": row.robot, "position": row.position.tolist()}
    if row.orientation is not None:
        told["orientation"] = row.orientation.tolist()
    return told
