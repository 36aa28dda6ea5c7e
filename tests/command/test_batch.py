"""`asterism batch`: what it writes is what `locate` writes, however it is run, stopped and gone on with."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server import Frame, Tracks, localize
from asterism.server.__main__ import main
from asterism.server.chain.report import report
from asterism.server.command.batch import run
from asterism.server.command.batch_films import How, courses
from asterism.server.command.parser import parser
from asterism.server.command.report import _observe_batch
from asterism.server.service.batch import cluster, cutting
from asterism.server.service.batch.folder import HIDDEN, PLAN, Outcome, Result, held
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene

RIG = load_rig(DEMO_RIG)
FRAMES = 6


def shot(count: int, seed: int) -> list[Frame]:
    scene = Scene(RIG, seed)
    return [
        Frame(scene.render(k, scene.truth(k, k / 60)), 10**18 + k * 16_666_667, k, f"{k:06d}", 10**18)
        for k in range(count)
    ]


def images(folder: Path, frames: list[Frame], step: int = 1) -> str:
    folder.mkdir(parents=True)
    for frame in frames:
        cv2.imwrite(str(folder / f"{frame.index}.png"), frame.image[::step, ::step])
    return str(folder)


def recorded(parent: Path, rig: Rig, frames: list[Frame]) -> str:
    recorder, tracks = Recorder(parent, rig, "test", FramesKept(1), wait=True), Tracks.none()
    for frame in frames:
        result, tracks = localize(frame, rig, tracks)
        recorder.write(list(report(frame, result, rig, frame.exposed_ns)), frame.image, frame.exposed_ns, frame.index)
    recorder.close({})
    return str(recorder.folder)


def video(path: Path, frames: list[Frame]) -> str:
    size = frames[0].image.shape[::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 60.0, size, isColor=False)
    for frame in frames:
        writer.write(frame.image)
    writer.release()
    return str(path)


def told(folder: Path) -> dict[str, dict[str, object]]:
    return {film["name"]: film for film in json.loads((folder / "batch.json").read_bytes())["films"]}


def located(source: str, out: Path) -> bytes:
    assert main(["locate", str(DEMO_RIG), source, "-o", str(out), "--quiet"]) == 0
    return out.read_bytes()


def test_films_of_every_kind_have_the_lines_of_locate_and_one_that_fails_ends_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cutting, "LEAST_S", 0.05)
    monkeypatch.setattr(cutting, "LEAST_FRAMES", 3)
    monkeypatch.setattr(cutting, "PIECES", 16)
    frames = shot(FRAMES, 1)
    sources = {
        "monday": images(tmp_path / "monday" / "frames", frames),
        "tuesday": images(tmp_path / "tuesday" / "frames", shot(FRAMES, 2)),
        "film": video(tmp_path / "film.mkv", frames),
        Path(made := recorded(tmp_path, RIG, frames)).name: made,
    }
    wrong = images(tmp_path / "wrong", [replace(frame, image=np.zeros((90, 90), np.uint8)) for frame in frames[:2]])
    out = tmp_path / "out"
    words = ["batch", str(DEMO_RIG), *sources.values(), wrong, "-o", str(out)]
    assert main(words) == 1
    shown = capsys.readouterr()
    assert max(map(len, shown.out.splitlines())) <= 80
    assert "wrong failed:" in shown.out
    assert "90x90" in shown.err
    films = told(out)
    assert films["wrong"]["state"] == "failed"
    for name, source in sources.items():
        assert (out / f"{name}.jsonl").read_bytes() == located(source, tmp_path / f"{name}.jsonl"), name
        assert films[name]["frames"] == FRAMES
        assert films[name]["pieces"] == (1 if name == "film" else 2)
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.jsonl")}
    assert main(words) == 1
    assert f"{len(sources)} of {len(sources) + 1} films were done before" in capsys.readouterr().err
    assert before == {path: path.stat().st_mtime_ns for path in out.glob("*.jsonl")}


def test_what_was_killed_goes_on_and_leaves_nobody_behind(tmp_path: Path) -> None:
    source, out = images(tmp_path / "film", shot(25, 3)), tmp_path / "out"
    words = ["batch", str(DEMO_RIG), source, "-o", str(out)]
    process = subprocess.Popen([sys.executable, "-m", "asterism", *words], stderr=subprocess.DEVNULL)
    try:
        while not list(out.glob(".batch/*/*.marks.partial-*")):
            assert process.poll() is None
            time.sleep(0.01)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        workers = children.read_text().split() if children.exists() else []
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    while any(Path(f"/proc/{worker}/cmdline").exists() and _runs(worker) for worker in workers):
        time.sleep(0.01)
    assert not (out / "film.jsonl").exists()
    assert main(words) == 0
    assert (out / "film.jsonl").read_bytes() == located(source, tmp_path / "alone.jsonl")


def test_films_that_changed_are_solved_anew(tmp_path: Path) -> None:
    source, said = images(tmp_path / "film", shot(1, 0)), list[str]()
    (tmp_path / ".batch").mkdir()

    def keys(rig: Rig, independent: bool = False) -> list[str]:
        films = courses({"film": source}, rig, How(independent, None, None), tmp_path, 2, said.append)
        return [course.film.key for course in films]

    first = keys(RIG)
    assert keys(load_rig(DEMO_RIG)) == first
    assert said == []
    other = replace(RIG, robots=(replace(RIG.robots[0], leds=RIG.robots[0].leds + 1e-9), *RIG.robots[1:]))
    assert keys(other) != first
    assert keys(other, independent=True) != first
    cv2.imwrite(str(tmp_path / "film" / "0.png"), np.zeros((1024, 1280), np.uint8))
    assert keys(other, independent=True) != first
    assert [text.split(" changed")[0] for text in said] == ["film: the rig", "film: the options", "film: the source"]
    assert len(list((tmp_path / ".batch").glob("film.*"))) == 1


def _runs(worker: str) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{worker}/stat").read_text()
    except OSError:
        return False


def test_a_cluster_gives_the_same_lines(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: asterism-localization[cluster]")
    sources = [images(tmp_path / name, shot(4, seed)) for seed, name in enumerate(("one", "two"))]
    out = tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        words = ["batch", str(DEMO_RIG), *sources, "-o", str(out), "--dask", cluster.scheduler_address]
        assert main(words) == 0
    for source in sources:
        lines = (out / f"{Path(source).name}.jsonl").read_bytes()
        assert lines == located(source, tmp_path / f"{Path(source).name}.jsonl")


def test_two_batches_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = {
        "frame": "0.png",
        "exposed_ns": 5,
        "robots": [
            {"id": "alpha", "state": "TRACKED", "position": [0, 0, 1], "orientation": [0, 0, 0, 1], "rms_px": 0.1}
        ],
        "lost": {"bravo": "why"},
    }
    for name, z in (("a", 1.0), ("b", 1.0), ("c", 1.002)):
        line["robots"][0]["position"][2] = z  # type: ignore[index]
        (tmp_path / name).mkdir()
        (tmp_path / name / "film.jsonl").write_text(json.dumps(line) + "\n")
        film = {"name": "film", "source": "x", "state": "done", "file": "film.jsonl"}
        head = {"asterism": "1", "rig": "r", "independent": False, "smooth": None, "topic": None}
        (tmp_path / name / "batch.json").write_text(json.dumps({**head, "films": [film]}))
    a, b, c = (str(tmp_path / name) for name in "abc")
    assert main(["compare", a, b]) == 0
    assert main(["compare", a, c, "--position", "0.003"]) == 0
    capsys.readouterr()
    assert main(["compare", a, c]) == 1
    shown = capsys.readouterr().out.split()
    assert shown[-8:] == ["film", "alpha", "100.0%", "100.0%", "0", "1", "2", "0"]
    assert main(["compare", a, str(DEMO_RIG.parent)]) == 2


def test_a_report_takes_all_films_that_have_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    films = []
    for name in ("one", "two"):
        assert main(["simulate", str(DEMO_RIG), str(tmp_path / name), "--frames", "2", "--quiet"]) == 0
        films.append(Outcome(name, str(tmp_path / name / "frames"), "done"))
    (tmp_path / "two" / "truth.jsonl").unlink()
    seen = _observe_batch(RIG, Result("1", "r", False, None, None, films))
    assert seen is not None
    assert [name for name, _ in seen.found] == ["one/00000.png", "one/00001.png"]
    assert seen.surveyed.keys() == {"one/00000.png", "one/00001.png"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nothing-here"], "there is no such source"),
        (["film", "film/../film"], "are the same, or share it"),
        (["film", "film/*.png"], "are the same, or share it"),
        (["sim"], "has no end"),
        (["film", "-o", "full"], "is no batch's, expected a new or empty folder"),
        (["film", "--independent", "--smooth"], "exclude each other"),
        (["film", "--against", "film"], "expected the folder of a batch"),
        (["film", "--dask", "nonsense"], "--dask nonsense: "),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_done(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    images(tmp_path / "film", shot(1, 0))
    images(tmp_path / "full", shot(1, 0))
    out = [] if "-o" in words else ["-o", "out"]
    assert main(["batch", str(DEMO_RIG), *words, *out]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert sentence in told[-1]
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_does_not_answer_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cluster, "ANSWERS_S", 0.3)
    pytest.importorskip("distributed", reason="Dask is not installed: asterism-localization[cluster]")
    source = images(tmp_path / "film", shot(1, 0))
    assert main(["batch", str(DEMO_RIG), source, "-o", str(tmp_path / "out"), "--dask", "tcp://127.0.0.1:9"]) == 1
    assert "no scheduler answers there" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_in_which_a_batch_is_at_work_is_not_set_aside(tmp_path: Path) -> None:
    out, source = tmp_path / "out", images(tmp_path / "film", shot(1, 1))
    with held(out):
        (out / HIDDEN / PLAN).write_text("{}")
        for words in ([], ["--force"]):
            with pytest.raises(InputError, match="another batch is at work in it"):
                run(parser().parse_args(["batch", str(DEMO_RIG), source, "-o", str(out), *words]))
    assert not list(tmp_path.glob("out?*"))
