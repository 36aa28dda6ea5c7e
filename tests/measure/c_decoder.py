"""The client in C on mutated poses, and its memory: `python -m tests.measure.c_decoder [COUNT] [--seed N]`.

COUNT mutated messages are given to it, compiled with the sanitizers of addresses and undefined behaviour, and to
Python's client and protobuf, which must agree. Then memory, with every C compiler that is there: code at -Os, linked
with what it takes of the compiler's libraries too; a pose, a clock; the stack, at most: there is no recursion, so the
frames of all functions together.
"""

import argparse
import shutil
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from tests.clients.c_client import SOURCES, build
from tests.clients.c_judge import judge
from tests.protocol.mutated_clients import poses

A_ROUND = 10_000
FILES = sorted(SOURCES.glob("asterism_*.c"))
BOARDS = {
    "this machine": ("cc",),
    "Cortex-M0+, no FPU": ("arm-none-eabi-gcc", "-mthumb", "-mcpu=cortex-m0plus"),
    "Cortex-M4F, floats": ("arm-none-eabi-gcc", "-mthumb", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
}
ENTRIES = (
    "asterism_read_odometry",
    "asterism_clock_pose",
    "asterism_age_ns",
    "asterism_read_beat",
    "asterism_clock_beat",
)
SIZES = '#include "asterism_clock.h"\nchar pose[sizeof(asterism_odometry)], of_clock[sizeof(asterism_clock)];\n'


def _run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def _memory(folder: Path, compiler: tuple[str, ...], flags: tuple[str, ...]) -> tuple[int, str, int, int, int]:
    """Bytes of code, with library where that can be told, of a pose, of a clock, of stack."""
    how = (*compiler, *flags, "-std=c99", "-Os", f"-I{SOURCES}")
    tools = compiler[0].removesuffix("gcc").removesuffix("cc")
    objects = [str(folder / f"{file.stem}.o") for file in FILES]
    for file, made in zip(FILES, objects, strict=True):
        _run(*how, "-fstack-usage", "-c", str(file), "-o", made)
    code = sum(int(line.split()[0]) for line in _run(f"{tools}size", *objects).splitlines()[1:])
    stack = sum(int(line.split("\t")[1]) for made in folder.glob("*.su") for line in made.read_text().splitlines())
    (folder / "sizes.c").write_text(SIZES)
    _run(*how, "-fno-common", "-c", str(folder / "sizes.c"), "-o", str(folder / "sizes.o"))
    told = {
        line.split()[3]: int(line.split()[1], 16)
        for line in _run(f"{tools}nm", "-S", str(folder / "sizes.o")).splitlines()
    }
    return code, _linked(folder, how, tools), told["pose"], told["of_clock"], stack


def _linked(folder: Path, how: tuple[str, ...], tools: str) -> str:
    if not tools:
        return "-"
    program, wanted = str(folder / "linked"), [f"-Wl,-u,{entry}" for entry in ENTRIES]
    link = ("-ffunction-sections", "-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections", f"-Wl,-e,{ENTRIES[0]}")
    _run(*how, *link, *wanted, *map(str, FILES), "-o", program)
    return _run(f"{tools}size", program).splitlines()[1].split()[0]


def _print_memory() -> None:
    print(f"{'bytes':<32} {'code':>6} {'with library':>12} {'pose':>6} {'clock':>6} {'stack <=':>8}")
    for name, compiler in BOARDS.items():
        for flags in ((), ("-DASTERISM_FLOAT",)):
            if shutil.which(compiler[0]):
                with tempfile.TemporaryDirectory() as folder:
                    code, linked, pose, clock, stack = _memory(Path(folder), compiler, flags)
                kept = name + (", as floats" if flags else ", as doubles")
                print(f"{kept:<32} {code:6d} {linked:>12} {pose:6d} {clock:6d} {stack:8d}")


def main() -> None:
    """Mutate, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    told, began = Counter[str](), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        client = build(Path(folder))
        for turn, left in enumerate(range(options.count, 0, -A_ROUND)):
            told += judge(client, poses(), min(left, A_ROUND), np.random.default_rng([options.seed, turn]))
    print(f"{options.count} mutated messages, sanitizers {'on' if client.sanitized else 'not there'}, all agree:")
    for words, count in told.most_common():
        print(f"{count:8d} {words}")
    print(f"{time.process_time() - began:.0f} s of this process")
    _print_memory()


if __name__ == "__main__":
    main()
