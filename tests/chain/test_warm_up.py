"""The first start: what is compiled is what is needed, said, on all cores, whoever dies meanwhile."""

import ast
import io
import json
import os
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numba import types
from rich.console import Console

import asterism.protocol
import asterism.server
from asterism.server.chain import compile_beside, warm_up
from asterism.server.chain.compile_beside import divide
from asterism.server.chain.kernel_list import CHECK, DESIGN, LOCALIZE, SIMULATE, Entry, kernel_list, text_of, type_of
from asterism.server.identity.search import Spots
from asterism.server.service.telling import telling
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.measure.first_start import SCENARIOS

SERVER = Path(asterism.server.__file__).resolve().parent
SMALL = ("pose.fit.fit_room", "pose.fit.median_of", "segmentation.segment.describe", "chain.answers.tell_whose")

# A start that needs only a few small kernels, with two cores. Says which processes it starts.
START = f"""
import sys
from asterism.server.chain import compile_beside, warm_up
from asterism.server.chain.kernel_list import kernel_list
from asterism.server.service.telling import telling

start = compile_beside._start
def told():
    worker = start()
    print(worker.pid, flush=True)
    if "kill" in sys.argv:
        worker.kill()
    if "wait" in sys.argv:
        warm_up._SAID.info("waiting")
        sys.stdin.read()
    return worker

compile_beside._start = told
if "nowhere" in sys.argv:
    compile_beside.sys.executable = "/nowhere/python"
compile_beside.LEAST_SECONDS = 1e-3
warm_up.cores = lambda: 2
warm_up.kernel_list = lambda: [entry for entry in kernel_list() if entry.kernel in {SMALL}]
with telling():
    warm_up.warm_up("blobs", "localize")
"""


