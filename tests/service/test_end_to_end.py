"""The product as a user runs it: commands in processes of their own, a stranger's subscriber, one set of bytes."""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asterism.clients import PoseClient
from asterism.protocol.geometry import Pose, angle_between
from asterism.recordings.reader import Recording
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import shared
from tests.servers import Subscriber, asterism, free_endpoint, open_router, running, wait_for_line
from tests.wire_bytes import in_the_session_of, received_bytes, recorded_bytes

FRAMES = 45


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulated frames with truth, made by the command."""
    out = tmp_path_factory.mktemp("film") / "sim"
    done = asterism("simulate", DEMO_RIG, out, "--frames", FRAMES, "--seed", 4)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def served(film: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], Path]:
    """What a stranger's subscriber received of the film, and the recording made meanwhile."""
    folder, endpoint = tmp_path_factory.mktemp("served"), free_endpoint()
    with running(
        "serve", film / "rig.yaml", film / "frames", "--listen", endpoint, "--record", folder, "--rate", "60"
    ) as server:
        received = Subscriber(endpoint, folder / "received.jsonl").finish()
        assert server.wait(timeout=60) == 0
    return received, next(folder.glob("demo-*"))


@pytest.fixture(scope="module")
def located(film: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], str]:
    """The lines that `locate` wrote of the film, and what it said."""
    out = tmp_path_factory.mktemp("located") / "poses.jsonl"
    done = asterism("locate", film / "rig.yaml", film / "frames", "-o", out)
    assert done.returncode == 0, done.stderr
    return lines_of(out), done.stderr


@pytest.fixture(scope="module")
def serving(film: Path) -> Iterator[str]:
    """Where the simulated camera is served."""
    endpoint = free_endpoint()
    with running("serve", film / "rig.yaml", "sim", "--listen", endpoint) as server:
        wait_for_line(server, "serving 5 robots")
        yield endpoint


