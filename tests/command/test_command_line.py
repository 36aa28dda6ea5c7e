"""The command line: help, lightness, and one sentence with exit code 2 for every kind of bad input."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.server.__main__ import main
from asterism.server.command import calibrate, parser
from asterism.server.command.shared_arguments import client_words
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.servers import asterism

COMMANDS = [[name] for name in parser.COMMANDS if name != "calibrate"]
ALL = [[], *COMMANDS, ["calibrate"], *(["calibrate", kind] for kind in calibrate.SUBCOMMANDS)]
HEAVY = ("cv2", "scipy", "numba", "rerun", "mcap", "matplotlib")


def imported(statement: str) -> set[str]:
    """The modules that a statement brings along, in a fresh interpreter."""
    code = f"{statement}\nimport sys; print('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_help_begins_with_lines_to_copy(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ALL:
        with pytest.raises(SystemExit) as ended:
            main([*words, "--help"])
        assert ended.value.code == 0
        told = capsys.readouterr().out
        assert told.startswith(" ".join(["asterism", *(words or ["demo"])]))
        assert "usage:" in told


def test_the_lines_to_copy_are_understood() -> None:
    shown = [parser.EXAMPLES, *(parser.module_of(" ".join(words)).EXAMPLES for words in ALL if words)]
    lines = [line.split("  ")[0] for text in shown for line in text.splitlines()]
    assert len(lines) > 25
    whole = parser.parser()
    for line in lines:
        words = shlex.split(line)
        assert words[0] == "asterism"
        whole.parse_args(words[1:])


def test_only_the_commands_that_are_asked_for_are_described() -> None:
    """Else a command would import what it does not need."""
    with pytest.raises(SystemExit):
        parser.parser(["watch"]).parse_args(["check", "rig.yaml"])


def test_help_and_clients_are_light() -> None:
    assert not imported("from asterism.server.command.parser import parser; parser([]).format_help()") & set(HEAVY)
    assert not imported("import asterism.clients") & set(HEAVY)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "frames"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.zeros((100, 100), np.uint8))
    return folder


def refused(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 2) -> str:
    """Run a command that must be refused; what it says, in one sentence."""
    try:
        given = main([str(argument) for argument in arguments])
    except SystemExit as ended:
        given = int(ended.code or 0)
    told = capsys.readouterr().err.strip()
    assert given == code, told
    assert told.startswith("asterism")
    assert "Traceback" not in told
    assert len(told.splitlines()) == 1, told
    return told


def test_bad_input_gets_one_sentence_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], frames: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.jsonl"
    text = DEMO_RIG.read_text()
    (tmp_path / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    (tmp_path / "typo.yaml").write_text(text.replace("range:", "rnage:"))
    (tmp_path / "void.yaml").write_text("camera: nothing.yaml\nrobots: {}\n")
    (tmp_path / "empty").mkdir()
    for arguments, words in (
        (("locate", "nowhere.yaml", frames, "-o", out), "nowhere.yaml: no such file"),
        (("locate", tmp_path / "typo.yaml", frames, "-o", out), "unknown key 'rnage'; did you mean 'range'?"),
        (("locate", tmp_path / "void.yaml", frames, "-o", out), "there is no file"),
        (("locate", DEMO_RIG, frames, "-o", out), "the image is 100x100, expected 1280x1024"),
        (("locate", DEMO_RIG, tmp_path / "empty", "-o", out), "holds no images"),
        (("locate", DEMO_RIG, tmp_path / "none", "-o", out), "there is no such source"),
        (("locate", DEMO_RIG, "sim", "-o", out), "sim: has no end; locate takes a folder"),
        (("locate", DEMO_RIG, frames, "-o", tmp_path / "no" / "x"), "there is no folder"),
        (("locate", DEMO_RIG, frames, "-o", out, "--smooth", "--independent"), "--independent and --smooth exclude"),
        (("locate", DEMO_RIG, frames), "expected -o OUT for lines, --record DIR for a recording, or both"),
        (("serve", DEMO_RIG, frames, "--listen", "here"), "endpoint 'here': expected PROTOCOL/ADDRESS"),
        (
            ("serve", DEMO_RIG, frames, "--listen", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:2"),
            "exclude each other",
        ),
        (("serve", DEMO_RIG, frames, "--rate", "0"), "argument --rate: 0, expected a number above 0"),
        (("serve", DEMO_RIG, frames, "--record-frames", "some"), "argument --record-frames: 'some'"),
        (("serve", DEMO_RIG, frames, "--zenoh", tmp_path / "none.json5"), "none.json5: no such file"),
        (("watch", "a/b"), "robot id 'a/b' holds '/'"),
        (("watch", "--connect", "127.0.0.1"), "endpoint '127.0.0.1': expected"),
        (("replay", frames), "is no recording"),
        (("replay", tmp_path / "none"), "there is no such recording"),
        (("replay", frames, "--speed", "nan"), "argument --speed: 'nan', expected a finite number"),
        (("review", frames, "-o", "x.rrd"), "is no recording"),
        (("compare", frames, frames), "is no recording"),
        (("recover", frames), "is no recording"),
        (("simulate", DEMO_RIG, frames), "exists already, expected a new or empty folder"),
        (("simulate", DEMO_RIG, tmp_path / "s", "--frames", "0"), "argument --frames: '0'"),
        (("simulate", DEMO_RIG, tmp_path / "s", "--hide", "2"), "argument --hide: 2, expected a number from 0 to 1"),
        (("simulate", DEMO_RIG, tmp_path / "s", "--glints", "-1"), "argument --glints: '-1', expected a"),
        (("nonsense",), "invalid choice: 'nonsense'"),
    ):
        assert words in refused(capsys, *arguments), arguments


def test_a_hint_how_to_watch_leads_to_where_the_server_is(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    for text, words, expected in (
        ("{}", [], []),
        ("{}", ["--listen", "tcp/127.0.0.1:7448"], ["--connect", "tcp/127.0.0.1:7448"]),
        ("{}", ["--connect", "tcp/10.0.0.1:7447"], ["--connect", "tcp/10.0.0.1:7447"]),
        ("{}", ["--zenoh", str(file)], []),
        ("{listen: {endpoints: ['tcp/127.0.0.1:9']}}", ["--zenoh", str(file)], ["--connect", "tcp/127.0.0.1:9"]),
        (
            "{mode: 'client', connect: {endpoints: ['tcp/10.0.0.1:9']}}",
            ["--zenoh", str(file)],
            ["--connect", "tcp/10.0.0.1:9"],
        ),
    ):
        file.write_text(text)
        assert client_words(parser.parser(["demo"]).parse_args(["demo", *words])) == expected


def test_a_camera_that_does_not_open_is_exit_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    told = refused(capsys, "serve", DEMO_RIG, "/dev/video97", "--listen", "tcp/127.0.0.1:0", code=1)
    assert "/dev/video97: the camera does not open: there is no /dev/video97; is it plugged in?" in told


def test_a_zenoh_infrastructure_that_is_not_there_is_exit_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    from tests.servers import free_endpoint

    told = refused(capsys, "serve", DEMO_RIG, "sim", "--connect", free_endpoint(), code=1)
    assert "nothing answers there" in told


def test_unreadable_images_are_named_skipped_and_counted(tmp_path: Path) -> None:
    made = asterism("simulate", DEMO_RIG, tmp_path / "s", "--frames", "3", "--rate", "20")
    assert made.returncode == 0, made.stderr
    bad = tmp_path / "s" / "frames" / "00001.png"
    bad.write_bytes(bad.read_bytes()[:5000])
    done = asterism("locate", tmp_path / "s" / "rig.yaml", tmp_path / "s" / "frames", "-o", "-")
    assert done.returncode == 0, done.stderr
    # The others have the times of their truth.
    assert [json.loads(line)["exposed_ns"] for line in done.stdout.splitlines()] == [0, 100_000_000]
    assert "00001.png: is cut off; skipped" in done.stderr
    assert "1 images could not be read" in done.stderr


def test_compare_tells_and_its_exit_code_says_whether_it_is_the_same(tmp_path: Path) -> None:
    from asterism.protocol.codec import stamped
    from asterism.server import Frame, Tracks, localize
    from asterism.server.chain.report import report
    from asterism.server.simulation.simulate import Scene
    from tests.recordings.test_recordings import FRAMES, RIG, START_NS, record  # noqa: F401

    scene, made = Scene(RIG, 0), []
    for index in range(2):
        frame = Frame(scene.render(index, scene.truth(index, 0.0)), START_NS + index, index)
        result, _ = localize(frame, RIG, Tracks.none())
        made.append((frame, [stamped(message, 0) for message in report(frame, result, RIG, 0)]))
    a, b = record(tmp_path / "a", made).folder, record(tmp_path / "b", made).folder
    same = asterism("compare", a, b)
    assert same.returncode == 0, same.stderr
    assert "within the tolerances" in same.stdout
    other = asterism("compare", a, record(tmp_path / "c", made[:1]).folder)
    assert other.returncode == 1
    assert "1 only in A" in other.stdout


def nonsense(folder: Path) -> list[Path]:
    """Files and names that no command can read."""
    contents: dict[str, bytes] = {
        "empty": b"",
        "binary": bytes(range(256)) * 8,
        "latin.yaml": b"camera: c\xe4mera.yaml\nrobots: {}\n",
        "deep": b"a: " + b"[" * 700,
        "zero.yaml": b"camera: a\0b\n",
        "list.yaml": b"- 1\n",
        "huge.yaml": b"camera: camera.yaml\nrange: [" + b"9" * 400 + b", 2]\nrobots: {}\n",
        "long.yaml": b"camera: " + b"x" * 400 + b"\nrobots: {}\n",
    }
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    (folder / "folder").mkdir()
    names = ["none", "folder", *contents, "x" * 300, "empty/x", "\udcff\udcfe"]
    return [folder / name for name in names]


def test_files_that_are_none_get_one_sentence_in_every_command(
    capsys: pytest.CaptureFixture[str], frames: Path, tmp_path: Path
) -> None:
    (tmp_path / "w").mkdir()
    out = tmp_path / "out"
    for file in nonsense(tmp_path / "w"):
        for arguments in (
            ("check", file),
            ("locate", file, frames, "-o", out),
            ("locate", DEMO_RIG, file, "-o", out),
            ("simulate", file, out),
            ("report", file, "-o", out),
            ("report", DEMO_RIG, "--truth", file, frames, "-o", out),
            ("serve", DEMO_RIG, frames, "--zenoh", file),
            ("replay", file),
            ("review", file, "-o", tmp_path / "out.rrd"),
            ("compare", file, file),
            ("recover", file),
            ("calibrate", "camera", file, "--target", "chessboard:9x6:0.02", "-o", out),
            ("calibrate", "camera", frames, "--target", f"leds:{file}", "-o", out),
            ("calibrate", "leds", file, frames, "--robot", "alpha", "--distance", "0,1=0.1", "-o", out),
            ("calibrate", "world", DEMO_RIG, frames, "--truth", file, "-o", out),
        ):
            refused(capsys, *arguments)
        assert not out.exists()


def test_numbers_that_are_none_get_one_sentence(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    for text in ("", "nan", "-inf", "-1", "²", "abc", "1,2", "9" * 9000, "0x10"):
        for option in ("--frames", "--rate", "--seed", "--hide", "--glints"):
            assert "expected a" in refused(capsys, "simulate", "none", out, f"{option}={text}")
        for arguments in (
            ("serve", DEMO_RIG, tmp_path, f"--record-frames={text}"),
            ("design", f"--robots={text}", "-o", out),
            ("replay", "none", f"--speed={text}"),
            ("compare", "none", "none", f"--position={text}"),
            ("calibrate", "camera", tmp_path, "--target", f"chessboard:{text}x6:0.02", "-o", out),
            ("calibrate", "leds", DEMO_RIG, tmp_path, "--robot", "alpha", "--distance", f"0,1={text}", "-o", out),
            ("calibrate", "offset", DEMO_RIG, tmp_path, "--truth", "none", "--window", f"1.5,{text}", "-o", out),
            ("serve", DEMO_RIG, tmp_path, "--listen", f"tcp/127.0.0.1:{text}"),
        ):
            refused(capsys, *arguments)
    for camera in ("²", "9" * 30, "/dev/videoX"):
        refused(capsys, "serve", DEMO_RIG, camera)


def test_what_is_nested_too_deeply_is_refused(capsys: pytest.CaptureFixture[str], frames: Path, tmp_path: Path) -> None:
    """A parser that calls itself would end the process, or with a traceback."""
    for bracket in "[{":
        (tmp_path / "deep").write_text('{"a":' * 3000 if bracket == "{" else bracket * 3000)
        told = refused(capsys, "serve", DEMO_RIG, frames, "--zenoh", tmp_path / "deep")
        assert "is nested too deeply, expected a zenoh configuration" in told
        survey = ("--truth", tmp_path / "deep", "-o", tmp_path / "out")
        assert "line 1: is no JSON" in refused(capsys, "calibrate", "world", DEMO_RIG, frames, *survey)
    (tmp_path / "deep").write_text("a: " + "[" * 1000)
    assert "is nested too deeply" in refused(capsys, "check", tmp_path / "deep")