def start(cache: Path, *words: str, **options: Any) -> "subprocess.Popen[str]":
    """That start, with a cache of its own."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), **options.pop("env", {})}
    environment.pop("NUMBA_CACHE_DIR", None)
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", START, *words],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def ended(started: "subprocess.Popen[str]") -> tuple[list[int], str]:
    """The processes that it started, and what it said; it ended well."""
    out, said = started.communicate(timeout=120)
    assert started.returncode == 0, said
    return [int(line) for line in out.split()], said


def kept(cache: Path) -> set[str]:
    """The kernels on disk."""
    return {file.name.split("-")[0] for file in cache.rglob("*.nbc")}


NAMES = {name.split(".", 1)[1] for name in SMALL}


@pytest.fixture(scope="module")
def first_start(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int], str]:
    """The cache that a first start left, the processes that it started, and what it said."""
    cache = tmp_path_factory.mktemp("first")
    return cache, *ended(start(cache))


def test_both_cores_work_and_the_next_start_is_silent(first_start: tuple[Path, list[int], str]) -> None:
    cache, workers, said = first_start
    assert len(workers) == 2
    assert kept(cache) == NAMES
    lines = said.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("asterism: compiling 4 kernels for this machine, only the first time")
    assert lines[1].startswith("asterism: compiled 4 kernels in ")
    assert ended(start(cache)) == ([], "")


def test_a_process_that_dies_does_not_break_the_start(tmp_path: Path) -> None:
    workers, said = ended(start(tmp_path, "kill"))
    assert len(workers) == 2
    assert kept(tmp_path) == NAMES
    assert "compiled 4 kernels" in said


def test_without_processes_it_compiles_all_the_same(tmp_path: Path) -> None:
    workers, said = ended(start(tmp_path, "nowhere"))
    assert workers == []
    assert kept(tmp_path) == NAMES
    assert "compiled 4 kernels" in said


def test_two_starts_at_once(tmp_path: Path) -> None:
    first, second = start(tmp_path), start(tmp_path)
    told = [ended(first), ended(second)]
    assert kept(tmp_path) == NAMES
    # Whoever comes second says that it waits, or finds all done.
    assert sorted(len(workers) for workers, _ in told) == [0, 2]


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="awaits the end of a process that is not its child")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_is_left_behind(tmp_path: Path, how: signal.Signals) -> None:
    started = start(tmp_path, "wait")
    assert started.stdout is not None
    worker = int(started.stdout.readline())
    descriptor = os.pidfd_open(worker)  # readable once the process has ended
    started.send_signal(how)
    started.communicate(timeout=60)
    assert started.returncode not in (0, None)
    assert select.select([descriptor], [], [], 60)[0]
    os.close(descriptor)


def test_what_another_copy_has_compiled_does_not_silence_this_one(
    first_start: tuple[Path, list[int], str], tmp_path: Path
) -> None:
    shutil.copytree(first_start[0], tmp_path / "cache")
    copy = tmp_path / "copy" / "asterism"
    for package in (asterism.server, asterism.protocol):
        source = Path(package.__file__).resolve().parent
        shutil.copytree(source, copy / source.name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(Path(asterism.__file__), copy)
    workers, said = ended(start(tmp_path / "cache", cwd=copy.parent, env={"PYTHONPATH": str(copy.parent)}))
    assert len(workers) == 2
    assert "compiling 4 kernels" in said
    assert ended(start(tmp_path / "cache")) == ([], "")  # nor has it taken anything away


def test_where_nothing_can_be_kept_it_works_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    workers, said = ended(start(tmp_path / "file"))
    assert workers == []
    assert f"asterism: nothing can be kept for the next start ({tmp_path / 'file' / 'asterism'}" in said
    assert "next start has" not in said
    assert "compiled 4 kernels" in said


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_what_is_compiled_first_is_what_is_called(scenario: str) -> None:
    """If this fails, run `python -m tests.measure.first_start write`: the list of kernels is not what it was."""
    told = subprocess.run(
        [sys.executable, "-m", "tests.measure.first_start", "verify", scenario],
        stdout=subprocess.PIPE,
        check=True,
        cwd=SERVER.parent,
    ).stdout
    assert json.loads(told) == {"compiled": [], "not listed": [], "for nobody": []}


def test_types_survive_the_list() -> None:
    array, ints = types.Array(types.float64, 2, "C"), types.Array(types.int32, 1, "C")
    spots = types.BaseTuple.from_types([array, array, ints, ints, ints, ints], Spots)
    for kind in (array, ints, types.int64, types.boolean, types.npy_rng, types.UniTuple(types.int64, 3), spots):
        assert type_of(json.loads(json.dumps(text_of(kind)))) == kind
    with pytest.raises(TypeError, match="kernels that Python calls take numbers, whole arrays and tuples"):
        text_of(types.Array(types.float64, 2, "A"))


class Fake:
    """Stands in for an `Entry`."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.ready = seconds, 0

    def make_ready(self) -> None:
        self.ready += 1


def test_shares_take_about_the_same_time_and_keep_neighbours_together() -> None:
    entries: list[Any] = [Fake(seconds) for seconds in (9.0, 4.0, 2.0, 8.0, 1.0, 6.0)]
    shares = divide(entries, 2)
    assert shares == [entries[:3], entries[3:]]
    assert divide(entries, 1) == [entries]
    assert divide(entries[4:5], 2) == [entries[4:5]]
    assert [entry for share in divide(entries, 100) for entry in share] == entries
    assert len(divide(entries, 100)) <= compile_beside.MOST_PROCESSES


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    shown = io.StringIO()
    monkeypatch.setattr("rich.console.Console", lambda **_: Console(file=shown, force_terminal=True, width=80))
    monkeypatch.setattr(warm_up, "_shows", lambda: True)
    return shown


