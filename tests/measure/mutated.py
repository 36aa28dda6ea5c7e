"""Mutated files and messages in great numbers: `python -m tests.measure.mutated [COUNT] [--seed N] [--only NAME]`.

COUNT in total, shared among the targets as the test suite shares its own. What breaks the law is written into
mutated-found/, named after target, number and exception, and belongs into tests/data/mutated once it is mended.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from tests.protocol.mutated_targets import TARGETS, check

FOUND = Path("mutated-found")


def main() -> None:
    """Try, and say for each target how many were read, refused, and broke the law."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=TARGETS)
    options = parser.parse_args()
    whole = sum(target.in_tests for target in TARGETS.values())
    print(f"{'target':<12} {'tried':>8} {'read':>8} {'refused':>8} {'broke it':>9} {'slowest s':>10}")
    for number, (name, target) in enumerate(TARGETS.items()):
        if options.only not in (None, name):
            continue
        rng = np.random.default_rng([options.seed, number])
        count = options.count if options.only else round(options.count * target.in_tests / whole)
        read = broke = 0
        slowest = 0.0
        for k in range(count):
            mutated = target.mutate(target.good, rng)
            began = time.perf_counter()
            try:
                read += check(target, mutated)
            except Exception as error:  # the very thing that is looked for
                broke += 1
                FOUND.mkdir(exist_ok=True)
                data = mutated if isinstance(mutated, bytes) else mutated.encode("utf-8", "surrogatepass")
                (FOUND / f"{name}-{options.seed}-{k}-{type(error).__name__}").write_bytes(data)
            slowest = max(slowest, time.perf_counter() - began)
        print(f"{name:<12} {count:8d} {read:8d} {count - read - broke:8d} {broke:9d} {slowest:10.2f}", flush=True)


if __name__ == "__main__":
    main()