def lines_of(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def truth_of(film: Path) -> list[dict[str, Any]]:
    return lines_of(film / "truth.jsonl")


def test_every_message_arrives_in_order_with_the_right_pose(
    film: Path, served: tuple[list[dict[str, Any]], Path]
) -> None:
    received, _ = served
    truth = truth_of(film)
    for robot in ("alpha", "bravo", "charlie", "delta", "echo"):
        told = [entry for entry in received if entry.get("robot") == robot]
        assert [int(entry["metadata"]["sequence"]) for entry in told] == list(range(FRAMES))
        stamps = [entry["exposed_ns"] for entry in told]
        assert stamps == sorted(stamps)
        for entry in told:
            right = next(r for r in truth[int(entry["metadata"]["sequence"])]["robots"] if r["id"] == robot)
            a = Pose(np.array(entry["position"]), np.array(entry["orientation"]))
            b = Pose(np.array(right["position"]), np.array(right["orientation"]))
            assert np.linalg.norm(a.position - b.position) < 0.002
            assert angle_between(a.rotation, b.rotation) < np.radians(1.5)
            assert entry["frame_id"] == "world"
    assert sum(entry["key"] == "asterism/demo/frame" for entry in received) == FRAMES


def test_wire_recording_and_replay_have_the_same_bytes(
    served: tuple[list[dict[str, Any]], Path], tmp_path: Path
) -> None:
    received, folder = served
    recorded = recorded_bytes(folder)
    assert recorded == received_bytes(received)
    with open_router() as (router, _):
        # Through a router, as in an existing infrastructure, so that the subscriber is there from the first message.
        listener = Subscriber(router, tmp_path / "again.jsonl", "replay/asterism/**")
        done = asterism("replay", folder, "--connect", router, "--speed", "2")
        assert done.returncode == 0, done.stderr
        again = listener.finish()
    played = received_bytes(again)
    assert played == in_the_session_of(played, recorded)


def test_the_recorded_frames_solved_again_give_the_same_poses(
    film: Path, served: tuple[list[dict[str, Any]], Path], tmp_path: Path
) -> None:
    _, folder = served
    done = asterism("locate", film / "rig.yaml", folder, "-o", tmp_path / "again.jsonl")
    assert done.returncode == 0, done.stderr
    lines = lines_of(tmp_path / "again.jsonl")
    assert len(lines) == FRAMES
    told = {(entry["robot"], int(entry["metadata"]["sequence"])): entry for entry in served[0] if "robot" in entry}
    for sequence, line in enumerate(lines):
        for robot in line["robots"]:
            np.testing.assert_array_equal(robot["position"], told[robot["id"], sequence]["position"])


@pytest.mark.parametrize("way", ["forward", "both"])
def test_smoothed_poses_are_another_thing_and_say_so(
    film: Path, located: tuple[list[dict[str, Any]], str], tmp_path: Path, way: str
) -> None:
    out = tmp_path / "smoothed.jsonl"
    assert asterism("locate", film / "rig.yaml", film / "frames", "-o", out, "--smooth", way).returncode == 0
    for plain, smoothed in zip(located[0], lines_of(out), strict=True):
        assert plain["lost"] == smoothed["lost"]
        for before, after in zip(plain["robots"], smoothed["robots"], strict=True):
            assert "smoothed" not in before
            assert after["smoothed"] is True
            assert after["filter"].endswith("backwards") == (way == "both")
            assert len(after["velocity"]["covariance"]) == 36
            assert before["rms_px"] == after["rms_px"]
            away = np.linalg.norm(np.subtract(before["position"], after["position"]))
            assert away < 2e-3
            assert away > 0 or (plain["exposed_ns"] == located[0][0]["exposed_ns"] and way == "forward")


def test_a_server_that_smooths_says_so_on_the_wire(film: Path, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with running(
        "serve", film / "rig.yaml", film / "frames", "--listen", endpoint, "--rate", "60", "--smooth"
    ) as server:
        received = Subscriber(endpoint, tmp_path / "received.jsonl").finish()
        assert server.wait(timeout=60) == 0
    poses = [entry for entry in received if "robot" in entry]
    assert poses
    assert all(entry["metadata"]["smoothed"] == "true" and entry["metadata"]["filter"] for entry in poses)


def test_locate_writes_what_the_design_says(film: Path, tmp_path: Path) -> None:
    done = asterism("locate", film / "rig.yaml", film / "frames", "-o", tmp_path / "poses.jsonl", "--independent")
    assert done.returncode == 0, done.stderr
    lines = lines_of(tmp_path / "poses.jsonl")
    assert [line["frame"] for line in lines] == [f"{k:05d}.png" for k in range(FRAMES)]
    assert [line["exposed_ns"] for line in lines] == [round(k * 1e9 / 60) for k in range(FRAMES)]
    robot = lines[0]["robots"][0]
    assert set(robot) == {"id", "state", "position", "orientation", "covariance", "leds", "rms_px", "alternative"}
    assert (len(robot["covariance"]), robot["leds"], lines[0]["lost"]) == (36, 6, {})
    assert robot["orientation"][3] >= 0


def test_locate_says_who_was_found_and_on_a_pipe_nothing_before_the_end(
    film: Path, located: tuple[list[dict[str, Any]], str], tmp_path: Path
) -> None:
    lines = located[1].splitlines()
    assert lines[0] == f"asterism: {FRAMES} frames"
    assert lines[1] == f"asterism: alpha    {FRAMES} TRACKED"
    assert len(lines) == 6
    for part in ("rig.yaml", "camera.yaml"):
        (tmp_path / part).write_text((film / part).read_text().replace("range: [0.9, 1.6]", "range: [2.5, 4.0]"))
    done = asterism("locate", tmp_path / "rig.yaml", film / "frames", "-o", tmp_path / "none.jsonl")
    assert f"alpha    {FRAMES} LOST: its constellation is seen at 1.2" in done.stderr
    assert "nearer than range (2.5 m): change range, or move it" in done.stderr
    assert "but the rig's range is 2.5 to 4 m: change `range`" in done.stderr.splitlines()[-1]


def test_locate_stopped_by_ctrl_c_says_what_it_left_and_is_not_in_its_own_way(film: Path, tmp_path: Path) -> None:
    out, many = tmp_path / "poses.jsonl", tmp_path / "frames"
    many.mkdir()
    for number in range(3000):
        (many / f"{number:05d}.png").symlink_to(film / "frames" / f"{number % FRAMES:05d}.png")
    part = tmp_path / "poses.jsonl.partial"
    with running("locate", film / "rig.yaml", many, "-o", out) as locating:
        end = time.monotonic() + 60
        while not (part.exists() and part.stat().st_size):
            assert time.monotonic() < end
            time.sleep(0.01)
        locating.send_signal(signal.SIGINT)
        _, told = locating.communicate(timeout=60)
    lines = part.read_text().splitlines()
    assert (locating.returncode, out.exists()) == (130, False)
    assert 0 < len(lines) < 3000
    assert all(json.loads(line)["robots"] for line in lines)
    assert f"asterism: {len(lines)} frames of 3000" in told
    assert f"asterism: interrupted; what was done so far is in {part}" in told
    for file in list(many.iterdir())[3:]:
        file.unlink()
    assert asterism("locate", film / "rig.yaml", many, "-o", out).returncode == 0


def test_serve_stopped_by_ctrl_c_says_what_it_left(film: Path, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        PoseClient(endpoint) as robots,
        running("serve", film / "rig.yaml", "sim", "--listen", endpoint, "--record", tmp_path) as server,
    ):
        assert robots["alpha"].wait(60.0) is not None
        server.send_signal(signal.SIGINT)
        _, told = server.communicate(timeout=60)
    assert server.returncode == 0
    folder = next(tmp_path.glob("demo-*"))
    frames = Recording(folder).count_frames()
    assert f"asterism: stopped after {frames} frames, 0 dropped" in told
    assert f"asterism: alpha    {frames} TRACKED" in told
    assert f"asterism: recorded in {folder}" in told
    assert f" -m asterism review {folder}" in told


def test_watch_follows_a_replay_as_lines_of_json(served: tuple[list[dict[str, Any]], Path]) -> None:
    endpoint = free_endpoint()
    with (
        running("replay", served[1], "--loop", "--listen", endpoint) as replaying,
        running("watch", "alpha", "alhpa", "--prefix", "replay/", "--json", "--connect", endpoint) as watching,
    ):
        assert f"watch --prefix replay/ --connect {endpoint}" in wait_for_line(replaying, "watch it in another")
        assert watching.stdout is not None
        lines = map(json.loads, iter(watching.stdout.readline, ""))
        told = next(line for line in lines if line["type"] == "frame")
        assert "no rig here has a robot 'alhpa'; did you mean 'alpha'?" in wait_for_line(watching, "no rig")
        watching.send_signal(signal.SIGINT)
        assert watching.wait(timeout=30) == 0
    assert (told["camera"], [robot["id"] for robot in told["robots"]]) == ("demo", ["alpha"])


def test_a_pose_client_follows_a_running_server(film: Path) -> None:
    endpoint = free_endpoint()
    with PoseClient(endpoint) as robots, running("serve", film / "rig.yaml", "sim", "--listen", endpoint) as server:
        alpha = robots["alpha"]
        first = alpha.wait(60.0)
        assert first is not None
        following = alpha.wait(5.0)
        assert following is not None
        assert following.sequence > first.sequence
        assert following.age_s < 1.0
        end = time.monotonic() + 10
        while not (robots.alive and alpha.visible):  # tokens come on their own, not with the poses
            assert time.monotonic() < end
            time.sleep(0.01)
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=30) == 0
        end = time.monotonic() + 10
        while robots.alive or alpha.visible:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert alpha.latest(max_age_s=0.0) is None


def test_killed_in_the_middle_a_recording_loses_little_and_recovers(film: Path, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        PoseClient(endpoint) as robots,
        running("serve", film / "rig.yaml", "sim", "--listen", endpoint, "--record", tmp_path) as server,
    ):
        feed = robots["alpha"]
        first = feed.wait(60.0)
        assert first is not None
        while (newest := feed.wait(5.0)) is not None and newest.sequence < first.sequence + 150:
            pass
        server.kill()
        server.wait()
    assert newest is not None
    folder = next(tmp_path.glob("demo-*"))
    refused = asterism("review", folder, "-o", tmp_path / "x.rrd")
    assert refused.returncode == 2
    assert "was cut off" in refused.stderr
    assert f"asterism recover {folder}" in refused.stderr
    done = asterism("recover", folder)
    assert done.returncode == 0, done.stderr
    assert "messages over" in done.stdout
    last = max(m.sequence for m in Recording(folder).messages() if m.key.endswith("/alpha/odometry"))
    assert (newest.sequence - last) / 60.0 <= 1.5
    assert Recording(folder).count_frames() > 0
    assert asterism("recover", folder).stdout.count("whole") == 2


def test_as_live_is_refused_while_the_server_is_alive(serving: str, served: tuple[list[dict[str, Any]], Path]) -> None:
    refused = asterism("replay", served[1], "--as-live", "--connect", serving)
    assert refused.returncode == 2
    assert "camera 'demo' is being served already, by process" in refused.stderr


def test_an_endpoint_in_use_is_refused(film: Path, serving: str) -> None:
    refused = asterism("serve", film / "rig.yaml", "sim", "--listen", serving)
    assert refused.returncode == 2
    assert "the endpoint is already in use" in refused.stderr
    assert "--connect" in refused.stderr


def test_review_writes_a_rerun_recording(served: tuple[list[dict[str, Any]], Path], tmp_path: Path) -> None:
    import rerun as rr

    out = tmp_path / "review.rrd"
    done = asterism("review", served[1], "-o", out)
    assert done.returncode == 0, done.stderr
    paths: set[str] = set()
    for chunk in rr.chunk.RrdReader(str(out)).stream():
        paths.add(str(chunk.entity_path))
    for robot in ("alpha", "echo"):
        assert {
            f"/world/robots/{robot}",
            f"/plots/residual/{robot}",
            f"/states/{robot}",
            f"/world/paths/{robot}",
        } <= paths
    assert {
        "/world/camera/image",
        "/world/camera/image/spots",
        "/world/camera/image/residuals",
        "/plots/latency/solving",
        "/events",
    } <= paths


def test_the_demo_runs_and_says_where_to_look(tmp_path: Path) -> None:
    done = asterism("demo", "--seconds", "2", "--record", tmp_path / "rec", "--listen", free_endpoint())
    assert done.returncode == 0, done.stderr
    for words in ("asterism watch", "asterism replay", "asterism review", "watch --prefix replay/", "TRACKED", "alpha"):
        assert words in done.stdout
    recording = Recording(next((tmp_path / "rec").glob("demo-*")))
    assert recording.count_frames() > 0


def test_the_films_robot_goes_lost_at_once_and_is_back_at_once(tmp_path: Path) -> None:
    folder = shared("samples", "film")
    truth = json.loads((folder / "truth.json").read_text())
    out = tmp_path / "film.jsonl"
    done = asterism("locate", folder / "rig.yaml", folder / "frames", "-o", out)
    assert done.returncode == 0, done.stderr
    for line, frame in zip(lines_of(out), truth, strict=True):
        found = {robot["id"] for robot in line["robots"]}
        for robot in frame["robots"]:
            assert (robot["id"] in found) == (robot["visible"] >= 4), (frame["frame"], robot["id"])