def test_the_bar_counts_every_kernel_and_ends_where_it_said(
    terminal: io.StringIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(warm_up, "cores", lambda: 1)
    entries: list[Any] = [Fake(1.0), Fake(5.0), Fake(2.0)]
    with telling():
        warm_up._compile(entries)
    assert [entry.ready for entry in entries] == [1, 1, 1]
    assert "3 of 3 kernels" in terminal.getvalue()
    assert "compiled 3 kernels in 0 s" in capsys.readouterr().err


def test_what_the_processes_leave_undone_is_done_here(terminal: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    entries: list[Any] = [Fake(10.0), Fake(10.0), Fake(10.0)]

    def beside(shares: Any) -> Iterator[Any]:
        assert len(shares) == 2
        yield entries[2]

    monkeypatch.setattr(warm_up, "cores", lambda: 2)
    monkeypatch.setattr(warm_up, "compile_beside", beside)
    warm_up._compile(entries)
    assert [entry.ready for entry in entries] == [1, 1, 0]
    assert "3 of 3 kernels" in terminal.getvalue()


NEEDY = ["demo", "doctor", "serve", "fuse_live", "fuse_recordings", "locate", "batch", "replay", "simulate", "check"]
NEEDY += [
    "coverage",
    "design",
    "report",
    *(f"calibrate_{kind}" for kind in ("camera", "world", "leds", "offset", "point", "surface", "z")),
]


@pytest.mark.parametrize("command", NEEDY)
def test_every_command_that_needs_kernels_warms_up(command: str) -> None:
    tree = ast.parse((SERVER / "command" / f"{command}.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    assert [call for call in calls if call.func.id == "warm_up" and call.args]  # type: ignore[attr-defined]


# example writes a camera.yaml as calibrations do; the others do what the needy ones work with.
PARTS = ["example", "cameras", "exported_smooth", "fitted_rig", "foreign_camera", "joined", "outlets", "simulated_film"]
PARTS += ["example_cameras", "placed_rigs", "recorded_film", "batch_films", "batch_progress", "fused_line", "__init__"]
PARTS += ["example_surface", "registered_surface"]


def test_other_commands_stay_light() -> None:
    others = [
        f"asterism.server.command.{file.stem}"
        for file in sorted((SERVER / "command").glob("*.py"))
        if file.stem not in [*NEEDY, *PARTS]
    ]
    assert "asterism.server.command.watch" in others
    code = f"import sys, importlib\nfor name in {others}: importlib.import_module(name)\nprint('numba' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"


def test_a_start_without_a_terminal_loads_no_more_than_it_needs() -> None:
    """A service that is started again is waited for: these were an eighth of its start."""
    code = """
import sys
import asterism.server.command.serve
from asterism.server.chain.warm_up import warm_up
warm_up("nothing")
from numba.core.registry import cpu_target
cpu_target.target_context.refresh()
print([name for name in ("numba.np.arraymath", "scipy.linalg", "rich") if name in sys.modules])
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "['numba.np.arraymath']\n"


PLATES = ("--robots", "2", "--disc", "0.1", "--spacing", "0.02", "--distance", "1.5", "--sigma", "0.05")


@pytest.mark.parametrize(
    ("command", "need"),
    [
        (["simulate", str(DEMO_RIG), "OUT", "--frames", "1"], SIMULATE),
        (["check", str(DEMO_RIG)], CHECK),
        (["design", *PLATES, "-o", "OUT"], DESIGN),
    ],
)
def test_a_command_warms_up_before_it_works(
    command: list[str], need: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = __import__(f"asterism.server.command.{command[0]}", fromlist=["run"])

    class Asked(BaseException):
        pass

    def ask(*needs: str) -> None:
        raise Asked(*needs)

    monkeypatch.setattr(module, "warm_up", ask)
    from asterism.server.__main__ import main

    words = [str(tmp_path / "out") if word == "OUT" else word for word in command]
    with pytest.raises(Asked) as asked:
        main(words)
    assert asked.value.args == (need,)


def test_localizing_needs_only_the_rigs_own_estimator() -> None:
    from asterism.protocol.rig import ESTIMATORS, load_rig

    needs = warm_up.localizing(load_rig(DEMO_RIG))
    assert ESTIMATORS[0] in needs
    assert LOCALIZE in needs
    assert not set(needs) & {*ESTIMATORS[1:], SIMULATE, CHECK, DESIGN}
    assert SIMULATE in warm_up.localizing(load_rig(DEMO_RIG), "sim")
    chosen: list[Entry] = [entry for entry in kernel_list() if not entry.needs.isdisjoint(needs)]
    assert [entry.kernel for entry in chosen if "_refine_" in entry.kernel] == ["centres.centre._refine_edge_model"]
