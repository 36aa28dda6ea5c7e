"""Spreadsheets of surveyed poses: what several countries' programs write is read alike, what is unclear is refused."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from asterism.protocol.errors import InputError
from asterism.server.calibration.survey.survey import match_frames, read_survey
from asterism.server.calibration.survey.survey_csv import Row, read_survey_csv

HEADER = "robot,frame,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg"
ROWS = ("alpha,0.png,100.5,-20,30.25,1,2,3", "bravo,0.png,1,2,3,0,0,90", "alpha,1.png,4,5.5,6,10,-20,170")


def written(folder: Path, text: str | bytes, name: str = "survey.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rows(folder: Path, text: str | bytes) -> tuple[Row, ...]:
    return read_survey_csv(written(folder, text)).rows


def values(found: tuple[Row, ...]) -> list[tuple[object, ...]]:
    return [
        (row.frame, row.robot, *row.position, *(row.orientation if row.orientation is not None else ()))
        for row in found
    ]


def test_places_are_in_m_and_angles_those_of_rep_103(tmp_path: Path) -> None:
    found = rows(tmp_path, "\n".join((HEADER, *ROWS)))
    assert [(row.line, row.frame, row.robot) for row in found] == [
        (2, "0.png", "alpha"), (3, "0.png", "bravo"), (4, "1.png", "alpha")
    ]  # fmt: skip
    np.testing.assert_allclose(found[0].position, [0.1005, -0.02, 0.03025], atol=1e-15)
    for row, turns in zip(found, ([1, 2, 3], [0, 0, 90], [10, -20, 170]), strict=True):
        quat = Rotation.from_euler("xyz", turns, degrees=True).as_quat(canonical=True)  # about fixed axes
        np.testing.assert_allclose(row.orientation, quat, atol=1e-12)


def test_what_programs_of_several_countries_write_is_the_same(tmp_path: Path) -> None:
    plain = values(rows(tmp_path, "\n".join((HEADER, *ROWS))))
    comma = [line.replace(".png", "@").replace(".", ";").replace(",", "|") for line in ROWS]
    german = [line.replace(";", ",").replace("|", ";").replace("@", ".png") for line in comma]
    header = HEADER.replace(",", ";")
    for text in (
        "\r\n".join((header, *german)),
        "\ufeff" + "\r\n".join((header, *german, "", ";;;;;;;", "")),
        "sep=;\r\n" + "\r\n".join((header, *german)),
        "\n".join((HEADER, *ROWS)).replace(",", "\t"),
        "\n".join(('"Robot", Frame ,X [mm],y (mm),Z_mm,Roll [°],pitch [deg],yaw_deg', *ROWS)),
        "\n\n" + "\n".join((HEADER.replace("robot", "robot_id").replace("frame", "image"), *ROWS)),
    ):
        assert values(rows(tmp_path, text)) == plain, text


def test_any_order_of_columns_is_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    plain = values(rows(tmp_path, "\n".join((HEADER, *ROWS))))
    table = [line.split(",") for line in (HEADER, *ROWS)]
    for _ in range(5):
        order = rng.permutation(8)
        assert values(rows(tmp_path, "\n".join(",".join(line[k] for k in order) for line in table))) == plain


def test_units_and_quaternions(tmp_path: Path) -> None:
    text = "frame,robot,x_cm,y_m,z_mm,qx,qy,qz,qw\n0.png,alpha,1,0.02,30,0,0,-0.6,-0.8\n"
    (row,) = rows(tmp_path, text)
    np.testing.assert_allclose(row.position, [0.01, 0.02, 0.03], atol=1e-15)
    np.testing.assert_allclose(row.orientation, [0, 0, 0.6, 0.8])
    (row,) = rows(tmp_path, "frame,robot,x_m,y_m,z_m,yaw_rad\n0.png,alpha,1,2,3,0.5\n")
    np.testing.assert_allclose(row.orientation, [0, 0, np.sin(0.25), np.cos(0.25)])


def test_times_are_exact_to_the_ns(tmp_path: Path) -> None:
    for column, text in (("time_s", "1795398896.123456789"), ("exposed_ns", "1795398896123456789")):
        (row,) = rows(tmp_path, f"robot,{column},x_m,y_m,z_m\nalpha,{text},1,2,3\n")
        assert (row.exposed_ns, row.frame) == (1795398896123456789, "1795398896123456789")
    with pytest.raises(InputError, match=r"'1\.8E\+18', expected ns as a whole number, every digit of it"):
        rows(tmp_path, "robot,exposed_ns,x_m,y_m,z_m\nalpha,1.8E+18,1,2,3\n")


def test_what_is_taken_for_something_is_said(tmp_path: Path) -> None:
    read = read_survey_csv(
        written(tmp_path, "robot,frame,x_m,y_m,z_m,yaw_deg,note\nalpha,0,1,2,3,4,by hand\nbravo,0,,,,,fell\n")
    )
    assert [remark.partition(": ")[2] for remark in read.remarks] == [
        "columns not looked at: 'note'",
        "rows without a place, left out: 1",
        "has a yaw, but no roll and pitch: robots are taken to stand upright",
    ]
    assert len(read.rows) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no known column ('')"),
        ("Survey of May;;\nrobot;frame;x_m\n", "names no known column ('survey_of_may'), expected"),
        ("a,b\n1,2\n", "names no known column ('a,b'), expected a spreadsheet's CSV with named columns"),
        (HEADER, "holds no row with a place"),
        (HEADER.replace("robot,", "") + "\n", "column robot is missing"),
        (HEADER.replace("frame,", "") + "\n", "column frame is missing"),
        (HEADER.replace("y_mm,", "") + "\n", "column y is missing, expected y_m or y_mm or y_cm"),
        (HEADER.replace("y_mm", "y") + "\n", "column 'y': tells no unit, expected y_m or y_mm or y_cm"),
        (HEADER.replace("pitch_deg,", "") + "\n", "column pitch is missing, expected pitch_deg or pitch_rad"),
        (HEADER.replace("yaw_deg", "qx") + "\n", "columns qx and roll_deg are both there"),
        ("robot,frame,x_m,y_m,z_m,qx,qy,qz\n", "column qw is missing, expected all of qx, qy, qz, qw"),
        (f"{HEADER},x_m\n", "columns x_m and x_mm are both there"),
        (f"{HEADER},robot\n", "column 'robot': is there twice"),
        (f"{HEADER},id\n", "expected one column for the robot and the frame"),
        (f"{HEADER}\n{ROWS[0]}\n{ROWS[0]}\n", "line 3, column 'robot': 'alpha' has frame '0.png' in line 2"),
        (f"{HEADER}\nalpha,0.png,1,,3,4,5,6\n", "line 2, column 'y_mm': is empty"),
        (f"{HEADER}\nalpha,0.png,1,2,3,4,,6\n", "line 2, column 'pitch_deg': is empty"),
        (f"{HEADER}\nalpha,0.png,1,two,3,4,5,6\n", "line 2, column 'y_mm': 'two', expected a number such as 12.5"),
        (f"{HEADER}\nalpha,0.png,1,nan,3,4,5,6\n", "'nan', expected a number"),
        (f"{HEADER}\nalpha,0.png,1,1e300,3,4,5,6\n", "'1e300', expected up to 1e+06 in SI units"),
        (f'{HEADER}\nalpha,0.png,1,"2,5",3,4,5,6\n', "'2,5' in a file whose cells are parted by commas"),
        (f"{HEADER}\nalpha,0.png,1,2,3,4,5\n", "line 2: 7 cells, expected 8 as in the header"),
        (f"{HEADER}\nalpha,0.png,1,2,3,4,5,6,7\n", "line 2: 9 cells, expected 8"),
        (f'{HEADER}\nalpha,"0.png,1,2,3,4,5,6\n', "line 2: unexpected end of data"),
        (f"{HEADER}\n,0.png,1,2,3,4,5,6\n", "column 'robot': '' is empty"),
        (f"{HEADER}\na/b,0.png,1,2,3,4,5,6\n", "column 'robot': 'a/b' holds '/'"),
        (f"{HEADER}\nalpha,,1,2,3,4,5,6\n", "column 'frame': is empty, expected the image's name"),
        (
            f"{HEADER}\nalpha;0;1,5;2;3;4;5;6\nalpha;1;1.5;2;3;4;5;6\n".replace(HEADER, HEADER.replace(",", ";")),
            "line 3, column 'x_mm': '1.5', but line 2 has decimals behind a ','",
        ),
        (
            f"{HEADER}\nalpha;0;1.234,5;2;3;4;5;6\n".replace(HEADER, HEADER.replace(",", ";")),
            "'1.234,5', expected a number",
        ),
        ("robot,frame,x_m,y_m,z_m,qx,qy,qz,qw\na,0,1,2,3,0,0,0,2\n", "a quaternion of length 2"),
        ("robot,frame,time_s,x_m,y_m,z_m\na,0,1,1,2,3\nb,0,2,1,2,3\n", "line 3, column 'time_s': another time than"),
        ("robot,time_s,x_m,y_m,z_m\na,-1,1,2,3\n", "'-1', expected a time from 0"),
        (b"\xff\xfer\0o\0", "is no text in UTF-8"),
        ("robot;frame;x_mm;y_mm;z_mm;yaw [°]\n".encode("cp1252"), "in Excel: save as 'CSV UTF-8'"),
    ],
)  # fmt: skip
def test_what_is_unclear_is_refused(tmp_path: Path, text: str | bytes, words: str) -> None:
    with pytest.raises(InputError) as refused:
        read_survey_csv(written(tmp_path, text))
    assert words in str(refused.value)
    assert str(refused.value).isprintable()


def test_a_spreadsheet_is_a_survey_like_any_other(tmp_path: Path) -> None:
    path = written(tmp_path, "\n".join((f"{HEADER},by", *(f"{row},me" for row in ROWS))))
    survey = read_survey(path, ["alpha", "bravo"])
    assert [(frame.name, frame.line, list(frame.robots)) for frame in survey.frames] == [
        ("0.png", 2, ["alpha", "bravo"]), ("1.png", 4, ["alpha"])
    ]  # fmt: skip
    assert [remark.partition(": ")[2] for remark in match_frames(survey, ["0.png", "1.png"], "film").remarks] == [
        "columns not looked at: 'by'"
    ]
    with pytest.raises(InputError, match="line 3: 'bravo' is not in the rig, expected one of alpha"):
        read_survey(path, ["alpha"])
    bare = written(tmp_path, "robot,frame,x_m,y_m,z_m\nalpha,0,1,2,3\n", "bare.CSV")
    assert read_survey(bare, ["alpha"], orientations=False).frames[0].robots["alpha"].orientation is None
    with pytest.raises(InputError, match="line 2: tells no orientation"):
        read_survey(bare, ["alpha"])


def test_every_missing_column_is_named(tmp_path: Path) -> None:
    names = HEADER.split(",")
    for gone in itertools.chain(names[:5], names[5:7]):
        header = ",".join(name for name in names if name != gone)
        with pytest.raises(InputError, match=f"column {gone.partition('_')[0]} is missing"):
            read_survey_csv(written(tmp_path, f"{header}\n"))
