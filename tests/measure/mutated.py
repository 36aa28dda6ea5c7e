"""Mutated files and messages in great numbers: `python -m tests.measure.mutated [COUNT] [--seed N] [--only NAME]`.

COUNT in total, in rounds of ten thousand, each with a seed of its own: the first N, the next N + 1, and so on, so that
what was stopped goes on where it was. After every round the counts up to there are printed. What breaks the law is
written into mutated-found/, named after target, seed, number and exception, and belongs into tests/data/mutated once it
is mended.
"""

import argparse
import contextlib
import os
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.protocol.bounds import forget_peak
from tests.protocol.mutated_targets import TARGETS, Target, check

FOUND = Path("mutated-found")
A_ROUND = 10_000


@dataclass
class Count:
    """Of one target."""

    tried: int = 0
    read: int = 0
    broke: int = 0
    spent_s: float = field(default=0.0)
    slowest_s: float = field(default=0.0)


def _try(name: str, target: Target, count: int, seed: int, told: Count) -> None:
    rng = np.random.default_rng([seed, *name.encode()])
    for k in range(count):
        mutated = target.mutated(rng)
        began = time.process_time()
        try:
            told.read += check(target, mutated)
        except Exception as error:  # the very thing that is looked for
            told.broke += 1
            FOUND.mkdir(exist_ok=True)
            data = mutated if isinstance(mutated, bytes) else mutated.encode("utf-8", "surrogatepass")
            (FOUND / f"{name}-{seed}-{k}-{type(error).__name__}").write_bytes(data)
        took_s = time.process_time() - began
        told.tried += 1
        told.spent_s += took_s
        told.slowest_s = max(told.slowest_s, took_s)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Decoders of images write what they think to the error channel, past Python."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def main() -> None:
    """Try, and say for each target how many were read, refused, and broke the law."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=A_ROUND)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=TARGETS)
    options = parser.parse_args()
    counts = {name: Count() for name in TARGETS if options.only in (None, name)}
    forget_peak()
    warnings.simplefilter("error")  # as in the test suite
    for turn, left in enumerate(range(options.count, 0, -A_ROUND)):
        size = min(left, A_ROUND)
        with _silent():
            for name, told in counts.items():
                target = TARGETS[name]
                _try(
                    name,
                    target,
                    size if options.only else size * target.in_a_thousand // 1000,
                    options.seed + turn,
                    told,
                )
        print(f"after seed {options.seed + turn}:")
        _print(counts)


def _print(counts: dict[str, Count]) -> None:
    print(f"{'target':<12} {'tried':>8} {'read':>8} {'refused':>8} {'broke it':>9} {'ms each':>8} {'slowest ms':>10}")
    whole = Count(
        *(sum(getattr(told, name) for told in counts.values()) for name in ("tried", "read", "broke", "spent_s"))
    )
    whole.slowest_s = max(told.slowest_s for told in counts.values())
    for name, told in [*counts.items(), ("all", whole)]:
        refused, each = told.tried - told.read - told.broke, 1e3 * told.spent_s / max(told.tried, 1)
        print(
            f"{name:<12} {told.tried:8d} {told.read:8d} {refused:8d} {told.broke:9d} {each:8.3f} "
            f"{1e3 * told.slowest_s:10.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
